"""How the links of cflib_bridge are: told on /diagnostics, and a drone that is hardly reached any more is landed."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from rclpy.task import Future
from std_srvs.srv import Trigger

from flatsat_ros.crazyflie.link import (
    BAD_QUALITY,
    POOR_QUALITY,
    QUALITY,
    QUALITY_HOLD,
    LinkQuality,
    Reception,
    SupervisorInfo,
)
from flatsat_ros.crazyflie.outbox import Stream
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.diagnostics import Diagnostics, Level, RobotCondition
from flatsat_ros.nodes.ros.runtime import ProgramNode

if TYPE_CHECKING:
    from flatsat_ros.nodes.cflib_link import Link

_QUALITY_PERIOD = 0.2  # s between two looks at the link quality

# what of supervisor.info ends a flight, and how it is told; the first that holds is
_ENDED = {
    SupervisorInfo.LOCKED: "locked until reboot",
    SupervisorInfo.CRASHED: "crashed",
    SupervisorInfo.TUMBLED: "tumbled",
}


class LinkWatch:
    """Looks at the links of a node."""

    def __init__(self, node: ProgramNode, links: Sequence[Link], low_voltages: Sequence[float]) -> None:
        """Look at them from now on.

        Args:
            node: reports.
            links: to drones.
            low_voltages: of each drone, V: below that its battery is low.
        """
        self._links, self._low_voltages = links, low_voltages
        self._logger, self._faults = node.get_logger(), node.faults
        self._qualities = [LinkQuality() for _ in links]
        self._conditions = [link.condition for link in links]  # as told last
        self._landings = [node.create_client(Trigger, interfaces.service_of(link.robot, "land")) for link in links]
        node.create_timer(_QUALITY_PERIOD, self._look)
        Diagnostics(node, self._report)

    def _look(self) -> None:
        """Tell who is connected or why not, and whose radio is poor; land a drone that is hardly reached any more."""
        now = time.monotonic()
        for index, link in enumerate(self._links):
            if link.condition != self._conditions[index]:
                self._conditions[index] = link.condition
                if link.connected:
                    self._logger.info(f"{link.robot}: {link.condition}")
                else:
                    self._logger.warning(f"{link.robot}: {link.condition}")
        for link, quality, landing in zip(self._links, self._qualities, self._landings, strict=True):
            value = link.values.get(QUALITY)
            if value is None or not link.connected or not quality.measure(value, now):
                continue
            text = f"{link.robot}: link quality = {value:.0f} % for {QUALITY_HOLD:g} s"
            if quality.reception is Reception.POOR:
                self._logger.warning(f"{text}: must be above {POOR_QUALITY:g} %; at {BAD_QUALITY:g} % it lands")
            elif not link.outbox.flies(now):
                self._logger.error(f"{text}: it should not fly")
            elif not landing.service_is_ready():
                self._logger.error(f"{text}: land it: there is no service {landing.service_name} to ask")
            else:
                self._logger.error(f"{text}: {landing.service_name} is asked to land it")
                landing.call_async(Trigger.Request()).add_done_callback(
                    self._faults.contained(landing.service_name, partial(self._tell_refusal, link.robot))
                )

    def _tell_refusal(self, robot: str, answer: Future) -> None:
        if refusal := messages.refusal_from_answer(answer.result()):
            self._logger.error(f"{robot}: does not land: {refusal}")

    def _report(self, _now: int) -> list[RobotCondition]:
        """Return how every drone is."""
        reports = []
        for link, quality, low_voltage in zip(self._links, self._qualities, self._low_voltages, strict=True):
            level, text = _condition(link, quality.reception, low_voltage)
            values: dict[str, object] = {
                "uri": link.address.uri,
                "silent s": f"{link.silence:.2f}",
                "refused": self._faults.count(link.robot),
                "overtaken": link.outbox.overtaken,
                **{stream.value: link.outbox.sent[stream] for stream in Stream},
                "connections": link.connections,
                **{name: f"{value:.4g}" for name, value in dict(link.values).items()},
                "console": "\n".join(list(link.console)),
            }
            reports.append(RobotCondition(link.robot, link.address.uri, level, text, values))
        return reports


def _condition(link: Link, reception: Reception, low_voltage: float) -> tuple[Level, str]:
    """Return how well a drone is whose battery is low below a voltage, V, and its condition in a few words."""
    flags = int(link.values.get("supervisor.info", 0))
    if link.outbox.stopped:
        return Level.ERROR, "emergency stop"
    if not link.connected:
        return Level.ERROR, link.condition
    for flag, text in _ENDED.items():
        if flags & flag:
            return Level.ERROR, text
    if link.values.get("pm.vbat", math.inf) < low_voltage:
        return Level.WARN, "battery low"
    if reception is not Reception.GOOD:
        return (Level.WARN if reception is Reception.POOR else Level.ERROR), f"link {reception.name.lower()}"
    return Level.OK, link.condition

"""One drone's connection through cflib: a thread that opens it, feeds it, notices that it is gone and opens it again.

cflib is GPL: this module is loaded by the executable cflib_bridge only.

Nothing of the drone's is asked before a set-point may fly: from its first answer on it gets the newest set-point, each
message once. So silence of the controller is silence on the radio, and the firmware's watchdogs keep their meaning.
"""

from __future__ import annotations

import logging
import math
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import cflib.crtp
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crtp.crtpstack import CRTPPacket, CRTPPort

from flatsat_ros.base.errors import one_line
from flatsat_ros.crazyflie.link import QUALITY, Address
from flatsat_ros.crazyflie.outbox import Outbox
from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.nodes.cflib_sender import CflibSender, Turn

_RETRY = 1.0  # s between two attempts to reach a drone that does not answer
_LOOK = 0.02  # s between two looks at the link while there is nothing to send
_STATUS_PERIOD = 500  # ms, of battery and supervisor
_CONSOLE_LINES = 5
DEAD_STREAM = 2.0  # s without a report that was asked for, of a drone that is heard
CONSOLE_CHARACTERS = 300  # of one line
_ARMING_ANSWERED = 0x81  # crtp_supervisor.c: CMD_ARM_SYSTEM, answered; then whether it was done
_CFLIB_PREFIX = "Couldn't load link driver: "

POSITION = ("stateEstimate.x", "stateEstimate.y", "stateEstimate.z")
# as half floats, so that one packet holds the pose
QUATERNION = ("stateEstimate.qx", "stateEstimate.qy", "stateEstimate.qz", "stateEstimate.qw")
VOLTAGE, SUPERVISOR = "pm.vbat", "supervisor.info"


@dataclass
class _Stream:
    """What a drone was asked to report regularly.

    Attributes:
        block: its variables, as cflib knows them.
        heard: when it came last, or was asked for, monotonic s.
        ask: asks for it anew.
    """

    block: LogConfig
    heard: float
    ask: Callable[[], None]


@dataclass(frozen=True)
class Settings:
    """What all links have in common.

    Attributes:
        pose_period: ms, a multiple of 10, of the on-board estimate; 0 does not ask for it.
        timeout: s without any packet after which a connection counts as lost.
        cache: folder for the tables of contents that drones send, without which connecting takes seconds; None: none.
    """

    pose_period: int
    timeout: float
    cache: str | None


class _Crazyflie(Crazyflie):  # type: ignore[misc]
    """cflib's Crazyflie that only notes the errors of its link.

    cflib closes the link right where the error is noticed. If that is within send_packet, it waits for its own ping
    thread while it holds the lock that the ping thread waits for.
    """

    error = ""
    heard = -math.inf  # monotonic s

    def note_packet(self, _packet: object) -> None:
        """Remember when the drone was heard last."""
        self.heard = time.monotonic()

    def note_error(self, text: str) -> None:
        """Take the first error for the reason."""
        self.error = self.error or text

    _link_error_cb = note_error


class Link:
    """One drone.

    Attributes:
        robot, address: who.
        condition: a few words about the connection, or why there is none.
        connected: whether the drone answers.
        values: by name, what the drone last told.
        connections: how often it has begun to answer.
        console: the last lines the drone printed.
        outbox: what it is to be sent.
    """

    def __init__(
        self,
        robot: str,
        address: Address,
        outbox: Outbox,
        settings: Settings,
        on_pose: Callable[[tuple[float, ...], tuple[float, ...]], None],
        on_battery: Callable[[float], None],
        on_line: Callable[[str], None],
    ) -> None:
        """Prepare; `start` connects.

        Args:
            robot: its name.
            address: where it is.
            outbox: what it is to be sent.
            settings: common to all links.
            on_pose: called with position, m, and quaternion, x, y, z, w, in a thread of cflib's.
            on_battery: called with the voltage, V, likewise.
            on_line: called with each line of the console, likewise.
        """
        self.robot, self.address = robot, address
        self.condition, self.connected = "not connected", False
        self.values: dict[str, float] = {}
        self.connections = 0
        self.console: deque[str] = deque(maxlen=_CONSOLE_LINES)
        self.outbox = outbox
        self._settings, self._on_pose, self._on_battery, self._on_line = settings, on_pose, on_battery, on_line
        self._wake, self._leaving = threading.Event(), threading.Event()
        self._line = ""
        self._streams: list[_Stream] = []
        self._heard = 0.0
        self._thread = threading.Thread(target=self._run, name=f"link of {robot}", daemon=True)

    @property
    def silence(self) -> float:
        """Return the time since the drone's last packet, s."""
        return time.monotonic() - self._heard

    def start(self) -> None:
        """Connect, and stay connected."""
        self._thread.start()

    def command(self, setpoint: WireSetpoint) -> None:
        """Send a set-point that `crazyflie.link.sendable` returned, unless a newer one comes before its turn."""
        self.outbox.command(setpoint, time.monotonic())
        self._wake.set()

    def locate(self, position: tuple[float, ...], quaternion: tuple[float, ...] | None) -> None:
        """Send an external position, m, or pose; both finite."""
        self.outbox.locate(position, quaternion, time.monotonic())
        self._wake.set()

    def stop_motors(self) -> None:
        """Emergency stop, sent over and over; nothing else is sent any more, not even after a reconnection."""
        self.outbox.stop_motors()
        self._wake.set()

    def arm(self, armed: bool) -> bool:
        """Send an arming request; return False if there is no connection to send it on."""
        if self.connected:
            self.outbox.arm(armed)
            self._wake.set()
        return self.connected

    def leave(self) -> None:
        """Send what the drone needs to be left alone, and end."""
        self.outbox.leave()
        self._leaving.set()
        self._wake.set()

    @property
    def alive(self) -> bool:
        """Whether the link is still at work, after `leave` with its last packets."""
        return self._thread.is_alive()

    def _run(self) -> None:
        """Connect again and again: at once when a connection was lost, for a drone in flight has two seconds."""
        while not self._leaving.is_set():
            cf = _Crazyflie(rw_cache=self._settings.cache)
            lost = False
            try:
                lost = self._serve(cf)
            except Exception as error:  # cflib raises just that; it ends the connection, not the link
                cf.error = str(error)
            self.connected = False
            if cf.error:
                # what follows is a traceback
                self.condition = " ".join(cf.error.partition("\n\n")[0].removeprefix(_CFLIB_PREFIX).split())
            _close(cf)
            if not lost:
                self._leaving.wait(_RETRY)

    def _serve(self, cf: _Crazyflie) -> bool:
        """Open a connection and send until it is lost or nothing is left; return whether the drone answered."""
        ready, sender = threading.Event(), CflibSender(cf)
        cf.connection_failed.add_callback(lambda _, text: cf.note_error(text))
        cf.connected.add_callback(lambda _: ready.set())
        self._attach(cf)
        # a request or a report from before may be about a drone that was rebooted since
        self.outbox.forget_requests()
        self.values.clear()
        self._streams.clear()
        self._heard = opened = time.monotonic()
        cf.open_link(self.address.uri)
        if cf.link:
            self.outbox.pulled = False
            if hasattr(cf.link, "_radio"):
                Turn(cf, self.outbox, lambda: self.connected)
            else:
                # over UDP a single lost packet would end the connection's set-up; a radio's driver repeats by itself,
                # and requests sent again meanwhile would take the turns of set-points
                cf.link.needs_resending = True
        while not cf.error:
            self._wake.wait(min(self.outbox.wait(time.monotonic()), _LOOK))
            self._wake.clear()
            answered = cf.heard > opened
            self._heard = max(cf.heard, opened)
            if answered and not self.connected:
                self.connected, self.condition = True, "connected"
                self.connections += 1
            if ready.is_set():
                ready.clear()
                self._listen(cf)
            self._listen_again(cf)
            if not (self.outbox.send(sender, time.monotonic()) if answered else not self._leaving.is_set()):
                break
            if self.silence > self._settings.timeout:
                cf.note_error(f"silent for {self._settings.timeout:g} s")
        return self.connected

    def _attach(self, cf: _Crazyflie) -> None:
        """Hear what the drone says unasked."""
        cf.packet_received.add_callback(cf.note_packet)
        cf.console.receivedChar.add_callback(self._on_console)
        cf.add_port_callback(CRTPPort.SUPERVISOR, self._on_supervisor)
        cf.link_statistics.link_quality_updated.add_callback(partial(self.values.__setitem__, QUALITY))
        cf.link_statistics.latency_updated.add_callback(partial(self.values.__setitem__, "latency ms"))

    def _listen(self, cf: _Crazyflie) -> None:
        """Have the drone report its battery and supervisor, and its estimate if that was asked for."""
        known = [name for name in (VOLTAGE, SUPERVISOR) if cf.log.toc.get_element_by_complete_name(name)]
        if known:
            self._log(cf, _STATUS_PERIOD, dict.fromkeys(known), self._on_status)
        if self._settings.pose_period:
            variables = {**dict.fromkeys(POSITION, "float"), **dict.fromkeys(QUATERNION, "FP16")}
            self._log(cf, self._settings.pose_period, variables, self._on_estimate)

    def _log(
        self, cf: _Crazyflie, period: int, variables: Mapping[str, str | None], take: Callable[[dict[str, float]], None]
    ) -> None:
        block = LogConfig(",".join(variables), period)
        for name, kind in variables.items():
            block.add_variable(name, kind)
        report = _Stream(block, time.monotonic(), lambda: self._log(cf, period, variables, take))

        def hear(_stamp: int, data: dict[str, float], _block: LogConfig) -> None:
            report.heard = time.monotonic()
            take(data)

        block.data_received_cb.add_callback(hear)
        self._streams.append(report)
        try:
            cf.log.add_config(block)
        except KeyError as error:
            cf.note_error(f"the firmware logs no such thing: {error}")
        else:
            block.start()

    def _listen_again(self, cf: _Crazyflie) -> None:
        """Ask again for what the drone has stopped to report, although it was told to and is still heard."""
        for report in [report for report in self._streams if cf.heard - report.heard > DEAD_STREAM]:
            self._streams.remove(report)
            self._tell(f"no {report.block.name} for {DEAD_STREAM:g} s: asked for again")
            report.block.delete()
            report.ask()

    def _on_status(self, data: dict[str, float]) -> None:
        """Take what is a number; other firmware may log other types under these names."""
        told = {name: value for name, value in data.items() if math.isfinite(value)}
        self.values.update(told)
        if VOLTAGE in told:
            self._on_battery(told[VOLTAGE])

    def _on_estimate(self, data: dict[str, float]) -> None:
        self._on_pose(tuple(data[name] for name in POSITION), tuple(data[name] for name in QUATERNION))

    def _on_supervisor(self, packet: CRTPPacket) -> None:
        """Tell of a request to arm that was refused: none to disarm ever is."""
        if packet.datal[:2] == [_ARMING_ANSWERED, False]:
            self._tell("the drone refuses to arm")

    def _on_console(self, text: str) -> None:
        """Collect lines from the pieces that packets hold; one that does not end is told in parts."""
        *lines, self._line = (self._line + text).split("\n")
        if len(self._line) > CONSOLE_CHARACTERS:
            lines, self._line = [*lines, self._line], ""
        for line in filter(None, (one_line(line, CONSOLE_CHARACTERS) for line in lines)):
            self._tell(line)

    def _tell(self, line: str) -> None:
        self.console.append(line)
        self._on_line(line)


def initialise() -> None:
    """Load cflib's drivers. Of its log everything that matters comes to us by callbacks as well."""
    cflib.crtp.init_drivers()
    logging.getLogger("cflib").setLevel(logging.CRITICAL + 1)
    # for old firmware cflib sends the old packets
    warnings.filterwarnings("ignore", message="The supervisor subsystem requires CRTP protocol version 12")


def _close(cf: _Crazyflie) -> None:
    """Close the link itself first: close_link would send a set-point without thrust, in the air a cut.

    The rest waits a second for cflib's threads, which a drone in flight does not have.
    """
    if cf.link:
        cf.link.close()

    def dispose() -> None:
        cf.link_statistics.stop()
        cf.close_link()

    threading.Thread(target=dispose, name="closing", daemon=True).start()

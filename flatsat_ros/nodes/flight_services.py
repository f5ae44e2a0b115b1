"""The services by which a flight is begun, held, ended and handed over, for each robot and for all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from std_srvs.srv import SetBool, Trigger

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.nodes.flight_report import ThrottledLog
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.runtime import ProgramNode

Answer = TypeVar("Answer", SetBool.Response, Trigger.Response)


class FlightServices:
    """Answers requests drone by drone: what is refused for one does not stop the others."""

    def __init__(
        self,
        node: ProgramNode,
        robots: Sequence[str],
        actions: Mapping[str, Callable[[int], str | None]],
        arm: Callable[[int, bool], str | None],
        log: ThrottledLog,
        breathe: Callable[[], None],
    ) -> None:
        """Offer the services.

        Args:
            node: offers them.
            robots: names.
            actions: by name, see `interfaces.TRIGGERS`: does it with one drone, given its number, and returns what
                there is to say; raises FlatsatError to refuse.
            arm: arms (True) or disarms one drone in the same manner.
            log: tells of what is refused.
            breathe: does what cannot wait until many drones have been asked.
        """
        self._node, self._robots, self._log, self._breathe = node, list(robots), log, breathe
        for robot in (*robots, interfaces.ALL):
            indices = range(len(self._robots)) if robot == interfaces.ALL else [self._robots.index(robot)]
            for name in interfaces.TRIGGERS:
                self._offer(robot, name, indices, actions[name])
            self._offer_arming(robot, indices, arm)

    def _offer(self, robot: str, name: str, indices: Sequence[int], act: Callable[[int], str | None]) -> None:
        def trigger(_: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
            return self._answer(answer, name, indices, act)

        self._node.create_service(Trigger, interfaces.service_of(robot, name), trigger)

    def _offer_arming(self, robot: str, indices: Sequence[int], act: Callable[[int, bool], str | None]) -> None:
        def arm(request: SetBool.Request, answer: SetBool.Response) -> SetBool.Response:
            wanted = messages.arming_from_request(request)
            return self._answer(answer, "arm" if wanted else "disarm", indices, lambda index: act(index, wanted))

        self._node.create_service(SetBool, interfaces.service_of(robot, interfaces.ARM), arm)

    def _answer(self, answer: Answer, name: str, indices: Sequence[int], act: Callable[[int], str | None]) -> Answer:
        """Do something with some drones and say how it went for each."""
        refused, done = [], []
        for index in indices:
            robot = self._robots[index]
            self._breathe()
            try:
                done.append(act(index))
            except FlatsatError as error:
                refused.append(f"{robot}: {name} refused: {error}")
            except Exception as error:
                self._node.faults.note(f"{robot}/{name}", error)
                refused.append(f"{robot}: {name} failed by an error of the program: see the log")
        messages.fill_answer(answer, not refused, "; ".join(refused + [sentence for sentence in done if sentence]))
        self._log.refusals(", ".join(self._robots[index] for index in indices), refused)
        return answer

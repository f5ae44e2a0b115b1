"""Which of crazyswarm2's back ends the set-points of each drone go to: they disagree on the sign of the pitch.

Of crazyswarm2's servers only that of cflib lets log blocks be added while it runs, so that its services tell.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import Enum

from flatsat_ros.crazyflie.wire import Backend
from flatsat_ros.nodes.ros import interfaces
from flatsat_ros.nodes.ros.parameters import declare_choice
from flatsat_ros.nodes.ros.runtime import ProgramNode


class BackendChoice(str, Enum):
    """The back end; AUTO finds it out."""

    AUTO = "auto"
    CPP = "cpp"
    CFLIB = "cflib"


class Backends:
    """The back end of each drone, as far as it is known."""

    def __init__(self, node: ProgramNode, robots: Sequence[str], flies: Callable[[int], bool]) -> None:
        """Declare the parameter.

        Args:
            node: looks, and tells.
            robots: names of the drones.
            flies: whether a drone, by its number, is in the air: then its back end does not change.
        """
        choice = declare_choice(node, "backend", BackendChoice, "crazyswarm2 back end, gives the sign of the pitch")
        self._node, self._robots, self._flies = node, list(robots), flies
        self._is_given = choice is not BackendChoice.AUTO
        self._backends = [Backend(choice.value) if self._is_given else Backend.CPP] * len(robots)
        self._linked = [False] * len(robots)
        self._told = [""] * len(robots)

    def of(self, index: int) -> Backend:
        """Return the back end that the set-points of drone index go to."""
        return self._backends[index]

    def look(self, index: int) -> None:
        """Look who takes the set-points of drone index now, and tell what has changed."""
        robot = self._robots[index]
        service = interfaces.drone_service_of(robot, interfaces.ADD_LOGGING)
        full_name = self._node.resolve_service_name(service)
        linked = self._node.count_subscribers(interfaces.COMMAND.of(robot)) > 0
        if self._linked[index] and not linked:
            self._node.get_logger().error(f"{robot}: nobody takes its set-points any more: its link has ended")
        if linked and not self._linked[index]:
            self._told[index] = ""
        self._linked[index] = linked
        if self._is_given or not linked:
            return
        offered = self._node.count_services(full_name) > 0
        found = Backend.CFLIB if offered else Backend.CPP
        why = f"{service} is {'offered' if offered else 'not offered'}"
        if found is not self._backends[index] and self._flies(index):
            text = f"{robot}: {why}, but it flies with backend {self._backends[index].value}: land it"
            if text != self._told[index]:
                self._node.get_logger().error(text)
        else:
            self._backends[index] = found
            text = f"{robot}: backend {found.value}: {why}"
            if text != self._told[index]:
                self._node.get_logger().info(text)
        self._told[index] = text

"""What RViz shows and recordings keep: drones, their names, references and tubes, and the box, as markers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from flatsat_ros.base.colours import colour_of
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.path_limits import ReferenceBox
from flatsat_ros.flight.tick import Tick
from flatsat_ros.nodes.ros import interfaces
from flatsat_ros.nodes.ros.marker_messages import Shape, markers_message
from flatsat_ros.nodes.ros.runtime import ProgramNode

_PERIOD = 0.1  # s
# m: of a drone, and of the dot that is its reference
_DRONE, _DOT = (0.12, 0.12, 0.03), (0.03, 0.03, 0.03)
_TEXT, _ABOVE = 0.08, 0.12  # m, height of names, and how far above the drone they stand
_GREY = (0.5, 0.5, 0.5)


class Markers:
    """Publishes the newest tick as markers, ten times a second, while somebody listens."""

    def __init__(
        self,
        node: ProgramNode,
        robots: Sequence[str],
        world: str,
        box: ReferenceBox,
        newest: Callable[[], tuple[Tick, np.ndarray] | None],
    ) -> None:
        """Begin to publish.

        Args:
            node: publishes.
            robots: names of the drones.
            world: frame of the markers.
            box: room for references; where it has no end no box is shown.
            newest: returns the newest tick and the drones' positions (N, 3), m; None before the first.
        """
        topic = interfaces.MARKERS
        self._publisher = node.create_publisher(topic.kind, topic.suffix, topic.publish)
        self._node, self._robots, self._world, self._newest = node, list(robots), world, newest
        corners = np.array([box.low, box.high])
        self._box = [Shape("box", 0, "lines", (0.0, 0.0, 0.0), (0.01, 0.01, 0.01), _GREY, 0.6, points=_edges(corners))]
        if not np.isfinite(corners).all():
            self._box = []
        node.create_timer(_PERIOD, self._publish)

    def _publish(self) -> None:
        if not self._publisher.get_subscription_count():
            return
        found = self._newest()
        if found is not None:
            shapes = self._box + [shape for index in range(len(self._robots)) for shape in self._of(index, *found)]
            now = self._node.get_clock().now().nanoseconds
            self._publisher.publish(markers_message(self._world, now, 5.0 * _PERIOD, shapes))

    def _of(self, index: int, tick: Tick, places: np.ndarray) -> list[Shape]:
        """Return the shapes of one drone."""
        name, colour = self._robots[index], _rgb(colour_of(index))
        place = tuple(map(float, places[index]))
        shapes = [
            Shape("drone", index, "cylinder", place, _DRONE, colour, 1.0),
            Shape("name", index, "text", (*place[:2], place[2] + _ABOVE), (_TEXT,) * 3, colour, 1.0, text=name),
        ]
        if tick.mode[index] != Mode.FLY:
            return shapes
        reference = tuple(map(float, tick.reference[index, :3]))
        shapes.append(Shape("reference", index, "sphere", reference, _DOT, colour, 1.0))
        tube = tick.assessment.tube
        if tube is not None:
            wide, high = (2.0 * float(radius) for radius in np.broadcast_to(tube, (len(self._robots), 2))[index])
            shapes.append(Shape("tube", index, "sphere", reference, (wide, wide, high), colour, 0.2))
        return shapes


def _rgb(colour: str) -> tuple[float, float, float]:
    """Return red, green and blue, 0 to 1, of #rrggbb."""
    red, green, blue = (int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return red, green, blue


def _edges(corners: np.ndarray) -> list[tuple[float, float, float]]:
    """Return the ends of the twelve edges of a box, in pairs, from its corners (2, 3), m."""
    ends = []
    for axis in range(3):
        for other in range(4):
            sides = [other & 1, other >> 1]
            sides.insert(axis, 0)
            for side in (0, 1):
                sides[axis] = side
                ends.append((float(corners[sides[0], 0]), float(corners[sides[1], 1]), float(corners[sides[2], 2])))
    return ends

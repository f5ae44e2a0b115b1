"""Where drones are now, for the planner: the places from which a running controller can let them set out.

A drone that flies sets out from the place that it holds, its pose less the error that telemetry tells; one on the
ground from `ABOVE` over its pose, where the controller lets it climb first. `python -m
flatsat_ros.nodes.present_places --ros-args -p robot_names:="[cf1]"` prints them as JSON, or one line of why not.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError, refusal
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.nodes.pose_sources import PoseSource, PoseSources
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.parameters import declare, declare_robots, require_known_parameters
from flatsat_ros.nodes.ros.runtime import ProgramNode, run

ABOVE = 0.5  # m, over a drone on the ground
_GROUND = (Mode.IDLE, Mode.UNLOCK, Mode.CUT, Mode.REST)
_ERROR, _MODE = slice(FIELDS.index("error_x"), FIELDS.index("error_x") + 3), FIELDS.index("mode")
_LOOK_PERIOD, _HEARD, _PATIENCE = 0.05, 0.6, 10.0  # s: between looks, how long is listened, and until it gives up
_STILL = 0.03  # m, that a place may wander meanwhile


class PresentPlaces(ProgramNode):
    """Listens to poses and telemetry of some drones until it knows where they are.

    Attributes:
        places: of the drones, by name, (3,) m; None until all are known.
        refused: why they are not known in the end; empty where they are.
    """

    def __init__(self) -> None:
        """Subscribe to what the parameter robot_names says."""
        super().__init__("flatsat_present_places")
        self._robots = [robot.name for robot in declare_robots(self)]
        world = declare(self, "world_frame", "world", "frame_id of poses")
        require_known_parameters(self)
        self.places: Mapping[str, FloatArray] | None = None
        self.refused = ""
        self._poses = PoseSources(self, self._robots, world, lambda _: False, PoseSource.AUTO)
        self._rows: dict[str, FloatArray] = {}
        self._heard: dict[str, list[tuple[float, FloatArray]]] = {robot: [] for robot in self._robots}
        self._begun = time.monotonic()
        for robot in self._robots:
            topic = interfaces.TELEMETRY
            self.create_subscription(topic.kind, topic.of(robot), partial(self._on_telemetry, robot), topic.subscribe)
        self.create_timer(_LOOK_PERIOD, self._look)

    def _on_telemetry(self, robot: str, message: object) -> None:
        self._rows[robot] = messages.telemetry_from_message(message)

    def finish(self) -> None:
        """Print the places, or why they are not known."""
        if self.places is not None:
            print(json.dumps({robot: place.tolist() for robot, place in self.places.items()}), flush=True)
        elif self.refused:
            print(f"error: {self.refused}", file=sys.stderr)

    def _look(self) -> None:
        try:
            self._listen(time.monotonic())
        except FlatsatError as error:
            self.refused, self.exit_code = str(error), 2
        self.done = self.places is not None or bool(self.refused)

    def _listen(self, now: float) -> None:
        """Take what has come; find the places once all have been listened to for long enough.

        Raises:
            FlatsatError: a pose is of another frame, a drone cannot set out, or nothing comes of one.
        """
        self._poses.look()
        for index, robot in enumerate(self._robots):
            while self._poses.queues[index]:
                place = np.array(self._poses.take(index).position)
                if robot in self._rows:
                    self._heard[robot].append((now, place_of(robot, place, self._rows[robot])))
        missing = [robot for robot, heard in self._heard.items() if not heard or now - heard[0][0] < _HEARD]
        if not missing:
            self.places = {robot: settled(robot, [place for _, place in heard]) for robot, heard in self._heard.items()}
        elif now - self._begun > _PATIENCE:
            names = ", ".join(missing)
            raise FlatsatError(f"{names}: no poses and telemetry within {_PATIENCE:g} s: the controller must run")


def place_of(robot: str, pose: FloatArray, row: FloatArray) -> FloatArray:
    """Return the place (3,), m, from which a drone sets out.

    Args:
        robot: its name.
        pose: its position, (3,) m.
        row: of telemetry.

    Raises:
        FlatsatError: it neither flies nor is on the ground.
    """
    mode = Mode(int(row[_MODE]))
    if mode is Mode.FLY:
        return np.asarray(pose - row[_ERROR])
    if mode not in _GROUND:
        raise refusal(f"mode of {robot}", mode.name, "", "FLY, or on the ground: then it can set out")
    return np.asarray(pose + (0.0, 0.0, ABOVE))


def settled(robot: str, places: Sequence[FloatArray]) -> FloatArray:
    """Return the mean of places (3,), m, refusing those of a drone that is on its way.

    Raises:
        FlatsatError: they wander.
    """
    wandered = float(np.ptp(np.array(places), axis=0).max())
    if wandered > _STILL:
        raise refusal(
            f"way that {robot} made while it was looked at", wandered, "m", f"at most {_STILL} m: let it hold"
        )
    return np.asarray(np.mean(places, axis=0))


def main(argv: Sequence[str] | None = None) -> int:
    """Print where the drones are; 2 with a line on stderr if that is not known."""
    return run(PresentPlaces, argv)


if __name__ == "__main__":
    sys.exit(main())

"""Who stands on something: it was unlocked on the ground, or taken over, and was not seen to leave its place."""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray, any_of
from flatsat_ros.flight.detectors import LIFTED_OFF, LiftOffDetector
from flatsat_ros.flight.policy import Policy

# near the ground, m, a drone is not judged by its motion: something may carry it
NEAR_GROUND = 0.15
# a drone on the ground that is commanded upward by this, m/s^2, and has not risen by so much, m, has too little thrust:
# its estimated velocity believes in the commands, or shows the noise of the poses
_LIFTING = 0.3
_LIFTING_RISE = 0.005
# so many times the thrust of a hover lift whoever can be flown, or as many as the weakest drone needs that is flown
_ENOUGH = 1.3
# who was taken over and has risen less than this, m, may stand on something that is higher than the floor
_RESTS = 0.01
# one that is not even so far, m, from its place in any direction does not move; noise of 2 mm in the poses shows less
_IMMOBILE = 0.006
# a drone that moves faster than this, m/s, does not stand; noise of 2 mm in the poses shows half of that
_MOVING = 0.2
_SLID = "told to climb, it moves sideways instead: is z up in the poses?"
_SUNK = "told to climb, it is seen {0:.2f} m below where it stood, at most {1:g} m: has z the other sign?"


class Footing:
    """What N drones stand on, and how they leave it.

    Attributes:
        lift_off: watches them on the ground.
        low: height below which something may carry a drone, m.
        grounded: (N,) who was unlocked on the ground and has not left it yet.
        held: (N,) who was told to climb and was not seen to leave the ground, until its motors stop.
    """

    def __init__(self, policy: Policy, gravity: float, count: int) -> None:
        """Begin with nobody watched.

        Args:
            policy: the figures of the flight layer.
            gravity: g, m/s^2.
            count: N.
        """
        enough = max(_ENOUGH, 1.0 / max(1.0 - policy.thrust_error_max, 1e-3))
        self.lift_off = LiftOffDetector(count, policy.lift_off_time, enough)
        self.low = policy.floor + NEAR_GROUND
        self._gravity = gravity
        self._unlocked, self.grounded, self.held = np.zeros((3, count), dtype=bool)  # unlocked for its present flight

    @property
    def standing(self) -> np.ndarray:
        """Who may stand on something, (N,): it was not seen to leave its place."""
        return self.lift_off.standing

    @property
    def taken_over(self) -> np.ndarray:
        """Who of these was taken over, wherever that was, (N,)."""
        return np.asarray(self.lift_off.standing & ~self._unlocked)

    def begin(self, index: int, place: FloatArray, *, unlocked: bool) -> None:
        """Watch drone index, which is at a place (3,), m, and was unlocked there, or else taken over."""
        self._unlocked[index] = unlocked
        self.lift_off.begin(index, place, taken_over=not unlocked)
        self.grounded = self._unlocked & self.lift_off.standing

    def look(self, now: float, place: FloatArray, upward: FloatArray, scale: FloatArray, steered: np.ndarray) -> None:
        """Look who has left the ground, and who should have; the arguments are those of `LiftOffDetector.held`."""
        self.held = self.held | self.lift_off.held(now, place, upward, scale, self._gravity, steered)
        self.grounded = self._unlocked & self.lift_off.standing

    def astray(self, height: FloatArray) -> np.ndarray | None:
        """Return who leaves the ground another way than upward, (N,), by heights (N,), m; None for nobody."""
        lift_off = self.lift_off
        if not (any_of(lift_off.slid) or any_of(lift_off.sunk)):
            return None
        # one that was unlocked in somebody's hand may well sink
        sunk = lift_off.sunk & (height < self.low - LIFTED_OFF)
        return np.asarray((lift_off.slid | sunk) & self._unlocked)

    def describe(self, index: int, place: FloatArray) -> str:
        """Return in words how drone index, now seen at a place (3,), m, leaves the ground if not upward."""
        if self.lift_off.slid[index]:
            return _SLID
        return _SUNK.format(self.lift_off.risen(index, place) - place[2], LIFTED_OFF)

    def immobile(self, place: FloatArray, usable: np.ndarray) -> np.ndarray:
        """Return who is seen not to move from its place, (N,).

        Args:
            place: (N, 3) or more, m.
            usable: (N,) who has poses.
        """
        return usable & (self.lift_off.moved(place) < _IMMOBILE)

    def resting(self, estimated: FloatArray) -> np.ndarray:
        """Return who was taken over, wherever that was, and has not risen since, (N,), by estimates (N, 9)."""
        return np.asarray(self.taken_over & (self.lift_off.above(estimated) < _RESTS))

    def lifting(self, estimated: FloatArray, upward: FloatArray, steered: np.ndarray) -> np.ndarray:
        """Return who stands although it is told to climb, (N,).

        Args:
            estimated: (N, 9) position, velocity, disturbance: m, m/s, m/s^2.
            upward: (N,) vertical acceleration that is commanded, m/s^2.
            steered: (N,) who is steered.
        """
        standing = self.lift_off.standing
        if not any_of(standing):
            return standing
        low = self.lift_off.above(estimated) < _LIFTING_RISE
        return np.asarray(steered & standing & (upward >= _LIFTING) & low)

    def moves(self, state: FloatArray) -> bool:
        """Tell whether a drone with a state (6,), m, m/s, is seen to move: then it does not stand on anything."""
        return float(np.abs(state[3:]).max()) > _MOVING

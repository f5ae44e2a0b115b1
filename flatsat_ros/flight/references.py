"""The references of N drones: which trajectory each follows, sampled together at every tick."""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray, all_of
from flatsat_ros.flight.trajectory import SIZE, Trajectory, evaluate, jerks

_NOBODY = np.zeros(0, dtype=int)
_NEVER = np.inf, -np.inf


class Cursor:
    """The segment of each trajectory at some time.

    Attributes:
        coefficients: (N, 8, 3) of t^0 .. t^7, with the origin below.
        origin: (N,) s.
        until: (N,) time of the segment's end, s.
    """

    def __init__(self, count: int) -> None:
        self.coefficients = np.zeros((count, SIZE, 3))
        self.origin = np.zeros(count)
        self.until = np.full(count, np.inf)
        self._span = _NEVER  # s, in which nobody's segment becomes another one

    def forget(self, index: int) -> None:
        """Seek the segment of drone index anew."""
        self.until[index], self._span = -np.inf, _NEVER

    def seek(self, t: float, trajectories: list[Trajectory | None]) -> np.ndarray:
        """Go to a time, s; return the indices of those whose segment is another one now."""
        begin, end = self._span
        if begin <= t < end:
            return _NOBODY
        # earlier than the segment: before the start, or the clock was set back
        changing = (t >= self.until) | (t < self.origin)
        indices = np.flatnonzero(changing)
        for index in indices:
            trajectory = trajectories[index]
            if trajectory is not None:
                self.coefficients[index], self.origin[index], self.until[index] = trajectory.segment(t)
        self._span = float(self.origin.max()), float(self.until.min())
        return indices


class References:
    """The current trajectories of N drones.

    Attributes:
        yaw: (N,) psi to hold, rad.
        margin: (N,) distance of the trajectories' accelerations, from now on, to the boundary of the input set, m/s^2.
        demand: (N,) what the trajectories ask for, over what a flight section assumes; at most 1 is kept, 0 at rest.
        assigned: how many trajectories were assigned so far.
        at_rest: (N,) whether the reference stays where it is for good: a set-point, or a trajectory that has ended.
    """

    def __init__(self, count: int, margin_at_rest: float) -> None:
        """Begin without any; until a drone gets one, its reference is the origin.

        Args:
            count: N.
            margin_at_rest: of a reference that stays where it is, m/s^2.
        """
        self._margin_at_rest = margin_at_rest
        self._margin_on_way = np.full(count, np.inf)  # the least of the whole trajectory, m/s^2
        self.yaw = np.zeros(count)
        self.margin = np.full(count, np.inf)
        self.demand = np.zeros(count)
        self.assigned = 0
        self._trajectories: list[Trajectory | None] = [None] * count
        self.at_rest = np.ones(count, dtype=bool)
        self._present = Cursor(count)  # the segments that are flown now
        self._cursors = [self._present]
        self._resting = np.zeros((count, 9))

    def assign(self, index: int, trajectory: Trajectory, margin: float, demand: float = 0.0) -> None:
        """Give drone index a new trajectory with its margin, m/s^2, and demand, in force from the next sample on."""
        self.margin[index] = self._margin_on_way[index] = margin
        self.demand[index] = demand
        self.assigned += 1
        self._trajectories[index] = trajectory
        self.at_rest[index] = False
        for cursor in self._cursors:
            cursor.forget(index)
        self.yaw[index] = trajectory.yaw

    def sample(self, t: float) -> FloatArray:
        """Return position, velocity and acceleration of all drones at t, (N, 9); zero without a reference."""
        for index in self._present.seek(t, self._trajectories):
            self._resting[index, :3] = self._present.coefficients[index, 0]
            rests = self.at_rest[index] = np.isinf(self._present.until[index])
            self.margin[index] = self._margin_at_rest if rests else self._margin_on_way[index]
            if rests:
                self.demand[index] = 0.0
        if all_of(self.at_rest):
            return self._resting.copy()
        return evaluate(self._present.coefficients, t - self._present.origin)

    def jerk(self, t: float) -> FloatArray:
        """Return the jerk of all references, (N, 3) m/s^3, at the time t that was sampled last."""
        return jerks(self._present.coefficients, t - self._present.origin)

    def cursor(self) -> Cursor:
        """Return a cursor of somebody who looks at other times; to be moved by `seek` alone."""
        cursor = Cursor(len(self._trajectories))
        for index, trajectory in enumerate(self._trajectories):
            if trajectory is not None:
                cursor.forget(index)
        self._cursors.append(cursor)
        return cursor

    def seek(self, cursor: Cursor, t: float) -> None:
        """Move a cursor to a time, s."""
        cursor.seek(t, self._trajectories)

    def trajectory(self, index: int) -> Trajectory | None:
        """Return what drone index follows; None before its first reference."""
        return self._trajectories[index]

    def motion(self, index: int, t: float) -> FloatArray:
        """Return position, velocity, acceleration and jerk (4, 3) of drone index's reference at t."""
        trajectory = self._trajectories[index]
        if trajectory is None:
            return np.zeros((4, 3))
        return np.concatenate([trajectory.sample(t).reshape(3, 3), trajectory.jerk(t)[np.newaxis]])

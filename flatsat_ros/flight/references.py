"""The references of N drones: which trajectory each follows, sampled together at every tick."""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.flight.trajectory import Trajectory, evaluate


class References:
    """The current trajectories of N drones.

    Attributes:
        yaw: (N,) psi to hold, rad.
        margin: (N,) distance of the trajectories' accelerations to the boundary of the input set, m/s^2.
        at_rest: (N,) whether the reference stays where it is for good: a set-point, or a trajectory that has ended.
    """

    def __init__(self, count: int) -> None:
        """Begin without any; until a drone gets one, its reference is the origin."""
        self.yaw = np.zeros(count)
        self.margin = np.full(count, np.inf)
        self._trajectories: list[Trajectory | None] = [None] * count
        self.at_rest = np.ones(count, dtype=bool)
        # the segment of each trajectory that is flown now: coefficients, time origin, time of its end
        self._coefficients = np.zeros((count, 8, 3))
        self._origin = np.zeros(count)
        self._until = np.full(count, np.inf)
        self._resting = np.zeros((count, 9))

    def assign(self, index: int, trajectory: Trajectory, margin: float) -> None:
        """Give drone index a new trajectory with its margin, m/s^2, in force from the next sample on."""
        self.margin[index] = margin
        self._trajectories[index] = trajectory
        self._until[index], self.at_rest[index] = -np.inf, False
        self.yaw[index] = trajectory.yaw

    def sample(self, t: float) -> FloatArray:
        """Return position, velocity and acceleration of all drones at t, (N, 9); zero without a reference."""
        # earlier than the segment: before the start, or the clock was set back
        changing = (t >= self._until) | (t < self._origin)
        if np.count_nonzero(changing):
            for index in np.flatnonzero(changing):
                trajectory = self._trajectories[index]
                if trajectory is not None:
                    self._coefficients[index], self._origin[index], self._until[index] = trajectory.segment(t)
                    self._resting[index, :3] = self._coefficients[index, 0]
                    self.at_rest[index] = np.isinf(self._until[index])
        if self.at_rest.all():
            return self._resting.copy()
        return evaluate(self._coefficients, t - self._origin)

    def trajectory(self, index: int) -> Trajectory | None:
        """Return what drone index follows; None before its first reference."""
        return self._trajectories[index]

    def motion(self, index: int, t: float) -> FloatArray:
        """Return position, velocity, acceleration and jerk (4, 3) of drone index's reference at t."""
        trajectory = self._trajectories[index]
        if trajectory is None:
            return np.zeros((4, 3))
        return np.concatenate([trajectory.sample(t).reshape(3, 3), trajectory.jerk(t)[np.newaxis]])

"""Ideal drones that a pilot flies, and what holds of every tick."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import GoalMode, Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.flatness import acceleration_from_input
from flatsat_ros.law.gain import Tuning

CERTIFICATE = Certificate.load(Path(__file__).parents[2] / "config" / "paper_experiment.yaml")
LIMITS = CERTIFICATE.limits
POLICY = Policy(
    pose_timeout=0.3,
    level_time=0.5,
    unlock_time=0.3,
    level_thrust=0.95,
    goal_mode=GoalMode.STEP,
    walls=(-1e3, -1e3, 1e3, 1e3),
)
GOAL = [0.6, 0.6, 0.8]


def tuning(mu: float = 2.0) -> Tuning:
    return Tuning(mu, 0.05, 1.0, CERTIFICATE.gain_max)


def require_within_limits(tick: Tick) -> None:
    """Every command is finite and inside the limits of thrust, roll and pitch, whatever the mode."""
    assert np.isfinite(tick.input).all()
    assert np.isfinite(tick.yaw_rate).all()
    assert (tick.input[:, 0] >= 0.0).all()
    assert (tick.input[:, 0] <= LIMITS.thrust_max * (1.0 + 1e-12)).all()
    assert (np.abs(tick.input[:, 1:]) <= LIMITS.tilt_max * (1.0 + 1e-9)).all()
    assert (np.abs(tick.yaw_rate) <= 1.0).all()
    assert not tick.input[np.isin(tick.mode, [Mode.IDLE, Mode.UNLOCK, Mode.CUT])].any()


class World:
    """Ideal drones on a floor at z = 0 with motion capture at 100 Hz and the pilot at 10 Hz."""

    def __init__(
        self,
        count: int = 1,
        mu: float = 2.0,
        start: tuple[float, ...] = (-0.6, -0.6, 0.0),
        policy: Policy = POLICY,
    ) -> None:
        self.pilot = Pilot(CERTIFICATE, tuning(mu), policy, count)
        self.x = np.tile([*start, 0.0, 0.0, 0.0], (count, 1))
        self.yaw = np.zeros(count)
        self.blind = np.zeros(count, dtype=bool)
        self.held = self.unoriented = False
        self.missing = 0.0  # of the thrust, m/s^2
        self.steps = 0
        self.offset = 0.0
        self.ticks: list[Tick] = []

    @property
    def now(self) -> float:
        return self.offset + 0.01 * self.steps

    def fly(self, seconds: float) -> list[Tick]:
        """Let time pass; return its ticks."""
        ticks = []
        for _ in range(round(100 * seconds)):
            for i in np.flatnonzero(~self.blind):
                half = float(self.yaw[i]) / 2.0
                quaternion = (0.0, 0.0, math.sin(half), math.cos(half))
                if self.unoriented:
                    quaternion = (math.nan,) * 4
                self.pilot.measure(int(i), self.now, tuple(self.x[i, :3]), quaternion, self.now)
            if self.steps % 10 == 0:
                ticks.append(self.pilot.tick(self.now))
                require_within_limits(ticks[-1])
                self.v = acceleration_from_input(ticks[-1].input, self.yaw)
                self.v[ticks[-1].mode == Mode.IDLE] = 0.0  # somebody else holds it
                self.rate = ticks[-1].yaw_rate
            v = np.zeros_like(self.v) if self.held else self.v - (0.0, 0.0, self.missing)
            self.x[:, :3] += 0.01 * self.x[:, 3:] + 0.01**2 / 2.0 * v
            self.x[:, 3:] += 0.01 * v
            self.x[(self.x[:, 2] <= 0.0) & (self.x[:, 5] <= 0.0), 2:] *= 0.0
            self.yaw += 0.01 * self.rate
            self.steps += 1
        return ticks


def modes(ticks: list[Tick]) -> list[Mode]:
    """The modes of drone 0, repetitions removed."""
    sequence = [Mode(int(tick.mode[0])) for tick in ticks]
    return [mode for mode, before in zip(sequence, [None, *sequence], strict=False) if mode is not before]


def airborne(count: int = 1, policy: Policy = POLICY, yaw: float = 0.0) -> World:
    """Drones hovering at 1 m, with a yaw, rad."""
    world = World(count, start=(0.0, 0.0, 1.0), policy=policy)
    world.yaw[:] = yaw
    for i in range(count):
        world.pilot.set_reference(i, Trajectory.hold([0.0, 0.0, 1.0], yaw))
    world.fly(1.0)
    assert (world.pilot.mode == Mode.FLY).all()
    return world

"""What one demo flight left behind, live or simulated, and the figures drawn from it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.files import write_text
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.plans import Plan

# root mean square tracking errors of the paper's Test 2, Table III, m
PAPER_RMS = (0.0703, 0.0826, 0.0602)
RMS_LIMIT = 0.10  # m, what the demo promises
_LIFTED = 0.03  # m, above where it stood: a drone in the air
_SETTLED = 2.0  # s after lift-off, from which on the guarantee is asked for
_MEASURED = 0.01  # s, between two times at which distances are looked at
_FLOOR = 0.05  # m, around the height of the floor, where a drone that landed stands
SUMMARY = "summary.json"
PLAN = "plan.yaml"  # that was made for the flight
REPORT = "report.html"
# degrees and PWM on the wire cost a few units in the last place
_ROUNDING = 1e-9

_MODE = 1 + FIELDS.index("mode")
_TICK_US = 1 + FIELDS.index("tick_us")


@dataclass(frozen=True, eq=False)
class RobotRecord:
    """One robot's flight; times are s on the record's clock.

    Attributes:
        poses: (n, 4) stamp, x, y, z, m, as measured.
        ticks: (m, 1 + len(FIELDS)) time and telemetry.
        commands: (k, 5) time, T m/s^2, phi, theta rad, yaw rate rad/s, as read off the wire.
        reference: of the swap.
    """

    poses: FloatArray
    ticks: FloatArray
    commands: FloatArray
    reference: Trajectory

    def column(self, field: str) -> FloatArray:
        """Return one telemetry field over the ticks."""
        return self.ticks[:, 1 + FIELDS.index(field)]


@dataclass(frozen=True, eq=False)
class FlightRecord:
    """A whole flight, from the floor to the floor.

    Attributes:
        robots: by name.
        limits: the input set of the certificate flown.
        level: eps of the certificate.
        threshold: V_inf.
        gain_max: cap of the gain.
        rate: ticks per second.
        dynamics: of the simulated drones.
        swap: begin and end of the swap, s.
        plan: that was flown; None without one.
        floor: its height, m.
    """

    robots: Mapping[str, RobotRecord]
    limits: InputSet
    level: float
    threshold: float
    gain_max: float
    rate: float
    dynamics: str
    swap: tuple[float, float]
    plan: Plan | None = None
    floor: float = 0.0

    def summary(self) -> dict[str, Any]:
        """Return the figures of summary.json, computed from what was recorded."""
        swapped = self.plan is None and len(self.robots) == len(PAPER_RMS)
        paper = PAPER_RMS if swapped else (None,) * len(self.robots)
        durations = np.concatenate([r.ticks[:, _TICK_US] for r in self.robots.values()])
        return {
            "robots": {
                name: self._robot_summary(robot) | {"rms_paper_m": printed}
                for (name, robot), printed in zip(self.robots.items(), paper, strict=True)
            },
            "violations": sum(self._violations(robot) for robot in self.robots.values()),
            "separation_min_m": self._separation(),
            "tick_median_us": float(np.median(durations)),
            "tick_p99_us": float(np.quantile(durations, 0.99)),
            "dynamics": self.dynamics,
            "rate_hz": self.rate,
            "seconds": self.swap[1] - self.swap[0],
            "plan": None if self.plan is None else _plan_summary(self.plan, self.robots, self.swap),
        }

    def _robot_summary(self, robot: RobotRecord) -> dict[str, Any]:
        begin, end = self.swap
        flown = robot.poses[(robot.poses[:, 0] >= begin) & (robot.poses[:, 0] <= end)]
        error = flown[:, 1:] - np.array([robot.reference.sample(t)[:3] for t in flown[:, 0]])
        flying = robot.ticks[robot.ticks[:, _MODE] == Mode.FLY]
        thrust, roll, pitch = (flying[:, 1 + FIELDS.index(name)] for name in ("T", "phi", "theta"))
        higher = abs(robot.poses[-1, 3] - self.floor)
        return {
            "rms_m": float(np.sqrt((error**2).sum(axis=1).mean())),
            "gamma_final": float(robot.column("gamma")[robot.ticks[:, 0] <= end][-1]),
            "tilt_max_rad": float(np.arccos(np.cos(roll) * np.cos(pitch)).max()),
            "thrust_min": float(thrust.min()),
            "thrust_max": float(thrust.max()),
            **_tube_summary(robot),
            "landed": bool(robot.ticks[-1, _MODE] in (Mode.REST, Mode.IDLE) and higher <= _FLOOR),
        }

    def _violations(self, robot: RobotRecord) -> int:
        """Count the commands on the wire that break a limit on thrust, roll or pitch, or are not numbers."""
        thrust, roll, pitch = robot.commands[:, 1:4].T
        tilt = self.limits.tilt_max + _ROUNDING
        within = (thrust >= self.limits.thrust_min - _ROUNDING) & (thrust <= self.limits.thrust_max + _ROUNDING)
        within &= (np.abs(roll) <= tilt) & (np.abs(pitch) <= tilt)
        return int((~within).sum())

    def _separation(self) -> float | None:
        """Return the smallest distance between two drones from the first command on, m; None for one drone."""
        tracks = list(self.robots.values())
        if len(tracks) < 2:
            return None
        begin = max(track.poses[0, 0] for track in tracks)
        end = min(track.poses[-1, 0] for track in tracks)
        times = np.arange(begin, end, _MEASURED)
        paths = [np.stack([np.interp(times, t.poses[:, 0], t.poses[:, i]) for i in (1, 2, 3)], axis=1) for t in tracks]
        return float(
            min(np.linalg.norm(paths[i] - paths[j], axis=1).min() for i in range(len(paths)) for j in range(i))
        )


def _tube_summary(robot: RobotRecord) -> dict[str, float | None]:
    """Return how often the guarantee held, the tube, and how far the drone was from its reference.

    From 2 s after lift-off to touch-down, as long as the drone is steered; None where there was nothing of that.
    """
    height, times = robot.poses[:, 3], robot.ticks[:, 0]
    aloft = robot.poses[(height > height[0] + _LIFTED), 0]
    begin, end = (aloft[0] + _SETTLED, aloft[-1]) if len(aloft) else (np.inf, -np.inf)
    flown = (robot.ticks[:, _MODE] == Mode.FLY) & (times >= begin) & (times <= end)
    if not flown.any():
        return dict.fromkeys(("guaranteed_share", "tube_m", "error_max_m", "tube_z_m", "error_z_max_m"))
    x, y, z = (robot.column(f"error_{axis}")[flown] for axis in "xyz")
    tubes = [float(robot.column(name)[flown][-1]) for name in ("tube", "tube_z")]
    return {
        "guaranteed_share": float(robot.column("guaranteed")[flown].mean()),
        "tube_m": tubes[0] if np.isfinite(tubes[0]) else None,
        "error_max_m": float(np.hypot(x, y).max()),
        "tube_z_m": tubes[1] if np.isfinite(tubes[1]) else None,
        "error_z_max_m": float(np.abs(z).max()),
    }


def _plan_summary(plan: Plan, robots: Mapping[str, RobotRecord], swap: tuple[float, float]) -> dict[str, Any]:
    """Return what a plan proves, and what of it was measured in its flight, m in the plan's metric.

    Two drones inside their tubes are at least as far apart as their references, less both tubes.
    """
    times = np.arange(*swap, _MEASURED)
    stretch = np.array([1.0, 1.0, plan.downwash])
    paths, tubes, shares = {}, {}, {}
    for drone in plan.drones:
        robot, tubes[drone.name] = robots[drone.name], drone.tube.radius
        measured = np.stack([np.interp(times, robot.poses[:, 0], robot.poses[:, i]) for i in (1, 2, 3)], axis=1)
        reference = np.array([robot.reference.sample(t)[:3] for t in times])
        paths[drone.name] = measured / stretch
        off = np.linalg.norm((measured - reference) / stretch, axis=1)
        shares[drone.name] = float(off.max() / drone.tube.radius)
    pairs = [
        {
            "first": pair.first,
            "second": pair.second,
            "certified_m": round(pair.distance * 1e-4 - tubes[pair.first] - tubes[pair.second], 6),
            "measured_m": float(np.linalg.norm(paths[pair.first] - paths[pair.second], axis=1).min()),
        }
        for pair in plan.pairs
    ]
    return {"name": plan.name, "certificate": plan.certificate, "tube_share_max": shares, "pairs": pairs}


def write(summary: Mapping[str, Any], folder: Path) -> Path:
    """Write the figures to `SUMMARY` in a folder; return its path.

    Raises:
        FlatsatError: the file cannot be written.
    """
    target = folder / SUMMARY
    write_text(target, json.dumps(summary, indent=2) + "\n")
    return target


def failures(summary: Mapping[str, Any]) -> list[str]:
    """Return what the demo promises and this flight broke, one sentence each."""
    broken = [
        f"{name}: RMS tracking error {100 * robot['rms_m']:.2f} cm, promised below {100 * RMS_LIMIT:.0f} cm"
        for name, robot in summary["robots"].items()
        if not robot["rms_m"] < RMS_LIMIT
    ]
    broken += [
        f"{name}: does not stand on the floor, promised to land"
        for name, robot in summary["robots"].items()
        if not robot["landed"]
    ]
    if summary["plan"] is not None:
        broken += _of_plan(summary["plan"])
    if summary["violations"]:
        broken.append(f"{summary['violations']} commands outside the limits, promised none")
    return broken


def _of_plan(plan: Mapping[str, Any]) -> list[str]:
    """Return what a plan proves and its flight broke, one sentence each."""
    broken = [
        f"{name}: {share:.2f} of its tube away from its reference, promised to stay inside"
        for name, share in plan["tube_share_max"].items()
        if not share <= 1.0
    ]
    return broken + [
        f"{pair['first']}, {pair['second']}: {pair['measured_m']:.3f} m apart, proved {pair['certified_m']:.3f} m"
        for pair in plan["pairs"]
        if not pair["measured_m"] >= pair["certified_m"]
    ]


def table(summary: Mapping[str, Any], limits: InputSet) -> str:
    """Return the figures as a table for the terminal."""
    lines = [
        f"{'robot':<8}{'RMS cm':>9}{'paper cm':>10}{'gamma':>8}{'tilt deg':>10}{'T min':>8}{'T max':>8}  m/s^2  landed",
        "-" * 76,
    ]
    for name, robot in summary["robots"].items():
        paper = "-" if robot["rms_paper_m"] is None else f"{100 * robot['rms_paper_m']:.2f}"
        lines.append(
            f"{name:<8}{100 * robot['rms_m']:>9.2f}{paper:>10}{robot['gamma_final']:>8.2f}"
            f"{np.degrees(robot['tilt_max_rad']):>10.2f}{robot['thrust_min']:>8.2f}{robot['thrust_max']:>8.2f}"
            f"{'yes' if robot['landed'] else 'no':>15}"
        )
    lines.append(
        f"{'limits':<8}{100 * RMS_LIMIT:>9.0f}{'':>10}{'':>8}{np.degrees(limits.tilt_max):>10.2f}"
        f"{limits.thrust_min:>8.2f}{limits.thrust_max:>8.2f}"
    )
    separation = summary["separation_min_m"]
    lines += [
        "",
        f"commands outside the limits: {summary['violations']}"
        + ("" if separation is None else f"      smallest separation: {separation:.2f} m"),
        f"tick: median {summary['tick_median_us']:.0f} us, 99 % below {summary['tick_p99_us']:.0f} us, "
        f"drones: {len(summary['robots'])}, at {summary['rate_hz']:g} Hz",
        f"dynamics: {summary['dynamics']}, swap of {summary['seconds']:g} s",
    ]
    if (plan := summary["plan"]) is not None:
        name, share = max(plan["tube_share_max"].items(), key=lambda each: each[1])
        lines.append(f"plan {plan['name']}: at most {share:.2f} of a tube used, by {name}")
        if plan["pairs"]:
            nearest = min(plan["pairs"], key=lambda pair: pair["measured_m"])
            lines.append(
                f"nearest: {nearest['first']} and {nearest['second']}, {nearest['measured_m']:.3f} m apart, proved "
                f"{nearest['certified_m']:.3f} m"
            )
    return "\n".join(lines)

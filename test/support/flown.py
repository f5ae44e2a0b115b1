"""Flight logs of our own: simulated drones with known figures, flown around by a simple controller."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.identification.log import FlightLog
from flatsat_ros.law.flatness import input_from_acceleration
from flatsat_ros.sim.dynamics import STEP, Bodies, IdentifiedResponse

PERIOD = 0.01  # s, of the log
_HOLD = round(0.02 / STEP)  # steps between commands


def fly(
    profile: VehicleProfile,
    seeds: range,
    *,
    seconds: float = 20.0,
    delay: float = 0.03,
    noise: float = 0.0,
    frame: tuple[float, float] = (0.0, 0.0),
    amplitude: float = 0.4,
    weight: float = 1.0,
    voltages: tuple[float, float] | None = None,
) -> list[FlightLog]:
    """Return the logs of flights, one for each seed: a figure of sines around (0, 0, 1) at 0.1 to 0.7 Hz.

    Args:
        profile: what the drones are; the controller asks for thrust by its map.
        seeds: of sines and noise.
        seconds: duration.
        delay: of the commands and of the noise-free poses together, s.
        noise: of the positions, m, and ten times as many rad of the angles.
        frame: roll and pitch of the markers on a level drone, rad.
        amplitude: of the motion, m.
        weight: actual force over the force of the profile.
        voltages: of the battery under load at the beginning and at the end, V, logged to 10 mV; None: it is that of
            the profile throughout, and not logged.
    """
    count, steps = len(seeds), round(seconds / STEP)
    body = Bodies(
        IdentifiedResponse(profile.dynamics),
        np.tile((0.0, 0.0, 1.0), (count, 1)),
        np.zeros(count),
        thrust=GRAVITY,
        floor=-9.0,
    )
    generators = [np.random.default_rng(seed) for seed in seeds]
    rate = 2.0 * np.pi * np.stack([each.uniform(0.1, 0.7, (3, 4)) for each in generators])
    phase = np.stack([each.uniform(0.0, 2.0 * np.pi, (3, 4)) for each in generators])
    size = amplitude * np.array([1.0, 1.0, 0.5])[:, None] / (rate / rate.min()) ** 0.5 / 2.0
    full = profile.force_max / profile.mass
    commands: list[np.ndarray] = []
    poses, asked = [], []
    for step in range(steps):
        if step % _HOLD == 0:
            wave = rate * step * STEP + phase
            wanted = (size * np.sin(wave)).sum(-1) + (0.0, 0.0, 1.0)
            moving = (size * rate * np.cos(wave)).sum(-1)
            v = 6.0 * (wanted - body.position) + 4.0 * (moving - body.velocity)
            u = input_from_acceleration(np.clip(v, -3.0, 3.0), 0.0)
            pwm = np.clip(profile.pwm_from_thrust(u[:, 0]), 0.0, 60000.0)
            commands.append(np.column_stack([u[:, 1:], pwm]))
        late = commands[max(0, int((step * STEP - delay) / STEP + 1e-6)) // _HOLD]
        if step * STEP % PERIOD < 1e-9 or PERIOD - step * STEP % PERIOD < 1e-9:
            poses.append(np.concatenate([body.position, body.angles], axis=1))
            asked.append(commands[-1])
        charge = 1.0
        if voltages is not None:
            charge = float(profile.voltage_factor(voltages[0] + (voltages[1] - voltages[0]) * step / steps))
        thrust = weight * full * charge * (late[:, 2] / 65535.0) ** profile.thrust_slope
        body.step(thrust, np.stack([late[:, 0], late[:, 1], np.zeros(count)]), np.zeros(3))
    seen, sent = np.stack(poses, axis=1), np.stack(asked, axis=1)
    logs = []
    for k, generator in enumerate(generators):
        time = np.arange(len(seen[k])) * PERIOD
        position = seen[k, :, :3] + noise * generator.standard_normal((len(time), 3))
        angles = seen[k, :, 3:] + (*frame, 0.0) + 10.0 * noise * generator.standard_normal((len(time), 3))
        told = np.empty(0) if voltages is None else np.round(np.linspace(*voltages, len(time)), 2)
        read = time[: len(told)]
        logs.append(FlightLog(f"flight {seeds[k]}", time, position, angles, time, sent[k], read, told))
    return logs


def write(log: FlightLog, path: Path) -> Path:
    """Write a log as a CSV file in the form of cflib's client."""
    degrees = 180.0 / np.pi
    columns = {
        "Timestamp": 1000.0 * log.pose_time + 5000.0,
        **{f"stateEstimate.{axis}": log.position[:, k] for k, axis in enumerate("xyz")},
        "stateEstimate.roll": degrees * log.angles[:, 0],
        "stateEstimate.pitch": -degrees * log.angles[:, 1],
        "stateEstimate.yaw": degrees * log.angles[:, 2],
        "controller.roll": degrees * log.command[:, 0],
        "controller.pitch": -degrees * log.command[:, 1],
        "controller.cmd_thrust": log.command[:, 2],
    }
    if len(log.voltage):
        columns["pm.vbat"] = log.voltage
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(f"{value:.9g}" for value in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path

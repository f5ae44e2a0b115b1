"""Simulated flights recorded as real ones are: give `Recorder.observe` to `flatsat_ros.fly`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.flight import telemetry
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.viewing.flight import COMMAND_FIELDS, POSE_FIELDS, Channel, Flight, Track, with_mode_events


def setup_of(certificate: Certificate, policy: Policy) -> dict[str, object]:
    """Return names and values, in SI units, by which a viewer draws the limits of a certificate and of a policy."""
    limits, box, flight = certificate.limits, policy.box, certificate.flight
    tubes = {}
    if flight is not None:
        tubes = {"tube_m": flight.horizontal.tube.position, "tube_z_m": flight.vertical.tube.position}
    return tubes | {
        "certificate": certificate.name,
        "period": certificate.period,
        "thrust_min": limits.thrust_min,
        "thrust_max": limits.thrust_max,
        "tilt_max": limits.tilt_max,
        "eps": certificate.level,
        "gain_max": certificate.gain_max,
        "floor": policy.floor,
        "box": [*box.low.tolist(), *box.high.tolist()],
    }


class MeasuredPose(Protocol):
    """A measured pose, as `flatsat_ros.sim.sensor.Sample` is."""

    @property
    def drone(self) -> int:
        """Index of the drone."""

    @property
    def stamp(self) -> float:
        """When it was measured, s."""

    @property
    def position(self) -> FloatArray:
        """(3,) m."""

    @property
    def quaternion(self) -> FloatArray:
        """(4,) x, y, z, w, body -> world."""


class Recorder:
    """Collects a flight tick by tick."""

    def __init__(self, names: Sequence[str], setup: Mapping[str, object]) -> None:
        """Begin with nothing.

        Args:
            names: of the drones.
            setup: what the flight is flown with, see `setup_of`.
        """
        self._names, self._setup = list(names), dict(setup)
        self._poses: list[list[list[float]]] = [[] for _ in names]
        self._ticks: list[list[FloatArray]] = [[] for _ in names]
        self._commands: list[list[list[float]]] = [[] for _ in names]

    def observe(self, now: float, poses: Iterable[MeasuredPose], tick: Tick, sent: Mapping[int, WireSetpoint]) -> None:
        """Take in what a tick shows, as `flatsat_ros.fly` calls its observers.

        Args:
            now: time of the tick, s.
            poses: measured since the tick before.
            tick: of the pilot.
            sent: set-points, by drone.
        """
        for pose in poses:
            self._poses[pose.drone].append([pose.stamp, *pose.position, *pose.quaternion])
        for index, row in enumerate(telemetry.rows(tick)):
            self._ticks[index].append(np.array([now, *row]))
        for index, setpoint in sent.items():
            self._commands[index].append([now, setpoint.roll, setpoint.pitch, setpoint.yaw, setpoint.thrust])

    def flight(self, title: str) -> Flight:
        """Return the flight so far, under a title."""
        tracks = []
        for index, name in enumerate(self._names):
            recorded: dict[str, tuple[tuple[str, ...], list[Any]]] = {
                "pose": (POSE_FIELDS, self._poses[index]),
                "tick": (telemetry.FIELDS, self._ticks[index]),
                "command": (COMMAND_FIELDS, self._commands[index]),
            }
            channels = {kind: Channel(fields, np.array(rows)) for kind, (fields, rows) in recorded.items() if rows}
            tracks.append(Track(name, channels))
        return with_mode_events(Flight(title, tracks, setup=self._setup))

"""The loop around the law: which state it acts on, about which base, and what is guaranteed of that.

There are two. `PredictedLoop` is that of a flight section (`certificate.flight_loop`), and `flight.direct_loop` that of
certificates without one.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray, all_of, any_of
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight import FlightSection
from flatsat_ros.certificate.sets import Place
from flatsat_ros.flight.assumptions import Assumption, Seen
from flatsat_ros.flight.doubt import Carried, Doubt
from flatsat_ros.flight.estimator import Estimator
from flatsat_ros.flight.guarantee import Assessment
from flatsat_ros.flight.monitors import Monitors
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.predictor import Predictor
from flatsat_ros.flight.preview import Preview
from flatsat_ros.flight.references import References
from flatsat_ros.law.controller import Output

# of a reference's margin, this much at most may be spent on a disturbance; the rest is left to steer with
COMPENSATED_SHARE = 0.5
_TINY = 1e-300
_SUM = np.ones(3)  # sums the entries of rows, faster than sum() on few of them
OF_STATE, OF_VECTOR = [0, 0, 1, 0, 0, 1], [0, 0, 1]  # which of horizontal and vertical
_NONE, _TUBE, _OUTSIDE = Assumption.NONE.value, Place.TUBE.value, Place.OUTSIDE.value


class Aim(NamedTuple):
    """What the law shall act on.

    Attributes:
        state: (N, 6) m, m/s.
        base: (N, 9) its reference: position, velocity, and the acceleration that is commanded without an error.
        error: (N, 6) estimate less reference at the tick; None where it is the law's own.
        disturbance: (N, 3) what is compensated, m/s^2.
    """

    state: FloatArray
    base: FloatArray
    error: FloatArray | None
    disturbance: FloatArray


class Steered(NamedTuple):
    """Which drones are steered at a tick.

    Attributes:
        flying: (N,) who is steered.
        level: (N,) who is in the air without being steered.
        grounded: (N,) who is steered and has not left the ground yet.
        landing: (N,) who lands; None for nobody.
        touching: (N,) who of these is so low that the ground may carry it; None for nobody.
        resting: returns who was taken over and has not risen since, (N,), by what is estimated, (N, 9): asked for where
            it matters alone.
    """

    flying: np.ndarray
    level: np.ndarray
    grounded: np.ndarray
    landing: np.ndarray | None
    touching: np.ndarray | None
    resting: Callable[[FloatArray], np.ndarray]


class Loop(ABC):
    """What the pilot knows of a loop."""

    @abstractmethod
    def estimate(self, now: float, thorough: bool, gained: FloatArray | None) -> FloatArray:
        """Return position, velocity and disturbance of the drones at a tick, (N, 9): m, m/s, m/s^2.

        Args:
            now: s.
            thorough: they are for detectors that judge by them.
            gained: (N,) by how much more the drones have been accelerated upward since the last tick because their
                thrust has been learnt, m/s^2; None for nothing.
        """

    @abstractmethod
    def aim(self, now: float, estimated: FloatArray, reference: FloatArray, drones: Steered) -> Aim:
        """Return what the law acts on at a tick.

        Args:
            now: s.
            estimated: (N, 9) position, velocity, disturbance: m, m/s, m/s^2.
            reference: (N, 9) position, velocity, acceleration.
            drones: who is steered.
        """

    @abstractmethod
    def assess(self, output: Output, acceleration: FloatArray, flying: np.ndarray) -> Assessment:
        """Return where the drones are, and note what they are commanded.

        Args:
            output: of the law.
            acceleration: (N, 3) commanded in any mode, m/s^2.
            flying: (N,) who is steered.
        """

    def astray(self) -> list[int]:
        """Return who is where it cannot be if nothing is broken; nobody where no tube is known."""
        return []

    @property
    def doubted(self) -> np.ndarray | None:
        """(N,) who is flown softly in height; None for nobody."""
        return None

    def ease(self, now: float, swings: np.ndarray) -> np.ndarray:
        """Fly those softly, (N,), who are seen to swing at time now, s; return for whom that is something new."""
        return np.zeros_like(swings)

    def unclaimed(self, index: int) -> str:
        """Return why the tube is not claimed of drone index; empty if it is, or none is known."""
        return ""

    def reports(self, flying: np.ndarray) -> list[tuple[int, str]]:
        """Return what is to be told of the drones in flight, drone and text, once per event."""
        return []


class PredictedLoop(Loop):
    """The law acts on the state in which a command finds the drone, and leads along the reference."""

    def __init__(
        self,
        certificate: Certificate,
        flight: FlightSection,
        policy: Policy,
        references: References,
        estimator: Estimator,
    ) -> None:
        count = len(estimator.yaw)
        horizontal, vertical = flight.horizontal.design, flight.vertical.design
        self._references, self._estimator, self._limits = references, estimator, certificate.limits
        self._inside = certificate.limits.inner_radius / math.sqrt(3.0)  # m/s^2, of a cube in the input set
        self._most, self._most_doubted = min(policy.disturbance_max, flight.disturbance), policy.disturbance_max
        self._predictor = Predictor(horizontal, vertical, count, flight.pose_age)
        self._preview = Preview(references, horizontal, vertical)
        self._monitors = Monitors(flight, self._most, references)
        self._doubt = Doubt.of_flight(flight, self._monitors.bounds.innovations, count)
        self._carried = Carried(horizontal.period, count)
        self._doubts, self._gain = np.zeros((count, 2), dtype=bool), np.ones(count)
        self._feedback = -certificate.matrix[:, 3:]
        self._second = horizontal.model.frequency > 0.0 or vertical.model.frequency > 0.0
        self._tubes = np.array([flight.horizontal.tube.position, flight.vertical.tube.position])
        self._now, self._steady = 0.0, False  # whether all drones were steered at the last tick
        self._needed, self._reference = np.zeros((count, 3)), np.zeros((count, 9))
        self._error = np.zeros((count, 6))

    def estimate(self, now: float, thorough: bool, gained: FloatArray | None) -> FloatArray:
        """Move the model on; its state serves where nobody judges by it, while all drones are steered."""
        estimator = self._estimator
        if gained is not None:  # what was disturbance before would be made up for twice meanwhile
            self._predictor.disturbance[:, 2] += gained
        self._predictor.advance(now, estimator.newest, estimator.measured)
        if self._steady and not thorough:
            return self._predictor.estimated
        return estimator.estimate(now)

    def aim(self, now: float, estimated: FloatArray, reference: FloatArray, drones: Steered) -> Aim:
        """Predict from the model; where a drone is not in the air, or not where the model is, that begins anew."""
        predictor, flying, level = self._predictor, drones.flying, drones.level
        self._steady = all_of(flying)
        if any_of(self._monitors.lost) or not self._steady:
            predictor.restart(~(flying | level) | self._monitors.lost, estimated, now)
        self._now, self._reference = now, reference
        state, push = predictor.state, predictor.disturbance
        most: float | FloatArray = self._most
        met = state + predictor.ahead(reference, self._references.jerk(now) if self._second else None)
        if self._is_doubted(now, estimated, drones):
            doubts = self._doubts
            plain = self._estimator.estimate(now)
            met = np.where(doubts[:, OF_STATE], plain[:, :6], met)
            met = reference[:, :6] + self._doubt.soften(met - reference[:, :6], doubts, self._gain)
            push = np.where(
                doubts[:, OF_VECTOR], self._doubt.slowed(now, self._monitors.recent.mean, plain[:, 6:]), push
            )
            state = np.where(doubts[:, OF_STATE], plain[:, :6], state)
            most = np.where(doubts.any(axis=1), self._most_doubted, most)
        self._error = state - reference[:, :6]
        disturbance, _ = shortened(push, np.minimum(most, COMPENSATED_SHARE * self._references.margin), flying)
        base = reference.copy()
        self._needed = self._preview.needed(now)
        base[:, 6:] = self._needed - disturbance
        if np.abs(base[:, 6:]).max() > self._inside:  # drag and lag may need more than the acceleration itself
            base[:, 6:] = self._limits.saturate(base[:, 6:])
        return Aim(met, base, self._error, disturbance)

    def _is_doubted(self, now: float, estimated: FloatArray, drones: Steered) -> bool:
        """Find whose loop is not the proved one; tell whether there are any."""
        doubt, monitors = self._doubt, self._monitors
        if not monitors.quiet:
            if any_of(drones.grounded):
                doubt.wait(now, drones.grounded)
            airborne = (drones.flying | drones.level) & ~drones.grounded
            innovation = _sizes(self._predictor.innovation)
            if drones.touching is not None:  # what carries a drone is in no model
                innovation[drones.touching] = 0.0
            if drones.landing is not None:  # nor is a table that nobody knew of
                higher, height = self._predictor.innovation[:, 2], self._estimator.measured[:, 2]
                innovation[self._carried.look(now, drones.landing, higher, height)] = 0.0
            doubt.rest(now, drones.resting(estimated))
            doubt.look(now, airborne, self._predictor.age, innovation)
        if drones.landing is not None and drones.touching is not None:
            doubt.land(now, drones.landing & ~drones.touching)
        if doubt.any:
            doubt.hold(now, self._error, drones.touching)
            self._doubts = doubt.of(now)
        return doubt.any

    def assess(self, output: Output, acceleration: FloatArray, flying: np.ndarray) -> Assessment:
        """Return where the drones are in their tubes."""
        predictor, monitors = self._predictor, self._monitors
        self._gain = output.gain
        monitors.look(
            self._now,
            flying & ~self._doubts.any(axis=1) if self._doubt.any else flying,
            Seen(
                self._error,
                self._reference,
                predictor.age,
                predictor.innovation,
                predictor.disturbance,
                output.applied_gain,
                output.error @ self._feedback,
                predictor.acceleration,
            ),
        )
        predictor.command(acceleration, self._needed if self._steady else self._needed * flying[:, np.newaxis])
        holds = monitors.broken == _NONE
        return Assessment(
            relative_level=monitors.ratio,
            place=np.where(monitors.ratio <= 1.0, _TUBE, _OUTSIDE),
            kappa=holds.astype(np.float64),
            guaranteed=holds,
            broken=monitors.broken,
            tube=self._tubes,
        )

    @property
    def doubted(self) -> np.ndarray | None:
        """(N,) who is flown softly in height; None for nobody."""
        return self._doubts[:, 1] if self._doubt.any else None

    def astray(self) -> list[int]:
        """Return who is outside its tube although all seems to be as assumed."""
        return self._monitors.astray()

    def unclaimed(self, index: int) -> str:
        """Return what does not hold of what the certificate assumes, of drone index."""
        return self._monitors.sentence(index)

    def reports(self, flying: np.ndarray) -> list[tuple[int, str]]:
        """Return what does not hold of what the certificate assumes, and who is flown softly therefore."""
        return self._monitors.reports(flying) + self._doubt.reports()


def shortened(estimate: FloatArray, most: FloatArray, flying: np.ndarray) -> tuple[FloatArray, FloatArray]:
    """Return disturbances (N, 3), m/s^2, shortened to what may be compensated, and their sizes; 0 if not steered."""
    estimate = estimate.copy()  # its columns together: faster
    size = np.sqrt((estimate * estimate) @ _SUM)
    steady = all_of(flying)
    if steady and not any_of(size > most):
        return estimate, size
    spent = np.minimum(size, most)
    if not steady:
        spent = np.where(flying, spent, 0.0)
    return estimate * (spent / np.maximum(size, _TINY))[:, np.newaxis], spent


def _sizes(vectors: FloatArray) -> FloatArray:
    """Return the sizes of vectors (N, 3), horizontal and vertical, (N, 2)."""
    return np.column_stack([np.hypot(vectors[:, 0], vectors[:, 1]), np.abs(vectors[:, 2])])

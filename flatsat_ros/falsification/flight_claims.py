"""What a flight section claims about every tick of a flight, checked for many drones at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight import FlightSection
from flatsat_ros.certificate.flight_plant import Plant
from flatsat_ros.falsification.exact_drones import ExactDrones
from flatsat_ros.falsification.swinging import amplitudes
from flatsat_ros.falsification.worst_inputs import SIGNALS
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.tick import Tick

AXES = ("horizontal", "vertical")
KINDS = ("gain that rests", "any gain", "after starts")

# by how much, relatively, floating-point numbers may exceed what is proved
_ROUNDING = 1e-9
_TINY, _HUGE = 1e-300, 1e300


class Found(NamedTuple):
    """The largest value of a signal that a batch has reached.

    Attributes:
        axis, signal, kind: which, numbers in `AXES`, `SIGNALS` and `KINDS`.
        ratio: over what is claimed.
        value: m, m/s or m/s^2.
        seed, drone, run, period: where.
        plant: of the drone, on these axes.
        gain: applied then.
    """

    axis: int
    signal: int
    kind: int
    ratio: float
    value: float
    seed: int
    drone: int
    run: int
    period: int
    plant: Plant
    gain: float


class Breach(NamedTuple):
    """A claim that failed.

    Attributes:
        claim: what.
        seed, drone, run, period: where.
        value: what was found.
        bound: what is claimed.
    """

    claim: str
    seed: int
    drone: int
    run: int
    period: int
    value: float
    bound: float


class _Largest:
    """The largest values of the signals of N drones, in the run that is flown and in those before it."""

    def __init__(self, seed: int, kinds: Sequence[Sequence[Plant]], count: int) -> None:
        """Begin without a run.

        Args:
            seed: of the batch.
            kinds: plants for x and y, and for z.
            count: N.
        """
        self._seed, self._kinds, self._count = seed, kinds, count
        self.best: dict[tuple[int, int, int], Found] = {}

    def begin(self, run: int, resting: np.ndarray, plants: np.ndarray) -> None:
        """Begin a run, with a number; the other arguments are those of `Judge.begin`."""
        self._run, self._resting, self._plants = run, resting, plants
        self._most, self._value = np.zeros((2, 2, len(SIGNALS), self._count))
        self._when, self._gains = np.zeros((2, *self._most.shape))

    def note(self, ratios: FloatArray, values: FloatArray, judged: np.ndarray, period: int, gain: FloatArray) -> None:
        """Keep what is larger than before.

        Args:
            ratios: (2, S, N) of the values to what is claimed.
            values: (2, S, N) m, m/s or m/s^2.
            judged: (N,) who counts.
            period: its number.
            gain: (N,) applied.
        """
        larger = (ratios > self._most) & judged
        self._most = np.where(larger, ratios, self._most)
        self._value = np.where(larger, values, self._value)
        self._when = np.where(larger, period, self._when)
        self._gains = np.where(larger, gain, self._gains)

    def end(self, started: np.ndarray) -> None:
        """End the run; started (N,) are the drones that began beside their references."""
        kinds = np.where(started, 2, np.where(self._resting, 0, 1))
        for kind, axis, signal in np.ndindex(len(KINDS), 2, len(SIGNALS)):
            ratios = np.where(kinds == kind, self._most[axis, signal], 0.0)
            drone = int(ratios.argmax())
            best = self.best.get((axis, signal, kind))
            if ratios[drone] > 0.0 and (best is None or ratios[drone] > best.ratio):
                at = axis, signal, drone
                self.best[axis, signal, kind] = Found(
                    axis, signal, kind, float(ratios[drone]), float(self._value[at]), self._seed, drone, self._run,
                    int(self._when[at]), self._kinds[axis][self._plants[axis, drone]], float(self._gains[at]),
                )  # fmt: skip


class Judge:
    """The claims of one batch of drones, and how they fared.

    Attributes:
        started: (2, N) m, what is left of starts beside the reference.
        told: number of ticks at which tubes were claimed, as a share of the drones.
    """

    def __init__(
        self, certificate: Certificate, flight: FlightSection, seed: int, kinds: Sequence[Sequence[Plant]], count: int
    ) -> None:
        """Judge by what is claimed.

        Args:
            certificate: that is flown.
            flight: its section.
            seed: of the batch.
            kinds: plants for x and y, and for z.
            count: N drones.
        """
        self._limits, self._flight, self._seed = certificate.limits, flight, seed
        self._largest = _Largest(seed, kinds, count)
        self._feedback, self._period = -certificate.matrix[:, 3:], certificate.period
        self._tubes = np.array([[getattr(axis.tube, name) for name in SIGNALS] for axis in flight.axes])
        backs = [axis.back for axis in flight.axes]
        self._back = np.array([[back.position, np.inf, back.nominal, np.inf] for back in backs])
        self._keep = np.exp(-self._period * np.array([back.rate for back in backs]))[:, np.newaxis]
        self._breaches: dict[int, Breach] = {}
        self._gain_of = np.array([[plant.gain for plant in kind] for kind in kinds])
        # D = d + (g - 1) r + (what the model knows of drag and tilt, less the plant's) p_ref', r = a_ref + known p_ref'
        self._known = np.array([axis.design.model.drag + axis.design.model.tilt for axis in flight.axes])[:, np.newaxis]
        self._unknown = self._known - np.array([[plant.drag + plant.tilt for plant in kind] for kind in kinds])
        self._run = -1
        self._certified = np.array(flight.certified_start(certificate.limits))[:, np.newaxis]
        self.started, self.told = np.zeros((2, count)), 0.0
        self._sure, self._judged = np.ones(count, dtype=bool), np.ones(count, dtype=bool)

    @property
    def found(self) -> tuple[Found, ...]:
        """The largest of each signal."""
        return tuple(self._largest.best.values())

    @property
    def breaches(self) -> tuple[Breach, ...]:
        """The first of each drone."""
        return tuple(self._breaches.values())

    def begin(self, resting: np.ndarray, plants: np.ndarray, away: FloatArray) -> None:
        """Begin a run.

        Args:
            resting: (N,) whose gain rests.
            plants: (2, N) which each is.
            away: (2, N) m, how far from their references the drones are with the next tick; 0 for no start.
        """
        self._run += 1
        self._plants, self._away = plants.copy(), away
        self._largest.begin(self._run, resting, self._plants)

    def asked_at_most(self, plants: np.ndarray) -> FloatArray:
        """Return how much disturbance references that swing make of themselves, m/s^2, on plants (2, N)."""
        speed, acceleration, _, _ = amplitudes(self._flight)
        each = [[0], [1]], plants
        asked = np.abs(self._gain_of[each] - 1.0) * (acceleration + self._known * speed)
        return np.asarray(asked + np.abs(self._unknown[each]) * speed)

    def look(self, tick: Tick, before: FloatArray, drones: ExactDrones, push: FloatArray, period: int) -> None:
        """Check all claims at a tick, and that of the place also in the middle of the period before it.

        Args:
            tick: of the pilot.
            before: (N, 9) references at the tick before.
            drones: where they truly are.
            push: (N, 3) disturbance, m/s^2.
            period: number of the period that ends.
        """
        started = self.started
        place = before[:, :3] + self._period / 2.0 * (before[:, 3:6] + self._period / 4.0 * before[:, 6:])
        middle = _sizes(drones.middle - place) / (self._tubes[:, 0, np.newaxis] + self._back[:, :1] * started)
        started = self.started = self._keep * started
        if self._away.any():
            started = self.started = started + self._away
            self._sure &= (started <= np.maximum(self._certified, 0.0)).all(axis=0)
            self._away = np.zeros_like(self._away)

        gain, flight, limits = tick.output.applied_gain, self._flight, self._limits
        outside = (gain < flight.gain_min * (1.0 - _ROUNDING)) | (gain > flight.gain_max * (1.0 + _ROUNDING))
        most = np.where(gain < 1.0, flight.gain_min, flight.gain_max)
        self._fail("the applied gain is in its interval", outside & self._sure, gain, most, period)
        self._judged &= ~outside  # starts that are not certified may saturate, and then nothing is claimed
        thrust, tilt = tick.input[:, 0], np.abs(tick.input[:, 1:]).max(axis=1)
        self._claim("T <= T_max", thrust, limits.thrust_max, period)
        self._claim("|phi|, |theta| <= eps_max", tilt, limits.tilt_max, period)
        flies = float(Mode.FLY.value)
        self._fail("the pilot flies on", tick.mode != flies, tick.mode, flies, period)

        plants = [[0], [0], [1]], self._plants[[0, 0, 1]]
        gains, velocity = self._gain_of[plants].T, tick.reference[:, 3:6]
        asked = tick.reference[:, 6:] + self._known[[0, 0, 1], 0] * velocity
        divided = (push + (gains - 1.0) * asked + self._unknown[plants].T * velocity) / gains
        error = drones.position - tick.reference[:, :3], drones.velocity - tick.reference[:, 3:6]
        signals = (*error, tick.output.error @ self._feedback, divided - tick.disturbance)
        values = np.stack([_sizes(signal) for signal in signals], axis=1)
        reached = started[:, np.newaxis]
        beside = np.where(reached > 0.0, self._back[..., np.newaxis] * np.maximum(reached, _TINY), 0.0)
        bounds = self._tubes[..., np.newaxis] + beside
        ratios = values / bounds
        ratios[:, 0] = np.maximum(ratios[:, 0], middle)
        values[:, 0] = ratios[:, 0] * bounds[:, 0]
        for axis, signal in np.ndindex(2, len(SIGNALS)):
            ratio, bound = ratios[axis, signal], bounds[axis, signal]
            over = ~(ratio <= 1.0 + _ROUNDING)
            self._fail(f"{AXES[axis]} {SIGNALS[signal]}", over, ratio * np.minimum(bound, _HUGE), bound, period)
        self._largest.note(ratios, values, self._judged, period, gain)
        self.told += float(tick.assessment.guaranteed.mean())

    def end(self) -> None:
        """End a run: note what was the largest."""
        self._largest.end(np.asarray((self.started > 0.0).any(axis=0)))

    def _claim(self, text: str, values: FloatArray, bound: FloatArray | float, period: int) -> None:
        """Note of whom a claim fails, that values (N,) are at most a bound."""
        bounds = np.broadcast_to(bound, values.shape)
        self._fail(text, ~(values <= bounds * (1.0 + _ROUNDING)), values, bounds, period)

    def _fail(self, text: str, failing: np.ndarray, values: FloatArray, bound: FloatArray | float, period: int) -> None:
        """Note of whom a claim fails, (N,)."""
        failing = failing & self._judged
        if not np.count_nonzero(failing):
            return
        bounds = np.broadcast_to(bound, values.shape)
        for drone in map(int, np.flatnonzero(failing)):
            value, most = float(values[drone]), float(bounds[drone])
            self._breaches[drone] = Breach(text, self._seed, drone, self._run, period, value, most)
            self._judged[drone] = False


def _sizes(vectors: FloatArray) -> FloatArray:
    """Return the sizes (2, N) of vectors (N, 3): horizontal and vertical."""
    return np.array([np.hypot(vectors[:, 0], vectors[:, 1]), np.abs(vectors[:, 2])])

"""Whether a drone's loop is still the one that its flight certificate is about; if not, its law gets less to correct.

Stiff gains are proved for a lag, a delay and an age of the poses inside intervals. Outside they swing a drone, and one
whose axis has the wrong sign they throw away before anybody can see it. So a drone whose poses are old, or not where
the model expects them, is flown softly until that has passed: from the estimate that knows of no lag and delay, with
the error made smaller before the law sees it, so that for its gain gamma and v0 = -(K_p e + K_v e')

    gamma v0 = -(k_p e + k_v e')

with gains that bear half a second of lag and delay, and what disturbs it is made up for slowly. The law, its gains and
its limits stay what they are. The sign of an axis shows in the air alone: a drone that takes off is flown softly
sideways until it has been there for a while, and moves as the model expects.

Certificates without a flight section have no model that expects anything: of their loops swings alone tell that they
are late, and nothing whether they still are while a drone is flown softly. So that lasts for a minute there.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from flatsat_ros.base.arrays import BoolArray, FloatArray, any_of
from flatsat_ros.certificate.flight import FlightSection

# k_p, 1/s^2, and k_v, 1/s
_SOFT = (0.9, 1.4)
# a pose of this age, s, is older than a loop with the certificate's gains bears for long, whatever was proved
_OLD = 0.12
# An innovation of so much, m, and so many times its bound, is no noise, nor a gust of 2 m/s: sideways its size, and
# vertically the amplitude of a swing with its mean square over about so long, s: a late loop swings, a gust does not.
_STRANGE, _TIMES = np.array([0.016, 0.0075]), np.array([5.0, 2.5])
_SWINGING = 0.4
# where no model knows of lag and delay, what disturbs it vertically swings so far, m/s^2, beyond gusts and climbs
_SWINGS = 1.5
# until it has been off the ground for a while its thrust is not known yet, and gusts come on top of that: so many times
# as far it may swing
_CLIMBING = 1.5
# A drone is doubted for so long, s, after the last reason; if there is another within so long, s, after that, for
# longer by this factor, up to so long, s: a loop that is late swings again at once, gusts come by chance.
_DOUBTED, _AGAIN, _LONGER, _LONGEST = 2.0, 6.0, 4.0, 60.0
# and after it has left the ground, sideways, s; then until so long, s, it has been where it is expected, but not for
# more than so long, s, besides
_LIFTED = 1.5
_CALM, _WAITED = 0.5, 2.0
# The stiff law would answer to more than this, m and m/s, along z with all its thrust, and swing a late loop at once:
# so long it is flown softly on.
_NEAR, _SLOWLY = 0.1, 0.2
# what disturbs one that is doubted is made up for with this time constant, s: quickly that would swing a drone whose
# commands act late, of which its estimate knows nothing
_SLOW = 1.5
# a landing drone that is slowed by so much, m/s, from one tick to the next and then stays within so much, m, is carried
_STOPPED, _STAYS = 0.15, 0.01
_STRANGELY = "its poses come too late or are not where they are expected: flown softly for {:g} s at least"
_SWINGINGLY = "it swings: do poses or commands come too late? It is flown softly for {:g} s at least"


class Doubt:
    """Doubts about the loops of N drones.

    Attributes:
        any: whether there are any.
    """

    def __init__(
        self,
        gains: FloatArray,
        strange: FloatArray,
        expected: float,
        shortest: float,
        told: str,
        period: float,
        count: int,
    ) -> None:
        """Begin without doubts.

        Args:
            gains: of the law for a gain of 1, along x, y, z: stiffness, 1/s^2, and rate, 1/s, (2, 3).
            strange: what is looked at, horizontal and vertical, is strange beyond this, (2,).
            expected: and as expected up to this horizontally.
            shortest: s for which a doubt lasts at least.
            told: of a drone that is doubted, with a place for these s.
            period: between two ticks, s.
            count: N.
        """
        self._share = np.minimum(np.array(_SOFT)[:, np.newaxis] / gains, 1.0).ravel()
        self._strange, self._expected = strange, expected
        self._until = np.full((count, 2), -np.inf)  # s, horizontal and vertical
        self._lifted = np.full(count, -np.inf)  # s, until when each has just left the ground
        self._rested = np.full(count, -np.inf)  # s, until when what carries each may still show in its height
        self._shortest, self._told = shortest, told
        self._doubted = np.full(count, shortest)  # for how long the next time, s
        self._square, self._looked = np.zeros(count), -np.inf  # mean, of the vertical innovations, m^2; and when, s
        self._period = period
        self._new = np.zeros(count, dtype=bool)  # the doubts of each have just begun
        self._followed = np.zeros((count, 3))  # of its disturbance, m/s^2
        self._pace = self._period / _SLOW
        self._reports: list[tuple[int, str]] = []
        self.any = False

    @classmethod
    def of_flight(cls, flight: FlightSection, bounds: FloatArray, count: int) -> Doubt:
        """Return doubts that arise from innovations, m.

        Args:
            flight: what is proved.
            bounds: of the innovation while all holds, horizontal and vertical, (2,), m.
            count: N.
        """
        designs = [axis.design for axis in (flight.horizontal, flight.horizontal, flight.vertical)]
        gains = np.array([[design.stiffness for design in designs], [design.rate for design in designs]])
        strange = np.maximum(_STRANGE, _TIMES * bounds)
        return cls(gains, strange, float(bounds[0]), _DOUBTED, _STRANGELY, flight.horizontal.design.period, count)

    @classmethod
    def of_swings(cls, matrix: FloatArray, period: float, count: int) -> Doubt:
        """Return doubts that arise from how far disturbances, m/s^2, swing in height: no model tells more.

        Args:
            matrix: of the law, (6, 6): v0 = -(its last three columns)' (e, e').
            period: between two ticks, s.
            count: N.
        """
        gains = np.stack([np.diag(matrix[:3, 3:]), np.diag(matrix[3:, 3:])])
        return cls(gains, np.array([np.inf, _SWINGS]), np.inf, _LONGEST, _SWINGINGLY, period, count)

    def reports(self) -> list[tuple[int, str]]:
        """Return what is to be told, drone and text, once."""
        reports, self._reports = self._reports, []
        return reports

    def of(self, now: float) -> BoolArray:
        """Return the doubts, (N, 2), horizontal and vertical, at time now, s."""
        doubts = np.asarray(now < self._until)
        self.any = any_of(doubts)
        return doubts

    def look(self, now: float, flying: np.ndarray, age: FloatArray, innovation: FloatArray) -> None:
        """Find reasons to doubt.

        Args:
            now: s.
            flying: (N,) who is steered.
            age: (N,) of the pose that was used last, s.
            innovation: (N, 2) its size, horizontal and vertical, m.
        """
        sideways = innovation[:, 0]
        swing = self._swing(now, np.where(flying & (now >= self._rested), innovation[:, 1], 0.0))
        beyond = (sideways > self._strange[0]) | (swing > self._strange[1])
        waits = now < np.minimum(self._until[:, 0], self._lifted + _WAITED)
        longer = flying & waits & (sideways > self._expected)
        self._until[longer, 0] = np.maximum(self._until[longer, 0], now + _CALM)
        strange = flying & ((age > _OLD) | beyond)
        if not any_of(strange):
            return
        early = (now < self._lifted) & (sideways <= self._strange[0]) & (swing <= _CLIMBING * self._strange[1])
        strange &= ~early | (age > _OLD)
        if not any_of(strange):
            return
        self._begin(now, strange)

    def ease(self, now: float, swings: np.ndarray) -> BoolArray:
        """Doubt the loops of those that are seen to swing, (N,); return which of these were flown stiffly till now."""
        eased = swings & (now >= self._until[:, 1])
        if any_of(eased):
            self._begin(now, eased)
        return np.asarray(eased)

    def _begin(self, now: float, strange: np.ndarray) -> None:
        """Doubt the loops of some drones, (N,), or go on with it."""
        ended = self._until[:, 1]
        new = strange & (now >= ended)
        again = now - ended < _AGAIN
        lasting = np.where(again, np.minimum(_LONGER * self._doubted, _LONGEST), self._shortest)
        self._doubted = np.where(new, lasting, self._doubted)
        self._new |= new
        self._until[strange] = (now + self._doubted)[strange, np.newaxis]
        self._reports += [(int(i), self._told.format(self._doubted[i])) for i in np.flatnonzero(new)]
        self.any = True

    def hold(self, now: float, error: FloatArray, touching: np.ndarray | None = None) -> None:
        """Let doubts last while a drone is too far from its reference in height for what follows.

        Args:
            now: s.
            error: (N, 6) m and m/s.
            touching: (N,) who lands and is so low that the ground may carry it, while its reference sinks on; nobody by
                default.
        """
        far = (np.abs(error[:, 2]) > _NEAR) | (np.abs(error[:, 5]) > _SLOWLY)
        if touching is not None:
            far &= ~touching
        held = far & (now < self._until[:, 1])
        self._until[held, 1] = np.maximum(self._until[held, 1], now + _CALM)

    def land(self, now: float, landing: np.ndarray) -> None:
        """Let drones land softly, (N,), that were flown so lately: a swing must not begin again before the ground."""
        lately = landing & (now - self._until[:, 1] < _LONGEST)
        if any_of(lately):
            self._until[lately, 1] = np.maximum(self._until[lately, 1], now + _CALM)
            self.any = True

    def _swing(self, now: float, innovation: FloatArray) -> FloatArray:
        """Return how far vertical innovations (N,), m, swing, (N,) m; unseen ones are next to nothing."""
        self._square *= math.exp(min(self._looked - now, 0.0) / _SWINGING)
        self._square += self._period / _SWINGING * innovation * innovation
        self._looked = now
        return np.asarray(np.sqrt(2.0 * self._square))

    def wait(self, now: float, grounded: np.ndarray) -> None:
        """Doubt what is sideways of drones that have not left the ground, (N,), and for a while after that."""
        self._lifted[grounded] = now + _LIFTED
        self._until[grounded, 0] = np.maximum(self._until[grounded, 0], now + _LIFTED)
        self.any = True

    def rest(self, now: float, resting: np.ndarray) -> None:
        """Let heights of drones that may stand on something, (N,), be as they are, and for a while after that."""
        self._rested[resting] = now + _LIFTED

    def slowed(self, now: float, lately: Callable[[], FloatArray], disturbance: FloatArray) -> FloatArray:
        """Return the disturbances (N, 3), m/s^2, that are made up for: slowly, of drones that are not where expected.

        Args:
            now: s.
            lately: returns the mean over the last second, (N, 3), from which on it is followed; vertically from 0.
            disturbance: (N, 3) estimated.
        """
        if any_of(self._new):
            self._followed[self._new] = lately()[self._new]
            self._followed[self._new, 2] = 0.0  # what lasts has been learnt of the thrust
            self._new[:] = False
        self._followed += self._pace * (disturbance - self._followed)
        return np.where((now < self._until[:, 1])[:, np.newaxis], self._followed, disturbance)

    def soften(self, error: FloatArray, doubts: np.ndarray, gain: FloatArray) -> FloatArray:
        """Return errors (N, 6), m and m/s, that the law may see.

        Args:
            error: (N, 6) m and m/s.
            doubts: (N, 2), see `of`.
            gain: (N,) gamma.
        """
        share = np.minimum(self._share / gain[:, np.newaxis], 1.0)
        return np.where(doubts[:, _AXES], share * error, error)


class Carried:
    """Tells which of N landing drones have come down on something that nobody knew of.

    It stops them at once, as no air does, and they stay there: so long nothing follows from where they are.
    """

    def __init__(self, period: float, count: int) -> None:
        """Begin with nobody; period between two ticks, s."""
        self._stopped, self._soon = _STOPPED * period, 1.5 * period
        self._before, self._last = np.zeros(count), -np.inf  # innovations of the last look, m, and when that was, s
        self._height = np.full(count, np.nan)  # at which each was stopped, m

    def look(self, now: float, landing: np.ndarray, innovation: FloatArray, height: FloatArray) -> np.ndarray:
        """Return who is carried, (N,).

        Args:
            now: s; whoever looks not at every tick has not seen anything large meanwhile.
            landing: (N,) who lands.
            innovation: (N,) vertical, m.
            height: (N,) measured, m.
        """
        gained = innovation - (self._before if now - self._last < self._soon else 0.0)
        self._before, self._last = innovation.copy(), now
        stays = landing & (np.abs(height - self._height) < _STAYS)
        self._height = np.where(stays, self._height, np.where(landing & (gained > self._stopped), height, np.nan))
        return np.asarray(np.isfinite(self._height))


_AXES = [0, 0, 1, 0, 0, 1]  # of position and velocity

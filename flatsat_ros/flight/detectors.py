"""What a drone's motion says about the ground, wind and swings; `falls` and `astray` have what else it says."""

from __future__ import annotations

import math

import numpy as np

from flatsat_ros.base.arrays import FloatArray, any_of

# A landing drone is carried when it is commanded to accelerate downward by this much, m/s^2, in the mean and stays
# within so little height, m, for this long, s: in free air it would be three times as far down. Air that rises holds it
# as well, but where it is led to: what is carried is above its reference, which sinks on, by so much, m.
_WELL_BELOW_HOVER = 1.2
_STEADY = 0.05
_ABOVE = 0.15
_CARRIED_TIME = 0.9  # a body that is pushed so and falls freely moves farther in that time, wherever it is on its way

# a drone is off the ground when it is so far, m, from the height at which its lock was opened; it cannot be below
LIFTED_OFF = 0.05
# one that was taken over wherever it was is in the air, too, when it has moved along x or y by so much, m: what stands
# on something with its lock closed does not
_MOVED_ASIDE = 0.03
# an upward acceleration of this much, m/s^2, is a command to climb
_CLIMB = 0.5
# a drone that a thrust that lifts whoever can be flown does not lift by so much, m, within this time, s, stays on the
# ground, or its poses do not show that it leaves it.
_ENOUGH_RISE, _ENOUGH_TIME = 0.01, 0.4
# A drone that moves sideways by so much, m, before it has left the ground does not climb where it is told to, unless it
# was seen to rise by more than so small a part of that: gusts push one sideways that hops on the cushion of the ground.
_SLID, _HOPPED = 0.15, 0.2

# A drone whose commanded tilt has this share of the largest is at its limit.
_AT_LIMIT = 0.9
# It is blown off if for this long, s, the second time while it lands, it has been at its limit and this far off, m,
# m, without coming nearer by this share.
_BLOWN_TIME, _BLOWN_LANDING_TIME = 2.0, 0.4
_OFF = 0.5
_NEARER = 0.05
# It is opposed if at its limit for this long, s, what disturbs it is against the command and so many times as much. Two
# is what a wrong sign makes of it; 1.8 times the limit of 10 degrees is a wind of 7 m/s.
_OPPOSED_TIME = 0.2
_OPPOSED = 1.8
# where the yaw is assumed, so much is opposed: what a yaw makes of it that is 1.4 rad off, or a wind of 3 m/s
_ASSUMED_OPPOSED = 0.8
# It swings if its error tilts it by this share of the limit, then to the opposite, more often than this within about so
# many seconds; a step to a set-point takes one or two such changes.
_SWINGING_SHARE = 0.5
_SWINGS = 3.0
_SWINGING_TIME = 5.0
_OPPOSITE = -0.5  # cosine
# it bobs if its error asks for this much, m/s^2, upward and downward in turns as often
_BOBBING = 0.7


class TouchDownDetector:
    """Tells which landing drones are carried by something, wherever that is."""

    def __init__(self, count: int) -> None:
        self._since = np.full(count, np.inf)
        self._height = np.full(count, np.nan)  # then, m
        self._pushed = np.zeros(count)  # change of velocity that was commanded since then, m/s
        self._last = np.inf  # s, of the last look

    def carried(
        self, now: float, height: FloatArray, upward: FloatArray, above: FloatArray, landing: np.ndarray
    ) -> np.ndarray:
        """Tell which drones are carried, (N,).

        Args:
            now: s.
            height: (N,) z, m.
            upward: (N,) vertical acceleration that was commanded at the last tick, m/s^2: what the law asks for, with
                the disturbance that is compensated.
            above: (N,) height above the reference, m.
            landing: (N,) who lands.
        """
        elapsed, self._last = max(now - self._last, 0.0), now
        if not any_of(landing):
            self._since[:] = np.inf
            return np.zeros(landing.size, dtype=bool)
        steady = landing & np.isfinite(self._since) & (np.abs(height - self._height) < _STEADY)
        self._pushed = np.where(steady, self._pushed + elapsed * upward, 0.0)
        self._since = np.where(steady, np.minimum(self._since, now), np.where(landing, now, np.inf))
        self._height = np.where(steady, self._height, height)
        lasted = now - self._since
        pushed = (lasted >= _CARRIED_TIME) & (self._pushed <= -_WELL_BELOW_HOVER * lasted)
        return np.asarray(pushed & (above >= _ABOVE))


class LiftOffDetector:
    """Tells which drones are commanded to climb and stay on the ground.

    Attributes:
        standing: (N,) who may stand on something: it was not seen to leave the place where it was watched first.
        slid: (N,) who of these has moved sideways instead.
        sunk: (N,) who of these is seen below the ground instead.
    """

    def __init__(self, count: int, patience: float, enough: float = math.inf) -> None:
        """Watch nobody at first.

        Args:
            count: N.
            patience: s of a commanded climb after which a drone that is still on the ground will not leave it.
            enough: times the thrust of a hover that lift whoever can be flown.
        """
        self._patience, self._enough = patience, enough
        self.standing = self.slid = self.sunk = self._nobody = np.zeros(count, dtype=bool)
        self._aside = np.full(count, np.inf)  # who is so far along x or y is in the air, m
        self._place = np.zeros((count, 3))  # where each stood last, m
        self._highest = np.zeros(count)  # how far each was seen to rise from there at most, m
        self._held_since = np.full(count, np.inf)
        self._enough_since = np.full(count, np.inf)
        self._enough_from = np.zeros(count)  # how far each had risen then, m
        self._last = np.inf  # s, of the last look
        self._unseen = np.zeros((2, count))  # rise, m, and climb rate, m/s, of each if its thrust is what is asked for

    def begin(self, index: int, place: FloatArray, *, taken_over: bool = False) -> None:
        """Watch drone index, which is at a place (3,), m.

        Args:
            index: which drone.
            place: where it stands and is about to take off.
            taken_over: it may be in the air there, or stand on something with its thrust lock closed.
        """
        self.standing = self.standing.copy()
        self._aside[index] = _MOVED_ASIDE if taken_over else np.inf
        self.standing[index], self._place[index], self._held_since[index] = True, place, np.inf
        self._enough_since[index], self._unseen[:, index], self._highest[index] = np.inf, 0.0, 0.0

    def risen(self, index: int, place: FloatArray) -> float:
        """Return how high drone index, which is seen at a place (3,), m, is if all its way led upward, m."""
        return float(self._place[index, 2] + np.linalg.norm(place - self._place[index]))

    def above(self, place: FloatArray) -> FloatArray:
        """Return how far each, which is seen at a place (N, 3) or more, m, is above where it stood, (N,) m."""
        return np.asarray(place[:, 2] - self._place[:, 2])

    def moved(self, place: FloatArray) -> FloatArray:
        """Return how far each, which is seen at a place (N, 3) or more, m, is from where it stood, (N,) m."""
        return np.asarray(np.linalg.norm(place[:, :3] - self._place, axis=1))

    def upward(self, index: int, place: FloatArray) -> FloatArray:
        """Return the direction (3,) in which drone index, which is seen at a place (3,), m, has left the ground."""
        way = place - self._place[index]
        return np.asarray(way / np.linalg.norm(way))

    def unseen(self, index: int) -> tuple[float, float]:
        """Return how high, m, and how fast, m/s, drone index is by now if its poses do not show that it climbs."""
        rise, climb = self._unseen[:, index].tolist()
        return rise, climb

    def held(
        self, now: float, place: FloatArray, upward: FloatArray, scale: FloatArray, gravity: float, flying: np.ndarray
    ) -> np.ndarray:
        """Tell which drones have been commanded to climb for too long without leaving the ground, (N,).

        Args:
            now: s.
            place: (N, 3) m.
            upward: (N,) vertical acceleration that was commanded at the last tick, m/s^2.
            scale: (N,) by which the thrust is divided that is asked for.
            gravity: g, m/s^2.
            flying: (N,) who is steered.
        """
        elapsed, self._last = max(now - self._last, 0.0), now
        if not any_of(self.standing):
            self.slid = self.sunk = self._nobody
            return self._nobody
        way = place.copy() - self._place  # a copy is faster than a view
        moved = np.abs(way)
        np.maximum(self._highest, way[:, 2], out=self._highest)
        self.slid = self.sunk = self._nobody
        if any_of(moved > _MOVED_ASIDE):
            self.sunk = flying & self.standing & (way[:, 2] < -LIFTED_OFF)
            self.standing = self.standing & (moved[:, 2] < LIFTED_OFF) & (moved[:, :2].max(axis=1) < self._aside)
            aside = np.hypot(moved[:, 0], moved[:, 1])
            self.slid = flying & self.standing & (aside > _SLID) & (_HOPPED * aside > self._highest)
        waiting = flying & self.standing
        gained = (upward + gravity) / scale - gravity  # m/s^2, if its thrust is what is asked for
        rise, climb = self._unseen
        climb += elapsed * gained
        np.maximum(climb, 0.0, out=climb)
        climb *= waiting
        rise += elapsed * climb
        held = climbing = waiting & (upward >= _CLIMB)
        if any_of(climbing):
            self._held_since = np.where(climbing, np.minimum(self._held_since, now), np.inf)
            held = now - self._held_since >= self._patience
        else:
            self._held_since[:] = np.inf
        strong = gained >= (self._enough - 1.0) * gravity
        if not any_of(strong):
            self._enough_since[:] = np.inf
            return np.asarray(held)
        self._enough_from = np.where(np.isfinite(self._enough_since), self._enough_from, way[:, 2])
        enough = waiting & strong & (way[:, 2] - self._enough_from < _ENOUGH_RISE)
        self._enough_since = np.where(enough, np.minimum(self._enough_since, now), np.inf)
        return np.asarray(held | (now - self._enough_since >= _ENOUGH_TIME))


class TiltLimitDetector:
    """Tells which drones the limit of their tilt does not let follow: blown off by wind, or swinging by a late loop."""

    def __init__(self, count: int, tilt_max: float, gravity: float) -> None:
        """Watch nobody at first.

        Args:
            count: N.
            tilt_max: rad.
            gravity: m/s^2.
        """
        self._slope, self._gravity = math.tan(tilt_max), gravity
        self._since = np.full(count, np.inf)  # at its limit and far off, without coming nearer
        self._nearest = np.zeros(count)  # how far off it was then, m
        self._opposed_since = np.full(count, np.inf)
        self._direction = np.zeros((count, 2))  # in which its error tilted it far last
        self._swings = np.zeros(count)  # changes to the opposite, forgotten slowly
        self._last = -np.inf  # s, of the last look

    def look(
        self,
        now: float,
        acceleration: FloatArray,
        correction: FloatArray,
        disturbance: FloatArray,
        error: FloatArray,
        steered: np.ndarray,
        landing: np.ndarray,
        assumed: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Tell who is blown off, who swings and who is opposed, each (N,).

        Args:
            now: s.
            acceleration: (N, 3) commanded, m/s^2.
            correction: (N, 2) horizontal part of it that the error asks for, m/s^2.
            disturbance: (N, 2) estimated, less the drag of its own speed, m/s^2.
            error: (N, 2) horizontal position minus reference, m.
            steered: (N,) who is in the air and steered.
            landing: (N,) who lands.
            assumed: (N,) whose yaw nobody sees; nobody's by default.
        """
        most = self._slope * np.maximum(acceleration[:, 2] + self._gravity, 0.0)
        limited = steered & (np.hypot(acceleration[:, 0], acceleration[:, 1]) >= _AT_LIMIT * most)
        size = np.hypot(correction[:, 0], correction[:, 1])
        tilted = steered & (size >= _SWINGING_SHARE * most) & (size > 0.0)
        self._swings *= math.exp(max(self._last - now, -_SWINGING_TIME) / _SWINGING_TIME)
        self._last = now
        if not (any_of(limited) or any_of(tilted)):
            self._since[:] = self._opposed_since[:] = np.inf
            return limited, limited, limited
        direction = correction / np.where(tilted, size, 1.0)[:, np.newaxis]
        self._swings += tilted & ((direction * self._direction).sum(axis=1) < _OPPOSITE)
        self._direction = np.where(tilted[:, np.newaxis], direction, self._direction)
        self._swings[~steered] = 0.0
        off = np.hypot(error[:, 0], error[:, 1])
        stuck = limited & (off > _OFF)
        anew = stuck & (np.isinf(self._since) | (off < (1.0 - _NEARER) * self._nearest))
        self._nearest = np.where(anew, off, self._nearest)
        self._since = np.where(stuck, np.where(anew, now, self._since), np.inf)
        blown = now - self._since >= np.where(landing, _BLOWN_LANDING_TIME, _BLOWN_TIME)
        ahead = acceleration[:, :2]
        share = _OPPOSED if assumed is None else np.where(assumed, _ASSUMED_OPPOSED, _OPPOSED)
        opposed = limited & ((disturbance * ahead).sum(axis=1) < -share * (ahead * ahead).sum(axis=1))
        self._opposed_since = np.where(opposed, np.minimum(self._opposed_since, now), np.inf)
        return np.asarray(blown), self._swings > _SWINGS, np.asarray(now - self._opposed_since >= _OPPOSED_TIME)

    def forget(self, which: np.ndarray) -> None:
        """Forget how often some drones, (N,), have swung."""
        self._swings[which] = 0.0

    def set_clock_back(self, now: float) -> None:
        """Let nothing last longer because the clock was set back to now, s."""
        self._since, self._opposed_since = (
            np.where(np.isfinite(since), np.minimum(since, now), np.inf) for since in (self._since, self._opposed_since)
        )
        self._last = min(self._last, now)


class BobbingDetector:
    """Tells which drones swing up and down: commands or poses come too late for their height."""

    def __init__(self, count: int) -> None:
        """Watch nobody at first."""
        self._sign = np.zeros(count)  # of the last large correction
        self._swings = np.zeros(count)  # changes of it, forgotten slowly
        self._last = -np.inf  # s, of the last look at a large one

    def look(self, now: float, correction: FloatArray, steered: np.ndarray) -> np.ndarray:
        """Tell who bobs, (N,).

        Args:
            now: s.
            correction: (N,) vertical acceleration that the error asks for, m/s^2.
            steered: (N,) who is in the air and steered.
        """
        large = steered & (np.abs(correction) >= _BOBBING)
        if not any_of(large):
            return large
        self._swings *= math.exp(min(self._last - now, 0.0) / _SWINGING_TIME)
        self._last = now
        sign = np.sign(correction)
        self._swings += large & (sign * self._sign < 0.0)
        self._sign = np.where(large, sign, self._sign)
        self._sign[~steered] = self._swings[~steered] = 0.0
        return np.asarray(self._swings > _SWINGS)

    def forget(self, which: np.ndarray) -> None:
        """Forget how often some drones, (N,), have swung."""
        self._swings[which] = 0.0

"""What a drone's motion says about the ground and about its commands: the detectors of the supervisor."""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray

# A landing drone is carried when it is commanded to accelerate downward by this much, m/s^2, and still is this slow,
# m/s, for this long, s.
_WELL_BELOW_HOVER = 1.2
_SLOW = 0.05
_CARRIED_TIME = 0.5

# a drone is off the ground when it is so far, m, from the height at which its lock was opened
_LIFTED_OFF = 0.05
# an upward acceleration of this much, m/s^2, is a command to climb
_CLIMB = 0.5

# A drone falls when it sinks faster than this, m/s, and is disturbed downward by more than this, m/s^2.
_FALLING_SPEED = 1.0
_FALLING_DISTURBANCE = 4.0
# It lies when so near, m, to the ground on which it once stood it stays within so little, m, though commanded upward by
# this, m/s^2, for this long, s.
_NEAR_GROUND = 0.10
_STILL = 0.003
_UPWARD = 0.3
_LYING_TIME = 1.5

# Motion against command is judged by changes of the velocity over this time, s, forgetting them with the second one, s,
# once commands have changed it by so much, (m/s)^2 s.
_WINDOW = 0.2
_FORGOTTEN = 1.5
_JUDGED = 0.001
# Of what is commanded, at least this share must come, and at most this much across it.
_LEAST_ALONG = -0.4
_MOST_ACROSS = 0.8
_TURNED = 2.0  # if it is also so much more than what comes along


class TouchDownDetector:
    """Tells which landing drones are carried by something: no height is needed for that."""

    def __init__(self, count: int) -> None:
        self._since = np.full(count, np.inf)

    def carried(self, now: float, climb: FloatArray, upward: FloatArray, landing: np.ndarray) -> np.ndarray:
        """Tell which drones are carried, (N,).

        Args:
            now: s.
            climb: (N,) vertical velocity, m/s.
            upward: (N,) vertical acceleration that was commanded at the last tick, m/s^2: what the law asks for, with
                the disturbance that is compensated.
            landing: (N,) who lands.
        """
        if not np.count_nonzero(landing):
            self._since[:] = np.inf
            return np.zeros(landing.size, dtype=bool)
        carried = landing & (upward <= -_WELL_BELOW_HOVER) & (np.abs(climb) < _SLOW)
        self._since = np.where(carried, np.minimum(self._since, now), np.inf)
        return np.asarray(now - self._since >= _CARRIED_TIME)


class LiftOffDetector:
    """Tells which drones are commanded to climb and stay on the ground.

    Attributes:
        standing: (N,) who was seen to stand and has not left the ground yet.
    """

    def __init__(self, count: int, patience: float) -> None:
        """Watch nobody at first.

        Args:
            count: N.
            patience: s of a commanded climb after which a drone that is still on the ground will not leave it.
        """
        self._patience = patience
        self.standing = np.zeros(count, dtype=bool)
        self._height = np.zeros(count)  # at which each stood last, m
        self._held_since = np.full(count, np.inf)

    def begin(self, index: int, height: float) -> None:
        """Watch drone index, which stands at a height, m, and is about to take off."""
        self.standing[index], self._height[index], self._held_since[index] = True, height, np.inf

    def held(self, now: float, height: FloatArray, upward: FloatArray, flying: np.ndarray) -> np.ndarray:
        """Tell which drones have been commanded to climb for too long without leaving the ground, (N,).

        Args:
            now: s.
            height: (N,) z, m.
            upward: (N,) vertical acceleration that was commanded at the last tick, m/s^2.
            flying: (N,) who is steered.
        """
        if not np.count_nonzero(self.standing):
            return np.zeros(flying.size, dtype=bool)
        self.standing = self.standing & (np.abs(height - self._height) < _LIFTED_OFF)
        waiting = flying & self.standing & (upward >= _CLIMB)
        self._held_since = np.where(waiting, np.minimum(self._held_since, now), np.inf)
        return np.asarray(now - self._held_since >= self._patience)


class FallDetector:
    """Tells which drones fall, or lie on the ground, though they are commanded to fly: their motors do not obey."""

    def __init__(self, count: int) -> None:
        self._since = np.full(count, np.inf)
        self._place = np.full((count, 3), np.nan)  # where it has been lying since

    def fell(
        self, now: float, state: FloatArray, disturbance: FloatArray, upward: FloatArray, height: FloatArray
    ) -> np.ndarray:
        """Tell who fell, (N,), of drones that have left the ground and are steered.

        Args:
            now: s.
            state: (N, 6) position, m, and velocity, m/s.
            disturbance: (N,) estimated vertical disturbance, m/s^2.
            upward: (N,) vertical acceleration that was commanded at the last tick, m/s^2.
            height: (N,) above the ground on which each stood last, m; infinite for those that are not judged.
        """
        sinking, low = state[:, 5] < -_FALLING_SPEED, np.abs(height) < _NEAR_GROUND
        if not np.count_nonzero(sinking) + np.count_nonzero(low):
            self._since[:] = np.inf
            return sinking
        falling = sinking & np.isfinite(height) & (disturbance < -_FALLING_DISTURBANCE)
        lying = low & (upward > _UPWARD)
        if not np.count_nonzero(lying):
            self._since[:] = np.inf
            return np.asarray(falling)
        moved = ~(np.abs(state[:, :3] - self._place).max(axis=1) < _STILL)
        self._place[moved] = state[moved, :3]
        self._since = np.where(lying & ~moved, np.minimum(self._since, now), np.inf)
        return np.asarray(falling | (now - self._since >= _LYING_TIME))

    def set_clock_back(self, now: float) -> None:
        """Let nothing last longer because the clock was set back to now, s."""
        self._since = np.where(np.isfinite(self._since), np.minimum(self._since, now), np.inf)


class AstrayDetector:
    """Tells which drones do not move horizontally as they are commanded: a wrong yaw, frame, sign or body.

    How the acceleration changes is compared with how the commands should have changed it, as late as they act: how much
    of that comes along, and how much across. Changes, because a constant wind is countered by a constant command.
    """

    def __init__(self, count: int, period: float, late: float) -> None:
        """Begin without a past.

        Args:
            count: N.
            period: between two looks, s.
            late: how long a command takes to act, s.
        """
        self._period = period
        self._window, self._late = max(1, round(_WINDOW / period)), round(late / period)
        # velocity, and velocity that was commanded since the start, of the last looks: (looks, 2, N, 2), newest last
        self._past = np.zeros((2 * self._window + self._late + 1, 2, count, 2))
        self._sums = np.zeros((count, 3))  # of what was commanded, of what came along it and across it
        self._judged = np.zeros(count)  # s

    def astray(self, push: FloatArray, velocity: FloatArray, judged: np.ndarray) -> np.ndarray:
        """Tell who goes astray, (N,).

        Args:
            push: (N, 2) horizontal change of velocity that was commanded since the last look, m/s.
            velocity: (N, 2) estimated, m/s.
            judged: (N,) who is in the air and steered.
        """
        commanded = self._past[-1, 1] + push
        self._past[:-1] = self._past[1:]
        self._past[-1] = velocity, commanded
        wanted = self._changed(self._past[: len(self._past) - self._late, 1])
        came = self._changed(self._past[:, 0])
        along = (wanted * came).sum(axis=1)
        across = wanted[:, 0] * came[:, 1] - wanted[:, 1] * came[:, 0]
        sums = np.stack([(wanted * wanted).sum(axis=1), along, across], axis=1)
        self._sums += self._period * (sums - self._sums / _FORGOTTEN)
        self._judged = np.where(judged, self._judged + self._period, 0.0)
        self._sums[self._judged < len(self._past) * self._period] = 0.0
        size, along, across = self._sums[:, 0], self._sums[:, 1], np.abs(self._sums[:, 2])
        turned = (across > _MOST_ACROSS * size) & (across > _TURNED * along)
        return np.asarray((turned | (along < _LEAST_ALONG * size)) & (size > _JUDGED))

    def _changed(self, past: FloatArray) -> FloatArray:
        """Return how much more a quantity changed over the last window than over the one before, (N, 2)."""
        return np.asarray(past[-1] - 2.0 * past[-1 - self._window] + past[-1 - 2 * self._window])

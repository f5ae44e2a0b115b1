"""The estimator and the predictor of a flight certificate, for N drones at once.

Per axis the nominal plant of the design, x = (p, v, a[, a']), is driven by the commands when they act, and by the
estimated disturbance d^. At a tick it is moved on by a period and corrected by L times an innovation: the newest
position, plus how far the model has moved since it was measured, less the model's position. From there the law's state
follows: where the drone will be, measured from its reference, when the command acts (`certificate.flight_loop`).

All of it is linear with fixed matrices: one product per tick moves all drones on, one predicts.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray, all_of
from flatsat_ros.certificate.flight_loop import FlightLoop
from flatsat_ros.certificate.flight_plant import Design, split

_P, _V, _A, _AA, _D, _U = range(
    6
)  # entries of an axis; from _U on the commands, newest first, then what f was for each
# poses farther apart than this, s, correct velocity and disturbance by no more than these over the time between and its
# square: that is as stable as the observer is at its own period
_RARE, _SLOW = 0.1, (0.8, 0.2)
# ticks farther apart than this, s, leave nothing to predict from
_GAP = 0.5
# an interval between ticks that differs from the period by no more than this, s, is the period
_EVEN = 1e-9


class _Moment(NamedTuple):
    """The model at a tick: when, s, and (N, 3) the way come without corrections, m, and velocity, m/s."""

    time: float
    way: FloatArray
    before: FloatArray  # the correction of the velocity
    after: FloatArray


class Predictor:
    """The estimates of N drones.

    Attributes:
        innovation: (N, 3) of the last correction, m; 0 where there was none.
        age: (N,) of the pose that was used last, s; infinite before the first.
    """

    def __init__(self, horizontal: Design, vertical: Design, count: int, pose_age: float) -> None:
        """Begin at rest at the origin.

        Args:
            horizontal: for x and y.
            vertical: for z, of the same period.
            count: N.
            pose_age: s; a pose that is no longer new is used until it is so old.
        """
        loops = [FlightLoop(design, design.model) for design in (horizontal, horizontal, vertical)]
        self._period, self._pose_age = horizontal.period, pose_age
        self._depth = max(loop.depth for loop in loops)
        size = _U + 2 * (self._depth + 1)
        self._state = np.zeros((count, size, 3))
        step = np.zeros((size, 3, size, 3))  # from, to
        ahead, reference = np.zeros((size, 3, 2, 3)), np.zeros((4, 3, 2, 3))
        for axis, loop in enumerate(loops):
            _fill(loop, self._depth, *(matrix[:, axis, :, axis] for matrix in (step, ahead, reference)))
        self._step = step.reshape(3 * size, 3 * size)
        self._ahead, self._reference = ahead.reshape(3 * size, 6), reference.reshape(12, 6)
        self._second = any(loop.design.model.frequency > 0.0 for loop in loops)
        self._drag = np.array([loop.design.model.drag for loop in loops])
        observers = np.array([loop.design.observer for loop in loops])
        self._observer = np.array(observers[:, :2].T), observers[:, 2]  # of position and velocity (2, 3), and of d^
        self._corrections = np.zeros((count, 3))  # sum of those of the position, m
        self._moments: deque[_Moment] = deque(maxlen=2 + math.ceil(pose_age / self._period))
        self._now = -math.inf
        self._since = np.full(count, -np.inf)  # when each began
        self._stamp = np.full(count, -np.inf)  # of the newest pose
        self._gap, self._rare = np.zeros(count), False  # between the two newest poses, s; whether one is long
        self._anchor = np.zeros((count, 3))  # the newest position less the model's way until it was measured, m
        self.innovation, self.age = np.zeros((count, 3)), np.full(count, np.inf)

    @property
    def state(self) -> FloatArray:
        """(N, 6) estimated position and velocity at the tick, m and m/s."""
        return np.asarray(self._state[:, :_A].reshape(-1, 6))

    @property
    def estimated(self) -> FloatArray:
        """(N, 9) position, velocity and disturbance at the tick: m, m/s, m/s^2."""
        return np.asarray(self._state[:, (_P, _V, _D)].reshape(-1, 9))

    @property
    def disturbance(self) -> FloatArray:
        """(N, 3) d^, m/s^2, of the command that would make up for it."""
        return self._state[:, _D]

    @property
    def acceleration(self) -> FloatArray:
        """(N, 3) of the model at the tick, without the disturbance, m/s^2."""
        return self._state[:, _A]

    def restart(self, drones: np.ndarray, estimated: FloatArray, now: float) -> None:
        """Begin anew with some drones, in an attitude that holds their last command.

        Args:
            drones: (N,) which.
            estimated: (N, 9) position, velocity, disturbance: m, m/s, m/s^2.
            now: s.
        """
        chosen = drones[:, np.newaxis]
        state = self._state
        self._corrections += np.where(chosen, estimated[:, :3] - state[:, _P], 0.0)  # the way come stays what it is
        for entry, value in (
            (_P, estimated[:, :3]), (_V, estimated[:, 3:6]), (_D, estimated[:, 6:9]),
            (_A, state[:, _U]), (_AA, np.zeros((1, 3))),
        ):  # fmt: skip
            np.copyto(state[:, entry], value, where=chosen)
        np.copyto(self._since, now, where=drones)
        if self._moments:
            np.copyto(self._moments[-1].after, state[:, _V])

    def advance(self, now: float, stamps: FloatArray, positions: FloatArray) -> None:
        """Move on to a tick and take in the newest poses.

        Args:
            now: s, after that of the last tick.
            stamps: (N,) of the newest poses, s; -inf for none.
            positions: (N, 3) measured then, m.
        """
        elapsed = now - self._now
        self._now = now
        if not 0.0 < elapsed <= _GAP:
            self._moments.clear()
            self._since[:] = now
            self.innovation, self.age = np.zeros_like(self.innovation), now - stamps
            self._note(now)
            return
        shape, periods = self._state.shape, max(1, round(elapsed / self._period))
        for _ in range(periods):
            self._state = (self._state.reshape(len(stamps), -1) @ self._step).reshape(shape)
        state = self._state
        late = elapsed - periods * self._period
        if abs(late) > _EVEN:
            pull = state[:, _A] + state[:, _D] - self._drag * state[:, _V]
            state[:, _P] += late * (state[:, _V] + late / 2.0 * pull)
            state[:, _V] += late * pull
        self._note(now)
        fresh = self._take(stamps, positions)
        self.age = now - stamps
        used = fresh | ((self.age <= self._pose_age) & (self._stamp >= self._since))
        innovation = self._anchor - self._corrections
        if not all_of(used):
            innovation = np.where(used[:, np.newaxis], innovation, 0.0)
        self.innovation = innovation
        moving, disturbing = self._observer
        if self._rare:  # gains for poses at every tick would swing where they come rarely
            gap = np.maximum(self._gap, self._period)[:, np.newaxis]
            speed, push = np.minimum(moving[1], _SLOW[0] / gap), np.minimum(disturbing, _SLOW[1] / (gap * gap))
            moving, disturbing = np.stack(np.broadcast_arrays(moving[0], speed), axis=1), push
        shift = moving * innovation[:, np.newaxis]
        self._corrections += shift[:, _P]
        state[:, :_A] += shift
        state[:, _D] += disturbing * innovation
        np.copyto(self._moments[-1].after, state[:, _V])

    def _note(self, now: float) -> None:
        velocity = self._state[:, _V]
        self._moments.append(_Moment(now, self._state[:, _P] - self._corrections, velocity.copy(), velocity.copy()))

    def _take(self, stamps: FloatArray, positions: FloatArray) -> np.ndarray:
        """Tie poses that are new to the way that the model had come when they were measured; return whose are, (N,)."""
        fresh = np.asarray((stamps != self._stamp) & (stamps >= self._since))
        count = np.count_nonzero(fresh)
        if not count:
            return fresh
        moments, before, self._stamp = self._moments, np.maximum(self._stamp, self._since), stamps.copy()
        gap = np.minimum(stamps - before, _GAP)
        self._gap = gap if count == fresh.size else np.where(fresh, gap, self._gap)
        self._rare = float(self._gap.max()) > _RARE
        if float(stamps.min()) > moments[-2].time:  # all within the last period
            (first, _, _, left), (last, way, arrived, _) = moments[-2], moments[-1]
            span, back = np.float64(last - first), last - stamps[:, np.newaxis]
        else:
            times, stamps = np.array([moment.time for moment in moments]), np.maximum(stamps, moments[0].time)
            index = np.clip(np.searchsorted(times, stamps), 1, len(times) - 1)
            each = np.arange(len(stamps))
            way, arrived = (np.array([getattr(m, n) for m in moments])[index, each] for n in ("way", "before"))
            left = np.array([moment.after for moment in moments])[index - 1, each]
            span, back = (times[index] - times[index - 1])[:, np.newaxis], (times[index] - stamps)[:, np.newaxis]
        # back from the end of a period, over which the velocity changes evenly
        way = way - back * (arrived - (back / (2.0 * span)) * (arrived - left))
        anchor = positions - way
        self._anchor = anchor if count == fresh.size else np.where(fresh[:, np.newaxis], anchor, self._anchor)
        return fresh

    def ahead(self, reference: FloatArray, jerk: FloatArray | None = None) -> FloatArray:
        """Return by how much the law's state is ahead of the estimated position and velocity, (N, 6), m and m/s.

        Args:
            reference: (N, 9) position, velocity, acceleration at the tick.
            jerk: (N, 3) of the reference, m/s^3, which a second-order attitude needs; None for 0.
        """
        predicted = self._state.reshape(len(reference), -1) @ self._ahead - reference @ self._reference[:9]
        if jerk is not None and self._second:
            predicted -= jerk @ self._reference[9:]
        return np.asarray(predicted)

    def command(self, acceleration: FloatArray, needed: FloatArray) -> None:
        """Note what is commanded from this tick on.

        Args:
            acceleration: (N, 3) m/s^2.
            needed: (N, 3) the part of it that only leads along the reference, f, m/s^2.
        """
        self._state[:, _U] = acceleration
        self._state[:, _U + self._depth + 1] = needed


def _fill(loop: FlightLoop, depth: int, step: FloatArray, ahead: FloatArray, reference: FloatArray) -> None:
    """Write the matrices of one axis, for rows: from the entries, or (4,) derivatives of the reference, to the others.

    Args:
        loop: the design on its own model.
        depth: how many commands under way are kept.
        step: of a period.
        ahead: what the prediction adds to position and velocity, from the entries.
        reference: and what it takes off for the motion of the reference.
    """
    model = loop.design.model
    y, first = model.size, depth + 1
    error = 2 * y  # in z, whose plant is the model
    estimate, prediction = loop.estimate, loop.prediction
    step[:y, :y] = estimate[:, y:error].T
    step[_D, :y] = -estimate[:, error]
    step[_U, :y] = estimate[:, -1]
    step[_U + 1 : _U + 1 + loop.depth, :y] = estimate[:, error + 1 : -1].T
    if y == 2:  # no lag: the acceleration is the command that acts, of no use to the prediction
        step[_U + split(model.delay, loop.design.period)[0], _A] = 1.0
    step[_D, _D] = 1.0
    for newest in (_U, _U + first):
        step[newest, newest] = 1.0
        for i in range(newest, newest + depth):
            step[i, i + 1] = 1.0
    ahead[:y] = prediction[:, y:error].T
    ahead[_P, 0] -= 1.0
    ahead[_V, 1] -= 1.0
    ahead[_D] = -prediction[:, error]
    under_way = prediction[:, error + 1 :].T
    ahead[_U + 1 : _U + 1 + loop.depth] = under_way
    ahead[_U + first + 1 : _U + first + 1 + loop.depth] = -under_way
    # the reference needs an attitude that makes a_ref + drag v_ref
    reference[0], reference[1] = ahead[_P], ahead[_V]
    for entry in range(2, y):
        reference[entry] += ahead[entry]
        reference[entry - 1] += model.drag * ahead[entry]

"""Whether a drone moves as it is commanded to, and what comes of its commands if it does not."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from flatsat_ros.base.arrays import FloatArray, all_of, any_of

# Motion against command is judged by changes of the velocity over this time, s, forgetting them with the second one, s,
# once commands have changed it by so much, (m/s)^2 s.
_WINDOW = 0.2
_FORGOTTEN = 1.0
_JUDGED = 0.0004
# What comes is wrong if between these shares of what is commanded comes, beyond this tangent of an angle to it, and the
# commands explain at least this share of it. Commands do not explain gusts, which bring more, nor noise.
_LEAST, _MOST = 0.5, 1.2
_TURNED = 2.0
_EXPLAINED = 0.5
# of that this much, (m/s)^2 s, is not asked: noise of 0.5 mm in the poses brings it alone
_NOISE = 4e-4
# an axis is taken for mirrored by a correlation of minus this much with what is commanded
_MIRRORED = 0.3
# both for turned if that explains this many times as much: one axis alone shows no difference
_TURNED_MORE = 1.1
# A gust that begins looks like a wrong sign until commands counter it; a wrong sign stays one for longer than this, s.
_WRONG_TIME = 0.31
# Where the yaw is assumed, a smaller turn is wrong, beyond this tangent, that lasts for longer than this, s: in gusts
# of 1 m/s a yaw that is 20 degrees off never looked like it, one that is 57 off always did.
_ASSUMED_TURNED = 0.7
_ASSUMED_WRONG_TIME = 0.6


class AstrayDetector:
    """Tells which drones do not move horizontally as they are commanded: a wrong yaw, frame, sign or body.

    How the acceleration changes is compared with how the commands should have changed it, as late as they act. Changes,
    because a constant wind is countered by a constant command. Whether the best rotation between the two turns the
    commands far, or whether one of the body's axes has the other sign, is asked of sums over the last seconds.
    """

    def __init__(self, count: int, period: float, late: float, *, turns: bool = False, wary: bool = False) -> None:
        """Begin without a past.

        Args:
            count: N.
            period: between two looks, s.
            late: how long a command takes to act, s.
            turns: `turns` will be asked for.
            wary: what comes along one axis without being commanded is taken for a gust, which may come along the other
                one as well: it moves a drone that is flown softly by much.
        """
        self._wary = wary
        self._turns = turns
        self._period = period
        self._window, self._late = max(1, round(_WINDOW / period)), math.ceil(late / period - 0.5)
        # velocities, and velocities that were commanded since the start, of the last looks, (N, 2) each, newest last
        looks, nowhere = 2 * self._window + self._late + 1, np.zeros((count, 2))
        self._velocities, self._commanded = deque([nowhere] * looks, looks), deque([nowhere] * looks, looks)
        # sums of products: of what was commanded along the axes of the body and what came, each with each
        self._sums = np.zeros((4, 4, count))
        self._common = np.zeros((2, count))  # of both axes: what came along, and across, by the yaw of now
        self._judged = np.zeros(count)  # s
        # s, for how long what comes has been wrong, and turned by more than an assumed yaw may be wrong
        self._wrong = np.zeros((2, count))

    def astray(
        self,
        push: FloatArray,
        velocity: FloatArray,
        yaw: FloatArray,
        judged: np.ndarray,
        assumed: np.ndarray | None = None,
        standing: np.ndarray | None = None,
    ) -> np.ndarray:
        """Tell who goes astray, (N,).

        Args:
            push: (N, 2) horizontal change of velocity that was commanded since the last look, m/s.
            velocity: (N, 2) estimated, m/s.
            yaw: (N,) psi, rad, by which the commands were turned into the body's axes.
            judged: (N,) who is steered, and in the air if it moves.
            assumed: (N,) whose yaw nobody sees; nobody's by default.
            standing: (N,) who of these has not moved yet: it is judged from when it does, by what was commanded before
                as well; nobody by default.
        """
        self._velocities.append(velocity)
        self._commanded.append(self._commanded[-1] + push)
        self._judged += self._period
        self._judged *= judged
        early = self._judged < len(self._velocities) * self._period
        if standing is not None:
            early |= standing
        if all_of(early):
            self._sums[:], self._common[:], self._wrong[:] = 0.0, 0.0, 0.0
            return np.zeros(early.size, dtype=bool)
        sin, cos = np.sin(yaw), np.cos(yaw)
        motion = np.empty((4, len(yaw)))
        for axes, past, newest in ((motion[:2], self._commanded, -1 - self._late), (motion[2:], self._velocities, -1)):
            x, y = self._changed(past, newest).T
            axes[0], axes[1] = cos * x + sin * y, cos * y - sin * x
        products = self._period * motion[:, np.newaxis] * motion
        self._sums *= 1.0 - self._period / _FORGOTTEN
        self._sums += products
        if self._turns:
            self._common *= 1.0 - self._period / _FORGOTTEN
            self._common += products[0, 2] + products[1, 3], products[0, 3] - products[1, 2]
        if any_of(early):
            self._sums[..., early] = self._common[:, early] = 0.0
        if not any_of(self._sums[0, 0] + self._sums[1, 1] > _JUDGED):
            self._wrong[:] = 0.0
            return np.zeros(early.size, dtype=bool)
        size, along, total, across = self._compared()
        whole = total.sum(axis=0)
        if self._wary:
            total = total + np.maximum(total - along * along / np.maximum(size, _JUDGED) - _NOISE, 0.0)[::-1]
        negated = _explained(size, along, total) & (along < 0.0)
        straight = along.sum(axis=0)
        turned = _explained(size.sum(axis=0), np.hypot(straight, across), whole)
        wrong = np.zeros_like(self._wrong, dtype=bool)
        wrong[0] = negated.any(axis=0) | (turned & (np.abs(across) > _TURNED * straight))
        if assumed is not None:
            wrong[1] = assumed & turned & (np.abs(across) > _ASSUMED_TURNED * straight)
        self._wrong = np.where(wrong, self._wrong + self._period, 0.0)
        return np.asarray((self._wrong[0] > _WRONG_TIME) | (self._wrong[1] > _ASSUMED_WRONG_TIME))

    def answer(self, index: int) -> FloatArray | None:
        """Return what comes of what is commanded to drone index along its body's axes, (2, 2); None if unknown.

        It is a turn about the vertical, or the sign of each axis.
        """
        size, along, total, across = (sums[..., index] for sums in self._compared())
        straight = float(along.sum())
        whole = np.array([size.sum(), math.hypot(straight, across), total.sum()])
        if not (_explained(size, along, total).any() or _explained(*whole)):
            return None
        if whole[1] > _TURNED_MORE * np.abs(along).sum():  # what is turned; along the axes it would be less
            cos, sin = straight / float(whole[1]), across / float(whole[1])
            return np.array([[cos, -sin], [sin, cos]])
        return np.diag(np.where(along < -_MIRRORED * np.sqrt(size * total), -1.0, 1.0))

    def turns(self) -> FloatArray:
        """Return by which angle what comes is turned from what is commanded, (N,) rad; 0 where that is not known."""
        along, across = self._common
        size, _, total, _ = self._compared()
        known = _explained(size.sum(axis=0), np.hypot(along, across), total.sum(axis=0))
        return np.where(known, np.arctan2(across, along), 0.0)

    def correct(self, angle: FloatArray, anew: np.ndarray) -> None:
        """Take note of yaws that are corrected by an angle (N,), rad; judge some (N,) drones anew."""
        (along, across), sin, cos = self._common, np.sin(angle), np.cos(angle)
        self._common = np.array([cos * along + sin * across, cos * across - sin * along])
        self._judged[anew] = self._wrong[:, anew] = 0.0
        self._sums[..., anew] = self._common[:, anew] = 0.0

    def _compared(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return sums of squares, (m/s)^2 s.

        Returns:
            For each axis of the body, (2, N): what was commanded, what came along it, all that came; and what came
            across both, (N,).
        """
        sums = self._sums
        size, along, total = (np.einsum("iin->in", part) for part in (sums[:2, :2], sums[:2, 2:], sums[2:, 2:]))
        return size, along, total, sums[0, 3] - sums[1, 2]

    def _changed(self, past: deque[FloatArray], newest: int) -> FloatArray:
        """Return how much more a quantity changed over a window up to its newest value than over the one before."""
        return np.asarray(past[newest] - 2.0 * past[newest - self._window] + past[newest - 2 * self._window])


def _explained(size: FloatArray, common: FloatArray, total: FloatArray) -> np.ndarray:
    """Tell what commands explain: enough of them, and of what they bring, in what came; all are sums of squares."""
    share = np.abs(common) / np.maximum(size, _JUDGED)
    return (
        (size > _JUDGED) & (share > _LEAST) & (share < _MOST) & (share * np.abs(common) > _EXPLAINED * (total - _NOISE))
    )

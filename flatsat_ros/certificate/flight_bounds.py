"""From the sums of cells to bounds of their signals, by small gains."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.enclosures import UP
from flatsat_ros.certificate.flight_sums import CellSums, applied

# By how much, relatively, the distances of a cell may be wrong, which are rounded to the nearest.
_NEAREST = 1e-15

# By how much, relatively, the bounds of the loop's own signals are above what they imply; of coarse bounds.
_SLACK, _COARSE_SLACK = 1e-3, 1e-2

# Rounds in which the bounds of the loop's own signals must settle.
_ITERATIONS = 1000

# Signals beyond this, m/s^2, have no bound.
_ABSURD = 1e4


@dataclass(frozen=True)
class Drives:
    """Bounds of what acts on a cell, (B,) but for the last two, which are those of the nominal plant.

    Attributes:
        drive: of the drive at the last row.
        rate: of D', m/s^3.
        model: of the drive at the nominal plant's input, m/s^2.
        other_age: by how much the age of a pose is another than the loop's, s.
    """

    drive: FloatArray
    rate: FloatArray
    model: float
    other_age: float


class CellBounds(CellSums):
    """The sums of cells, and the bounds of signals that follow from them, by operations that only add to them."""

    def growing(self) -> CellBounds:
        """Return the bounds of signals that are multiplied by a factor more in every period than in the one before."""
        other = copy.copy(self)
        other._take(1)
        return other

    def _in_stretches(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return bounds of x' at the beginning of each stretch (..., B, S, x), and of F at its nodes (..., B, S, k, m).

        Args:
            values: (..., B, rows) bounds of the signals at ticks.
        """
        x, m = self.cells.growth.shape[-1], self._on_state.shape[1]
        parts = values[..., 5 : self._seen].reshape(*values.shape[:-1], self._radius.shape[1], -1)
        return parts[..., :x], parts[..., x:].reshape(*parts.shape[:-1], -1, m)

    def _seen_between(self, values: FloatArray, leak: FloatArray) -> FloatArray:
        """Return bounds of F (..., B, m) at all times, from those of signals at ticks and of what acts between.

        Args:
            values: (..., B, rows) bounds of the signals at ticks.
            leak: (..., B, x) by how much inputs within a period move x.
        """
        slopes, nodes = self._in_stretches(values)
        moved = self._radius[..., None] * applied(self._reach[:, None], slopes)
        return np.asarray((nodes.max(axis=-2) + moved).max(axis=-2) + applied(self._on_state, leak))

    def _pulled_between(self, at_nodes: FloatArray, values: FloatArray, leak: FloatArray) -> FloatArray:
        """Return bounds of p'F (...) at all times and for all plants, from those in each direction at the nodes.

        Args:
            at_nodes: (..., B, S k U) bounds of it at the nodes of all stretches.
            values: (..., B, rows) bounds of the signals at ticks.
            leak: (..., B, x) by how much inputs within a period move x.
        """
        way = self._radius[..., None] * applied(self._reach[:, None], self._in_stretches(values)[0])
        peaks = at_nodes.reshape(*at_nodes.shape[:-1], self._radius.shape[1], -1).max(axis=-1)
        bound = (peaks + (self._moved[:, None] * way).sum(axis=-1)).max(axis=-1)
        return np.asarray(bound + (self._moved * applied(self._on_state, leak)).sum(axis=-1))

    def _bend_between(self, values: FloatArray, leak: FloatArray) -> FloatArray:
        """Return bounds of e'' (..., B) at all times; the arguments are those of `_seen_between`."""
        bend = applied(self.cells.growth[:, None], self._in_stretches(values)[0])[..., 1].max(axis=-1)
        return np.asarray(bend + applied(self._dynamics, leak)[..., 1])

    def _late_pose(self, values: FloatArray, leak: FloatArray, jolt: FloatArray, drives: Drives) -> FloatArray:
        """Return bounds (..., B) of what poses of another age than the loop's add to innovations, m.

        Args:
            values: (..., B, rows) bounds of the signals at ticks.
            leak: (..., B, x) by how much inputs within a period move x.
            jolt: (..., B, x) bounds of the inputs at each row of x'.
            drives: what acts.
        """
        cells, h = self.cells, self.cells.period
        A, E, slope = self._dynamics, cells.loop.body.system[2], self._in_stretches(values)[0].max(axis=-2)
        moving = applied(cells.growth, slope) + applied(A, leak) + E * (h * drives.rate)[:, None] + jolt
        bend = applied(A, moving)[..., 1] + cells.drag_error * moving[..., 1] + drives.rate

        A, B = self._model
        model_slope = values[..., self._seen + 2 : self._rows].reshape(*values.shape[:-1], -1, len(B)).max(axis=-2)
        model_leak = self._model_growth @ B * h * drives.model
        model_moving = model_slope @ self._model_growth.T + A @ model_leak + B * drives.model
        bend = bend + model_moving @ A[1]
        strayed = leak[..., 1] + model_leak[1]  # of the velocity, within the period
        wrong = np.maximum(values[..., self._seen], values[..., self._seen + 1] + strayed) + h * h / 8.0 * bend
        return np.asarray(drives.other_age * wrong + self.pose_age * strayed)

    def settled(
        self, signals: FloatArray, at_vertices: FloatArray, bent: FloatArray, drives: Drives
    ) -> tuple[FloatArray, FloatArray]:
        """Return bounds of the tracked signals (..., B, 4) and of e'' (..., B), infinite if the small gains fail.

        Args:
            signals: (..., B, rows) bounds of the signals of the middle at its middle gain.
            at_vertices: (..., B, V, rows) bounds of them to first order, at the vertices.
            bent: (..., B, columns) further inputs, which are not followed to first order.
            drives: what acts.
        """
        cells, sums, at, h = self.cells, self.sums, self._vertex_sums, self.cells.period
        E, lead, rows = cells.loop.body.system[2], signals.shape[:-1], self._rows
        late, moved = cells.vertices[..., -1].max(axis=1) * UP, self._moved
        steady = np.abs(self._vertices[..., :-1]).max(axis=1) * UP
        last = cells.growth[..., -1]
        late_shape = (late**2 / 2.0 * cells.port_gain)[:, None] * applied(self._dynamics, last)
        changes, noise = self._part["change"].start, self._part["noise"].start

        # what inputs that follow from signals do to all signals, per unit: drive, pulse and its shape, push
        pulse = self.amplitudes(0.0, pulse=late * cells.port_gain)
        shape = np.zeros_like(pulse)
        shape[:, self._part["plant"]] = late_shape
        units = np.stack([self.amplitudes(1.0), pulse, shape, self.amplitudes(0.0, push=1.0)], axis=-1)
        effects, always = sums @ units, applied(sums, bent)
        first_change, first_noise = at[..., changes], at[..., noise]

        def bounds(point: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
            """Bounds (..., B, 4) of the signals, (..., B, 5) of the inputs that follow from them, and of e''."""
            drive, difference, change, late_pose, push = np.moveaxis(point, -1, 0)
            rest = applied(effects, np.stack([drive, difference, difference, push], -1)) + always
            plain = signals + sums[..., changes] * change[..., None] + sums[..., noise] * late_pose[..., None] + rest
            leak = last * (h * (drive + drives.drive) + late * cells.port_gain * difference)[..., None]
            leak = leak + cells.growth[..., 1] * (h * (h * drives.rate + push))[..., None]
            left, seen = self._seen_between(np.stack([rest, plain]), leak)
            nearest = _NEAREST * (moved * seen).sum(axis=-1)
            changing, pulled = (self._changing * seen).sum(axis=-1) + nearest, (steady * left).sum(axis=-1)
            if self._directed:
                pulled = self._pulled_between(rest[..., rows:], rest, leak)
            wider = rest[..., 4] + (cells.port_gain_error / cells.port_gain + _NEAREST) * difference
            further = np.stack([pulled + changing, wider, difference, push], -1)
            second = (applied(effects, further) + always)[..., :rows]
            first = at_vertices + first_change * change[..., None, None] + first_noise * late_pose[..., None, None]
            whole = np.minimum(plain[..., :rows], first.max(axis=-2) + second)
            seen = self._seen_between(whole, leak)
            bend = self._bend_between(whole, leak) + h * drives.rate + push
            jolt = E * push[..., None]
            jolt[..., -1] += drive + drives.drive + np.where(late > 0.0, cells.port_gain * difference, 0.0)
            pose = self._late_pose(whole, leak, jolt, drives) if drives.other_age > 0.0 else np.zeros(lead)
            velocity = whole[..., 1] + h / 2.0 * bend  # half a period from a tick at most
            separating = (moved * seen).sum(axis=-1)
            if self._directed:
                directed = self._pulled_between(plain[..., rows:], whole, leak) + nearest
                separating = np.minimum(separating, directed)
            following = [separating, whole[..., 4], self._deviation * whole[..., 2], pose]
            return whole[..., :4], np.stack([*following, cells.drag_error * velocity], -1), bend

        slack = _COARSE_SLACK if cells.coarse else _SLACK
        tracked, bends, point = np.full((*lead, 4), np.inf), np.full(lead, np.inf), np.zeros((*lead, 5))
        going = np.broadcast_to(self._bounded, lead)
        for _ in range(_ITERATIONS):
            if not going.any():
                break
            found, implied, bend = bounds(point)
            implied = implied * UP
            settled = going & (implied <= point).all(axis=-1)  # these imply themselves: by small gains they hold
            tracked[settled], bends[settled] = found[settled] * UP, bend[settled] * UP
            going = going & ~settled & (implied.max(axis=-1) <= _ABSURD)
            point = np.where(going[..., None], implied * (1.0 + slack), point)
        return tracked, bends

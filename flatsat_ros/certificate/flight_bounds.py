"""From the sums of cells to bounds of their signals, by small gains."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.answers import answers
from flatsat_ros.certificate.enclosures import UP, Enclosure, concatenate, decimal, enclosed, upper
from flatsat_ros.certificate.flight_batch import Cells, exponential_norm

# Pieces of a period over which the effect of inputs that vary within it is interpolated.
_PIECES = 2

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


class CellBounds:
    """The sums of cells, and what follows from them; all numbers are bounds, and of operations that only add to them.

    Columns of inputs are named parts: those that are followed to first order, then those that are not. Rows of signals:
    e, e', v0, D/g - d^; the difference of commands and, of each stretch, x' at its beginning and nodes of F; then the
    errors of the estimated velocity and the model's x^' at the beginning of each of its stretches. Of plants of second
    order there are p'F in each direction p of the vertices at the nodes, too, not followed to first order.

    Attributes:
        cells: the plants.
        sums: (B, rows, columns) of the middles, of units of the inputs.
        pose_age: of the loops, s.
    """

    def __init__(
        self, cells: Cells, gain_min: float, gain_max: float, lag_varies: bool = False, faster: float | None = None
    ) -> None:
        """Sum up.

        Args:
            cells: the plants.
            gain_min: smallest applied gain.
            gain_max: largest applied gain.
            lag_varies: whether lag, frequency and damping change in flight.
            faster: if given, the factor of `growing`.
        """
        self.cells = cells
        self._on_state, self._dynamics = cells.on_state.size, enclosed(cells.loop.body.system[0]).size
        self._reach = self._on_state @ cells.growth
        believed = cells.loop.believed
        self._model = enclosed(believed.system[0]).size, enclosed(believed.system[1]).size
        self._model_growth = exponential_norm(believed, cells.period)
        self.pose_age = upper(cells.loop.pose_age)
        # distances that are what they are for all of a flight: to these the answer is known to first order
        self._vertices = cells.steady if lag_varies else cells.vertices
        self._moved = np.abs(cells.vertices[..., :-1]).max(axis=1) * UP
        self._changing = cells.changing if lag_varies else np.zeros_like(self._moved)
        gain = (decimal(gain_min) + decimal(gain_max)) / 2
        self._deviation = upper((decimal(gain_max) - decimal(gain_min)) / 2)
        loop = cells.loop
        size, h, x = loop.size, loop.period, loop.body.size
        command = concatenate([np.eye(size), loop.compensation[None] + loop.figure(gain) * loop.feedback[None]], -2)

        self._slack, self._pieces = _COARSE_SLACK if cells.coarse else _SLACK, 1 if cells.rough else _PIECES
        pieces = self._pieces
        shares = [(h * i / pieces, h / pieces / (2 if i in (0, pieces) else 1)) for i in range(pieces + 1)]
        times = [(loop.figure(w), loop.figure(t)) for t, w in shares]
        half = loop.figure(h / 2)
        columns = {
            "noise": [loop.noise_input],
            "drive": [w * loop.port_input(t) for w, t in times],
            "change": [loop.command_input],
        }
        columns["rate"] = [w * loop.rate_input(t) for w, t in times]
        columns["share"] = [loop.figure(h) * loop.share_input]
        columns["model_drive"] = [w * loop.model_drive_input(t) for w, t in times]
        units, nominal = loop.unit_inputs(loop.body), loop.unit_inputs(loop.believed)
        columns |= {
            "pulse": [cells.pulse[..., 0]],
            "push": [w * loop.push_input(t) for w, t in times],
            "ripple": [(units @ loop.body.system[0] @ loop.body.hold(half)[0])[..., -1]],
            "model_ripple": [
                (nominal @ believed.system[0] @ believed.hold(half)[0] @ believed.system[1][:, None])[:, 0]
            ],
            "plant": [units[:, i] for i in range(x)],
            "model": [nominal[:, i] for i in range(loop.believed.size)],
        }
        ends = np.cumsum([0, *(len(part) for part in columns.values())])
        self._part = {name: slice(a, b) for name, a, b in zip(columns, ends[:-1], ends[1:], strict=True)}
        self._count = int(ends[-1])
        inputs = concatenate([column[..., None] for part in columns.values() for column in part], -1)

        tracked = np.zeros((3, size))
        tracked[0, 0] = tracked[1, 1] = tracked[2, x + loop.believed.size] = 1.0
        blocks = [enclosed(cells.difference)]
        for stretch in cells.stretches:
            blocks += [stretch.slope, stretch.nodes]
        self._radius = np.stack([stretch.radius for stretch in cells.stretches], axis=-1)
        self._seen = 4 + sum(block.shape[-2] for block in blocks)
        blocks += [cells.lateness, cells.model_slopes]
        # by direction, if it stays what it is, sums are about half of those of its parts, which swing at other times
        self._directed = cells.directions.size > 0 and not lag_varies
        self._rows, plain = 4 + sum(block.shape[-2] for block in blocks), 0
        if self._directed:
            blocks.append(cells.pulls)
            plain = blocks[-1].shape[-2]
        others = concatenate(blocks, -2)
        self._followed = self._part["pulse"].start
        steps = cells.derivatives
        changes = self._part["change"].start
        kicks = Enclosure(*(np.zeros((*steps.shape[:3], self._followed)) for _ in range(2)))
        kicks.mid[..., changes], kicks.rad[..., changes] = steps.mid[..., size], steps.rad[..., size]
        starts = np.zeros((size, 2))  # of e and of e', which the estimator knows
        for i in range(2):
            starts[[i, x + i], i] = 1.0
        factors = [1.0]
        if faster is None:
            starts = starts[:, :0]
        else:
            factors.append(faster)
        count = len(steps.mid)
        self._found = answers(
            _batch(loop.matrix(gain), count),
            _batch(inputs, count),
            _batch(Enclosure(starts), count),
            _batch(concatenate([tracked[:2], loop.feedback[None], tracked[2:], others @ command], -2), count),
            steps @ command,
            kicks,
            self._vertices,
            factors,
            plain,
            cells.coarse,
        )
        self._direct = enclosed(others[..., size]).size
        self._take(0)

    def growing(self) -> CellBounds:
        """Return the bounds of signals that are multiplied by a factor more in every period than in the one before."""
        other = copy.copy(self)
        other._take(1)
        return other

    def _take(self, number: int) -> None:
        """Take the sums for one of the factors."""
        found, changes = self._found[number], self._part["change"].start
        self._bounded = np.isfinite(found.sums).all(axis=(1, 2))
        for sums in (found.sums, found.peaks, found.vertex_sums, found.vertex_peaks):
            sums[~self._bounded] = 0.0  # of these nothing is claimed
        self.sums, self._peaks = found.sums, found.peaks
        self._vertex_sums, self._vertex_peaks = found.vertex_sums, found.vertex_peaks
        self.sums[..., 4:, changes] += self._direct
        self._vertex_sums[..., 4:, changes] += self._direct[:, None, : self._rows - 4]

    def amplitudes(self, drive: FloatArray | float, **others: FloatArray | float) -> FloatArray:
        """Return bounds (B, columns) of all inputs, with what interpolation adds to those that act within a period."""
        cells, part = self.cells, self._part
        h, values = cells.period, np.zeros((len(self.sums), self._count))
        given = {name: np.broadcast_to(value, len(values)) for name, value in ({"drive": drive} | others).items()}
        for name, value in given.items():
            values[:, part[name]] = value[:, None]
        curve = h * (h / self._pieces) ** 2 / 12.0 * UP
        square = self._dynamics @ self._dynamics @ cells.growth
        bend = square[..., -1] * given["drive"][:, None]
        for name in ("rate", "push"):
            if name in given:
                bend += square[..., 1] * given[name][:, None]
        values[:, part["plant"]] += curve * bend
        if "model_drive" in given:
            A, B = self._model
            values[:, part["model"]] += curve * (A @ A @ self._model_growth @ B) * given["model_drive"][:, None]
        return values * UP

    def held(self, ripple: FloatArray, model_ripple: float) -> FloatArray:
        """Return bounds (B, columns) of what is left of inputs that grow within a period from -h/2 to h/2 of a slope.

        Where in the period that begins does not matter; over the period its mean is 0.

        Args:
            ripple: (B,) largest slope at the last row, per s.
            model_ripple: at the input of the nominal plant, m/s^3.
        """
        part, h, values = self._part, self.cells.period, np.zeros((len(self.sums), self._count))
        weight, curve = h**3 / 12.0, h**4 / 24.0  # of the answer's slope in the middle, and of how that changes
        values[:, part["ripple"]], values[:, part["model_ripple"]] = weight * ripple[:, None], weight * model_ripple
        square = self._dynamics @ self._dynamics @ self.cells.growth
        values[:, part["plant"]] = curve * ripple[:, None] * square[..., -1]
        A, B = self._model
        values[:, part["model"]] = curve * model_ripple * (A @ A @ self._model_growth @ B)
        return values * UP

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
        moved = self._radius[..., None] * _apply(self._reach[:, None], slopes)
        return np.asarray((nodes.max(axis=-2) + moved).max(axis=-2) + _apply(self._on_state, leak))

    def _pulled_between(self, at_nodes: FloatArray, values: FloatArray, leak: FloatArray) -> FloatArray:
        """Return bounds of p'F (...) at all times and for all plants, from those in each direction at the nodes.

        Args:
            at_nodes: (..., B, S k U) bounds of it at the nodes of all stretches.
            values: (..., B, rows) bounds of the signals at ticks.
            leak: (..., B, x) by how much inputs within a period move x.
        """
        way = self._radius[..., None] * _apply(self._reach[:, None], self._in_stretches(values)[0])
        peaks = at_nodes.reshape(*at_nodes.shape[:-1], self._radius.shape[1], -1).max(axis=-1)
        bound = (peaks + (self._moved[:, None] * way).sum(axis=-1)).max(axis=-1)
        return np.asarray(bound + (self._moved * _apply(self._on_state, leak)).sum(axis=-1))

    def _bend_between(self, values: FloatArray, leak: FloatArray) -> FloatArray:
        """Return bounds of e'' (..., B) at all times; the arguments are those of `_seen_between`."""
        bend = _apply(self.cells.growth[:, None], self._in_stretches(values)[0])[..., 1].max(axis=-1)
        return np.asarray(bend + _apply(self._dynamics, leak)[..., 1])

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
        moving = _apply(cells.growth, slope) + _apply(A, leak) + E * (h * drives.rate)[:, None] + jolt
        bend = _apply(A, moving)[..., 1] + cells.drag_error * moving[..., 1] + drives.rate

        A, B = self._model
        model_slope = values[..., self._seen + 2 : self._rows].reshape(*values.shape[:-1], -1, len(B)).max(axis=-2)
        model_leak = self._model_growth @ B * h * drives.model
        model_moving = model_slope @ self._model_growth.T + A @ model_leak + B * drives.model
        bend = bend + model_moving @ A[1]
        strayed = leak[..., 1] + model_leak[1]  # of the velocity, within the period
        wrong = np.maximum(values[..., self._seen], values[..., self._seen + 1] + strayed) + h * h / 8.0 * bend
        return np.asarray(drives.other_age * wrong + self.pose_age * strayed)

    def answered(self, inputs: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the first three arguments of `settled` for inputs (B, columns) of some amplitudes."""
        exact, bent = inputs[:, : self._followed], inputs.copy()
        bent[:, : self._followed] = 0.0
        own = _apply(self.sums[..., : self._followed], exact)
        return own, (self._vertex_sums @ exact[:, None, :, None])[..., 0], bent

    def started(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the first three arguments of `settled` for a unit of e and one of e' at the start, S = 2."""
        peaks, at_vertices = (np.moveaxis(array, -1, 0) for array in (self._peaks, self._vertex_peaks))
        return peaks, at_vertices, np.zeros((*peaks.shape[:2], self._count))

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
        late_shape = (late**2 / 2.0 * cells.port_gain)[:, None] * _apply(self._dynamics, last)
        changes, noise = self._part["change"].start, self._part["noise"].start

        # what inputs that follow from signals do to all signals, per unit: drive, pulse and its shape, push
        pulse = self.amplitudes(0.0, pulse=late * cells.port_gain)
        shape = np.zeros_like(pulse)
        shape[:, self._part["plant"]] = late_shape
        units = np.stack([self.amplitudes(1.0), pulse, shape, self.amplitudes(0.0, push=1.0)], axis=-1)
        effects, always = sums @ units, _apply(sums, bent)
        first_change, first_noise = at[..., changes], at[..., noise]

        def bounds(point: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
            """Bounds (..., B, 4) of the signals, (..., B, 5) of the inputs that follow from them, and of e''."""
            drive, difference, change, late_pose, push = np.moveaxis(point, -1, 0)
            rest = _apply(effects, np.stack([drive, difference, difference, push], -1)) + always
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
            second = (_apply(effects, further) + always)[..., :rows]
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
            point = np.where(going[..., None], implied * (1.0 + self._slack), point)
        return tracked, bends


def _apply(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return products (..., B, i) of matrices (B, i, j) and vectors (..., B, j)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _batch(value: Enclosure, count: int) -> Enclosure:
    """Return an enclosure (B, ...) of the same for all cells where it is (...)."""
    shape = (count, *value.shape[-2:])
    return Enclosure(np.broadcast_to(value.mid, shape), np.broadcast_to(value.rad, shape))

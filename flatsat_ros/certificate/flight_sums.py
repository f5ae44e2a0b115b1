"""The sums of cells: bounds of what their loops answer to units of their inputs, and of how much of each input acts."""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.answers import AnsweringLoops, answers
from flatsat_ros.certificate.enclosures import UP, Enclosure, concatenate, decimal, enclosed, upper
from flatsat_ros.certificate.flight_batch import Cells, exponential_norm

# Pieces of a period over which the effect of inputs that vary within it is interpolated.
_PIECES = 2


class CellSums:
    """The sums of cells; all numbers are bounds, and of operations that only add to them.

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
            faster: if given, the factor of `CellBounds.growing`.
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

        pieces = self._pieces = 1 if cells.rough else _PIECES
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
        loops = AnsweringLoops(
            _batch(loop.matrix(gain), count),
            _batch(inputs, count),
            _batch(Enclosure(starts), count),
            _batch(concatenate([tracked[:2], loop.feedback[None], tracked[2:], others @ command], -2), count),
            steps @ command,
            kicks,
            self._vertices,
        )
        self._found = answers(loops, factors, plain, cells.coarse)
        self._direct = enclosed(others[..., size]).size
        self._take(0)

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

    def answered(self, inputs: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the first three arguments of `settled` for inputs (B, columns) of some amplitudes."""
        exact, bent = inputs[:, : self._followed], inputs.copy()
        bent[:, : self._followed] = 0.0
        own = applied(self.sums[..., : self._followed], exact)
        return own, (self._vertex_sums @ exact[:, None, :, None])[..., 0], bent

    def started(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the first three arguments of `settled` for a unit of e and one of e' at the start, S = 2."""
        peaks, at_vertices = (np.moveaxis(array, -1, 0) for array in (self._peaks, self._vertex_peaks))
        return peaks, at_vertices, np.zeros((*peaks.shape[:2], self._count))


def applied(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return products (..., B, i) of matrices (B, i, j) and vectors (..., B, j)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _batch(value: Enclosure, count: int) -> Enclosure:
    """Return an enclosure (B, ...) of the same for all cells where it is (...)."""
    shape = (count, *value.shape[-2:])
    return Enclosure(np.broadcast_to(value.mid, shape), np.broadcast_to(value.rad, shape))

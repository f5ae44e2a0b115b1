"""From the sums of a cell to bounds of its signals, by small gains."""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.answers import answers
from flatsat_ros.certificate.flight_cell import Cell
from flatsat_ros.certificate.flight_loop import exponential

# Pieces of a period over which the effect of inputs that vary within it is interpolated.
_PIECES = 2

# By how much, relatively, every bound is enlarged for the rounding of its sums; that is some 1e-12.
_ROUNDING = 1e-8

# By how much, relatively, the bounds of the loop's own signals are above what they imply.
_SLACK = 1e-3

# Rounds in which the bounds of the loop's own signals must settle.
_ITERATIONS = 1000

# Signals beyond this, m/s^2, have no bound.
_ABSURD = 1e4


class Bounds:
    """The sums of a cell, and what follows from them.

    Columns of inputs are named parts: those that are followed to first order, then those that are not. Rows of signals:
    e, e', v0, D/g - d^; the difference of commands and, of each stretch, x' at its beginning and nodes of F; then the
    errors of the estimated velocity and the model's x^' at the beginning of each of its stretches.
    """

    def __init__(
        self, cell: Cell, gain_min: float, gain_max: float, growth: float | None = None, lag_varies: bool = False
    ) -> None:
        """Sum up.

        Args:
            cell: the plants.
            gain_min: smallest applied gain.
            gain_max: largest applied gain.
            growth: for the answers to starts instead of those to inputs, the factor by which all signals are multiplied
                more in every period than in the one before.
            lag_varies: whether lag, frequency and damping change in flight.
        """
        self.cell = cell
        # distances that are what they are for all of a flight: to these the answer is known to first order
        self._vertices = cell.steady if lag_varies else cell.vertices
        self._changing = cell.changing if lag_varies else np.zeros_like(cell.changing)
        gain, self._deviation = (gain_min + gain_max) / 2.0, (gain_max - gain_min) / 2.0
        loop = cell.loop
        size, h, model = loop.size, loop.design.period, loop.design.model
        command = loop.compensation + gain * loop.feedback

        def closed(rows: FloatArray) -> FloatArray:
            """Rows on z from rows on (z, c_0)."""
            return np.asarray(rows[..., :size] + rows[..., size:] * command)

        times = np.linspace(0.0, h, _PIECES + 1)
        weights = np.full(_PIECES + 1, h / _PIECES)
        weights[[0, -1]] /= 2.0
        port = 1.0 / loop.plant.system[1][-1]  # of one unit at the last row
        columns = {
            "noise": [loop.noise_input],
            "drive": [w * port * loop.drive_input(t) for w, t in zip(weights, times, strict=True)],
            "change": [loop.command_input],
        }
        if growth is None:  # starts have no other inputs
            columns["rate"] = [w * loop.rate_input(t) for w, t in zip(weights, times, strict=True)]
            columns["share"] = [h * loop.share_input]
            columns["model_drive"] = [w * loop.model_drive_input(t) for w, t in zip(weights, times, strict=True)]
        columns |= {
            "pulse": [cell.pulse],
            "push": [w * loop.push_input(t) for w, t in zip(weights, times, strict=True)],
            "ripple": [cell.unit_inputs @ loop.plant.system[0] @ loop.plant.hold(h / 2.0)[0][:, -1]],
            "model_ripple": [loop.model_unit_inputs @ model.system[0] @ model.hold(h / 2.0)[0] @ model.system[1]],
            "plant": list(cell.unit_inputs.T),
            "model": list(loop.model_unit_inputs.T),
        }
        ends = np.cumsum([0, *(len(part) for part in columns.values())])
        self._part = {name: slice(a, b) for name, a, b in zip(columns, ends[:-1], ends[1:], strict=True)}
        self._inputs = np.array([column for part in columns.values() for column in part]).T

        tracked = np.zeros((4, size))
        tracked[0, 0] = tracked[1, 1] = tracked[3, loop.plant.size + loop.design.model.size] = 1.0
        tracked[2] = loop.feedback
        blocks = [cell.difference[np.newaxis]]
        for stretch in cell.stretches:
            blocks += [stretch.slope, *stretch.nodes]
        self._seen = 4 + sum(len(block) for block in blocks)
        blocks += [cell.lateness, *cell.model_slopes]
        others = np.concatenate(blocks)
        steps = np.array(cell.derivatives)
        self._followed = self._part["pulse"].start
        kicks = np.zeros((len(steps), size, self._followed))
        kicks[:, :, self._part["change"].start] = steps[:, :, size]
        starts = np.zeros((size, 2))  # of e and of e', which the estimator knows
        for i in range(2):
            starts[[i, loop.plant.size + i], i] = 1.0
        if growth is None:
            growth, starts = 1.0, starts[:, :0]
        self.answers = answers(
            growth * loop.matrix(gain),
            growth * self._inputs,
            starts,
            np.concatenate([tracked, closed(others)]),
            growth * closed(steps),
            growth * kicks,
            self._followed,
            self._vertices,
        )
        for sums in (self.answers.sums, self.answers.vertex_sums):
            sums[..., 4:, self._part["change"]] += np.abs(others[:, size:])

    def amplitudes(self, drive: float, **others: float) -> FloatArray:
        """Return bounds (columns,) of all inputs, with what interpolation adds to those that act within a period."""
        cell, part, values = self.cell, self._part, np.zeros(self._inputs.shape[1])
        loop = cell.loop
        h = loop.design.period
        for name, value in ({"drive": drive} | others).items():
            values[part[name]] = value
        curve = h * (h / _PIECES) ** 2 / 12.0
        size, (A, _, E) = np.abs(loop.plant.system[0]), loop.plant.system
        bend = size @ size @ cell.growth[:, -1] * drive + size @ cell.growth @ np.abs(E) * others.get("rate", 0.0)
        bend += size @ size @ cell.growth @ np.abs(E) * others.get("push", 0.0)
        values[part["plant"]] += curve * bend
        if "model_drive" in others:
            A, B, _ = loop.design.model.system
            bend = np.abs(A) @ np.abs(A) @ exponential(np.abs(A) * h) @ np.abs(B)
            values[part["model"]] += curve * bend * others["model_drive"]
        return values

    def held(self, ripple: float, model_ripple: float) -> FloatArray:
        """Return bounds (columns,) of what is left of inputs that grow within a period from -h/2 to h/2 of a slope.

        Where in the period that begins does not matter; over the period its mean is 0.

        Args:
            ripple: largest slope at the last row, per s.
            model_ripple: at the input of the nominal plant, m/s^3.
        """
        loop, part, values = self.cell.loop, self._part, np.zeros(self._inputs.shape[1])
        h, size = loop.design.period, np.abs(loop.plant.system[0])
        A, B, _ = loop.design.model.system
        weight, curve = (
            h**3 / 12.0,
            h**4 / 24.0,
        )  # of the answer's slope in the middle, and its change
        values[part["ripple"]], values[part["model_ripple"]] = weight * ripple, weight * model_ripple
        values[part["plant"]] = curve * ripple * (size @ size @ self.cell.growth[:, -1])
        bend = np.abs(A) @ np.abs(A) @ exponential(np.abs(A) * h) @ np.abs(B)
        values[part["model"]] = curve * model_ripple * bend
        return values

    def _between(self, values: FloatArray, leak: FloatArray) -> tuple[FloatArray, float]:
        """Return bounds of F (m,) and e'' at all times, from those (rows,) at ticks and of what acts in between."""
        cell = self.cell
        x, m = len(cell.growth), len(cell.on_state)
        reach, begin, bound, bend = np.abs(cell.on_state) @ cell.growth, 5, np.zeros(m), 0.0
        for stretch in cell.stretches:
            slope = values[begin : begin + x]
            nodes = values[begin + x : begin + x + len(stretch.nodes) * m].reshape(-1, m)
            bound = np.maximum(bound, nodes.max(axis=0) + stretch.radius * reach @ slope)
            bend = max(bend, float(cell.growth[1] @ slope))
            begin += x + len(stretch.nodes) * m
        return bound + np.abs(cell.on_state) @ leak, bend + float(np.abs(cell.loop.plant.system[0])[1] @ leak)

    def _late_pose(
        self, values: FloatArray, leak: FloatArray, jolt: FloatArray, rate: float, model: float, other_age: float
    ) -> float:
        """Return a bound of what poses of another age than the loop's add to innovations, m.

        Args:
            values: (rows,) bounds of the signals at ticks.
            leak: (x,) by how much inputs within a period move x.
            jolt: (x,) bounds of the inputs at each row of x'.
            rate: of D', m/s^3.
            model: of the drive at the nominal plant's input, m/s^2.
            other_age: by how much the age is another, s.
        """
        cell, h = self.cell, self.cell.loop.design.period
        (A, _, E), growth, x = cell.loop.plant.system, cell.growth, len(cell.growth)
        slope, begin = np.zeros(x), 5
        for stretch in cell.stretches:
            slope = np.maximum(slope, values[begin : begin + x])
            begin += x + len(stretch.nodes) * len(cell.on_state)
        moving = growth @ slope + np.abs(A) @ leak + np.abs(E) * h * rate + jolt
        bend = float(np.abs(A)[1] @ moving) + cell.drag_error * float(moving[1]) + rate

        A, B, _ = cell.loop.design.model.system
        growth, y = exponential(np.abs(A) * h), len(A)
        slope = values[self._seen + 2 :].reshape(-1, y).max(axis=0)
        model_leak = growth @ np.abs(B) * h * model
        bend += float(np.abs(A)[1] @ (growth @ slope + np.abs(A) @ model_leak + np.abs(B) * model))
        strayed = leak[1] + model_leak[1]  # of the velocity, within the period
        wrong = max(values[self._seen], values[self._seen + 1] + strayed) + h * h / 8.0 * bend
        return float(other_age * wrong + cell.loop.pose_age * strayed)

    def answered(self, inputs: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the first three arguments of `settled` for inputs (columns,) of some amplitudes."""
        exact, bent = inputs[: self._followed], inputs.copy()
        bent[: self._followed] = 0.0
        return self.answers.sums[:, : self._followed] @ exact, self.answers.vertex_sums @ exact, bent

    def started(self, which: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the first three arguments of `settled` for a unit of e (0) or of e' (1) at the start."""
        peaks, at_vertices = self.answers.peaks[:, which], self.answers.vertex_peaks[:, :, which]
        return peaks, at_vertices, np.zeros(self._inputs.shape[1])

    def settled(
        self,
        signals: FloatArray,
        at_vertices: FloatArray,
        bent: FloatArray,
        error: float,
        rate: float,
        model: float,
        other_age: float,
    ) -> tuple[FloatArray, float] | None:
        """Return bounds of the tracked signals (4,) and of e'', or None if the small gain argument does not hold.

        Args:
            signals: (rows,) bounds of the signals of the middle at its middle gain.
            at_vertices: (V, rows) bounds of them to first order, at the vertices.
            bent: (columns,) further inputs, which are not followed to first order.
            error: bound of the drive at the last row.
            rate: of D', m/s^3.
            model: bound of the drive at the nominal plant's input, m/s^2.
            other_age: by how much the age of a pose is another than the loop's, s.
        """
        cell, loop = self.cell, self.cell.loop
        sums, at, h = self.answers.sums, self.answers.vertex_sums, loop.design.period
        A, _, E = loop.plant.system
        late, moved = cell.vertices[:, -1].max(), np.abs(cell.vertices[:, :-1]).max(axis=0)
        steady = np.abs(self._vertices[:, :-1]).max(axis=0)
        late_shape = late**2 / 2.0 * cell.port_gain * (np.abs(A) @ cell.growth[:, -1])
        changes, noise = self._part["change"].start, self._part["noise"].start

        # what inputs that follow from signals do to all signals, per unit: drive, pulse and its shape, push
        pulse = self.amplitudes(0.0, pulse=late * cell.port_gain)
        shape = np.zeros(len(pulse))
        shape[self._part["plant"]] = late_shape
        units = np.array([self.amplitudes(1.0), pulse, shape, self.amplitudes(0.0, push=1.0)]).T
        effects, always = sums @ units, sums @ bent
        first_change, first_noise = at[:, :, changes], at[:, :, noise]

        def bounds(
            drive: float, difference: float, change: float, late_pose: float, push: float
        ) -> tuple[FloatArray, FloatArray, float]:
            """Bounds (4,) of the signals, (5,) of the inputs that follow from them, and of e''."""
            rest = effects @ [drive, difference, difference, push] + always
            plain = signals + sums[:, changes] * change + sums[:, noise] * late_pose + rest
            leak = cell.growth[:, -1] * (h * (drive + error) + late * cell.port_gain * difference)
            leak += cell.growth @ np.abs(E) * h * (h * rate + push)
            left, _ = self._between(rest, leak)
            changing = self._changing @ self._between(plain, leak)[0] if self._changing.any() else 0.0
            wider = rest[4] + cell.port_gain_error / cell.port_gain * difference
            second = effects @ [float(steady @ left + changing), wider, difference, push] + always
            first = (at_vertices + first_change * change + first_noise * late_pose).max(axis=0)
            whole = np.minimum(plain, first + second)
            seen, bend = self._between(whole, leak)
            bend += h * rate + push
            jolt = np.abs(E) * push
            jolt[-1] += drive + error + (cell.port_gain * difference if late > 0.0 else 0.0)
            pose = self._late_pose(whole, leak, jolt, rate, model, other_age) if other_age > 0.0 else 0.0
            velocity = whole[1] + h / 2.0 * bend  # half a period from a tick at most
            following = [moved @ seen, whole[4], self._deviation * whole[2], pose, cell.drag_error * velocity]
            return whole[:4], np.array(following), float(bend)

        point = np.zeros(5)
        for _ in range(_ITERATIONS):
            tracked, implied, bend = bounds(*point)
            if (implied <= point).all():  # the bounds imply themselves: by the small gain argument they hold
                return tracked * (1.0 + _ROUNDING), bend
            if implied.max() > _ABSURD:
                break
            point = implied * (1.0 + _SLACK)
        return None

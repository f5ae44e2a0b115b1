"""The tube: how far the loop that flies can be from its reference, proved for all plants of a box and all gains.

Per cell of the box, with the loop z+ = A z + B w of the cell's middle at the middle k^ of the gain interval, a bound of
a signal y = C z is sum_i |C A^i B| times that of w, exact for one loop. What separates a plant of the cell from the
middle (`flight_cell`), and (k - k^) v0 of a gain that varies as it likes, are further inputs, bounded by signals of the
loop itself: a small gain argument. To first order in the distances from the middle the answer to them is computed
exactly, as a derivative of the response, and bounded at the vertices of the cell, because a sum of absolute values is
convex; only what is left, of second order, is left to the small gains. docs/mathematics.md has the proof.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError, refusal, require_fields, require_not_negative
from flatsat_ros.certificate.flight_cell import Box, Cell
from flatsat_ros.certificate.flight_loop import Design, Plant, exponential

# Pieces of a period over which the effect of inputs that vary within it is interpolated.
_PIECES = 2

# Periods that are summed in one go.
_CHUNK = 16

# A loop has forgotten once so little is left of every state, relatively.
_FORGOTTEN = 1e-12

# Periods after which a loop that still remembers is given up.
_PERIODS_MAX = 20_000

# By how much, relatively, every bound is enlarged for the rounding of its sums; that is some 1e-12.
_ROUNDING = 1e-8

# By how much, relatively, the bounds of the loop's own signals are above what they imply.
_SLACK = 1e-4

# Rounds in which the bounds of the loop's own signals must settle.
_ITERATIONS = 1000

# Signals beyond this, m/s^2, have no bound.
_ABSURD = 1e4


@dataclass(frozen=True)
class Assumptions:
    """What the tube takes for granted; Euclidean norms over the axes that share a loop.

    Attributes:
        disturbance_rate: of the acceleration by which nature disturbs, m/s^3.
        noise: of measured positions, m.
        acceleration: of the reference, m/s^2; only drag and tilt need it.
        jerk: of the reference, m/s^3.
        snap: of the reference, m/s^4.

    Raises:
        FlatsatError: a value is negative or not finite.
    """

    disturbance_rate: float
    noise: float
    acceleration: float
    jerk: float
    snap: float

    def __post_init__(self) -> None:
        require_fields(self, require_not_negative, disturbance_rate="m/s^3", noise="m", acceleration="m/s^2")
        require_fields(self, require_not_negative, jerk="m/s^3", snap="m/s^4")

    def drive(self, model: Plant, period: float, low: Plant, high: Plant) -> float:
        """Return a bound of what f has too much for the reference at the input of any plant between two, m/s^2.

        Args:
            model: the nominal plant, for which f is made.
            period: h, s.
            low: least figures of the plants.
            high: largest figures of the plants.
        """
        asked = model.drag + model.tilt
        jerk, snap = self.jerk + asked * self.acceleration, self.snap + asked * self.jerk
        second = low.frequency > 0.0
        shortest = 2.0 * low.damping / high.frequency if second else low.lag
        longest = 2.0 * high.damping / low.frequency if second else high.lag
        lag = 1.0 / low.frequency**2 if second else 0.0
        due = model.lead + model.delay  # f is taken ahead by so much, and by half a period
        early = max(abs(due - longest - high.delay), abs(due - shortest - low.delay)) + period / 2.0
        ahead = max(abs(low.delay - model.delay), abs(high.delay - model.delay)) + period / 2.0
        tilted = high.tilt / low.gain * (longest * self.acceleration + lag * self.jerk)
        return early * jerk + (ahead**2 / 2.0 + model.lead * ahead + lag) * snap + tilted

    def rate(self, model: Plant, low: Plant, high: Plant) -> float:
        """Return a bound of D', m/s^3, on any plant between two: of nature, and of what the loop makes of references.

        Args:
            model: the nominal plant.
            low: least figures of the plants.
            high: largest figures of the plants.
        """
        asked = model.drag + model.tilt
        wrong_gain = max(abs(low.gain - 1.0), abs(high.gain - 1.0))
        unknown = max(abs(asked - low.drag - low.tilt), abs(asked - high.drag - high.tilt))
        return (
            self.disturbance_rate + wrong_gain * (self.jerk + asked * self.acceleration) + unknown * self.acceleration
        )


@dataclass(frozen=True)
class Tube:
    """Bounds of Euclidean norms over the axes, once the loop has forgotten how it began.

    Attributes:
        position: |e|, m, at all times.
        velocity: |e'|, m/s, at the ticks.
        nominal: |v0|, m/s^2.
        disturbance: |D/g - d^|, m/s^2, at the ticks.
    """

    position: float
    velocity: float
    nominal: float
    disturbance: float

    def __or__(self, other: Tube) -> Tube:
        """Return the larger of each."""
        return Tube(*(max(getattr(self, f.name), getattr(other, f.name)) for f in fields(Tube)))


def cell_tube(
    design: Design, box: Box, gain_min: float, gain_max: float, assumptions: Assumptions, lag_varies: bool = False
) -> Tube:
    """Return the tube of all plants of a box, as one cell.

    Args:
        design: the controller.
        box: the plants, none of whose delays are separated by a whole period.
        gain_min: smallest applied gain k, which may be another at every tick.
        gain_max: largest applied gain.
        assumptions: bounds of the inputs.
        lag_varies: whether lag, frequency and damping change in flight, within the box; if so the tube is larger.

    Returns:
        Bounds; infinite ones if the small gain argument does not hold for so large a cell.

    Raises:
        FlatsatError: a whole period lies inside the interval of the delay, or the gains are no interval above 0.
    """
    if not box.within_periods(design.period):
        raise FlatsatError(f"delays from {box.low.delay} to {box.high.delay} s: must have no whole period inside")
    if not 0.0 < gain_min <= gain_max:
        raise refusal("gain_min", gain_min, "", f"above 0 and at most gain_max, {gain_max:g}")
    return _Bounds(Cell(design, box), (gain_min + gain_max) / 2.0, (gain_max - gain_min) / 2.0).tube(
        box, assumptions, lag_varies
    )


def box_tube(
    design: Design,
    box: Box,
    cuts: Sequence[str],
    gain_min: float,
    gain_max: float,
    assumptions: Assumptions,
    lag_varies: bool = False,
) -> Tube:
    """Return the tube of all plants of a box that is cut into cells.

    Args:
        design: the controller.
        box: the plants.
        cuts: for the box and then for the lower and the upper half of whatever is cut, each with its own halves before
            the next: the figure across which it is cut into halves (`Box.halves`), or "" for a cell.
        gain_min: smallest applied gain k.
        gain_max: largest applied gain.
        assumptions: bounds of the inputs.
        lag_varies: as for `cell_tube`; across these figures there must be no cut.

    Raises:
        FlatsatError: as `cell_tube`; or the cuts leave parts over, go on without any, or name no figure of a part.
    """
    tube, waiting = Tube(0.0, 0.0, 0.0, 0.0), [box]
    for name in cuts:
        if not waiting:
            raise refusal("number of cuts", len(cuts), "", "no more than there are parts")
        part = waiting.pop()
        if name:
            possible = part.constants(lag_varies)
            if name not in possible:
                raise refusal("a cut", name, "", f"one of {', '.join(possible)}, the figures to cut its part across")
            waiting.extend(reversed(part.halves(name, design.period)))
        else:
            tube |= cell_tube(design, part, gain_min, gain_max, assumptions, lag_varies)
    if waiting:
        raise refusal("number of cuts", len(cuts), "", f"more, {len(waiting)} parts are left")
    return tube


class _Bounds:
    """The sums of a cell, and what follows from them.

    With x the size of the plant's state, columns of inputs are: rate (pieces + 1), noise, drive (pieces + 1), pulse,
    change of the gain, share, model's drive (pieces + 1), plant (x), model (y). Rows of signals: e, e', v0, D/g - d^
    (with derivatives); then the difference of commands and, of each stretch, x' at its beginning and nodes of F.
    """

    def __init__(self, cell: Cell, gain: float, deviation: float) -> None:
        self.cell, self.deviation = cell, deviation
        loop = cell.loop
        size, h, x = loop.size, loop.design.period, loop.plant.size
        command = loop.compensation + gain * loop.feedback

        def closed(rows: FloatArray) -> FloatArray:
            """Rows on z from rows on (z, c_0)."""
            return np.asarray(rows[..., :size] + rows[..., size:] * command)

        times = np.linspace(0.0, h, _PIECES + 1)
        weights = np.full(_PIECES + 1, h / _PIECES)
        weights[[0, -1]] /= 2.0
        port = 1.0 / loop.plant.system[1][-1]  # of one unit at the last row
        columns = [
            *(w * loop.rate_input(t) for w, t in zip(weights, times, strict=True)),
            loop.noise_input,
            *(w * port * loop.drive_input(t) for w, t in zip(weights, times, strict=True)),
            cell.pulse,
            loop.command_input,
            h * loop.share_input,
            *(w * loop.model_drive_input(t) for w, t in zip(weights, times, strict=True)),
            *cell.unit_inputs.T,
            *loop.model_unit_inputs.T,
        ]
        ends = np.cumsum([0, _PIECES + 1, 1, _PIECES + 1, 1, 1, 1, _PIECES + 1, x, loop.design.model.size])
        names = ("rate", "noise", "drive", "pulse", "change", "share", "model_drive", "plant", "model")
        self.part = {name: slice(a, b) for name, a, b in zip(names, ends[:-1], ends[1:], strict=True)}
        self.inputs = np.array(columns).T

        tracked = np.zeros((4, size))
        tracked[0, 0] = tracked[1, 1] = tracked[3, loop.plant.size + loop.design.model.size] = 1.0
        tracked[2] = loop.feedback
        blocks = [cell.difference[np.newaxis]]
        for stretch in cell.stretches:
            blocks += [stretch.slope, *stretch.nodes]
        others = np.concatenate(blocks)
        kicks = [np.outer(step[:, size], np.eye(len(columns))[self.part["change"].start]) for step in cell.derivatives]
        steps = [closed(step) for step in cell.derivatives]
        self.vertex, self.plain = _sums(
            loop.matrix(gain), self.inputs, tracked, closed(others), steps, kicks, cell.vertices
        )
        self.plain[4:, self.part["change"]] += np.abs(others[:, size:])

    def _amplitudes(self, drive: float, **others: float) -> FloatArray:
        """The bounds of all inputs, with what interpolation within the period adds to those that act at any time."""
        cell, part, values = self.cell, self.part, np.zeros(self.inputs.shape[1])
        loop = cell.loop
        h = loop.design.period
        for name, value in ({"drive": drive} | others).items():
            values[part[name]] = value
        curve = h * (h / _PIECES) ** 2 / 12.0
        size, (A, _, E) = np.abs(loop.plant.system[0]), loop.plant.system
        bend = size @ size @ cell.growth[:, -1] * drive + size @ cell.growth @ np.abs(E) * others.get("rate", 0.0)
        values[part["plant"]] += curve * bend
        if "model_drive" in others:
            A, B, _ = loop.design.model.system
            bend = np.abs(A) @ np.abs(A) @ exponential(np.abs(A) * h) @ np.abs(B)
            values[part["model"]] += curve * bend * others["model_drive"]
        return values

    def _between(self, values: FloatArray, leak: FloatArray) -> tuple[FloatArray, float]:
        """Bounds of F (m,) and of e'' at all times, from those (rows,) at ticks and of what acts within a period."""
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

    def tube(self, box: Box, assumptions: Assumptions, lag_varies: bool) -> Tube:
        """Return what is proved of a box; of one whose lag varies the derivatives say nothing."""
        cell, loop, plain = self.cell, self.cell.loop, self.plain
        h, model = loop.design.period, loop.design.model
        if not np.isfinite(plain).all():
            return Tube(math.inf, math.inf, math.inf, math.inf)
        A, _, E = loop.plant.system
        late, moved = cell.vertices[:, -1].max(), np.abs(cell.vertices[:, :-1]).max(axis=0)
        rate = assumptions.rate(model, box.low, box.high)
        error = cell.port_gain * assumptions.drive(model, h, box.low, box.high)
        given = {
            "rate": rate,
            "noise": assumptions.noise,
            "share": cell.share_error * rate,
            "model_drive": assumptions.drive(model, h, model, model),
        }
        late_shape = late**2 / 2.0 * cell.port_gain * (np.abs(A) @ cell.growth[:, -1])

        def bounds(drive: float, difference: float, change: float) -> tuple[FloatArray, FloatArray, float]:
            """Bounds (4,) of the signals, (3,) of the inputs that follow from them, and of e''."""
            first = self._amplitudes(error, **given, change=change)
            wrong = self._amplitudes(drive, pulse=late * cell.port_gain * difference)
            wrong[self.part["plant"]] += late_shape * difference
            whole, rest = plain @ (first + wrong), plain @ wrong
            leak = cell.growth[:, -1] * (h * (drive + error) + late * cell.port_gain * difference)
            leak += cell.growth @ np.abs(E) * h * h * rate
            signals, bend = self._between(whole, leak)
            left, _ = self._between(rest, leak)
            second = self._amplitudes(
                float(moved @ left),
                pulse=late * (cell.port_gain * rest[4] + cell.port_gain_error * difference),
            )
            second[self.part["plant"]] += late_shape * difference
            tracked = whole[:4]
            if not lag_varies:
                tracked = np.minimum(tracked, (self.vertex @ first).max(axis=0) + plain[:4] @ second)
            following = np.array([moved @ signals, whole[4], self.deviation * tracked[2]])
            return tracked, following, bend + h * rate

        point = np.zeros(3)
        for _ in range(_ITERATIONS):
            _, following, _ = bounds(*point)
            if following.max() > _ABSURD:
                break
            point = following * (1.0 + _SLACK)
            tracked, implied, bend = bounds(*point)
            if (implied <= point).all():  # the bounds imply themselves: by the small gain argument they hold
                position, velocity, nominal, disturbance = (tracked * (1.0 + _ROUNDING)).tolist()
                return Tube(position + h * h / 8.0 * bend, velocity, nominal, disturbance)
        return Tube(math.inf, math.inf, math.inf, math.inf)


def _sums(
    A: FloatArray,
    B: FloatArray,
    tracked: FloatArray,
    others: FloatArray,
    steps: list[FloatArray],
    kicks: list[FloatArray],
    vertices: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return sum_i |C A^i B|, exactly or above.

    Args:
        A: (n, n).
        B: (n, m).
        tracked: (p, n) rows C of which derivatives are taken.
        others: (q, n) rows C of which none are.
        steps: derivatives of A by each parameter, (n, n).
        kicks: those of B, (n, m).
        vertices: (V, d) points of the parameters.

    Returns:
        (V, p, m) the sums of |(C A^i B) + its derivative in the direction of each vertex|, and (p + q, m) those of C
        from both; infinite where A is not stable.
    """
    n, p, q = len(A), len(tracked), len(steps)
    powers, slopes = [np.eye(n)], [np.zeros((q, n, n))]
    step = np.array(steps)
    for _ in range(_CHUNK):
        slopes.append(slopes[-1] @ A + powers[-1] @ step)
        powers.append(powers[-1] @ A)
    answers = np.concatenate([power @ B for power in powers[:-1]], axis=1)
    moves = np.concatenate(
        [d @ B + power @ np.array(kicks) for power, d in zip(powers, slopes, strict=True)][:-1], axis=2
    )
    reach = np.abs(vertices).max(axis=0)
    size = sum(_norm(power) for power in powers[:-1])
    bent = sum(float(reach @ np.abs(d).sum(axis=2).max(axis=1)) for d in slopes[:-1])

    # rows C A^i and their derivatives; and all of A^i itself, to see what is forgotten
    rows, turns = np.concatenate([tracked, others, np.eye(n)]), np.zeros((q, p, n))
    spin = np.zeros((q, n, n))
    plain, vertex = np.zeros((p + len(others), B.shape[1])), np.zeros((len(vertices), p, B.shape[1]))
    weight = np.zeros(len(plain))
    for _ in range(_PERIODS_MAX // _CHUNK):
        values = rows[:-n] @ answers
        plain += np.abs(values).reshape(len(plain), _CHUNK, -1).sum(axis=1)
        changes = turns @ answers + rows[:p] @ moves
        moved = values[:p] + np.tensordot(vertices, changes, axes=1)
        vertex += np.abs(moved).reshape(len(vertices), p, _CHUNK, -1).sum(axis=2)
        weight += np.abs(rows[:-n]).sum(axis=1) * ((1 + q) * size + bent)
        weight[:p] += size * np.tensordot(reach, np.abs(turns).sum(axis=2), axes=1)
        turns = turns @ powers[-1] + rows[:p] @ slopes[-1]
        spin = spin @ powers[-1] + rows[-n:] @ slopes[-1]
        rows = rows @ powers[-1]
        left = float((np.abs(rows[-n:]).sum(axis=1) + np.tensordot(reach, np.abs(spin).sum(axis=2), axes=1)).max())
        if left < _FORGOTTEN:
            kicked = np.tensordot(reach, np.abs(kicks).max(axis=1), axes=1)
            biggest = np.abs(B).max(axis=0) + kicked
            tail = np.outer(weight, biggest) * left / (1.0 - left)
            return vertex + tail[:p], plain + tail
        if left > 1e12:
            break
    return np.full_like(vertex, np.inf), np.full_like(plain, np.inf)


def _norm(matrix: FloatArray) -> float:
    """Return the largest sum of absolute values of a row."""
    return float(np.abs(matrix).sum(axis=1).max())

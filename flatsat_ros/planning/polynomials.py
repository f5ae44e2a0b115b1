"""Piecewise polynomials of degree 7 in crazyswarm's CSV form, as references of plans.

A line is a piece: its duration, s, and the coefficients of 1, t, ... t^7 of x, y, z, m, and yaw, rad. With few
digits pieces do not meet exactly; the reference that is taken is the nearest one that is continuous up to the jerk.
"""

from __future__ import annotations

import csv
import io
import math
import os

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError, refusal, require
from flatsat_ros.base.files import located, read_text
from flatsat_ros.base.numerals import number_of
from flatsat_ros.plans import Curve
from flatsat_ros.plans.curve import AT_REST

_DEGREE = 7
_SIZE = _DEGREE + 1
_COLUMNS = ("duration", *(f"{axis}^{power}" for axis in ("x", "y", "z", "yaw") for power in range(_SIZE)))
_BYTES_MAX = 1024 * 1024
_PIECES_MAX = 500
_APART = 1e-3  # m, that the reference may be off the pieces
_TURNED = 1e-6  # rad, of the yaw
_LOOKS = 20  # in each piece


def read_polynomials(path: str | os.PathLike[str]) -> tuple[Curve, float]:
    """Return the reference and its yaw, rad.

    Args:
        path: of the CSV file.

    Raises:
        FlatsatError: the file cannot be read or is not of its form, the yaw changes, or the pieces are not at rest at
            both ends or not continuous up to the jerk; the text begins with the path.
    """
    text = read_text(path, _BYTES_MAX)
    try:
        return _reference(*_pieces(text))
    except (FlatsatError, csv.Error) as error:
        raise located(path, error) from error


def is_polynomials(first_line: str) -> bool:
    """Tell such a file from its first line."""
    return first_line.strip().lower().startswith("duration")


def _reference(durations: FloatArray, coefficients: FloatArray) -> tuple[Curve, float]:
    """Return the reference nearest to pieces of durations (M,), s, and coefficients (M, 8, 4), and its yaw, rad."""
    yaw = coefficients[:, :, 3]
    if np.abs(yaw[:, 1:]).max() > _TURNED or np.ptp(yaw[:, 0]) > _TURNED:
        raise FlatsatError("yaw of the polynomials changes: must be constant, a reference holds one yaw")
    pieces = coefficients[:, :, :3]
    knots = np.rint(np.cumsum([0.0, *durations]) * 1e6).astype(int).tolist()
    joined = _joined(np.diff(knots) / 1e6, pieces)
    curve = Curve.rounded(knots, _control_points(np.array(knots) / 1e6, joined), _DEGREE)
    _require_near(curve, durations, pieces)
    return curve, float(yaw[0, 0])


def _pieces(text: str) -> tuple[FloatArray, FloatArray]:
    """Return durations (M,), s, and coefficients (M, 8, 4) of x, y, z, yaw from a file's text."""
    rows = list(csv.reader(io.StringIO(text)))
    rows = [row[:-1] if row and not row[-1].strip() else row for row in rows if row]  # a comma ends some lines
    names = [cell.strip().lower() for cell in rows[0]] if rows else []
    if tuple(names) != _COLUMNS:
        raise refusal("first line", ",".join(names), "", "duration,x^0,...,x^7,y^0,...,z^0,...,yaw^0,...,yaw^7")
    require(1 <= len(rows) - 1 <= _PIECES_MAX, "number of pieces", len(rows) - 1, "", f"from 1 to {_PIECES_MAX}")
    table = []
    for number, row in enumerate(rows[1:], 1):
        try:
            values = [number_of(cell) for cell in row]
        except ValueError as error:
            raise refusal(f"piece {number}", ",".join(row), "", "numbers") from error
        if len(values) != len(_COLUMNS) or not all(map(math.isfinite, values)):
            raise refusal(f"piece {number}", ",".join(row), "", f"{len(_COLUMNS)} finite numbers")
        require(1e-3 <= values[0] <= 3600.0, f"duration of piece {number}", values[0], "s", "from 0.001 to 3600")
        table.append(values)
    numbers = np.array(table)
    return numbers[:, 0], numbers[:, 1:].reshape(-1, 4, _SIZE).transpose(0, 2, 1)


def _joined(durations: FloatArray, pieces: FloatArray) -> FloatArray:
    """Return pieces (M, 8, 3) that meet at means in position, velocity, acceleration and jerk, at rest at both ends."""
    powers, orders = np.arange(_SIZE), np.arange(4)
    factors = np.array([[float(math.perm(power, order)) for power in powers] for order in orders])
    found = np.zeros_like(pieces)
    rates = []
    for duration, piece in zip(durations.tolist(), pieces, strict=True):
        rates.append(
            [(factors * np.power(t, np.maximum(powers - orders[:, None], 0))) @ piece for t in (0.0, duration)]
        )
    starts, ends = (np.array([rate[side] for rate in rates]) for side in (0, 1))
    means = np.concatenate([starts[:1], (ends[:-1] + starts[1:]) / 2.0, ends[-1:]])
    means[0, 1:] = means[-1, 1:] = 0.0
    for number, duration in enumerate(durations.tolist()):
        scale = np.power(duration, orders)[:, np.newaxis]
        low = means[number] * scale / np.diag(factors)[:, np.newaxis]
        high = np.linalg.solve(factors[:, 4:], means[number + 1] * scale - factors[:, :4] @ low)
        found[number] = np.concatenate([low, high]) / np.power(duration, powers)[:, np.newaxis]
    return found


def _control_points(knots: FloatArray, pieces: FloatArray) -> FloatArray:
    """Return the control points (4 M + 4, 3): blossoms of the pieces at the knots around them."""
    step = 4  # how often inner knots count
    padded = np.concatenate(
        [np.repeat(knots[:1], _DEGREE), np.repeat(knots[1:-1], step), np.repeat(knots[-1:], _DEGREE)]
    )
    points = np.zeros((step * len(pieces) + step, 3))
    binomials = np.array([math.comb(_DEGREE, power) for power in range(_SIZE)])
    for number, piece in enumerate(pieces):
        local = padded[step * number : step * number + 2 * _DEGREE] - knots[number]
        for index in range(_SIZE):
            symmetric = np.poly(-local[index : index + _DEGREE])  # elementary symmetric polynomials of the knots
            points[step * number + index] = (symmetric / binomials) @ piece
    points[:AT_REST] = points[0]
    points[-AT_REST:] = points[-1]
    return np.asarray(points)


def _require_near(curve: Curve, durations: FloatArray, pieces: FloatArray) -> None:
    """Refuse pieces that the reference is off by more than the rounding of digits explains."""
    trajectory = curve.trajectory()
    worst, time = 0.0, 0.0
    for begin, duration, piece in zip(np.array(curve.knots) / 1e6, durations.tolist(), pieces, strict=False):
        for t in np.linspace(0.0, duration, _LOOKS):
            place = np.power(t, np.arange(_SIZE)) @ piece
            offset = float(np.linalg.norm(trajectory.sample(float(begin + t))[:3] - place))
            if offset > worst:
                worst, time = offset, float(begin + t)
    if worst > _APART:
        raise FlatsatError(
            f"distance of the pieces from a reference that rests at both ends and is continuous up to the jerk = "
            f"{worst:.4g} m at t = {time:.4g} s: must be at most {_APART:g} m"
        )

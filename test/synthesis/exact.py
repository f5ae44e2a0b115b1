"""The inequalities of a certificate once more, in exact rational arithmetic.

Floats are the decimals that are written for them; sin, cos and exp are enclosed between rationals by their series. A
matrix is positive semidefinite if no pivot of its LDL' is negative.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction

import numpy as np

from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.robust import Robust

# Half of what the enclosures below may be wide.
_TINY = Fraction(1, 10**40)

Matrix = list[list[Fraction]]


def number(value: float) -> Fraction:
    return Fraction(repr(float(value)))


def rational(array: np.ndarray) -> Matrix:
    return [[number(entry) for entry in row] for row in np.atleast_2d(array)]


def product(first: Matrix, *others: Matrix) -> Matrix:
    for other in others:
        columns = list(zip(*other, strict=True))
        first = [[sum((a * b for a, b in zip(row, col, strict=True)), Fraction(0)) for col in columns] for row in first]
    return first


def transposed(matrix: Matrix) -> Matrix:
    return [list(row) for row in zip(*matrix, strict=True)]


def combined(*terms: tuple[Fraction | int, Matrix]) -> Matrix:
    """The sum of factors times matrices."""
    size = range(len(terms[0][1])), range(len(terms[0][1][0]))
    return [[sum((factor * matrix[i][j] for factor, matrix in terms), Fraction(0)) for j in size[1]] for i in size[0]]


def identity(size: int) -> Matrix:
    return [[Fraction(int(i == j)) for j in range(size)] for i in range(size)]


def inverse(matrix: Matrix) -> Matrix:
    """Gauss and Jordan, exact."""
    size = len(matrix)
    rows = [row + unit for row, unit in zip(matrix, identity(size), strict=True)]
    for i in range(size):
        pivot = next(j for j in range(i, size) if rows[j][i] != 0)
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [entry / rows[i][i] for entry in rows[i]]
        for j in range(size):
            if j != i:
                rows[j] = [a - rows[j][i] * b for a, b in zip(rows[j], rows[i], strict=True)]
    return [row[size:] for row in rows]


def positive(matrix: Matrix, *, strictly: bool = False) -> bool:
    """Whether no pivot of the symmetric matrix's LDL' is negative, or all are positive."""
    rows = [list(row) for row in matrix]
    assert rows == transposed(rows)
    for i in range(len(rows)):
        if rows[i][i] < 0 or (rows[i][i] == 0 and (strictly or any(rows[i][i:]))):
            return False
        if rows[i][i] == 0:
            continue
        for j in range(i + 1, len(rows)):
            factor = rows[j][i] / rows[i][i]
            rows[j] = [a - factor * b for a, b in zip(rows[j], rows[i], strict=True)]
    return True


def sine(x: Fraction) -> Fraction:
    """Within _TINY of sin x, for 0 <= x <= 2."""
    return _series(x, 1)


def cosine(x: Fraction) -> Fraction:
    """Within _TINY of cos x, for 0 <= x <= 2."""
    return _series(x, 0)


def _series(x: Fraction, first: int) -> Fraction:
    total, term, n = Fraction(0), x**first, first
    while abs(term) > _TINY / 4:  # alternating with falling terms from n = 2 on: the next term bounds the error
        total += term
        n += 2
        term *= -x * x / (n * (n - 1))
    return total


def exponential(x: Fraction) -> Fraction:
    """Within _TINY of exp(-x), for x >= 0."""
    halvings = max(0, math.ceil(math.log2(max(float(x), 1.0))) + 1)
    x = x / 2**halvings
    total, term, n = Fraction(0), Fraction(1), 0
    while abs(term) > _TINY / 4 ** (halvings + 4):
        total += term
        n += 1
        term *= -x / n
    return total ** (2**halvings)


def transition(certificate: Certificate) -> tuple[Matrix, Matrix]:
    """F and G, every entry within 10 _TINY (1 + h + tau)^2 of the truth."""
    h, tau, d = (number(getattr(certificate, name)) for name in ("period", "lag", "delay"))
    whole = int(d / h + Fraction(1, 10**9))
    part = d - whole * h if d - whole * h > h / 10**9 else Fraction(0)

    def hold(t: Fraction) -> tuple[Matrix, Matrix]:
        if tau == 0:
            return [[Fraction(1), t], [Fraction(0), Fraction(1)]], [[t * t / 2], [t]]
        gone = 1 - exponential(t / tau)
        late = t - tau * gone
        F = [[1, t, tau * late], [0, 1, tau * gone], [0, 0, 1 - gone]]
        return [[Fraction(entry) for entry in row] for row in F], [[t * t / 2 - tau * late], [late], [gone]]

    (early, early_input), (late, late_input) = hold(part), hold(h - part)
    body, past = len(late), whole + (part > 0)
    F = [[Fraction(0)] * (body + past) for _ in range(body + past)]
    G = [[Fraction(0)] for _ in range(body + past)]
    whole_step, carried = product(late, early), product(late, early_input)
    for i in range(body):
        F[i][:body] = whole_step[i]
        for ago, weight in ((whole, late_input[i][0]), (whole + 1, carried[i][0] if part > 0 else Fraction(0))):
            if ago == 0:
                G[i][0] += weight
            elif weight:
                F[i][body + ago - 1] += weight
    for i in range(past):
        if i == 0:
            G[body][0] = Fraction(1)
        else:
            F[body + i][body + i - 1] = Fraction(1)
    return F, G


def proved(certificate: Certificate) -> dict[str, bool]:
    """Every inequality of the certificate, and whether it holds."""
    limits, ball, level = certificate.limits, number(certificate.ball), number(certificate.level)
    g, tilt = number(limits.gravity), number(limits.tilt_max)
    room = min(g * (sine(tilt) - _TINY), number(limits.thrust_max) - g, g - number(limits.thrust_min))
    results = {
        "ball in V_c": ball <= room**2,
        "gains": 0 < certificate.gain_min <= 1 <= certificate.gain_max,
    }
    for axis, (block, loop) in enumerate(zip(certificate.blocks, certificate.loops, strict=True)):
        P, W = rational(block), rational(loop)
        for name, holds in (
            *_lyapunov(P, number(certificate.rate)),
            ("level", level * _slope(P, P) <= ball),
            ("level of the loop", level * _slope(W, P) <= ball),
            *(_held(certificate, P) if certificate.timing.immediate else _delayed(certificate, P, W)),
        ):
            results[f"{name}, axis {axis}"] = holds
    if certificate.robust is not None:
        results |= dict(_robust(certificate, certificate.robust))
    return results


def _slope(metric: Matrix, P: Matrix) -> Fraction:
    row = [[*P[1], *[Fraction(0)] * (len(metric) - 2)]]
    return product(row, inverse(metric), transposed(row))[0][0]


def _lyapunov(P: Matrix, rate: Fraction) -> Iterator[tuple[str, bool]]:
    A = [[Fraction(0), Fraction(1)], [Fraction(0), Fraction(0)]]
    column = [[P[0][1]], [P[1][1]]]
    terms = (1, product(transposed(A), P)), (1, product(P, A)), (-2, product(column, transposed(column))), (rate, P)
    yield "P > 0", positive(P, strictly=True)
    yield "decay", positive(combined(*((-factor, matrix) for factor, matrix in terms)))


def _held(certificate: Certificate, P: Matrix) -> Iterator[tuple[str, bool]]:
    """S(t)/t <= 0 within a period, in the Bernstein basis of each of eight pieces."""
    h, pieces = number(certificate.period), 8
    A = [[Fraction(0), Fraction(1)], [Fraction(0), Fraction(0)]]
    for name in ("gain_min", "gain_max"):
        B = [[Fraction(0)] * 2, [number(getattr(certificate, name)) * entry for entry in P[1]]]
        m1, m2 = combined((1, A), (-1, B)), combined((Fraction(-1, 2), product(A, B)))
        t1, t2 = transposed(m1), transposed(m2)
        powers = [
            combined((h, product(t1, P)), (h, product(P, m1))),
            combined((h**2, product(t2, P)), (h**2, product(t1, P, m1)), (h**2, product(P, m2))),
            combined((h**3, product(t2, P, m1)), (h**3, product(t1, P, m2))),
            combined((h**4, product(t2, P, m2))),
        ]
        holds = True
        for piece in range(pieces):
            start, width = Fraction(piece, pieces), Fraction(1, pieces)
            shifted = [
                combined(*((math.comb(i, j) * start ** (i - j) * width**j, powers[i]) for i in range(j, 4)))
                for j in range(4)
            ]
            for i in range(4):
                terms = [(Fraction(math.comb(i, j), math.comb(3, j)), shifted[j]) for j in range(i + 1)]
                holds &= positive(combined(*((-factor, matrix) for factor, matrix in terms)))
        yield f"hold at {name}", holds


def _delayed(certificate: Certificate, P: Matrix, W: Matrix) -> Iterator[tuple[str, bool]]:
    """W falls, with more left over than the enclosures of F and G can take away."""
    F, G = transition(certificate)
    row = [[*P[1], *[Fraction(0)] * (len(W) - 2)]]
    yield "W > 0", positive(W, strictly=True)
    for name in ("gain_min", "gain_max"):
        gain = number(getattr(certificate, name))
        M = combined((1, F), (-gain, product(G, row)))
        # |M - true M| <= delta entry by entry, so |z'(M'WM - true)z| <= (2 n |M| delta + delta^2 n) n |W| |z|^2
        largest = [max(abs(entry) for line in matrix for entry in line) for matrix in (M, W, row)]
        times = 1 + number(certificate.period) + number(certificate.lag)
        delta = 10 * _TINY * times**2 * (1 + gain * largest[2])
        left = 3 * len(W) ** 3 * (largest[0] + 1) * delta * largest[1]
        yield (
            f"W falls at {name}",
            positive(combined((1, W), (-1, product(transposed(M), W, M)), (-left, identity(len(W))))),
        )


def _robust(certificate: Certificate, robust: Robust) -> Iterator[tuple[str, bool]]:
    limits, box = certificate.limits, [number(width) for width in robust.box]
    g, tilt = number(limits.gravity), number(limits.tilt_max)
    least_tan = (sine(tilt) - _TINY) / (cosine(tilt) + _TINY)
    yield "box in the cone", 2 * box[0] ** 2 <= (least_tan * (g - box[1])) ** 2
    yield "box in the ball", 2 * box[0] ** 2 + (g + box[1]) ** 2 <= number(limits.thrust_max) ** 2
    yield "box above the floor", box[1] <= g - number(limits.thrust_min)
    yield "s <= eps", robust.floor <= certificate.level
    h, rate, share = number(certificate.period), number(robust.rate), number(robust.share)
    A = [[Fraction(0), Fraction(1)], [Fraction(0), Fraction(0)]]
    F, G = transition(certificate)
    assert certificate.timing.immediate
    for axis, block in enumerate(certificate.blocks):
        P = rational(block)
        Q = inverse(P)
        e, m = number(robust.drift[axis]) ** 2, number(robust.push[axis]) ** 2
        fixed: Matrix = [[e / rate, Fraction(0)], [Fraction(0), m / rate - 2]]
        terms = (1, product(A, Q)), (1, product(Q, transposed(A))), (rate, Q), (1, fixed)
        yield (
            f"robust, axis {axis}",
            positive(combined(*((-factor, matrix) for factor, matrix in terms))),
        )
        yield f"v0 in the box, axis {axis}", P[1][1] <= box[axis] ** 2
        gathered = [[h * (e * h + m * h**3 / 3), h * m * h**2 / 2], [h * m * h**2 / 2, h * m * h]]
        for name in ("gain_min", "gain_max"):
            M = combined((1, F), (-number(getattr(certificate, name)), product(G, [P[1]])))
            grown = (1 / (1 - share), product(M, Q, transposed(M))), (1 / (share * number(robust.floor)), gathered)
            yield (
                f"V <= max(V, s) at {name}, axis {axis}",
                positive(combined((1, Q), *((-factor, matrix) for factor, matrix in grown))),
            )

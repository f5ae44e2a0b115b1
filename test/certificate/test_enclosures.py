"""Enclosures hold what they say, in rational arithmetic, and what forgets to round outwards is found out."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.certificate import answers as sums
from flatsat_ros.certificate import enclosures
from flatsat_ros.certificate.answers import AnsweringLoops, answers
from flatsat_ros.certificate.enclosures import Enclosure, decimal, exponential, exponential_above, sine, upper
from flatsat_ros.certificate.running_sums import implied

seeds = st.integers(0, 2**32 - 1)


def exact(array: np.ndarray) -> np.ndarray:
    """The same numbers as fractions."""
    return np.array([Fraction(value) for value in array.ravel().tolist()], dtype=object).reshape(array.shape)


def some(random: np.random.Generator, *shape: int) -> tuple[Enclosure, np.ndarray]:
    """An enclosure, and numbers in it: as often as not at its ends."""
    mid = random.standard_normal(shape) * 10.0 ** random.integers(-3, 4, shape)
    rad = np.abs(mid) * random.choice([0.0, 1e-12, 1e-3], shape)
    share = exact(random.choice([-1.0, 0.25, 1.0], shape))
    return Enclosure(mid, rad), exact(mid) + share * exact(rad)


def within(enclosure: Enclosure, true: np.ndarray) -> bool:
    return bool((abs(exact(enclosure.mid) - true) <= exact(enclosure.rad)).all())


def sums_hold(seed: int) -> bool:
    """Operations on a few random arrays."""
    random = np.random.default_rng(seed)
    (a, x), (b, y), (c, z) = (some(random, *shape) for shape in ((3, 4), (3, 4), (4, 2)))
    k = int(random.integers(1, 20))
    pairs = [
        (a + b, x + y),
        (a - b, x - y),
        (2.5 - a, Fraction(5, 2) - x),
        (a * b, x * y),
        (a / k, x / k),
        (a @ c, x @ z),
    ]
    pairs += [(b.mid @ c, exact(b.mid) @ z), (a * 0.1, x * Fraction(0.1)), (-a[1:, :2], -x[1:, :2])]
    # of numbers about 0 the radii are all there is
    a, b = (Enclosure(np.zeros_like(one.mid), np.abs(one.mid)) for one in (a, b))
    x, y = exact(a.rad), exact(b.rad)
    pairs += [(a + b, x + y), (a * b, x * y), (a / k, x / k), (a @ c.mid, x @ abs(exact(c.mid)))]
    return all(within(found, true) for found, true in pairs)


@given(seed=seeds)
def test_what_operations_make_of_numbers_is_in_what_they_make_of_enclosures(seed: int) -> None:
    assert sums_hold(seed)


@settings(max_examples=10)
@given(seed=seeds, scale=st.floats(1e-3, 2.0))
def test_the_exponential_is_enclosed(seed: int, scale: float) -> None:
    matrix = scale * np.random.default_rng(seed).uniform(-1.0, 1.0, (3, 3))
    true, term = exact(np.eye(3)), exact(np.eye(3))
    for order in range(1, 50):
        term = term @ exact(matrix) / order
        true = true + term
    found = exponential(Enclosure(matrix))
    assert within(Enclosure(found.mid, found.rad + 1e-18), true)  # of the series that is compared with, the rest
    assert found.rad.max() <= 1e-9 * np.abs(found.mid).max()


@given(value=st.floats(1e-6, 1.5))
def test_scalars_are_on_the_safe_side_and_close(value: float) -> None:
    x = decimal(value)
    assert Fraction(upper(x)) > x
    assert exponential_above(x) == pytest.approx(math.exp(value), rel=1e-10)
    assert Fraction(exponential_above(x)) > sum(x**i / math.factorial(i) for i in range(40))
    assert float(sine(x)) == pytest.approx(math.sin(value), rel=1e-12)
    assert sine(x) < sum((-1) ** i * x ** (2 * i + 1) / math.factorial(2 * i + 1) for i in range(30))


def loop_holds(seed: int, forgets: bool, coarse: bool = False) -> bool:
    """Whether bounds are not below what a loop answers in rational arithmetic, and not far above."""
    random = np.random.default_rng(seed)
    n = 3
    A, B, C = (random.standard_normal(shape) for shape in ((n, n), (n, 2), (1, n)))
    step, kick, start = random.standard_normal((1, n, n)), random.standard_normal((1, n, 1)), np.eye(n)[:, :1]
    if forgets:  # after n periods, so that nothing is left but what rounding does
        A, step = np.triu(A, 1), np.triu(step, 1)
    else:
        A, step = 0.5 * A / np.abs(np.linalg.eigvals(A)).max(), 0.1 * step
    vertices = np.array([[0.3], [-0.3]])
    factors = (1.0, 1.125)  # without a last digit that is lost
    loops = AnsweringLoops(
        Enclosure(A[None]),
        Enclosure(B[None]),
        Enclosure(start[None]),
        Enclosure(np.stack([C[0], C[0]])[None]),  # followed, and for itself alone
        Enclosure(step[None]),
        Enclosure(kick[None]),
        vertices[None],
    )
    found = answers(loops, factors, plain=1, coarse=coarse)
    if not all(np.isfinite(part.sums).all() for part in found):
        return not forgets
    pairs = []
    for part, factor in zip(found, map(Fraction, factors), strict=True):
        power, slope = exact(np.eye(n)), exact(np.zeros((n, n)))
        total, bent, peak, moved_peak = exact(np.zeros((1, 2))), exact(np.zeros(2)), Fraction(0), exact(np.zeros(2))
        for _ in range(n if forgets else 16):
            total = total + abs(exact(C) @ power @ exact(B)) * factor
            peak = max(peak, abs(exact(C) @ power @ exact(start))[0, 0])
            for i, share in enumerate(exact(vertices)[:, 0]):
                turned = slope @ exact(B)[:, :1] + power @ exact(kick[0])
                bent[i] += abs(exact(C) @ (power @ exact(B)[:, :1] + share * turned))[0, 0] * factor
                moved_peak[i] = max(moved_peak[i], abs(exact(C) @ (power + share * slope) @ exact(start))[0, 0])
            power, slope = factor * power @ exact(A), factor * (slope @ exact(A) + power @ exact(step[0]))
        pairs += [(part.sums[0, :1], total), (part.sums[0, 1:], total), (part.vertex_sums[0, :, 0, 0], bent)]
    # of starts they are those for the last factor
    pairs += [(part.peaks[0], exact(np.zeros((2, 1))) + peak), (part.vertex_peaks[0, :, 0, 0], moved_peak)]
    assert not np.isfinite(found[0].peaks).any()
    above = Fraction(1, 4 if coarse else 100)
    assert all((exact(bound) <= (1 + above) * true + Fraction(1, 10**9)).all() for bound, true in pairs)
    return all(bool((exact(bound) >= true).all()) for bound, true in pairs)


@settings(max_examples=20)
@given(seed=seeds, forgets=st.booleans(), coarse=st.booleans())
def test_no_loop_answers_more_than_its_bounds(seed: int, forgets: bool, coarse: bool) -> None:
    assert loop_holds(seed, forgets, coarse)


@settings(max_examples=6, deadline=None)
@given(seed=seeds, coarse=st.booleans())
def test_nor_does_one_that_remembers_for_many_chunks(seed: int, coarse: bool) -> None:
    random, turn = np.random.default_rng(seed), 0.1
    A = 0.96 * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    A, B, C, step = (np.round(part * 256.0) / 256.0 for part in (A, *random.uniform(-1.0, 1.0, (3, 2, 2))))
    step, kick, vertices = step / 64.0, B[:, :1], np.array([[[0.5], [-0.5]]])
    none = Enclosure(np.zeros((1, 2, 0)))
    given_parts = (Enclosure(part) for part in (A[None], B[None], C[None], step[None, None], kick[None, None]))
    loop, inputs, signals, steps, kicks = given_parts
    loops = AnsweringLoops(loop, inputs, none, signals, steps, kicks, vertices)
    found = answers(loops, (1.0, 1.0078125), coarse=coarse)
    factor, grown = Fraction(1.0078125), Fraction(1)
    x, dx = exact(B), exact(kick)
    total, more, bent = exact(np.zeros((2, 2))), exact(np.zeros((2, 2))), exact(np.zeros((2, 2)))
    for _ in range(250):
        grown = grown * factor
        y, dy = abs(exact(C) @ x), exact(C) @ dx
        total, more = total + y, more + grown * y
        bent = bent + abs(exact(C) @ x[:, :1] + dy * exact(np.array([[0.5, -0.5]])))
        x, dx = exact(A) @ x, exact(A) @ dx + exact(step) @ x[:, :1]
    pairs = [(found[0].sums[0], total), (found[1].sums[0], more), (found[0].vertex_sums[0, :, :, 0].T, bent)]
    for bound, true in pairs:
        assert (exact(bound) >= true).all()
        assert (exact(bound) <= true * (Fraction(3, 2) if coarse else Fraction(101, 100))).all()


@given(seed=seeds, size=st.floats(0.0, 2.0))
def test_sums_of_the_state_are_above_what_they_imply_or_nothing_is_claimed(seed: int, size: float) -> None:
    random = np.random.default_rng(seed)
    q, summed = random.uniform(size=(1, 3, 3)), random.uniform(size=(1, 3, 2))
    q *= size / np.abs(np.linalg.eigvals(q[0])).max()
    bound, shown = implied(summed, q)
    if shown[0]:
        assert (exact(summed[0]) + exact(q[0]) @ exact(bound[0]) < exact(bound[0])).all()
    assert shown[0] == (size < 0.7) or 0.7 <= size < 1.0


@pytest.mark.parametrize("name", ["ROUNDING", "UP", "rounding"])
def test_without_its_rounding_each_check_fails(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is dropped is one by one the share of sums, what enlarges radii, and the share of inner products."""
    if name == "rounding":
        monkeypatch.setattr(enclosures, name, lambda _: 0.0)
        monkeypatch.setattr(sums, name, lambda _: 0.0)
        monkeypatch.setattr(sums, "UP", 1.0)
        assert not all(loop_holds(seed, forgets=True) for seed in range(40))
    else:
        monkeypatch.setattr(enclosures, name, 0.0 if name == "ROUNDING" else 1.0)
    assert not all(sums_hold(seed) for seed in range(40))

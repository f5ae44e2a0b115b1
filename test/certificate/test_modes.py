"""Coordinates in which loops fade mode by mode: inverses are enclosed, coarse bounds are above close ones by little."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.certificate import answers as sums
from flatsat_ros.certificate.answers import AnsweringLoops, Answers, answers
from flatsat_ros.certificate.enclosures import Enclosure
from flatsat_ros.certificate.modes import inverse, modes_of

seeds = st.integers(0, 2**32 - 1)


def exact_inverse(matrix: np.ndarray) -> np.ndarray:
    """The inverse of a matrix of floats, in fractions."""
    n = len(matrix)
    rows = np.array([[Fraction(x) for x in row] for row in np.hstack([matrix, np.eye(n)]).tolist()], dtype=object)
    for i in range(n):
        pivot = i + int(np.argmax([abs(x) for x in rows[i:, i]]))
        rows[[i, pivot]] = rows[[pivot, i]]
        rows[i] = rows[i] / rows[i, i]
        for j in set(range(n)) - {i}:
            rows[j] = rows[j] - rows[j, i] * rows[i]
    return rows[:, n:]


@given(seed=seeds, closeness=st.sampled_from([1.0, 1e-3, 1e-6]))
def test_inverses_are_enclosed(seed: int, closeness: float) -> None:
    random = np.random.default_rng(seed)
    matrix = random.standard_normal((4, 4))
    matrix[3] = matrix[2] + closeness * matrix[3]  # rows that are nearly the same
    found, true = inverse(matrix[None]), exact_inverse(matrix)
    wrong = abs(np.array([[Fraction(x) for x in row] for row in found.mid[0].tolist()]) - true)
    assert all(w <= Fraction(r) for w, r in zip(wrong.ravel(), found.rad[0].ravel().tolist(), strict=True))
    assert found.rad.max() <= 1e-9 / closeness * np.abs(found.mid).max()


def test_of_a_matrix_without_an_inverse_nothing_is_known() -> None:
    for entry in (1.0, np.nan, np.inf):
        with np.errstate(invalid="ignore"):
            assert np.isinf(inverse(np.full((1, 3, 3), entry)).rad).all()


def turning(random: np.random.Generator, sizes: list[float]) -> np.ndarray:
    """A loop of a pair of modes that turn and others, in coordinates of no meaning."""
    A = np.diag(sizes)
    A[:2, :2] = sizes[0] * np.array([[np.cos(0.05), -np.sin(0.05)], [np.sin(0.05), np.cos(0.05)]])
    T = random.standard_normal(A.shape)
    return T @ A @ np.linalg.inv(T)


@given(seed=seeds)
def test_slow_modes_are_told_from_each_other_and_from_the_rest(seed: int) -> None:
    A = turning(np.random.default_rng(seed), [0.99, 0.99, 0.97, 0.3, 0.0])
    G, slowest = modes_of(A[None])
    own = np.linalg.solve(G[0], A @ G[0])
    assert slowest[0] == pytest.approx(0.99)
    np.testing.assert_allclose(own[:2, 2:], 0.0, atol=1e-6)
    np.testing.assert_allclose(own[2, [0, 1, 3, 4]], 0.0, atol=1e-6)
    np.testing.assert_allclose(own[3:, :3], 0.0, atol=1e-6)
    np.testing.assert_allclose(G[0][:, 3:].T @ G[0][:, 3:], np.eye(2), atol=1e-12)


def test_where_numbers_overflow_coordinates_are_what_they_were() -> None:
    G, slowest = modes_of(np.full((1, 3, 3), np.inf))
    np.testing.assert_array_equal(G[0], np.eye(3))
    assert slowest == 1.0


def found(A: np.ndarray, random: np.random.Generator, coarse: bool) -> list[Answers]:
    """Bounds of a loop whose step changes with a parameter, at two factors."""
    n = len(A)
    B, C = random.standard_normal((1, n, 3)), random.standard_normal((1, 2, n))
    step, kick = 1e-3 * random.standard_normal((1, 1, n, n)), random.standard_normal((1, 1, n, 2))
    start, vertices = np.eye(n)[None, :, :1], np.array([[[0.3], [-0.3]]])
    given = (Enclosure(part) for part in (A[None], B, start, C, step, kick))
    return answers(AnsweringLoops(*given, vertices), (1.0, 1.005), 1, coarse)


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_coarse_bounds_are_above_close_ones_by_little(seed: int) -> None:
    A = turning(np.random.default_rng(seed), [0.98, 0.98, 0.95, 0.3, 0.0])
    coarse, close = (found(A, np.random.default_rng(seed), each) for each in (True, False))
    for above, below in zip(coarse, close, strict=True):
        for name in ("sums", "vertex_sums", "peaks", "vertex_peaks"):
            more, less = getattr(above, name), getattr(below, name)
            assert (more >= less * (1.0 - 1e-3)).all()  # close ones are above what loops answer, too
            assert (more[np.isfinite(less)] <= 1.5 * less[np.isfinite(less)]).all()


def test_of_loops_that_grow_or_hardly_fade_there_are_no_coarse_bounds_or_true_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    random = np.random.default_rng(0)
    for size in (1.01, 1.0):
        bounds = found(turning(random, [size, size, 0.5]), random, coarse=True)
        assert all(np.isinf(part.sums).all() for part in bounds)
    # what is not close after the last chunk is as it is
    monkeypatch.setattr(sums, "_CHUNKS_MAX", 2)
    A = turning(random, [0.985, 0.985, 0.5])
    seed = np.random.default_rng
    few, close = (found(A, seed(1), coarse)[0].sums for coarse in (True, False))
    assert (few >= close * (1.0 - 1e-3)).all()
    assert few.max() > 1.5 * close.max()

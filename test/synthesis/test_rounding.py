"""Figures on the safe side: never better than what was proved, and the same whatever the last digits were."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.synthesis.rounding import DIGITS, MATRIX_DIGITS, round_down, round_matrix, round_up

values = st.floats(-6.0, 6.0).map(lambda exponent: 10.0**exponent)


@given(value=values)
def test_a_figure_is_on_the_safe_side_and_close(value: float) -> None:
    down, up = round_down(value), round_up(value)
    assert down <= value * (1.0 + 1e-14)
    assert up >= value * (1.0 - 1e-14)
    assert 0.0 <= up - down <= 10.0 ** (1 - DIGITS) * value


@given(value=values, digits=st.integers(2, DIGITS), noise=st.floats(-4e-15, 4e-15))
def test_the_last_digits_of_a_decimal_figure_do_not_matter(value: float, digits: int, noise: float) -> None:
    figure = float(f"{value:.{digits - 1}e}")
    assert round_down(figure * (1.0 + noise)) == figure == round_up(figure * (1.0 + noise))


@pytest.mark.parametrize(
    ("value", "down", "up"),
    [
        (3.2699999999999996, 3.27, 3.27),
        (2.901873488392621, 2.9018734883, 2.9018734884),
        (0.999999999999, 0.99999999999, 1.0),
        (16.53875906934, 16.538759069, 16.53875907),
    ],
)
def test_figures_come_out_as_written_by_hand(value: float, down: float, up: float) -> None:
    assert (round_down(value), round_up(value)) == (down, up)


@given(seed=st.integers(0, 2**32 - 1), size=st.integers(1, 6), spread=st.floats(0.0, 4.0))
def test_a_matrix_stays_symmetric_and_close_and_loses_its_last_digits(seed: int, size: int, spread: float) -> None:
    random = np.random.default_rng(seed)
    root = random.standard_normal((size, size)) * 10.0 ** random.uniform(-spread, 0.0, size)
    matrix = root.T @ root
    matrix = (matrix + matrix.T) / 2.0
    rounded = round_matrix(matrix)
    np.testing.assert_array_equal(rounded, rounded.T)
    scale = np.sqrt(np.outer(np.diag(matrix), np.diag(matrix)))
    assert (np.abs(rounded - matrix) <= 0.5 * 10.0 ** (1 - MATRIX_DIGITS) * scale * (1.0 + 1e-9)).all()
    np.testing.assert_array_equal(round_matrix(rounded), rounded)

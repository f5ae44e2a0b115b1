"""Offset-free flight on the identified Crazyflie, as `make bench` reports it: 50 Hz, mu = 2, swaps with legs of 4 s."""

from __future__ import annotations

import pytest

from flatsat_ros.paper import offset_free


@pytest.mark.parametrize(("vehicle", "trouble"), [("cf21", 0), ("cf21_plus", 1), ("cf21", 2), ("cf21_plus", 2)])
def test_a_steady_error_below_one_centimetre_and_a_swap_below_four(vehicle: str, trouble: int) -> None:
    flown = offset_free.swap(vehicle, offset_free.TROUBLES[trouble], offset_free.OFFSET_FREE)
    assert flown.hover < 0.01
    assert flown.swap < 0.04
    assert flown.within


def test_without_it_the_papers_law_hangs_low_and_lags_behind() -> None:
    flown = offset_free.swap("cf21", offset_free.TROUBLES[0], offset_free.PAPER)
    assert flown.hover > 0.10
    assert flown.swap == pytest.approx(0.2, abs=0.1)
    assert flown.within


@pytest.mark.parametrize("trouble", range(2))
def test_a_thrust_that_is_far_wrong_is_estimated(trouble: int) -> None:
    far = offset_free.TOO_MUCH[trouble]
    flown = offset_free.swap("cf21", far, offset_free.ESTIMATING)
    assert flown.hover < 0.01
    assert flown.swap < 0.04
    assert flown.within


def test_a_thrust_that_is_far_wrong_is_too_much_to_be_compensated_without() -> None:
    assert offset_free.swap("cf21", offset_free.TOO_MUCH[0], offset_free.OFFSET_FREE).hover > 0.05

"""Offset-free flight on the identified Crazyflie, as `make bench` reports it: 50 Hz, mu = 2, swaps with legs of 4 s."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="module")
def offset(root: Path) -> ModuleType:
    """The bench's own flights."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(root / "bench")
        import offset

        yield offset
        sys.modules.pop("offset")


@pytest.mark.parametrize("trouble", range(3))
@pytest.mark.parametrize("vehicle", ["cf21", "cf21_plus"])
def test_a_steady_error_below_one_centimetre_and_a_swap_below_four(
    offset: ModuleType, vehicle: str, trouble: int
) -> None:
    flown = offset.swap(vehicle, offset.TROUBLES[trouble], offset.OFFSET_FREE)
    assert flown.hover < 0.01
    assert flown.swap < 0.04
    assert flown.within


def test_without_it_the_papers_law_hangs_low_and_lags_behind(offset: ModuleType) -> None:
    flown = offset.swap("cf21", offset.TROUBLES[0], offset.PAPER)
    assert flown.hover > 0.10
    assert flown.swap == pytest.approx(0.2, abs=0.1)
    assert flown.within


@pytest.mark.parametrize("trouble", range(2))
def test_a_thrust_that_is_far_wrong_is_estimated(offset: ModuleType, trouble: int) -> None:
    far = offset.TOO_MUCH[trouble]
    assert offset.swap("cf21", far, offset.OFFSET_FREE).hover > 0.05
    flown = offset.swap("cf21", far, offset.ESTIMATING)
    assert flown.hover < 0.01
    assert flown.swap < 0.04
    assert flown.within

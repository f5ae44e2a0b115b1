"""Splines through way-points: they pass them when they should, and what cannot be flown through is refused."""

from __future__ import annotations

import numpy as np
import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.planning.spline import spline_through

PLACES = np.array([[0.0, 0.0, 1.0], [1.0, 0.5, 1.5], [2.0, -0.5, 1.0]])


def test_the_path_passes_every_way_point_in_time_and_rests_at_both_ends() -> None:
    path = spline_through(PLACES, 2.0, 0.3)
    for number, place in enumerate(PLACES):
        assert path.sample(2.0 * number)[:3] == pytest.approx(place, abs=1e-9)
    assert path.sample(0.0)[3:] == pytest.approx(np.zeros(6))
    assert path.sample(4.0)[3:] == pytest.approx(np.zeros(6))
    assert path.yaw == 0.3


@pytest.mark.parametrize("farthest", [1.7e308, -1e160, 1.1e12])
def test_way_points_beyond_all_numbers_are_refused(farthest: float) -> None:
    with pytest.raises(FlatsatError, match=r"an entry of waypoints = .* m: must be within 1e.12 m"):
        spline_through(PLACES + [[0.0, 0.0, 0.0], [farthest, 0.0, 0.0], [-farthest, 0.0, 0.0]], 1.0)

"""The thrust scale is what makes the commanded thrust of a hover equal to gravity."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.identification.hover import thrust_scale


def hover(scale: float, tilt: float = 0.0, noise: float = 0.0, count: int = 200, estimated: float = 1.0) -> np.ndarray:
    """Telemetry of a hover with motors that give `scale` of what they should, a part of which was estimated already."""
    rows = np.zeros((count, len(FIELDS)))
    rows[:, FIELDS.index("mode")] = Mode.FLY
    rows[:, FIELDS.index("phi")] = tilt
    rows[:, FIELDS.index("thrust_scale")] = estimated
    thrust = GRAVITY / scale * estimated / np.cos(tilt) + noise * np.random.default_rng(0).normal(size=count)
    rows[:, FIELDS.index("T")] = thrust
    return rows


@given(scale=st.floats(0.5, 1.5), tilt=st.floats(-0.1, 0.1), estimated=st.floats(0.5, 1.5))
def test_the_scale_is_recovered_whatever_the_controller_has_estimated_already(
    scale: float, tilt: float, estimated: float
) -> None:
    assert thrust_scale(hover(scale, tilt, estimated=estimated), GRAVITY)[0] == pytest.approx(scale, rel=1e-12)


def test_the_standard_error_covers_the_noise() -> None:
    scale, error = thrust_scale(hover(0.95, noise=0.3, count=1000), GRAVITY)
    assert error == pytest.approx(0.95**2 / GRAVITY * 0.3 / np.sqrt(1000), rel=0.1)
    assert abs(scale - 0.95) < 4.0 * error


def test_what_is_no_hover_is_refused() -> None:
    moving, landed = hover(1.0), hover(1.0)
    moving[:, FIELDS.index("error_vx")] = 0.16
    landed[7, FIELDS.index("mode")] = Mode.REST
    with pytest.raises(FlatsatError, match=r"mean velocity = 0\.16.* m/s: must be at most 0\.15 m/s"):
        thrust_scale(moving, GRAVITY)
    with pytest.raises(FlatsatError, match="did not fly all the time"):
        thrust_scale(landed, GRAVITY)
    with pytest.raises(FlatsatError, match="must be"):
        thrust_scale(hover(1.0, count=5), GRAVITY)

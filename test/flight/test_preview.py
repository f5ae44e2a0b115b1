"""What references ask the law for, and that it is this of which a flight certificate needs the margin."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from flatsat_ros.base.resources import config_path
from flatsat_ros.base.strict_yaml import read_yaml
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight import FlightSection
from flatsat_ros.flight.path import path_to
from flatsat_ros.flight.path_limits import Demand, PathLimits, ReferenceBox
from flatsat_ros.flight.preview import Preview, needed_margin
from flatsat_ros.flight.references import References
from flatsat_ros.flight.trajectory import Trajectory

# not proved again here
CERTIFICATE, TIGHT = (
    Certificate.from_document(read_yaml(config_path(name))) for name in ("cf21_adaptive_50hz", "cf21_tight_50hz")
)
LIMITS = CERTIFICATE.limits
BOX = ReferenceBox(np.array([-90.0, -90.0, -9.0]), np.array([90.0, 90.0, 90.0]))


def flight_of(certificate: Certificate) -> FlightSection:
    assert certificate.flight is not None
    return certificate.flight


FLIGHT = flight_of(CERTIFICATE)


def asked(path: Trajectory, flight: FlightSection, times: np.ndarray) -> np.ndarray:
    """F (N, 3), m/s^2, of commands at some times, as it is flown."""
    references = References(1, LIMITS.inner_radius)
    references.assign(0, path, 1.0)
    references.sample(float(path.times[0]))
    preview = Preview(references, flight.horizontal.design, flight.vertical.design)
    return np.array([preview.needed(float(t))[0] for t in times])


moves = st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(-2.0, 9.0)).map(np.array)


@given(goal=moves, fast=st.floats(0.3, 2.5), hard=st.floats(0.2, 1.5))
@settings(max_examples=30)
def test_no_command_is_nearer_to_the_limits_than_the_margin(goal: np.ndarray, fast: float, hard: float) -> None:
    path = path_to(np.zeros((4, 3)), goal, 1.0, PathLimits(Demand(hard), Demand(hard), fast), BOX)
    assume(path.times.size > 1)
    bound = needed_margin(path, LIMITS, FLIGHT)
    f = asked(path, FLIGHT, np.linspace(0.5, path.times[-1] + 0.5, 400))
    nearest = float(FLIGHT.room(LIMITS).margin(f).min())
    assert nearest - 0.1 <= bound <= nearest + 1e-9


def test_a_reference_whose_acceleration_has_the_margin_may_ask_for_more_than_the_law_has() -> None:
    """What was accepted before: within the claims there is a command outside the input set, a gain below 1."""
    lively = PathLimits(Demand(0.7), Demand(0.2), 2.7, 0.85, 4.5)
    path = path_to(np.zeros((4, 3)), np.array([60.0, 0.0, 0.0]), 0.0, lively, BOX)
    demand = path.demand()
    assert FLIGHT.demanded(demand, path.margin(FLIGHT.room(LIMITS)).distance) <= 1.0
    assert FLIGHT.demanded(demand, needed_margin(path, LIMITS, FLIGHT)) > 1.0
    f = asked(path, FLIGHT, np.linspace(0.0, path.times[-1], 1000))
    sides, upright = (axis.tube for axis in FLIGHT.axes)
    out = np.array([np.cos(LIMITS.tilt_max), 0.0, -np.sin(LIMITS.tilt_max)])
    disturbance = -FLIGHT.disturbance * out
    wrong = np.array([sides.disturbance, 0.0, -upright.disturbance])
    gains = LIMITS.exit_factor(f - disturbance + wrong, np.array([sides.nominal, 0.0, -upright.nominal]))
    assert gains.min() < 0.95


@pytest.mark.parametrize("certificate", [CERTIFICATE, TIGHT], ids=lambda each: each.name)
@given(goal=moves, second=moves, when=st.floats(0.0, 1.0))
@settings(max_examples=25)
def test_paths_ask_for_no_more_than_the_certificate_assumes(
    certificate: Certificate, goal: np.ndarray, second: np.ndarray, when: float
) -> None:
    flight, limits = flight_of(certificate), certificate.limits
    bounds = PathLimits.assumed(limits, 1.0, flight)
    path = path_to(np.zeros((4, 3)), goal, 0.0, bounds, BOX)
    assert flight.demanded(path.demand(), needed_margin(path, limits, flight)) <= 1.0
    t = when * float(path.times[-1])
    motion = np.concatenate([path.sample(t).reshape(3, 3), path.jerk(t)[np.newaxis]])
    assert bounds.led_to(motion)

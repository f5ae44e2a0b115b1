"""Stored designs and what is made of them: the law's matrix, the wishes, and the packaged certificates' inputs."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.strict_yaml import read_yaml, write_yaml
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_loop import FlightLoop
from flatsat_ros.certificate.flight_plant import Design, Plant
from flatsat_ros.certificate.flight_tube import Assumptions
from flatsat_ros.certificate.lyapunov import decay_residual
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.synthesis.flight_design import FlightDesign, ideal_block, read_designs
from flatsat_ros.synthesis.flight_search import Goal, command_noise, corner_boxes, observer, search
from flatsat_ros.synthesis.flight_trade import require_tilt, sentence, trade
from flatsat_ros.synthesis.flight_wishes import STILL, Plants, assumed, sides, upright

CONFIG = Path(__file__).parents[2] / "config"
DESIGNS = read_designs(CONFIG / "designs" / "flight.yaml")
VEHICLES = ("brushless", "cf21", "cf21_markers", "cf21_markers_light", "cf21_plus", "cf2x_2025", "thrust_kit")


@given(rate=st.floats(0.5, 50.0), share=st.floats(0.02, 0.95))
@settings(max_examples=30)
def test_the_law_has_the_fastest_certified_decay_that_its_gains_allow(rate: float, share: float) -> None:
    stiffness = share * rate * rate
    alpha, block = ideal_block(stiffness, rate)
    assert (block[1] == [stiffness, rate]).all()
    assert np.linalg.eigvalsh(block)[0] > 0.0
    assert decay_residual(block, alpha) <= 1e-9
    # no other corner of P makes it faster
    for corner in np.linspace(0.5, 2.0, 16) * block[0, 0]:
        other = np.array([[corner, stiffness], [stiffness, rate]])
        assert np.linalg.det(other) <= 0.0 or decay_residual(other, 1.001 * alpha) > 0.0


def test_gains_without_such_a_matrix_are_refused() -> None:
    with pytest.raises(FlatsatError, match=r"stiffness = 4\.0 1/s\^2: must be below the square of the rate, 4"):
        ideal_block(4.0, 2.0)


@pytest.mark.parametrize("name", DESIGNS)
def test_what_is_packaged_is_what_the_stored_design_says(name: str) -> None:
    vehicle, design = DESIGNS[name]
    certificate = Certificate.from_document(read_yaml(CONFIG / f"{name}.yaml"))
    flight = certificate.flight
    assert flight is not None
    assert certificate.limits == design.limits
    assert certificate.limits.thrust_max <= load_vehicle(vehicle).thrust_max
    for key in ("gain_max", "margin", "disturbance", "assumptions"):
        assert getattr(flight, key) == getattr(design, key)
    for axis, stored in zip(flight.axes, (design.horizontal, design.vertical), strict=True):
        assert (axis.box, axis.lag_varies, axis.design) == (stored.box, stored.lag_varies, stored.design)
        assert axis.back.rate == design.return_rate
    assert f"stays within {100.0 * flight.horizontal.tube.position:.1f} cm horizontally" in sentence(certificate)


def test_a_small_design_becomes_a_certificate_that_verifies(tmp_path: Path) -> None:
    document = read_yaml(CONFIG / "designs" / "flight.yaml")["cf21_flight_50hz"]
    document.pop("vehicle")
    document["gain_max"], document["assumptions"]["pose_age"] = 1.5, 0.004
    document["return_rate"] = 20.0  # faster than the loop: what is shown is slower
    for axis in ("horizontal", "vertical"):
        document[axis]["excess"] = 1.0
        document[axis]["low"] = dict(document[axis]["high"], delay=document[axis]["high"]["delay"] - 1e-4)
    certificate = FlightDesign.from_document("small", document).certificate("small", {})
    certificate.save(tmp_path / "small.yaml")
    assert min(certificate.verify().values()) >= -1e-9
    assert certificate.flight is not None
    assert all(0.0 < axis.back.rate < 20.0 for axis in certificate.flight.axes)


def test_too_little_tilt_is_refused_with_what_would_do_and_the_trade_says_what_is_needed() -> None:
    certificate = Certificate.from_document(read_yaml(CONFIG / "cf21_adaptive_50hz.yaml"))
    require_tilt(certificate)
    lines = "\n".join(trade(certificate))
    for text in ("as certified", "any gain to 2.5", "noise 0 instead of 0.0005 m", "deg, of which"):
        assert text in lines
    assert certificate.flight is not None
    less = replace(certificate.flight, margin=certificate.flight.margin - 0.5)
    with pytest.raises(FlatsatError) as refused:
        require_tilt(replace(certificate, flight=less))
    needed = float(str(refused.value).split("at least ")[1].split(" deg")[0])
    assert needed == pytest.approx(float(lines.split("deg, of which ")[1].split(" ")[0]), abs=0.15)
    assert "or give up: --gain-max below 4, or less " in str(refused.value)


def test_the_observer_is_a_kalman_filter_at_rest() -> None:
    period, q, r = 0.02, 0.1, 2.0
    L = np.array(observer(period, q, r))
    F = np.array([[1.0, period, period**2 / 2.0], [0.0, 1.0, period], [0.0, 0.0, 1.0]])
    fine = period / 100.0
    step = np.array([[1.0, fine, fine**2 / 2.0], [0.0, 1.0, fine], [0.0, 0.0, 1.0]])
    N = np.zeros((3, 3))
    for _ in range(100):
        N = step @ N @ step.T + fine * np.diag([0.0, q, r])
    covariance = np.eye(3)
    for _ in range(3000):
        predicted = F @ covariance @ F.T + N
        gain = predicted[:, 0] / (predicted[0, 0] + 1e-6)
        covariance = predicted - np.outer(gain, predicted[0])
    np.testing.assert_allclose(L, gain, rtol=0.02)


def test_command_noise_is_what_noise_makes_of_commands() -> None:
    design = Design.predicting(0.02, Plant(0.03, 0.14), (0.25, 1.9, 3.6), 40.0, 16.0)
    loop, random = FlightLoop(design, Plant(0.03, 0.14)), np.random.default_rng(1)
    matrix, row = loop.matrix(1.0), loop.compensation + loop.feedback
    z, commands = np.zeros(loop.size), []
    for noise in 5e-4 * random.standard_normal(20_000):
        z = matrix @ z + loop.noise_input * noise
        commands.append(row @ z)
    assert math.degrees(8.0 * np.std(commands) / 9.81) == pytest.approx(
        command_noise(design, loop.plant, 5e-4), rel=0.05
    )


def test_a_search_makes_the_tube_smaller() -> None:
    plant = Plant(0.03, 0.14)
    plants = Plants(PlantBox(plant, plant), False, plant)
    goal = Goal(0.02, 1.5, 1.0, STILL)
    told: list[str] = []
    found = search(goal, plants, told.append, seconds=2.0)
    assert len(told) > 1
    assert goal.worst(found.design, plants, corner_boxes(plants)).nominal <= 1.2


def test_a_search_whose_time_is_over_before_it_finds_one_is_refused() -> None:
    plant = Plant(0.03, 0.14)
    with pytest.raises(FlatsatError, match="tube of every design that was tried = inf"):
        search(Goal(0.02, 1.5, 1.0, STILL), Plants(PlantBox(plant, plant), False, plant), lambda _: None, seconds=-1.0)


@pytest.mark.parametrize("name", VEHICLES)
def test_the_plants_of_a_profile_are_around_what_it_says(name: str) -> None:
    vehicle = load_vehicle(name)
    dynamics = vehicle.dynamics
    low, high = sides(vehicle, {}).box.low, sides(vehicle, {}).box.high
    assert low.gain <= dynamics.attitude_gain <= high.gain
    assert low.drag <= dynamics.drag_xy <= high.drag
    if dynamics.attitude.damping < 0.75:  # no first-order lag is like that
        assert low.frequency <= dynamics.attitude.natural_frequency <= high.frequency
        assert low.damping <= dynamics.attitude.damping <= high.damping
        assert low.tilt <= -9.81 * dynamics.velocity_tilt <= high.tilt  # of the loop it is against the motion
    else:
        assert low.lag < dynamics.attitude.mean_delay < high.lag
    plants = upright(vehicle, {"delay": (0.01, 0.02)})
    told = None if vehicle.intervals is None else vehicle.intervals.thrust_lag
    lags = told or tuple(sorted((dynamics.thrust_lag_up, dynamics.thrust_lag_down)))
    assert lags == (plants.box.low.lag, plants.box.high.lag)
    assert plants.lag_varies == (dynamics.thrust_lag_up != dynamics.thrust_lag_down)
    assert (plants.box.low.delay, plants.box.high.delay) == (0.01, 0.02)


def test_a_drone_that_leans_into_its_motion_has_plants_that_do() -> None:
    vehicle = load_vehicle("cf21_markers")
    box, known = sides(vehicle, {}).box, vehicle.intervals
    assert known is not None
    assert known.velocity_tilt is not None
    assert (box.low.tilt, box.high.tilt) == pytest.approx([-9.81 * k for k in known.velocity_tilt[::-1]])
    exact = replace(vehicle, intervals=None)
    assert sides(exact, {}).box.low.tilt == sides(exact, {}).box.high.tilt == -9.81 * vehicle.dynamics.velocity_tilt


def test_assumptions_are_read_from_a_file(tmp_path: Path) -> None:
    figures = {"disturbance_rate": 0.2, "noise": 1e-3, "acceleration": 0.5, "jerk": 1.0, "snap": 2.0, "pose_age": 0.01}
    write_yaml(tmp_path / "mine.yaml", {**figures, "delay": [0.02, 0.05]})
    assumptions, intervals = assumed(str(tmp_path / "mine.yaml"))
    assert assumptions == Assumptions(**figures)
    assert intervals == {"delay": (0.02, 0.05)}
    for change, text in (
        ({"delay": [0.05, 0.02]}, "must be an interval, the smaller end first"),
        ({"delay": 0.02}, "must be a list of two numbers"),
        ({"dalay": [0.02, 0.05]}, "assumptions: key = 'dalay': must be one of disturbance_rate, noise"),
        ({"noise": -1.0}, "noise = -1.0 m"),
    ):
        write_yaml(tmp_path / "mine.yaml", figures | change)
        with pytest.raises(FlatsatError) as refused:
            assumed(str(tmp_path / "mine.yaml"))
        assert text in str(refused.value)
    assert assumed("still") == (STILL, {})
    write_yaml(tmp_path / "mine.yaml", {"noise": 2e-3, "lag": [0.1, 0.2]})
    assert assumed(str(tmp_path / "mine.yaml")) == (replace(STILL, noise=2e-3), {"lag": (0.1, 0.2)})


def test_soft_gains_are_quiet_on_attitude_loops_that_nobody_has_identified() -> None:
    """72 loops of second order as real flights show them, which lean into their motion; a swap of 0.83 m in 4 s."""
    certificate = Certificate.from_document(read_yaml(CONFIG / "cf21_soft_50hz.yaml"))
    assert certificate.flight is not None
    design, worst = certificate.flight.horizontal.design, 0.0
    model, h = design.model, design.period
    ramp = Polynomial([0.0] * 4 + [35.0, -84.0, 70.0, -20.0])  # of degree 7, from rest to rest
    times = np.arange(0.0, 4.0, h) + h / 2.0
    speed, pull, jerk, snap = (0.83 / 4.0**n * ramp.deriv(n)(times / 4.0) for n in (1, 2, 3, 4))
    asked, bend = jerk + model.drag * pull, snap + model.drag * jerk
    grid = itertools.product((10.0, 14.8, 20.0, 25.0), (0.36, 0.42, 0.46, 0.5, 0.58, 0.67), (0.66, 0.75, 0.86))
    for wn, zeta, gain in grid:
        plant = Plant(0.03, frequency=wn, damping=zeta, gain=gain, tilt=-0.26, drag=0.41)
        loop = FlightLoop(design, plant)
        for k in (1.0, 1.5):
            assert np.abs(np.linalg.eigvals(loop.matrix(k))).max() < 0.99
        # what references do to the loop, docs/mathematics.md
        rate = (gain - 1.0) * asked + (model.drag - plant.drag - plant.tilt) * pull
        drive = (model.delay + model.lead - plant.delay - plant.lead) * asked - bend / wn**2
        drive += plant.tilt / gain * (plant.lead * pull + jerk / wn**2)
        matrix, z = loop.matrix(1.0), np.zeros(loop.size)
        pushed, driven = h * loop.rate_input(h / 2.0), h * gain * loop.drive_input(h / 2.0)
        for i in range(len(times)):
            z = matrix @ z + pushed * rate[i] + driven * drive[i]
            worst = max(worst, abs(float(z[0])))
    assert 0.03 < worst < 0.06
    assert speed.max() < 0.5

"""Attacks on a flight section: nothing is found in a right one, and what is 5 % wrong is found."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from small_flight import BACK, NONE, certificate_of, flight_of

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.resources import config_path
from flatsat_ros.base.strict_yaml import read_yaml, write_yaml
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight import Axis, FlightSection
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_loop import FlightLoop
from flatsat_ros.certificate.flight_plant import Design, Plant
from flatsat_ros.certificate.flight_tube import Assumptions
from flatsat_ros.cli.falsify import main
from flatsat_ros.falsification import flight as attacks
from flatsat_ros.falsification import worst_gains
from flatsat_ros.falsification.exact_drones import ExactDrones, draw_plants
from flatsat_ros.falsification.flight import AttackOutcome, attack
from flatsat_ros.falsification.flight_claims import Found
from flatsat_ros.falsification.flight_report import FlightTally, exact_at
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import GoalMode, Policy
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.gain import Tuning
from flatsat_ros.synthesis.flight_design import ideal_block

PERIOD, GAIN_MAX = 0.02, 1.05
ASSUMPTIONS = Assumptions(disturbance_rate=0.35, noise=5e-4, acceleration=0.0, jerk=0.58, snap=0.66)


def small() -> Certificate:
    """What is proved for nearly one plant and nearly one gain, so that the tube is what can be reached."""
    design = Design.predicting(PERIOD, Plant(0.03, 0.14), (0.357, 3.93, 14.2), 30.0, 18.0)
    sides = Axis(PlantBox(Plant(0.0298, 0.139), Plant(0.0302, 0.141)), False, design, ("",), NONE, BACK)
    upright = replace(sides, design=replace(design, stiffness=25.0, rate=16.0))
    return certificate_of(flight_of(sides, upright, ASSUMPTIONS, GAIN_MAX, 2.2, 0.45), GAIN_MAX)


@pytest.fixture(scope="module", autouse=True)
def few() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(attacks, "DRONES", 40)
        patch.setattr(attacks, "WINDOWS", 3)
        for name, value in (("_WIDTH", 40), ("_DEPTH", 40), ("_BEFORE", 200)):
            patch.setattr(worst_gains, name, value)
        yield


@pytest.fixture(scope="module")
def certificate() -> Certificate:
    return small()


@pytest.fixture(scope="module")
def flown(certificate: Certificate) -> list[AttackOutcome]:
    """One attack on what is claimed of x and y, and one of z."""
    return [attack(seed, certificate) for seed in range(2)]


def section(certificate: Certificate) -> FlightSection:
    assert certificate.flight is not None
    return certificate.flight


def position(outcome: AttackOutcome, axis: int) -> Found:
    return max((one for one in outcome.found if (one.axis, one.signal) == (axis, 0)), key=lambda one: one.ratio)


def with_axes(certificate: Certificate, change: Callable[[Axis], Axis]) -> Certificate:
    flight = section(certificate)
    changed = replace(flight, horizontal=change(flight.horizontal), vertical=change(flight.vertical))
    return replace(certificate, flight=changed)


def test_no_claim_fails_and_the_worst_runs_reach_nine_tenths_of_what_is_exact(
    certificate: Certificate, flown: list[AttackOutcome]
) -> None:
    certificate.verify()
    for axis, outcome in enumerate(flown):
        assert outcome.breaches == ()
        assert outcome.runs == 120
        resting = next(one for one in outcome.found if (one.axis, one.signal, one.kind) == (axis, 0, 0))
        assert 0.9 <= resting.value / exact_at(certificate, resting) <= 1.0
        assert 0.85 <= position(outcome, axis).ratio <= 1.0
    assert attack(0, certificate) == flown[0]


@pytest.mark.parametrize("axis", [0, 1])
def test_a_tube_five_per_cent_below_the_worst_run_is_refuted(
    axis: int, certificate: Certificate, flown: list[AttackOutcome]
) -> None:
    less = 0.95 * position(flown[axis], axis).ratio
    wrong = with_axes(certificate, lambda a: replace(a, tube=replace(a.tube, position=less * a.tube.position)))
    found = {breach.claim for breach in attack(axis, wrong).breaches}
    assert f"{('horizontal', 'vertical')[axis]} position" in found


# the other ones raise no claim by more than 5 %, some lower them: the certificate is nearly right
@pytest.mark.parametrize(("which", "factor"), [(0, 0.8), (1, 1.2), (2, 0.8)])
def test_an_estimator_gain_a_fifth_off_is_refuted(which: int, factor: float, certificate: Certificate) -> None:
    def changed(axis: Axis) -> Axis:
        gains = list(axis.design.observer)
        gains[which] *= factor
        return replace(axis, design=replace(axis.design, observer=(gains[0], gains[1], gains[2])))

    wrong = with_axes(certificate, changed)
    with pytest.raises(FlatsatError, match="fails by"):
        wrong.verify()
    assert attack(0, wrong).breaches


def smallest_destabilising(design: Design, plant: Plant) -> float:
    """Return a gain with which some switching between it and 1 makes the loop grow; the smallest such one, nearly."""
    loop = FlightLoop(design, plant)
    low, high = 1.0, 20.0
    while high - low > 1e-3:
        gain = (low + high) / 2.0
        lower, upper = loop.matrix(1.0), loop.matrix(gain)
        growth = max(
            abs(np.linalg.eigvals(np.linalg.matrix_power(lower, m) @ np.linalg.matrix_power(upper, n))).max()
            for m, n in itertools.product(range(4), range(1, 4))
        )
        low, high = (low, gain) if growth > 1.0 else (gain, high)
    return high


def test_a_cap_of_the_gain_above_the_smallest_destabilising_switching_is_refuted(certificate: Certificate) -> None:
    flight = section(certificate)
    axis = flight.horizontal
    limit = smallest_destabilising(axis.design, axis.box.high)
    assert 3.0 < limit < 2.0 / (axis.design.rate * PERIOD) * 1.05
    share, claims = 0.8, []
    for axis in flight.axes:
        tube, back = axis.claims(1.0, share * limit, ASSUMPTIONS)
        claims.append(replace(axis, tube=tube, back=back))
    for factor, refuted in ((share, False), (1.03, True)):
        gain = factor * limit
        capped = replace(flight, gain_max=gain, horizontal=claims[0], vertical=claims[1])
        assert bool(attack(2, replace(certificate, gain_max=gain, flight=capped)).breaches) == refuted


def test_gains_are_found_that_are_worse_than_any_that_rest_where_there_are_some(
    certificate: Certificate,
) -> None:
    flight = section(certificate)
    axis = flight.horizontal
    calm = worst_gains.worst_gains(flight, axis, GAIN_MAX)
    assert calm.plant in worst_gains.extreme_plants(axis.box)
    assert calm.resting <= calm.any * (1.0 + 1e-3) <= 1.02 * calm.resting
    assert calm.any < axis.tube.position
    limit = smallest_destabilising(axis.design, axis.box.high)
    wild = worst_gains.worst_gains(flight, axis, 1.1 * limit)
    assert wild.any > 2.0 * calm.resting
    assert set(wild.gains) == {1.0, 1.1 * limit}


@pytest.mark.parametrize("plant", [Plant(0.033, 0.12, gain=0.9, drag=0.4), Plant(0.02, 0.0, 15.0, 0.5, 0.8, 0.26, 0.4)])
def test_exact_drones_are_what_fine_steps_make_of_the_plant(plant: Plant) -> None:
    random, steps = np.random.default_rng(5), 2000
    drones = ExactDrones([[plant], [plant]], PERIOD, 0.015, np.zeros((1, 3)))
    drones.choose(np.zeros((2, 1), dtype=int))
    A, B, E = plant.system
    x, sent = np.zeros((len(A), 3)), [np.zeros(3)] * 4
    fine = PERIOD / steps
    for _ in range(5):
        command, push, rate, drive = random.standard_normal((4, 1, 3))
        sent.append(command[0])
        drones.advance(command, push, rate, drive)
        seen = []
        for step in range(steps):
            time = (step + 0.5) * fine
            late = next(i for i in range(4) if time - plant.delay + i * PERIOD >= 0.0)
            acting = plant.gain * (sent[-1 - late] + drive[0])

            def slope(x: np.ndarray, acting: np.ndarray = acting, there: np.ndarray = push + time * rate) -> np.ndarray:
                return np.asarray(A @ x + np.outer(B, acting) + np.outer(E, there))

            x = x + fine * slope(x + fine / 2.0 * slope(x))
            seen.append(x[0])
        assert drones.position[0] == pytest.approx(x[0], abs=1e-6)
        assert drones.velocity[0] == pytest.approx(x[1], abs=1e-6)
        assert drones.middle[0] == pytest.approx(seen[steps // 2 - 1], abs=1e-6)
        assert drones.seen[1, 0] == pytest.approx(seen[steps // 4 - 1], abs=1e-6)


def test_plants_are_drawn_at_the_ends_and_inside_and_keep_what_does_not_change() -> None:
    box = PlantBox(Plant(0.02, 0.1, gain=0.9), Plant(0.03, 0.2, gain=1.1))
    plants = draw_plants(np.random.default_rng(0), box, 50, lag_varies=False)
    assert {box.low.lag, box.high.lag} < {plant.lag for plant in plants}
    assert all(0.02 <= plant.delay <= 0.03 and 0.9 <= plant.gain <= 1.1 for plant in plants)
    changing = draw_plants(np.random.default_rng(0), box, 50, lag_varies=True)
    assert len({(plant.delay, plant.gain) for plant in changing}) == 1
    assert len({plant.lag for plant in changing}) > 10


def test_the_command_reports_and_ends_with_1_for_a_breach(
    certificate: Certificate, tmp_path: object, capsys: pytest.CaptureFixture[str]
) -> None:
    path = f"{tmp_path}/wrong.yaml"
    wrong = with_axes(certificate, lambda a: replace(a, tube=replace(a.tube, nominal=0.5 * a.tube.nominal)))
    write_yaml(path, wrong.to_document(), "")
    options = ["--workers", "1", "--runs", "1"]
    assert main([path, *options]) == 1
    report = capsys.readouterr().out
    assert "VIOLATED by" in report
    assert ": horizontal nominal\n  " in report
    assert f": falsify {path} --seed 0 --runs 1" in report
    assert main(["cf21_50hz", *options]) == 2
    assert "has no flight section" in capsys.readouterr().err
    assert main([path, *options, "--sabotage", "gain"]) == 2
    assert "--sabotage: not used with" in capsys.readouterr().err


def test_the_report_says_how_near_the_runs_came(certificate: Certificate, flown: list[AttackOutcome]) -> None:
    tally = FlightTally()
    for outcome in flown:
        tally.add(outcome)
    report = tally.text(certificate, "small", 2.0, True)
    assert report.startswith("certificate 'small': 240 runs of 125 periods in 2.0 s, 120 a second\n")
    assert "gain that rests: horizontal position" in report
    assert "horizontal tube for gains that rest at" in report
    assert "vertical position at the worst corner, delay 0.0" in report
    assert report.endswith("no claim failed")
    assert "horizontal tube for" not in tally.text(certificate, "small", 2.0, False)


def test_what_is_not_claimed_is_not_attacked() -> None:
    with pytest.raises(FlatsatError, match="claims no tubes to attack"):
        attack(0, Certificate.from_document(read_yaml(config_path("cf21_50hz"))))


def test_attitudes_of_second_order_follow_a_reference_of_constant_jerk(certificate: Certificate) -> None:
    model = Plant(0.04, frequency=16.0, damping=0.55)
    design = Design.predicting(PERIOD, model, (0.3, 2.6, 7.0), 20.0, 10.0)
    axis = Axis(PlantBox(model, model), False, design, ("",), NONE, BACK)
    rate, block = ideal_block(20.0, 10.0)
    flight = replace(section(certificate), horizontal=axis, vertical=axis)
    second = replace(certificate, rate=rate, block=block, block_vertical=None, flight=flight)
    pilot = Pilot(second, Tuning(0.0, 1.0, 1.0, GAIN_MAX), Policy(goal_mode=GoalMode.STEP), 1)
    drones = ExactDrones([[model], [model]], PERIOD, PERIOD, np.array([[0.0, 0.0, 1.0]]))
    drones.choose(np.zeros((2, 1), dtype=int))
    jerk = np.zeros((1, 8, 3))
    jerk[0, 0], jerk[0, 3] = (0.0, 0.0, 1.0), (0.1, 0.0, 0.0)  # 0.6 m/s^3
    away = 0.0
    for number in range(200):
        now = PERIOD * number
        pilot.measure(0, now, drones.position[0].tolist(), [0.0, 0.0, 0.0, 1.0], now)
        if number == 2:
            pilot.set_reference(0, Trajectory(np.array([2.0, 4.2]), jerk))
        tick = pilot.tick(now)
        if now > 3.0:  # when it has forgotten that the jerk began at once
            away = max(away, float(np.abs(drones.position - tick.reference[:, :3]).max()))
        if number > 50:  # until then something holds it
            drones.advance(tick.output.acceleration, *np.zeros((3, 1, 3)))
    assert away < 1e-4

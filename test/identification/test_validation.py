"""Verdicts on the assumptions of certificates."""

import dataclasses
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.resources import config_path
from flatsat_ros.base.strict_yaml import read_yaml
from flatsat_ros.certificate.certificate import Certificate, load_certificate
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_tube import Assumptions
from flatsat_ros.crazyflie.intervals import Intervals
from flatsat_ros.crazyflie.vehicle import VehicleProfile, load_vehicle
from flatsat_ros.identification.assumptions import assumptions
from flatsat_ros.identification.disturbances import blur, disturbances, shared
from flatsat_ros.identification.fit import Fit
from flatsat_ros.identification.identified import NAMES, Figure, Identified
from flatsat_ros.identification.log import ClaimedFlight, FlightLog, ages
from flatsat_ros.identification.residuals import REACH, ComparedFlight, misfit
from flatsat_ros.identification.response import Figures
from flatsat_ros.identification.screening import STEP, Samples
from flatsat_ros.identification.validation import CONTRADICTS, SILENT, SUPPORTS, older, oldest, validate

LOOP = load_certificate("cf21_50hz")
FLYING = Certificate.from_document(read_yaml(config_path("cf21_flight_50hz")))  # not proved again here
STILL = Assumptions(disturbance_rate=0.17, noise=5e-4, acceleration=0.4, jerk=0.6, snap=0.7)
IMMEDIATE = load_certificate("paper_experiment")


def told(**intervals: tuple[float, float] | None) -> Identified:
    """What flights tell, with these intervals; nothing of the rest."""
    figures = {
        name: Figure(np.mean(ends) if (ends := intervals.get(name)) else 0.0, ends, 3 if ends else 0, ())
        for name in NAMES
    }
    return Identified((), cast(Any, None), figures, np.empty((0, 3)), 0.0)


def log(*between: float) -> FlightLog:
    time = np.cumsum(np.concatenate([[0.0], np.tile(between, 500)]))
    return FlightLog(
        "log",
        time,
        np.zeros((len(time), 3)),
        np.zeros((len(time), 3)),
        time,
        np.zeros((len(time), 3)),
        time[:0],
        time[:0],
    )


@pytest.mark.parametrize(
    ("name", "figure", "scale", "offset"),
    [
        ("thrust available", "thrust_available", -1.0, LOOP.limits.thrust_max),
        ("lag plus delay", "lag_and_delay", 1.0, LOOP.lag + LOOP.delay),
        ("thrust lag", "thrust_lag", 1.0, LOOP.lag),
    ],
)
def test_a_bound_is_supported_contradicted_or_neither_by_where_the_interval_lies(
    name: str, figure: str, scale: float, offset: float
) -> None:
    for ends, verdict in (((-0.04, -0.01), "supports"), ((0.01, 0.04), "contradicts"), ((-0.01, 0.01), "silent")):
        low, high = sorted(offset + scale * end for end in ends)
        verdicts = {each.assumption: each for each in validate(LOOP, told(**{figure: (low, high)}), [log(0.02)])}
        assert verdicts.pop(name).verdict == verdict
        assert verdicts.pop("pose gaps").verdict == "supports"
        assert {each.verdict for each in verdicts.values()} == {"silent"}
        assert {each.shown for each in verdicts.values()} == {"not told"}


@pytest.mark.parametrize(
    ("interval", "verdict"),
    [((0.97, 1.03), "supports"), ((0.9, 1.1), "silent"), ((0.74, 0.79), "contradicts"), (None, "silent")],
)
def test_a_certificate_assumes_that_the_attitude_goes_where_it_is_sent(
    interval: tuple[float, float] | None, verdict: str
) -> None:
    judged = validate(LOOP, told(attitude_gain=interval), [log(0.02)])
    assert {each.assumption: each.verdict for each in judged}["attitude gain"] == verdict


def test_a_certificate_without_lag_is_contradicted_by_any() -> None:
    judged = validate(IMMEDIATE, told(lag_and_delay=(0.07, 0.09)), [log(0.02)])
    assert {each.assumption: each.verdict for each in judged}["lag plus delay"] == "contradicts"


@pytest.mark.parametrize(
    ("between", "verdict"),
    [((0.02,), "supports"), ((0.01,), "supports"), ((0.0202,), "supports"), ((0.04,), "contradicts")],
)
def test_poses_must_come_each_period(between: tuple[float, ...], verdict: str) -> None:
    judged = validate(LOOP, told(), [log(*between)])
    assert {each.assumption: each.verdict for each in judged}["pose gaps"] == verdict


def test_a_hole_counts_by_the_time_that_it_takes() -> None:
    def share(hole: float) -> str:
        holed = log(0.01)
        time = holed.pose_time.copy()
        time[250:] += hole
        moved = dataclasses.replace(holed, pose_time=time)
        return {each.assumption: each.verdict for each in validate(LOOP, told(), [moved])}["pose gaps"]

    assert share(0.012) == "supports"  # 1 ms too long, of 5 s
    assert share(0.1) == "contradicts"


@given(st.lists(st.tuples(st.floats(0.0, 0.5), st.floats(1e-3, 1.0)), min_size=1, max_size=30), st.floats(0.5, 0.9999))
def test_the_newest_pose_is_older_than_the_oldest_for_no_more_than_what_is_left_over(
    gaps: list[tuple[float, float]], coverage: float
) -> None:
    found = np.cumsum(gaps, axis=1)  # how old it is when it comes, and when the next one does
    age = oldest(found, coverage)
    assert 0.0 < age < found.max()
    assert older(found, age) == pytest.approx(1.0 - coverage, abs=1e-6)
    moments = np.concatenate([np.linspace(*ends, 2000, endpoint=False) for ends in found])
    weights = np.repeat(found[:, 1] - found[:, 0], 2000)
    assert np.average(moments > age, weights=weights) == pytest.approx(1.0 - coverage, abs=1e-3)


def test_poses_that_come_late_are_old_and_what_is_no_flight_does_not_count() -> None:
    time = np.arange(1000) * 0.01
    came = time + 3e-3
    came[500:505] = came[504]  # five at once
    command = np.zeros((1000, 3))
    command[100:900, 2] = 4e4
    flown = dataclasses.replace(log(0.01), pose_time=time, arrived=came, position=np.zeros((1000, 3)),
        angles=np.zeros((1000, 3)), command_time=time, command=command)  # fmt: skip
    found = ages(flown)
    assert (found[:, 1] - found[:, 0]).sum() == pytest.approx(8.0, abs=0.03)
    assert found[:, 1].max() == pytest.approx(came[504] - time[499])
    lost = dataclasses.replace(flown, position=np.where(np.tile(time < 0.5, (3, 1)).T, np.nan, 0.0))
    assert len(ages(lost)) == len(found)


def test_a_push_that_moves_the_drone_is_found_as_a_disturbance(found: Identified) -> None:
    size, rate = 0.03, 2.0 * np.pi * 0.4  # m, rad/s: 0.19 m/s^2
    flight = found.flights[0]
    samples = flight.motion.samples
    time = np.arange(len(samples.position)) * STEP
    moved = samples.position.copy()
    moved[:, 2] += size * np.sin(rate * time)
    shaken = ComparedFlight.of(dataclasses.replace(samples, position=moved))
    common = dataclasses.replace(found.common, misfits=(misfit(shaken, found.common.of(0)),))
    pushed, change = disturbances([shaken], common)
    at = shaken.position_at * STEP
    drag = found.common.figures.drag_z
    expected = size * (-(rate**2) * np.sin(rate * at) + drag * rate * np.cos(rate * at))
    assert_allclose(pushed[:, 2], expected, atol=0.05)
    noise = 3e-4 * np.sqrt(6.0) / (REACH * STEP) ** 2  # of the poses
    root = np.sqrt(np.mean(change[:, 2] ** 2))
    assert root == pytest.approx(np.hypot(size * rate**3, noise * 2.0 / 0.1) / np.sqrt(2.0), rel=0.15)
    assert shared(np.array([[3.0, 4.0, 1.0], [3.0, 4.0, -6.0]])).tolist() == [5.0, 6.0]


def test_drag_that_is_not_modelled_and_thrust_that_is_not_there_disturb(found: Identified) -> None:
    flight, figures = found.flights[0], found.common.figures
    common = dataclasses.replace(found.common, misfits=found.common.misfits[:1])
    known, _ = disturbances([flight], common)
    simple, _ = disturbances([flight], common, np.zeros(3), 1.1 * common.misfits[0].thrust_full)
    velocity = flight.drifted / (REACH * STEP) ** 2
    slowing = figures.drag_xy - GRAVITY * figures.velocity_tilt
    assert_allclose(simple[:, :2], known[:, :2] - slowing * velocity[:, :2])
    assert_allclose(simple[:, 2], known[:, 2] - figures.drag_z * velocity[:, 2] + (1.0 / 1.1 - 1.0) * GRAVITY)


def verdicts(
    certificate: Certificate, found: Identified, logs: list[FlightLog], vehicle: VehicleProfile | None = None
) -> dict[str, str]:
    return {each.assumption: each.verdict for each in validate(certificate, found, logs, vehicle)}


def test_a_flight_certificate_is_judged_by_all_that_it_assumes(
    found: Identified, logs: list[FlightLog], weak: VehicleProfile
) -> None:
    judged = verdicts(FLYING, found, logs)
    assert judged["attitude gain"] == CONTRADICTS  # 0.8 for 1
    assert judged["pose gaps"] == CONTRADICTS  # poses each 10 ms are up to 10 ms old
    assert judged["pose noise"] == CONTRADICTS  # 0.3 mm, more than 0.5 mm in a plane at times
    names = {name.partition(" up to")[0] for name in judged}
    assert {"lag plus delay", "thrust lag", "thrust available", "disturbance", "its rate"} <= names
    assert "tube of z" not in judged

    flight = FLYING.flight
    assert flight is not None
    box = flight.horizontal.box
    low = dataclasses.replace(box.low, gain=0.5, lag=1e-3, delay=0.0)
    high = dataclasses.replace(box.high, gain=1.5, lag=0.5)
    sides = dataclasses.replace(flight.horizontal, box=PlantBox(low, high))
    wide = dataclasses.replace(
        flight,
        disturbance=5.0,
        horizontal=sides,
        assumptions=dataclasses.replace(flight.assumptions, disturbance_rate=20.0, noise=0.01, pose_age=0.02),
    )
    generous = verdicts(dataclasses.replace(FLYING, flight=wide), found, logs)
    assert {name for name, verdict in generous.items() if verdict == CONTRADICTS} == {"thrust available"}
    assert generous["attitude gain"] == generous["pose noise"] == generous["pose gaps"] == SUPPORTS

    own = dataclasses.replace(weak, force_max=weak.force_max * 0.7)  # takes the drone for weaker than it is
    scale = found.common.misfits[0].thrust_full / (own.force_max / own.mass)
    assert scale == pytest.approx(0.9 / 0.7, rel=0.05)
    assert verdicts(dataclasses.replace(FLYING, flight=wide), found, logs, own)["thrust scale"] == CONTRADICTS


def test_the_tube_as_flown_is_judged_where_our_controller_flew(found: Identified, logs: list[FlightLog]) -> None:
    assert FLYING.flight is not None
    sides, upright = FLYING.flight.horizontal.tube.position, FLYING.flight.vertical.tube.position
    inside = np.tile((0.6 * sides, -0.6 * sides, -0.9 * upright), (1000, 1))
    certified = np.tile((sides, upright), (1000, 1))
    for count, claimed, tube, verdict in (
        (1, True, certified, SUPPORTS),
        (2, True, certified, CONTRADICTS),
        (2, False, certified, SUPPORTS),  # where it was not claimed
        (2, True, 1.1 * certified, SILENT),  # of another certificate
        (0, True, np.nan * certified, SILENT),
    ):
        outside, claims = inside.copy(), np.ones(1000, dtype=bool)
        outside[:count] *= 1.3
        claims[:count] = claimed
        flown = [dataclasses.replace(logs[0], flown=ClaimedFlight(outside, tube, claims)), logs[1]]
        judged = verdicts(FLYING, found, flown)
        assert judged["tube of x and y"] == judged["tube of z"] == verdict


@pytest.mark.parametrize("noise", [1e-4, 1e-3])
def test_noise_alone_looks_like_no_more_than_its_blur(noise: float) -> None:
    still = np.zeros((4000, 3))
    samples = Samples(
        "still", noise * np.random.default_rng(3).standard_normal(still.shape), still, still, np.empty(0),
        np.ones(4000, dtype=bool), np.ones(4000, dtype=bool), still[:0], {},
    )  # fmt: skip
    flight = ComparedFlight.of(samples)
    figures = Figures(1.0, 20.0, 0.7, 0.0, 1.0, 0.1, 0.0, 0.0, 0.0)
    alone = Fit(figures, np.zeros(1), (), (misfit(flight, figures),), (1.0, 1.0), np.zeros((0, 0)))
    pushed, change = disturbances([flight], alone)
    for vectors, most in zip((pushed - (0.0, 0.0, GRAVITY), change), blur(noise, 0.9), strict=True):
        assert np.mean(np.linalg.norm(vectors, axis=1) <= most) == pytest.approx(0.9, abs=0.02)


def test_what_noise_may_have_done_contradicts_nothing(found: Identified, logs: list[FlightLog]) -> None:
    flight = FLYING.flight
    assert flight is not None
    _, change = disturbances(found.flights, found.common)
    largest = float(shared(change).max())
    for pose_noise, verdict in ((1e-6, CONTRADICTS), (1e-3, SILENT)):  # the rate is of 0.3 mm of noise
        strict = dataclasses.replace(
            flight, assumptions=dataclasses.replace(flight.assumptions, disturbance_rate=0.5 * largest)
        )
        judged = verdicts(
            dataclasses.replace(FLYING, flight=strict), dataclasses.replace(found, pose_noise=pose_noise), logs
        )
        assert {name.partition(" up to")[0]: each for name, each in judged.items()}["its rate"] == verdict


def test_a_robust_certificate_is_judged_by_the_push_that_it_withstands(
    found: Identified, logs: list[FlightLog]
) -> None:
    robust = load_certificate("paper_robust")
    assert robust.robust is not None
    strong = dataclasses.replace(robust, robust=dataclasses.replace(robust.robust, push=np.array([3.0, 3.0])))
    for certificate, verdict in ((robust, CONTRADICTS), (strong, SUPPORTS)):
        judged = {name.partition(" up to")[0]: each for name, each in verdicts(certificate, found, logs).items()}
        assert judged["push of x and y"] == judged["push of z"] == verdict


def test_the_intervals_of_a_profile_are_judged(weak: VehicleProfile) -> None:
    drone = dataclasses.replace(
        weak, intervals=Intervals(attitude_gain=(0.7, 0.75), drag_xy=(0.3, 0.5), damping=(0.4, 0.5))
    )
    tells = told(attitude_gain=(0.6, 0.95), drag_xy=(0.2, 0.6))
    judged = verdicts(LOOP, tells, [log(0.02)], drone)
    assert judged["profile: attitude_gain"] == CONTRADICTS
    assert judged["profile: drag_xy"] == SUPPORTS
    assert judged["profile: damping"] == SILENT


def test_what_is_written_covers_the_share_that_it_says(found: Identified, logs: list[FlightLog]) -> None:
    base = load_vehicle("cf21")
    assert FLYING.flight is not None
    written = assumptions(found, logs, base, FLYING.flight.assumptions, 0.99)
    for name, values in (("disturbance_rate", disturbances(found.flights, found.common)[1]), ("noise", found.noise)):
        assert np.mean(shared(values) <= written[name]) == pytest.approx(0.99, abs=1.0 / len(values)), name
    assert written["pose_age"] == pytest.approx(0.01, rel=0.02)
    lag, delay, gain = (np.array(written[name]) for name in ("lag", "delay", "gain"))
    total = found.figures["lag_and_delay"].interval
    assert total is not None
    assert delay[0] == base.delay
    assert delay[1] == pytest.approx(found.common.delays.max())
    assert lag[0] + delay[1] <= total[0] + 1e-12
    for name in ("acceleration", "jerk", "snap"):
        assert written[name] == getattr(FLYING.flight.assumptions, name)
    for name, figure in (("frequency", "natural_frequency"), ("damping", "damping")):
        ends = found.figures[figure].interval
        assert ends is not None
        assert written[name] == list(ends)
    assert lag[1] + delay[0] >= total[1] - 1e-12
    assert tuple(gain) == found.figures["attitude_gain"].interval


def test_what_too_few_samples_cannot_show_is_not_written(found: Identified, logs: list[FlightLog]) -> None:
    base = load_vehicle("cf21")
    with pytest.raises(FlatsatError, match=r"samples of disturbance_rate = \d+: must be at least 1000 .*more flights"):
        assumptions(found, logs, base, STILL)
    for coverage in (0.5, 1.0, float("nan")):
        with pytest.raises(FlatsatError, match="coverage"):
            assumptions(found, logs, base, STILL, coverage)
    hidden = dataclasses.replace(found, figures={**found.figures, "attitude_gain": Figure(1.0, None, 0, ())})
    with pytest.raises(FlatsatError, match="do not tell attitude gain, lag and delay"):
        assumptions(hidden, logs, base, STILL, 0.99)

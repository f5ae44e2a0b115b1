"""The detectors on made-up motion: what they take for a fault, and what they must not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.fit import LINK_DELAY
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.flight.astray import AstrayDetector
from flatsat_ros.flight.detectors import BobbingDetector, LiftOffDetector, TiltLimitDetector, TouchDownDetector
from flatsat_ros.flight.following_check import FollowingCheck
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture

LOOK = 0.05  # s between two looks
LATE = 0.15  # s
ON = np.ones(1, dtype=bool)
OFF = np.zeros(1, dtype=bool)
GRAVITY = 9.81
TILT = math.radians(10.0)
LIMIT = GRAVITY * math.tan(TILT)

PHASES = st.lists(st.floats(0.0, 2.0 * math.pi), min_size=4, max_size=4)
YAWS = st.floats(-math.pi, math.pi)


def first_astray(
    answer: np.ndarray, phases: list[float], *, yaw: float = 0.0, gust: float = 0.0, assumed: bool = False
) -> float:
    """Time, s, after which a drone is taken for one that goes astray; infinite for never in 6 s.

    It is told to sway along both axes, and answers with answer (2, 2) times that, late, and with what a gust,
    m/s^2, adds. Its yaw is seen, or assumed.
    """
    return swaying(answer, phases, yaw=yaw, gust=gust, assumed=assumed)[0]


def swaying(
    answer: np.ndarray, phases: list[float], *, yaw: float = 0.0, gust: float = 0.0, assumed: bool = False
) -> tuple[float, np.ndarray | None]:
    """Time as `first_astray` returns it, and what is seen of the answer along the body's axes a second later."""
    found = math.inf
    random, detector = np.random.default_rng(1), AstrayDetector(1, LOOK, LATE)
    velocity, told, gusts = np.zeros(2), [], 0.0
    for n in range(round(6.0 / LOOK)):
        t = n * LOOK
        pairs = zip((2.1, 3.3), phases[::2], phases[1::2], strict=True)
        told.append(sum(0.6 * np.array([math.sin(w * t + a), math.sin(w * t + b)]) for w, a, b in pairs))
        came = answer @ told[max(0, n - round(LATE / LOOK))]
        gusts += LOOK * (random.normal(0.0, gust * math.sqrt(2.0 / LOOK), 2) - gusts)
        velocity = velocity + LOOK * (came + gusts)
        push, seen = LOOK * told[-1][np.newaxis], velocity[np.newaxis] + random.normal(0.0, 2e-3, (1, 2))
        if detector.astray(push, seen, np.array([yaw]), ON, ON if assumed else None)[0]:
            found = min(found, t)
        if t > found + 1.0:
            break
    return found, detector.answer(0)


def turned(degrees: float) -> np.ndarray:
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[cos, -sin], [sin, cos]])


@given(degrees=st.floats(80.0, 280.0), phases=PHASES, strength=st.floats(0.75, 1.0))
@settings(max_examples=12)
def test_commands_that_act_in_another_direction_are_noticed(
    degrees: float, phases: list[float], strength: float
) -> None:
    assert first_astray(strength * turned(degrees), phases) < 3.0


@given(degrees=st.floats(-45.0, 45.0), phases=PHASES, strength=st.floats(0.6, 1.2), gust=st.floats(0.0, 0.5))
@settings(max_examples=12)
def test_commands_that_act_nearly_as_told_are_left_in_peace_in_gusts_too(
    degrees: float, phases: list[float], strength: float, gust: float
) -> None:
    assumed = abs(degrees) < 10.0
    assert first_astray(strength * turned(degrees), phases, gust=gust, assumed=assumed) == math.inf


@given(degrees=st.floats(45.0, 315.0), phases=PHASES, strength=st.floats(0.75, 1.0))
@settings(max_examples=12)
def test_an_assumed_yaw_that_is_wrong_by_half_a_right_angle_is_noticed(
    degrees: float, phases: list[float], strength: float
) -> None:
    assert first_astray(strength * turned(degrees), phases, assumed=True) < 4.0


@given(yaw=YAWS, axis=st.integers(0, 1), phases=PHASES)
@settings(max_examples=12)
def test_an_axis_of_the_body_with_the_wrong_sign_is_noticed_at_every_yaw(
    yaw: float, axis: int, phases: list[float]
) -> None:
    body = turned(math.degrees(yaw))
    told = abs(math.sin(phases[0] - phases[1])) > 0.5 and abs(math.sin(phases[2] - phases[3])) > 0.5
    negated = body @ np.diag([-1.0 if i == axis else 1.0 for i in (0, 1)]) @ body.T
    if told:  # both axes are asked for something of their own
        assert first_astray(negated, phases, yaw=yaw) < 4.0


@given(
    degrees=st.floats(80.0, 280.0),
    mirrored=st.booleans(),
    axis=st.integers(0, 1),
    yaw=YAWS,
    phases=PHASES,
    gust=st.floats(0.0, 0.3),
)
@settings(max_examples=25)
def test_what_is_seen_of_the_answer_is_good_enough_to_brake_with(
    degrees: float, mirrored: bool, axis: int, yaw: float, phases: list[float], gust: float
) -> None:
    body = turned(math.degrees(yaw))
    along = np.diag([-1.0 if i == axis else 1.0 for i in (0, 1)]) if mirrored else turned(degrees)
    # of two axes that sway alike nobody can tell a turn from a mirror
    if abs(math.sin(phases[0] - phases[1])) < 0.5 or abs(math.sin(phases[2] - phases[3])) < 0.5:
        return
    time, seen = swaying(body @ along @ body.T, phases, yaw=yaw, gust=gust)
    assert time < 4.0
    assert seen is not None
    assert seen @ seen.T == pytest.approx(np.eye(2), abs=1e-9)
    # what comes of a command that shall bring w is within 60 degrees of w, for every w
    assert np.linalg.eigvalsh(along @ seen.T + seen @ along.T).min() > 2.0 * math.cos(math.radians(60.0))


def test_of_a_drone_that_was_told_nothing_nothing_is_seen() -> None:
    detector = AstrayDetector(1, LOOK, LATE)
    assert detector.answer(0) is None
    for _ in range(100):
        detector.astray(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros(1), ON)
    assert detector.answer(0) is None


def limited(seconds: float, error_rate: float, start: float = 1.0, *, landing: bool = False) -> bool:
    """Whether a drone at its limit is blown off whose error, m, grows at a rate, m/s."""
    detector, blown = TiltLimitDetector(1, TILT, GRAVITY), False
    at_limit = np.array([[LIMIT, 0.0, 0.0]])
    for n in range(round(seconds / LOOK)):
        error = np.array([[-max(0.0, start + error_rate * n * LOOK), 0.0]])
        answer = detector.look(n * LOOK, at_limit, at_limit[:, :2], np.zeros((1, 2)), error, ON, np.array([landing]))
        blown |= bool(answer[0][0])
        assert not answer[1][0]
        assert not answer[2][0]
    return blown


@given(rate=st.floats(0.0, 3.0), start=st.floats(0.51, 3.0))
@settings(max_examples=15)
def test_a_drone_at_its_limit_that_comes_no_nearer_is_blown_off(rate: float, start: float) -> None:
    assert limited(2.2, rate, start)
    assert not limited(1.9, rate, start)
    assert limited(0.6, rate, start, landing=True)


@given(rate=st.floats(0.1, 3.0), start=st.floats(0.0, 3.0))
@settings(max_examples=15)
def test_a_drone_on_its_way_to_a_far_set_point_is_not(rate: float, start: float) -> None:
    assert not limited(5.0, -rate, start)
    assert not limited(3.0, 0.0, 0.5), "nor one that is near"


@pytest.mark.parametrize(("half", "swings"), [(0.5, True), (0.9, True), (1.4, True), (3.0, False)])
def test_a_drone_that_is_sent_to_and_fro_swings(half: float, swings: bool) -> None:
    detector, found = TiltLimitDetector(1, TILT, GRAVITY), False
    for n in range(round(12.0 / LOOK)):
        side = 0.8 * LIMIT * np.sign(math.sin(math.pi * (n + 0.5) * LOOK / half))
        command = np.array([[side, 0.0, 0.0]])
        _, swing, _ = detector.look(n * LOOK, command, command[:, :2], np.zeros((1, 2)), np.zeros((1, 2)), ON, OFF)
        found |= bool(swing[0])
    assert found is swings


@given(half=st.floats(0.3, 1.3), height=st.floats(0.75, 8.0), first=st.sampled_from([-1.0, 1.0]))
@settings(max_examples=15)
def test_a_drone_that_is_sent_up_and_down_bobs(half: float, height: float, first: float) -> None:
    def bobs(half: float, height: float, steered: np.ndarray, seconds: float) -> bool:
        detector, found = BobbingDetector(1), False
        for n in range(round(seconds / LOOK)):
            push = first * height * np.sign(math.sin(math.pi * (n + 0.5) * LOOK / half))
            found |= bool(detector.look(n * LOOK, np.array([push]), steered)[0])
        return found

    assert bobs(half, height, ON, 6.0 * half + 1.0)
    assert not bobs(half, height, ON, 2.9 * half), "one swing may be a gust"
    assert not bobs(4.0 * half + 2.0, height, ON, 30.0), "slowly"
    assert not bobs(half, 0.6, ON, 10.0), "a little"
    assert not bobs(half, height, OFF, 10.0)


def stiffly(_now: float, swings: np.ndarray) -> np.ndarray:
    return np.zeros_like(swings)


@pytest.mark.parametrize("name", ["thrust_kit_tight_50hz", "cf21_adaptive_50hz"])
@given(half=st.floats(0.3, 0.5), first=st.sampled_from([-1.0, 1.0]), push=st.floats(1.0, 4.0))
@settings(max_examples=8)
def test_a_drone_that_gusts_move_up_and_down_by_centimetres_does_not_swing(
    name: str, half: float, first: float, push: float
) -> None:
    flight = load_certificate(name).flight
    assert flight is not None
    for size, swings in ((0.07, False), (1.01 * max(0.075, flight.vertical.tube.position), True)):
        check, base, found = FollowingCheck(load_certificate(name), 0.3, 1), np.zeros((1, 9)), False
        for n in range(round(4.0 / LOOK)):
            error, command = np.zeros((1, 6)), np.zeros((1, 3))
            error[0, 2] = first * size * np.sign(math.sin(math.pi * (n + 0.5) * LOOK / half))
            command[0, 2] = -push * np.sign(error[0, 2])
            late = check.look(n * LOOK, command, base, np.zeros((1, 3)), error, ON, OFF, None, OFF, stiffly)[1]
            found |= bool(late[0])
        assert found is swings


@pytest.mark.parametrize("axis", [0, 2])
def test_who_swings_is_flown_softly_first_and_goes_astray_if_it_swings_all_the_same(axis: int) -> None:
    check, base, eased, found = FollowingCheck(load_certificate("cf21_50hz"), 0.3, 1), np.zeros((1, 9)), [], []

    def ease(now: float, swings: np.ndarray) -> np.ndarray:
        eased.append(now)
        return swings & (len(eased) == 1)

    for n in range(round(8.0 / LOOK)):
        error, command = np.zeros((1, 6)), np.zeros((1, 3))
        command[0, axis] = 1.6 * np.sign(math.sin(math.pi * (n + 0.5) * LOOK / 0.5))
        if check.look(n * LOOK, command, base, np.zeros((1, 3)), error, ON, OFF, None, OFF, ease)[1][0]:
            found.append(n * LOOK)
            break
    assert len(eased) == 2
    assert found == eased[1:]
    assert found[0] > 1.8 * eased[0], "it swings as often again"


@given(ratio=st.floats(-3.0, 3.0))
@settings(max_examples=15)
def test_what_a_wrong_sign_does_at_the_limit_is_no_wind(ratio: float) -> None:
    """A wrong sign makes -2 times the command of the disturbance."""
    detector, command = TiltLimitDetector(1, TILT, GRAVITY), np.array([[0.0, LIMIT, 0.0]])
    for n in range(8):
        *_, opposed = detector.look(
            n * LOOK, command, command[:, :2], ratio * command[:, :2], np.zeros((1, 2)), ON, OFF
        )
    assert opposed[0] == (ratio < -1.8)


def carried(height: list[float], upward: list[float], above: float = 0.3) -> bool:
    detector, off = TouchDownDetector(1), np.array([above])
    pairs = enumerate(zip(height, upward, strict=True))
    return any(bool(detector.carried(n * LOOK, np.array([z]), np.array([u]), off, ON)[0]) for n, (z, u) in pairs)


@given(
    noise=st.lists(st.floats(-0.02, 0.02), min_size=20, max_size=20),
    upward=st.lists(st.floats(-6.0, -1.0), min_size=20, max_size=20).map(lambda found: [u - 0.5 for u in found]),
)
@settings(max_examples=15)
def test_what_stays_at_its_height_though_it_is_told_to_sink_is_carried(noise: list[float], upward: list[float]) -> None:
    assert carried(noise, upward)


@given(climb=st.floats(-1.0, 1.0), upward=st.floats(-4.0, -1.2), bias=st.floats(-0.4, 0.4))
@settings(max_examples=15)
def test_what_is_free_to_fall_is_not(climb: float, upward: float, bias: float) -> None:
    times = LOOK * np.arange(20)
    assert not carried(list(1.0 + climb * times + (upward + bias) * times**2 / 2.0), [upward] * 20)


def test_what_is_held_in_the_air_by_a_small_command_is_not() -> None:
    assert not carried([1.0] * 100, [-1.0] * 100)


@given(above=st.floats(-0.5, 0.5), upward=st.floats(-4.0, -1.3))
def test_what_is_where_it_is_led_is_not_however_air_that_rises_makes_it_be_commanded(
    above: float, upward: float
) -> None:
    assert carried([1.0] * 40, [upward] * 40, above) == (above >= 0.15)


@given(way=st.floats(0.0, 0.5), rises=st.booleans())
def test_a_drone_that_moves_sideways_before_it_leaves_the_ground_slides(way: float, rises: bool) -> None:
    detector = LiftOffDetector(1, 3.0)
    detector.begin(0, np.array([1.0, 2.0, 0.1]))
    for share in np.linspace(0.0, 1.0, 10):
        place = np.array([[1.0, 2.0 - way * share, 0.1 + 0.3 * share * rises]])
        detector.held(share, place, np.ones(1), np.ones(1), GRAVITY, ON)
    assert detector.slid[0] == (way > 0.15 and not rises)
    assert detector.risen(0, place[0]) == pytest.approx(0.1 + math.hypot(way, 0.3 * rises))


@given(hop=st.sampled_from([0.0, 0.02, 0.035, 0.045]), way=st.floats(0.1, 0.3))
def test_a_drone_that_was_seen_to_hop_may_be_blown_sideways_by_five_times_as_much(hop: float, way: float) -> None:
    detector = LiftOffDetector(1, 3.0)
    detector.begin(0, np.array([1.0, 2.0, 0.1]))
    for share in np.linspace(0.0, 1.0, 20):
        place = np.array([[1.0 + way * share, 2.0, 0.1 + hop * math.sin(math.pi * min(2.0 * share, 1.0))]])
        detector.held(share, place, np.ones(1), np.ones(1), GRAVITY, ON)
    if abs(way - 5.0 * hop) > 0.01:  # the highest place is between two looks
        assert detector.slid[0] == (way > 0.15 and way > 5.0 * hop)


@given(depth=st.floats(-0.3, 0.3), noise=st.floats(-0.02, 0.02))
def test_a_drone_that_is_seen_below_the_ground_on_which_it_stood_has_risen_as_far(depth: float, noise: float) -> None:
    detector, found = LiftOffDetector(1, 3.0), False
    detector.begin(0, np.array([1.0, 2.0, -0.1]))
    for share in np.linspace(0.0, 1.0, 30):
        place = np.array([[1.0 + noise, 2.0 - noise, -0.1 - depth * share]])
        detector.held(share, place, np.ones(1), np.ones(1), GRAVITY, ON)
        found |= bool(detector.sunk[0])
    assert found == (depth > 0.05)
    assert detector.risen(0, place[0]) == pytest.approx(-0.1 + math.hypot(noise, noise, depth))


@given(way=st.floats(0.0, 0.3), angle=st.floats(-math.pi, math.pi), taken_over=st.booleans())
def test_who_was_taken_over_and_moves_sideways_stands_on_nothing(way: float, angle: float, taken_over: bool) -> None:
    detector = LiftOffDetector(1, 3.0)
    detector.begin(0, np.array([1.0, 2.0, 0.8]), taken_over=taken_over)
    for share in (0.0, 1.0, 0.0):
        place = np.array([[1.0 + way * share * math.cos(angle), 2.0 + way * share * math.sin(angle), 0.81]])
        detector.held(share, place, np.zeros(1), np.ones(1), GRAVITY, ON)
    assert detector.standing[0] != (taken_over and way * max(abs(math.cos(angle)), abs(math.sin(angle))) > 0.03)
    assert not (taken_over and detector.slid[0])


def test_who_was_taken_over_and_stands_still_goes_not_astray_however_it_is_commanded() -> None:
    random, detector = np.random.default_rng(3), AstrayDetector(2, LOOK, LATE)
    told, velocity, found = [np.zeros(2)], np.zeros((2, 2)), []
    for n in range(round(6.0 / LOOK)):
        told.append(0.9 * told[-1] + random.normal(0.0, 0.2, 2))
        velocity[1] -= LOOK * told[max(0, n - round(LATE / LOOK))]  # the second one flies, with both signs wrong
        push, seen = LOOK * np.tile(told[-1], (2, 1)), velocity + random.normal(0.0, 2e-3, (2, 2))
        found.append(detector.astray(push, seen, np.zeros(2), np.tile(ON, 2), None, np.tile(n < 60, 2)))
    assert not np.any(found[:60]), "who was not seen to move is not judged"
    assert np.any(found, axis=0).tolist() == [False, True]
    assert np.any(found[:75], axis=0)[1], "and then by what was commanded before as well"


def test_air_that_rises_is_not_taken_for_the_ground_by_a_drone_that_is_about_to_land() -> None:
    vehicle, certificate = load_vehicle("thrust_kit"), load_certificate("thrust_kit_adaptive_100hz")
    fleet = SimulatedFleet(vehicle, 1, capture=MotionCapture(noise=1e-4), command_delay=LINK_DELAY)
    policy = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=vehicle.dynamics.drag_z)
    pilot, stopped = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), policy, 1), []

    def look(_now: float, _samples: object, tick: Tick, _sent: object) -> None:
        stopped.extend(fleet.bodies.position[i, 2] for i, _, after, _ in tick.transitions if after is Mode.REST)

    time = fly(pilot, fleet, vehicle, 1.0)
    pilot.take_off(0, 1.5)
    time = fly(pilot, fleet, vehicle, 8.0, start=time)
    for rising in (0.6, 1.2, 1.8, 2.4, 2.6, 2.8, 3.0, 3.2):
        if rising == 2.4:
            pilot.land(0)
        fleet.wind = Wind(mean=(0.0, 0.0, rising))
        time = fly(pilot, fleet, vehicle, time + 0.3, look, start=time)
    fleet.wind = Wind()
    fly(pilot, fleet, vehicle, time + 10.0, look, start=time)
    assert stopped == [0.0]

"""Doubts about a loop: what is seen raises them, they last, and the law then gets less to correct."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.fit import LINK_DELAY
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.flight.doubt import Carried, Doubt
from flatsat_ros.flight.estimator import Estimator
from flatsat_ros.flight.guidance import Guidance
from flatsat_ros.flight.loops import Steered
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.senses import Senses
from flatsat_ros.flight.tick import Tick
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture

CERTIFICATE = load_certificate("cf21_adaptive_50hz")
assert CERTIFICATE.flight is not None
FLIGHT = CERTIFICATE.flight
DIRECT = load_certificate("cf21_50hz")
BOUNDS = np.array([0.003, 0.003])  # m
FLYING, CALM = np.ones(1, dtype=bool), np.zeros((1, 2))
SOFTEST, SOFT = 0.5, 2.0  # 1/s^2 and 1/s: gains that bear half a second of lag and delay are between these

STRANGE = st.one_of(
    st.floats(0.15, 0.5).map(lambda age: (age, 0.0, 0.0)),
    st.floats(0.02, 1.0).map(lambda size: (0.0, size, 0.0)),
    st.floats(0.03, 1.0).map(lambda size: (0.0, 0.0, size)),
)


@given(
    error=st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6),
    gain=st.floats(1.0, 4.0),
    doubts=st.tuples(st.booleans(), st.booleans()),
)
def test_the_law_gets_an_error_that_is_smaller_along_doubted_axes_alone_whatever_its_gain(
    error: list[float], gain: float, doubts: tuple[bool, bool]
) -> None:
    doubt, xi = Doubt.of_flight(FLIGHT, BOUNDS, 1), np.array([error])
    seen = doubt.soften(xi, np.array([doubts]), np.array([gain]))
    for axis in range(3):
        if not doubts[axis == 2]:
            assert seen[0, [axis, axis + 3]].tolist() == xi[0, [axis, axis + 3]].tolist()
            continue
        assert (np.abs(seen) <= np.abs(xi)).all()
        for entry in (axis, axis + 3):
            alone = np.zeros((1, 6))
            alone[0, entry] = 1.0
            push = -gain * doubt.soften(alone, np.array([doubts]), np.array([gain])) @ CERTIFICATE.matrix[:, 3:]
            assert SOFTEST < -push[0, axis] < SOFT


@given(
    sink=st.floats(-1.0, 1.0),
    before=st.floats(0.0, 0.002),
    slowed=st.floats(0.0, 1.0).filter(lambda speed: abs(speed - 0.15) > 1e-6),
    ticks=st.integers(1, 20),
    pause=st.booleans(),
)
def test_a_landing_drone_that_is_stopped_at_once_and_stays_there_is_carried_and_one_that_moves_on_is_not(
    sink: float, before: float, slowed: float, ticks: int, pause: bool
) -> None:
    carried, both, period = Carried(0.02, 2), np.array([True, False]), 0.02
    assert not carried.look(0.0, both, np.full(2, before), np.full(2, 5.0)).any()
    begin = 3.0 * period if pause else period
    known = 0.0 if pause else before  # what was not looked at meanwhile was small
    for tick in range(ticks):
        height = 0.7 - period * sink * tick
        found = carried.look(begin + tick * period, both, np.full(2, known + period * slowed), np.full(2, height))
        assert found.tolist() == [slowed * period > 0.15 * period and abs(height - 0.7) < 0.01, False]


@given(seen=STRANGE, begin=st.floats(0.0, 1e5))
def test_old_poses_and_those_that_are_not_where_they_are_expected_are_doubted_for_two_seconds(
    seen: tuple[float, float, float], begin: float
) -> None:
    doubt, age, innovation = Doubt.of_flight(FLIGHT, BOUNDS, 1), np.array(seen[:1]), np.array([seen[1:]])
    doubt.look(begin, ~FLYING, age, innovation)
    doubt.look(begin, FLYING, np.full(1, 0.1), BOUNDS[np.newaxis])
    assert not doubt.any
    assert doubt.reports() == []
    doubt.look(begin, FLYING, age, innovation)
    doubt.look(begin + 1.0, FLYING, age, innovation)
    assert doubt.of(begin + 2.9).all()
    ((index, text),) = doubt.reports()
    assert index == 0
    assert text.endswith("flown softly for 2 s at least")
    assert not doubt.of(begin + 3.1).any()
    assert not doubt.any


def test_who_is_doubted_again_and_again_is_so_for_longer_each_time() -> None:
    doubt, now, lasted = Doubt.of_flight(FLIGHT, BOUNDS, 1), 0.0, []
    for _ in range(4):
        doubt.look(now, FLYING, np.full(1, 0.2), CALM)
        begin = now
        while doubt.of(now).any():
            now += 0.1
        lasted.append(now - begin)
    assert lasted == pytest.approx([2.0, 8.0, 32.0, 60.0], abs=0.15)
    doubt.look(now + 61.0, FLYING, np.full(1, 0.2), CALM)
    assert doubt.of(now + 62.9).all()
    assert not doubt.of(now + 63.1).any()


def test_who_is_seen_to_swing_is_flown_softly_for_a_minute_along_all_axes_whatever_its_gain() -> None:
    doubt, swings = Doubt.of_swings(DIRECT.matrix, DIRECT.period, 2), np.array([True, False])
    assert doubt.ease(1.0, swings).tolist() == [True, False]
    assert doubt.ease(1.1, swings).tolist() == [False, False], "it is flown so already"
    assert doubt.of(60.9).tolist() == [[True, True], [False, False]]
    assert not doubt.of(61.1).any()
    assert [index for index, _ in doubt.reports()] == [0]
    for gain in (1.0, DIRECT.gain_max):
        for entry in range(6):
            alone = np.zeros((2, 6))
            alone[:, entry] = 1.0
            seen = doubt.soften(alone, np.ones((2, 2), dtype=bool), np.full(2, gain))
            assert -gain * (seen @ DIRECT.matrix[:, 3:])[0, entry % 3] >= -SOFT


@given(swing=st.floats(0.0, 4.0), lasting=st.floats(-0.8, 0.8))
@settings(max_examples=10)
def test_without_a_flight_section_a_disturbance_that_swings_up_and_down_makes_a_loop_doubtful(
    swing: float, lasting: float
) -> None:
    pilot = Pilot(DIRECT, Tuning(2.0, 0.05, 1.0, DIRECT.gain_max), Policy(disturbance_max=0.8), 1)
    loop, fly_ = pilot._parts.loop, np.ones(1, dtype=bool)
    steered = Steered(fly_, ~fly_, ~fly_, None, None, lambda _: ~fly_)
    found = False
    for tick in range(200):
        estimated = np.zeros((1, 9))
        estimated[0, 8] = lasting + swing * np.sin(2.0 * np.pi * DIRECT.period * tick)
        loop.aim(DIRECT.period * tick, estimated, np.zeros((1, 9)), steered)
        found |= loop.doubted is not None
    if not 1.2 < swing < 1.8:
        assert found == (swing > 1.5)


@given(pushes=st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=20))
def test_of_a_doubted_drone_a_disturbance_is_made_up_for_slowly_and_of_others_at_once(pushes: list[float]) -> None:
    doubt, before = Doubt.of_flight(FLIGHT, BOUNDS, 2), np.zeros(3)
    doubt.look(0.0, np.array([True, False]), np.full(2, 0.2), np.zeros((2, 2)))
    for number, push in enumerate(pushes):
        found = doubt.slowed(0.02 * number, lambda: np.full((2, 3), 0.3), np.full((2, 3), push))
        assert found[1].tolist() == [push] * 3
        before = np.array([0.3, 0.3, 0.0]) if number == 0 else before
        assert np.abs(found[0] - before).max() <= 0.02 * np.abs(push - before).max() + 1e-12
        before = found[0].copy()
    assert doubt.slowed(2.1, lambda: np.zeros((2, 3)), np.full((2, 3), 2.0))[0].tolist() == [2.0] * 3
    # the next doubt begins anew
    doubt.look(3.0, np.array([True, False]), np.full(2, 0.2), np.zeros((2, 2)))
    found = doubt.slowed(3.0, lambda: np.full((2, 3), 0.7), np.tile([0.7, 0.7, 0.0], (2, 1)))[0]
    assert found == pytest.approx([0.7, 0.7, 0.0], abs=1e-12)


@pytest.mark.parametrize("late", [0.03, 0.2, 0.33])
def test_a_drone_that_is_flown_softly_does_not_swing_with_late_commands(late: float) -> None:
    doubt, estimator = Doubt.of_flight(FLIGHT, BOUNDS, 1), Estimator(1)
    plant = np.zeros(3)  # position, velocity, acceleration
    doubt.look(0.0, FLYING, np.full(1, 0.2), CALM)
    plant[0], commands, heights = 0.1, [0.0] * (round(late / 0.02) + 1), []
    for tick in range(1500):
        now = 0.02 * tick
        estimator.measure(0, now, [plant[0], 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], now)
        seen = estimator.estimate(now)
        error = doubt.soften(seen[:, :6], np.ones((1, 2), dtype=bool), np.ones(1))
        doubt.look(now, FLYING, np.full(1, 0.2), CALM)
        push = doubt.slowed(now, lambda: np.zeros((1, 3)), seen[:, 6:])
        wanted = -error @ CERTIFICATE.matrix[:, 3:] - push
        estimator.command(now, wanted, FLYING, FLYING)
        commands = [float(wanted[0, 0]), *commands[:-1]]
        lag = FLIGHT.vertical.design.model.lag
        plant += 0.02 * np.array([plant[1], plant[2], (commands[-1] - plant[2]) / lag])
        heights.append(abs(plant[0]))
    assert max(heights[-200:]) < 0.01


def test_who_leaves_the_ground_is_doubted_sideways_for_a_moment() -> None:
    doubt = Doubt.of_flight(FLIGHT, BOUNDS, 2)
    doubt.wait(3.0, np.array([True, False]))
    assert doubt.of(4.0).tolist() == [[True, False], [False, False]]
    assert not doubt.of(4.6).any()


@pytest.mark.parametrize(("off", "early"), [(0.03, False), (0.1, True)])
def test_thrust_that_is_not_known_yet_is_nothing_strange_in_its_height_but_a_large_swing_is(
    off: float, early: bool
) -> None:
    doubt = Doubt.of_flight(FLIGHT, BOUNDS, 2)
    doubt.wait(3.0, np.array([True, False]))
    for now, raised in ((4.4, [early, True]), (4.6, [True, True])):
        doubt.look(now, np.ones(2, dtype=bool), np.zeros(2), np.array([[0.0, off]] * 2))
        assert doubt.of(now)[:, 1].tolist() == raised


def test_a_doubt_lasts_until_the_drone_is_near_its_reference_in_height_and_slow() -> None:
    touches = np.ones(1, dtype=bool)  # whose reference sinks on, below the ground
    for error, lasts, touching in (
        ([0.2, 0.0], True, None),
        ([0.0, -0.3], True, ~touches),
        ([0.05, 0.1], False, None),
        ([0.2, -0.3], False, touches),
    ):
        doubt = Doubt.of_flight(FLIGHT, BOUNDS, 1)
        doubt.look(1.0, np.ones(1, dtype=bool), np.full(1, 1.0), np.zeros((1, 2)))
        for now in np.arange(1.0, 6.0, 0.02):
            doubt.hold(now, np.array([[9.0, 9.0, error[0], 9.0, 9.0, error[1]]]), touching)
        assert doubt.of(6.0)[0, 1] == lasts
        doubt.hold(9.0, np.ones((1, 6)))
        assert not doubt.of(9.0).any(), "none begins so"


def test_who_was_flown_softly_within_a_minute_lands_softly() -> None:
    doubt = Doubt.of_flight(FLIGHT, BOUNDS, 3)
    doubt.look(1.0, np.array([True, True, False]), np.ones(3), np.zeros((3, 2)))
    doubt.land(50.0, np.array([True, False, True]))
    assert doubt.any
    assert doubt.of(50.1).tolist() == [[False, True], [False, False], [False, False]]
    doubt.land(200.0, np.ones(3, dtype=bool))
    assert not doubt.of(200.1).any()


def test_who_has_left_the_ground_and_is_not_where_it_is_expected_is_doubted_for_longer_and_not_for_ever() -> None:
    doubt, three = Doubt.of_flight(FLIGHT, BOUNDS, 3), np.ones(3, dtype=bool)
    doubt.wait(3.0, three)
    for now in np.arange(60.5, 160.0) / 20.0:
        off = [0.004, 0.004 if now < 5.0 else 0.0, 0.002]
        doubt.look(now, three, np.zeros(3), np.column_stack([off, np.zeros(3)]))
        assert doubt.of(now)[:, 0].tolist() == [now < 6.95, now < 5.45, now < 4.5], now


def test_poses_that_do_not_come_teach_nothing_of_the_thrust() -> None:
    senses = Senses(CERTIFICATE, Policy(thrust_error_max=0.25), 2)
    estimated = np.zeros((2, 9))
    estimated[:, 2], estimated[:, 8] = 1.0, 0.5
    none = np.zeros(2, dtype=bool)
    before = senses.thrust.scale.copy()
    for tick in range(20):
        newest = np.array([0.02 * tick, 7.0])
        senses.note(np.zeros((2, 3)), estimated, estimated[:, :6], np.zeros(2), ~none, none, newest=newest)
        if tick == 1:
            first = senses.thrust.scale[1]
    assert senses.thrust.scale[0] > before[0] + 0.01
    assert senses.thrust.scale[1] == first


def test_who_is_to_sink_and_climbs_gets_less_thrust_if_it_is_seen() -> None:
    senses = Senses(CERTIFICATE, Policy(), 4)
    guidance = Guidance(CERTIFICATE.limits, 1.0, Policy().box, 4)
    for index in range(4):
        senses.enter(index, Mode.FLY, Mode.DESCEND, np.zeros(9), 0.0, guidance)
    climb = np.array([[0.0, 0.0, speed] for speed in (0.5, -0.5, 0.5, 5.0)])
    plain = senses.sinking.descent.thrust(1.0)
    less = plain - senses.sinking.thrusts(1.0, climb, np.array([True, True, False, True]))
    assert less[0] > 0.2
    assert less[1:3].tolist() == [0.0, 0.0]
    assert less[0] < less[3] <= 1.0


def test_who_went_aside_instead_of_up_is_led_down_slowly_by_what_is_seen_of_that() -> None:
    senses, guidance = Senses(CERTIFICATE, Policy(), 2), Guidance(CERTIFICATE.limits, 1.0, Policy().box, 2)
    both, rises = np.ones(2, dtype=bool), np.zeros((2, 9))
    for index in range(2):
        senses.enter(index, Mode.IDLE, Mode.UNLOCK, np.zeros(9), 0.0, guidance)
        senses.enter(index, Mode.UNLOCK, Mode.FLY, np.zeros(9), 0.3, guidance)
    rises[0, :2] = -0.12, 0.16  # up is there in the poses of the first one
    senses.look(1.0, rises, both, both, guidance)
    for index in range(2):
        senses.enter(index, Mode.FLY, Mode.DESCEND, rises[index], 1.0, guidance)
    plain = senses.sinking.descent.thrust(1.5)
    for speed, push in ((9.0, -2.5), (0.5, -1.8), (-0.3, -0.2), (-0.4, 0.0), (-0.8, 0.8), (-9.0, 1.0)):
        velocity = np.array([[-0.6 * speed, 0.8 * speed, 0.0]] * 2)
        found = senses.sinking.thrusts(1.5, velocity, both) - plain
        assert found[1] == 0.0
        assert found[0] == pytest.approx(push, abs=1e-9), "towards 0.4 m/s, upward by at most 1, downward by 2.5 m/s^2"


@given(off=st.floats(-0.19, 0.19), when=st.floats(0.5, 3.0), climb=st.floats(-0.5, 0.5))
@settings(max_examples=20)
def test_who_is_beside_its_path_when_its_poses_are_back_goes_on_with_it(off: float, when: float, climb: float) -> None:
    guidance = Guidance(CERTIFICATE.limits, 1.0, Policy().box, 1, FLIGHT)
    guidance.go_to(0, [0.0, 0.0, 1.5], 0.0)
    guidance.start(0, np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0]), 0.0)
    motion = guidance.references.motion(0, when)
    state = np.array([0.0, off, motion[0, 2], 0.0, 0.0, climb])
    assert guidance.start(0, state, when, resumed=True) == 0.0
    assert guidance.references.motion(0, when) == pytest.approx(motion, abs=1e-12)


def test_who_sinks_when_its_poses_are_back_comes_to_rest_before_the_floor() -> None:
    guidance = Guidance(CERTIFICATE.limits, 1.0, Policy().box, 1, FLIGHT)
    guidance.go_to(0, [0.0, 0.0, 1.0], 0.0)
    guidance.start(0, np.array([0.0, 0.0, 0.6, 0.1, 0.0, -0.5]), 0.0, resumed=True)
    times = np.arange(0.0, 10.0, 0.05)
    way = np.array([guidance.references.motion(0, time)[0] for time in times])
    assert way[:, 2].min() > 0.1
    assert way[-1] == pytest.approx([0.0, 0.0, 1.0], abs=1e-6)
    # and what comes then, in the middle of it, neither
    guidance.replan(0, 0.5)
    again = np.array([guidance.references.motion(0, time)[0] for time in times[10:]])
    assert again[:, 2].min() > 0.1
    assert np.abs(again[:, :2]).max() < 0.3


def test_a_landing_is_no_reason_to_doubt_the_loop_of_the_next_flight() -> None:
    vehicle = load_vehicle("cf21")
    fleet = SimulatedFleet(vehicle, 2, capture=MotionCapture(noise=1e-4), command_delay=LINK_DELAY)
    policy = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=vehicle.dynamics.drag_z)
    pilot, told = Pilot(CERTIFICATE, Tuning(2.0, 0.05, 1.0, CERTIFICATE.gain_max), policy, 2), []

    def look(_now: float, _samples: object, tick: Tick, _sent: object) -> None:
        told.extend(report.text for report in tick.reports)

    time = fly(pilot, fleet, vehicle, 1.0, look)
    for request in (lambda i: pilot.take_off(i, 0.3), pilot.land):
        for index in range(2):
            request(index)
        time = fly(pilot, fleet, vehicle, time + 5.0, look, start=time)
    assert fleet.bodies.grounded.all()
    assert not any("flown softly" in text for text in told)


def test_who_takes_off_from_a_table_with_its_thrust_lock_closed_is_not_doubted() -> None:
    vehicle, table = load_vehicle("cf21"), 0.7
    fleet = SimulatedFleet(vehicle, 1, capture=MotionCapture(noise=1e-4), command_delay=LINK_DELAY, floor=table)
    policy = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=vehicle.dynamics.drag_z)
    pilot, told = Pilot(CERTIFICATE, Tuning(2.0, 0.05, 1.0, CERTIFICATE.gain_max), policy, 1), []

    def look(_now: float, _samples: object, tick: Tick, _sent: object) -> None:
        told.extend(report.text for report in tick.reports)
        told.extend(transition.reason for transition in tick.transitions)

    time = fly(pilot, fleet, vehicle, 1.0, look)
    pilot.take_off(0, 0.5)
    fly(pilot, fleet, vehicle, time + 6.0, look, start=time)
    assert fleet.bodies.position[0, 2] == pytest.approx(table + 0.5, abs=0.05)
    assert any("on something: unlocked" in text for text in told)
    assert not any("flown softly" in text for text in told)


@pytest.mark.parametrize("scale", [0.92, 1.08])
def test_who_lands_on_a_table_that_nobody_knew_of_and_takes_off_from_it_is_not_doubted(scale: float) -> None:
    vehicle, table = load_vehicle("thrust_kit"), 0.4
    certificate = load_certificate("thrust_kit_adaptive_100hz")
    fleet = SimulatedFleet(
        vehicle, 1, capture=MotionCapture(noise=1e-4), command_delay=LINK_DELAY, thrust_scale=scale
    )  # fmt: skip
    policy = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=vehicle.dynamics.drag_z)
    pilot, told = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), policy, 1), []

    def look(_now: float, _samples: object, tick: Tick, _sent: object) -> None:
        told.extend(report.text for report in tick.reports)

    time = fly(pilot, fleet, vehicle, 1.0, look)
    pilot.take_off(0, 1.0)
    time = fly(pilot, fleet, vehicle, 7.0, look, start=time)
    fleet.bodies.floor = table
    pilot.land(0)
    time = fly(pilot, fleet, vehicle, 16.0, look, start=time)
    assert fleet.bodies.grounded[0]
    assert pilot.mode[0] == Mode.IDLE
    assert not any("flown softly" in text for text in told), "a table is nothing strange to land on"
    pilot.take_off(0, 0.8)
    fly(pilot, fleet, vehicle, 22.0, look, start=time)
    assert fleet.bodies.position[0, 2] == pytest.approx(table + 0.8, abs=0.05)
    assert not any("flown softly" in text for text in told), "nor to take off from, with an open lock"

"""A flight's life-cycle on the simulated Crazyflie with its firmware: take off, land, hand over, disarm."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate, load_certificate
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.crazyflie.wire import WireSetpoint, YawMode
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import GoalMode, Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.faults import FaultyLink, pitch_negated
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture, Sample

CONFIG = Path(__file__).parents[2] / "config"
CERTIFICATE = Certificate.load(CONFIG / "paper_experiment.yaml")
VEHICLE = VehicleProfile.load(CONFIG / "vehicles" / "cf21.yaml")


class Flight:
    """Drones on the floor, far from each other, and their pilot.

    Attributes:
        vehicle: what the pilot takes the drones for.
        modes: flight modes of the first one so far, repetitions removed.
        thrusts: thrust set-points so far, PWM.
        thrust_scales: estimates of all at the ticks at which all fly.
        now: time of the next tick, s.
    """

    def __init__(
        self,
        *scales: float,
        mu: float = 2.0,
        compensated: float = 0.0,
        floor: float = 0.0,
        thrust_error: float = 0.0,
        noise: float = 5e-4,
    ) -> None:
        policy = Policy(disturbance_max=compensated, floor=floor, thrust_error_max=thrust_error)
        scale = np.array(scales or [1.0])
        self.pilot = Pilot(CERTIFICATE, Tuning(mu, 0.05, 1.0, CERTIFICATE.gain_max), policy, len(scale))
        start = [[3.0 * index, 0.0, floor] for index in range(len(scale))]
        capture = MotionCapture(noise=noise)
        self.fleet = SimulatedFleet(VEHICLE, len(scale), start=start, floor=floor, thrust_scale=scale, capture=capture)
        self.vehicle = VEHICLE
        self.modes: list[Mode] = []
        self.thrusts: list[float] = []
        self.thrust_scales: list[FloatArray] = []
        self.now = 0.0
        self.let_pass(0.5)

    @property
    def height(self) -> float:
        return float(self.fleet.bodies.position[0, 2])

    @property
    def heights(self) -> FloatArray:
        return self.fleet.bodies.position[:, 2].copy()

    def ask(self, order: Callable[[int], None]) -> None:
        """Give all the same order."""
        for index in range(self.fleet.count):
            order(index)

    def let_pass(self, seconds: float) -> None:
        self.now = fly(self.pilot, self.fleet, self.vehicle, self.now + seconds, self._observe, start=self.now)

    def tick_after(self, seconds: float) -> Tick:
        """Return the last tick of some time, s."""
        self.let_pass(seconds)
        return self._tick

    def _observe(self, _now: float, _samples: list[Sample], tick: Tick, sent: dict[int, WireSetpoint]) -> None:
        mode = Mode(int(tick.mode[0]))
        self._tick = tick
        if (tick.mode == Mode.FLY).all():
            self.thrust_scales.append(tick.thrust_scale.copy())
        if self.modes[-1:] != [mode]:
            self.modes.append(mode)
        self.thrusts += [setpoint.thrust for setpoint in sent.values()]


@pytest.mark.parametrize("floor", [0.0, -0.4, 0.7])
def test_a_drone_takes_off_lands_and_can_take_off_again(floor: float) -> None:
    flight = Flight(floor=floor)
    for _ in range(2):
        flight.modes.clear()
        flight.pilot.take_off(0, 0.6)
        flight.let_pass(6.0)
        assert flight.height == pytest.approx(floor + 0.6, abs=0.15)
        flight.pilot.land(0)
        flight.let_pass(9.0)
        assert flight.modes == [Mode.IDLE, Mode.UNLOCK, Mode.FLY, Mode.REST, Mode.IDLE][-len(flight.modes) :]
        assert flight.height == pytest.approx(floor, abs=1e-3)
        assert flight.thrusts[-1] == 0.0


@pytest.mark.parametrize("mu", [0.0, 2.0])
@pytest.mark.parametrize("compensated", [0.0, 0.8])
def test_no_thrust_error_makes_it_take_the_air_for_the_floor(mu: float, compensated: float) -> None:
    flight = Flight(0.93, 1.0, 1.1, mu=mu, compensated=compensated)
    flight.ask(lambda index: flight.pilot.take_off(index, 1.5))
    flight.let_pass(10.0)
    assert (flight.heights > 0.3).all()
    flight.ask(flight.pilot.land)
    rested = np.zeros(3, dtype=bool)
    while not rested.all():
        tick = flight.tick_after(0.1)
        assert (flight.heights[tick.mode == Mode.REST] < 0.02).all()
        rested |= tick.mode == Mode.REST
        assert flight.now < 60.0, "it never touched down"


def test_after_the_landing_zeros_are_sent_for_longer_than_the_firmware_watches() -> None:
    flight = Flight()
    flight.pilot.take_off(0, 0.5)
    flight.let_pass(4.0)
    flight.pilot.land(0)
    flight.let_pass(9.0)
    zeros = len(flight.thrusts) - np.flatnonzero(flight.thrusts)[-1] - 1
    assert zeros * CERTIFICATE.period > 1.8
    assert flight.modes[-1] is Mode.IDLE


@pytest.mark.parametrize("name", ["cf21_adaptive_50hz", "cf21_tight_50hz", "cf21_soft_50hz"])
def test_as_the_thrust_goes_what_the_ground_carries_is_not_told_to_tilt(name: str) -> None:
    """With little thrust the noise of an estimate is a large tilt, which a firmware answers with its motors."""
    certificate = load_certificate(name)
    policy = Policy(disturbance_max=0.8, thrust_error_max=0.25)
    pilot = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), policy, 1)
    fleet = SimulatedFleet(VEHICLE, 1, capture=MotionCapture(noise=5e-4))
    tilts = []

    def observe(_now: float, _samples: list[Sample], tick: Tick, _sent: dict[int, WireSetpoint]) -> None:
        if fleet.bodies.position[0, 2] < 1e-3 and 0.0 < tick.input[0, 0] < 0.5 * GRAVITY:
            tilts.append(float(np.abs(tick.input[0, 1:]).max()))

    now = fly(pilot, fleet, VEHICLE, 0.5)
    pilot.take_off(0, 0.5)
    now = fly(pilot, fleet, VEHICLE, now + 8.0, observe, start=now)
    pilot.land(0)
    fly(pilot, fleet, VEHICLE, now + 10.0, observe, start=now)
    assert len(tilts) > 0.2 / certificate.period
    assert max(tilts) == 0.0


def test_a_new_goal_ends_the_landing() -> None:
    flight = Flight()
    flight.pilot.take_off(0, 1.0)
    flight.let_pass(6.0)
    flight.pilot.land(0)
    flight.let_pass(1.0)
    flight.pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 1.2]))
    flight.let_pass(10.0)
    assert flight.modes[-1] is Mode.FLY
    assert flight.height == pytest.approx(1.2, abs=0.15)


def test_what_is_unsafe_is_refused_with_the_reason() -> None:
    flight = Flight()
    pilot = flight.pilot
    with pytest.raises(FlatsatError, match="in IDLE: only one in FLY or LEVEL or DESCEND can land"):
        pilot.land(0)
    with pytest.raises(FlatsatError, match="in IDLE: only one in FLY can be handed over"):
        pilot.hand_over(0)
    with pytest.raises(FlatsatError, match=r"height = -1\.0 m"):
        pilot.take_off(0, -1.0)
    pilot.take_off(0, 0.5)
    flight.let_pass(4.0)
    with pytest.raises(FlatsatError, match="only one on the ground takes off"):
        pilot.take_off(0, 0.5)
    with pytest.raises(FlatsatError, match="in FLY: only one in IDLE or UNLOCK or CUT or REST or FALLEN can be"):
        pilot.arm(0, False)
    unseen = Pilot(CERTIFICATE, Tuning(2.0, 0.05, 1.0, 2.0), Policy(), 1)
    unseen.tick(0.0)
    with pytest.raises(FlatsatError, match="pose is not known"):
        unseen.take_off(0, 0.5)


def test_a_disarmed_drone_stays_on_the_ground_until_it_is_armed() -> None:
    flight = Flight()
    flight.pilot.arm(0, False)
    with pytest.raises(FlatsatError, match="disarmed: arm it first"):
        flight.pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 1.0]))
    with pytest.raises(FlatsatError, match="disarmed: arm it first"):
        flight.pilot.take_off(0, 0.5)
    flight.let_pass(2.0)
    assert (flight.modes, flight.thrusts) == ([Mode.IDLE], [])
    flight.pilot.arm(0, True)
    flight.pilot.take_off(0, 0.5)
    flight.let_pass(3.0)
    assert flight.modes[-1] is Mode.FLY


@pytest.mark.parametrize("mode", [Mode.UNLOCK, Mode.REST])
def test_a_drone_whose_motors_are_not_told_to_turn_can_be_disarmed(mode: Mode) -> None:
    flight = Flight()
    flight.pilot.take_off(0, 0.5)
    if mode is Mode.REST:
        flight.let_pass(4.0)
        flight.pilot.land(0)
    while flight.pilot.mode[0] != mode:
        flight.let_pass(0.1)
    flight.pilot.arm(0, False)
    sent = len(flight.modes)
    flight.let_pass(5.0)
    assert flight.modes[sent - 1 :] == [mode, Mode.IDLE]
    with pytest.raises(FlatsatError, match="disarmed: arm it first"):
        flight.pilot.take_off(0, 0.5)


def test_when_the_controller_ends_nobody_can_be_armed_to_fly_on_or_take_off() -> None:
    flight = Flight(1.0, 1.0)
    flight.pilot.take_off(0, 0.5)
    flight.let_pass(4.0)
    flight.pilot.retire()
    for index in range(2):
        with pytest.raises(FlatsatError, match="controller ends: no drone is armed any more"):
            flight.pilot.arm(index, True)
        with pytest.raises(FlatsatError, match="controller ends: drones in the air land"):
            flight.pilot.set_goal(index, [3.0 * index, 0.0, 1.0])
    with pytest.raises(FlatsatError, match="controller ends: drones in the air land"):
        flight.pilot.take_off(1, 0.5)
    flight.let_pass(8.0)
    assert (flight.pilot.mode == Mode.IDLE).all()
    assert flight.fleet.bodies.grounded.all()


def test_a_drone_handed_over_is_not_commanded_any_more() -> None:
    flight = Flight()
    flight.pilot.take_off(0, 0.5)
    flight.let_pass(4.0)
    flight.pilot.hand_over(0)
    sent = len(flight.thrusts)
    flight.let_pass(2.0)
    assert flight.modes[-1] is Mode.IDLE
    assert len(flight.thrusts) == sent


@pytest.mark.parametrize(("noise", "near"), [(0.0, 0.005), (1e-3, 0.03)])
def test_at_10_hz_a_drone_whose_disturbance_is_compensated_hovers_this_near_its_goal(noise: float, near: float) -> None:
    policy = Policy(disturbance_max=0.8, goal_mode=GoalMode.STEP)
    pilot = Pilot(CERTIFICATE, Tuning(2.0, 0.05, 1.0, CERTIFICATE.gain_max), policy, 1)
    fleet = SimulatedFleet(VEHICLE, 1, start=[[0.0, 0.0, 0.0]], capture=MotionCapture(noise=noise), seed=3)
    goal, errors = np.array([0.6, 0.6, 0.8]), []

    def observe(now: float, *_: object) -> None:
        if now > 10.0:
            errors.append(np.abs(fleet.bodies.position[0] - goal).max())

    pilot.set_reference(0, Trajectory.hold(goal))
    fly(pilot, fleet, VEHICLE, 20.0, observe)
    assert max(errors) < near


@pytest.mark.parametrize("yaw_mode", YawMode)
def test_the_drone_turns_to_the_yaw_of_its_goal_by_rate_and_by_angle(yaw_mode: YawMode) -> None:
    pilot = Pilot(CERTIFICATE, Tuning(2.0, 0.05, 1.0, CERTIFICATE.gain_max), Policy(), 1)
    fleet = SimulatedFleet(VEHICLE, 1, start=[[0.0, 0.0, 0.0]], yaw=-0.5, yaw_mode=yaw_mode)
    pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 0.6], 2.4))
    fly(pilot, fleet, VEHICLE, 12.0, lambda *_: None)
    assert fleet.bodies.angles[0, 2] == pytest.approx(2.4, abs=0.02)
    assert np.linalg.norm(fleet.bodies.position[0] - [0.0, 0.0, 0.6]) < 0.15


@pytest.mark.parametrize("armed", [True, False])
def test_a_drone_flown_by_its_own_commander_is_taken_over_if_it_was_armed_on_the_ground(armed: bool) -> None:
    flight = Flight()
    if armed:
        flight.pilot.arm(0, True)
        flight.let_pass(1.0)
        flight.fleet.notify_setpoints_stop(0)
    flight.fleet.take_off(0, 0.6, 2.0)
    flight.let_pass(4.0)
    assert flight.height == pytest.approx(0.6, abs=0.1)
    flight.pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 0.6]))
    lowest = flight.height
    for _ in range(10):
        flight.let_pass(0.5)
        lowest = min(lowest, flight.height)
    # the trap: with a closed thrust lock, the first set-point is a motor cut
    assert (lowest > 0.5) if armed else (lowest == 0.0)


def test_a_drone_is_handed_over_to_its_own_commander() -> None:
    flight = Flight()
    flight.pilot.take_off(0, 0.6)
    flight.let_pass(6.0)
    before = flight.height
    flight.pilot.hand_over(0)
    flight.let_pass(0.3)
    flight.fleet.notify_setpoints_stop(0)
    flight.fleet.go_to(0, [0.0, 0.0, 0.0], 0.0, 1.0, relative=True)
    flight.let_pass(8.0)
    assert flight.height == pytest.approx(before, abs=0.05)
    assert flight.modes[-1] is Mode.IDLE


def test_the_thrust_scale_is_found_in_flight_and_kept_through_landings() -> None:
    scales = [0.9, 1.0, 1.1]
    flight = Flight(*scales, compensated=0.8, thrust_error=0.2)
    flight.ask(lambda index: flight.pilot.take_off(index, 0.6))
    flight.let_pass(12.0)
    assert flight.thrust_scales[-1] == pytest.approx(scales, abs=0.02)
    flight.ask(flight.pilot.land)
    assert (flight.tick_after(9.0).mode == Mode.IDLE).all()
    flight.thrust_scales.clear()
    flight.ask(lambda index: flight.pilot.take_off(index, 0.6))
    flight.let_pass(12.0)
    assert (np.abs(np.array(flight.thrust_scales) - scales) < 0.03).all()


@pytest.mark.parametrize(("scales", "noise"), [((1.0,), 0.0), ((1.0, 1.2), 5e-4), ((0.8, 1.0), 2e-3)])
def test_whatever_the_thrust_and_the_noise_it_takes_off_without_a_leap(scales: tuple[float, ...], noise: float) -> None:
    flight = Flight(*scales, compensated=0.8, thrust_error=0.25, noise=noise)
    flight.ask(lambda index: flight.pilot.take_off(index, 0.5))
    heights = []
    for _ in range(100):
        flight.let_pass(0.1)
        heights.append(flight.heights)
    assert np.max(heights) < 0.6
    assert heights[-1] == pytest.approx(0.5, abs=0.05)


def test_a_drone_taken_over_in_the_air_neither_drops_nor_leaps() -> None:
    scales = np.array([0.9, 1.0, 1.1])
    flight = Flight(*scales, compensated=0.8, thrust_error=0.25)
    places = [[3.0 * index, 0.0, 1.0] for index in range(3)]
    flight.fleet = SimulatedFleet(
        VEHICLE, 3, start=places, flying=True, thrust_scale=scales, capture=MotionCapture(noise=5e-4)
    )
    flight.now = 0.0
    for _ in range(5):  # whoever flew them before
        for index, thrust in enumerate(VEHICLE.pwm_from_thrust(GRAVITY / scales)):
            flight.fleet.command(index, 0.0, 0.0, 0.0, float(thrust))
        flight.let_pass(0.1)
    flight.ask(lambda index: flight.pilot.set_goal(index, places[index]))
    heights = []
    for _ in range(60):
        tick = flight.tick_after(0.1)
        heights.append(flight.heights)
    assert (tick.mode == Mode.FLY).all()
    assert np.min(heights) > 0.8
    assert np.max(heights) < 1.2


def test_a_drone_that_is_locked_again_after_its_unlocking_stays_on_the_ground_until_it_is_armed() -> None:
    flight = Flight()
    flight.pilot.take_off(0, 0.6)
    flight.let_pass(1.2)
    flight.fleet.reboot(0)  # as if the zeros had gone unheard
    flight.let_pass(25.0)
    assert flight.height == 0.0
    assert flight.modes == [Mode.IDLE, Mode.UNLOCK, Mode.FLY, Mode.DESCEND, Mode.FALLEN][-len(flight.modes) :]
    flight.pilot.arm(0, True)
    flight.let_pass(0.1)
    flight.pilot.take_off(0, 0.6)
    flight.let_pass(6.0)
    assert flight.height == pytest.approx(0.6, abs=0.15)


@pytest.mark.parametrize(("armed", "flies"), [(0.5, True), (1.5, True), (10.5, False)])
def test_a_brushless_drone_with_poses_at_10_hz_takes_off_once_it_is_armed_but_not_when_nobody_waits_any_more(
    armed: float, flies: bool
) -> None:
    flight = Flight()
    flight.vehicle = VehicleProfile.load(CONFIG / "vehicles" / "brushless.yaml")
    flight.fleet = SimulatedFleet(flight.vehicle, 1, capture=MotionCapture(rate=10.0, noise=5e-4))
    flight.now = 0.0
    flight.let_pass(min(armed, 1.0))
    if armed < 1.0:
        flight.fleet.firmware.request_arming(0, True)
    flight.pilot.take_off(0, 0.5)
    flight.let_pass(armed - flight.now)
    flight.fleet.firmware.request_arming(0, True)
    flight.let_pass(4.0 if flies else 12.0)
    assert (flight.height > 0.3) == flies
    assert flight.modes[-1] is (Mode.FLY if flies else Mode.FALLEN)
    assert flight.thrusts[-1] > 0.0 or not flies


def test_after_an_emergency_and_a_power_cycle_nothing_starts_unasked() -> None:
    flight = Flight()
    flight.pilot.take_off(0, 0.5)
    flight.let_pass(4.0)
    flight.fleet.firmware.request_emergency(0)
    flight.let_pass(3.0)
    flight.fleet.reboot(0)
    flight.let_pass(1.0)
    sent = len(flight.thrusts)
    flight.fleet.command(0, 0.0, 0.0, 0.0, 0.0)  # crazyswarm2's Python server sends one when it starts: it unlocks
    flight.let_pass(5.0)
    assert not any(flight.thrusts[sent:])
    assert flight.height == 0.0
    with pytest.raises(FlatsatError, match="arm it again"):
        flight.pilot.take_off(0, 0.5)
    flight.pilot.arm(0, True)
    flight.let_pass(0.2)
    flight.pilot.take_off(0, 0.5)
    flight.let_pass(5.0)
    assert flight.height > 0.3


def test_a_pitch_of_the_other_back_ends_sign_is_noticed_in_a_hover_within_0_3_m_and_lands() -> None:
    flight = Flight()
    certificate = load_certificate("cf21_50hz")
    # as the controller flies by default
    policy = Policy(disturbance_max=0.8, thrust_error_max=0.25)
    flight.pilot = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), policy, 1)
    fleet = SimulatedFleet(VEHICLE, 1, wind=Wind(gust=0.05), capture=MotionCapture(noise=5e-4))
    link = FaultyLink(fleet)
    link.commands.append(pitch_negated(0))
    flight.fleet, flight.now = link, 0.0  # type: ignore[assignment]
    flight.let_pass(1.0)
    flight.pilot.take_off(0, 0.5)
    for _ in range(100):
        flight.let_pass(0.1)
        if flight.modes[-1] is Mode.DESCEND:
            break
    assert flight.modes[-1] is Mode.DESCEND
    assert np.linalg.norm(fleet.bodies.position[0, :2]) < 0.3
    flight.let_pass(4.0)
    assert fleet.bodies.grounded[0]
    assert flight.thrusts[-1] == 0.0

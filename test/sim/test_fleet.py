"""Laws of the simulated fleet as a whole."""

import dataclasses
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.crazyflie.wire import YawMode
from flatsat_ros.law.flatness import acceleration_from_input, input_from_acceleration
from flatsat_ros.sim.dynamics import STEP, Wind
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.power import Battery
from flatsat_ros.sim.sensor import NOISE_BOUND, MotionCapture, PoseSampler

VEHICLES = Path(__file__).parents[2] / "config" / "vehicles"
CF21 = VehicleProfile.load(VEHICLES / "cf21.yaml")
HOVER = float(CF21.pwm_from_thrust(GRAVITY))
END = 0.4  # s
START = [[0.0, 0.0, 1.0], [1.0, 0.0, 1.5], [0.0, 2.0, 0.7]]
ROUGH: dict[str, Any] = {
    "flying": True,
    "wind": Wind(mean=(0.5, 0.0, 0.0), gust=0.5),
    "battery": Battery(sag=0.4, drain=0.01),
    "command_delay": 0.013,
    "capture": MotionCapture(rate=90.0, noise=1e-3, dropout=0.2, gaps=((0.1, 0.2),), latency=0.02),
}

commands = st.lists(
    st.tuples(st.floats(0.0, 0.04), st.integers(0, 2), st.floats(-20, 20), st.floats(-20, 20), st.floats(-50, 50)),
    min_size=1,
    max_size=8,
)


def fly(fleet: SimulatedFleet, script: list[tuple[float, int, float, float, float]], stops: list[float]) -> None:
    """Play commands, the first number of each being the pause before it; visit the stops on the way."""
    time = 0.0
    for pause, index, roll, pitch, yaw_rate in script:
        for stop in sorted(stops):
            if time < stop < time + pause:
                fleet.advance_to(stop)
        time += pause
        fleet.advance_to(time)
        fleet.command(index, roll, pitch, yaw_rate, HOVER * (1.0 + roll / 100.0))
    for stop in sorted(stops):
        if stop > time:
            fleet.advance_to(stop)
    fleet.advance_to(END)


@settings(max_examples=20, deadline=None)
@given(commands, st.lists(st.floats(0.0, END), max_size=10))
def test_how_advance_to_is_chopped_makes_no_difference(
    script: list[tuple[float, int, float, float, float]], stops: list[float]
) -> None:
    fleets = [SimulatedFleet(CF21, 3, start=START, seed=3, **ROUGH) for _ in range(2)]
    fly(fleets[0], script, [])
    fly(fleets[1], script, stops)
    for whole, chopped in zip(fleets[0].poses(), fleets[1].poses(), strict=True):
        assert_array_equal(whole, chopped)
    samples = [fleet.measurements(END) for fleet in fleets]
    assert len(samples[0]) == len(samples[1]) > 0
    for one, other in zip(*samples, strict=True):
        assert one.stamp == other.stamp
        assert one.drone == other.drone
        assert_array_equal(one.position, other.position)


@settings(max_examples=10, deadline=None)
@given(commands, st.sampled_from(["ideal", "identified"]))
def test_a_batch_is_the_drones_one_by_one(script: list[tuple[float, int, float, float, float]], dynamics: str) -> None:
    room: dict[str, Any] = {"dynamics": dynamics, "seed": 5, "flying": True, "wind": Wind(gust=0.5)}
    together = SimulatedFleet(CF21, 3, start=START, thrust_scale=[0.95, 1.0, 1.05], **room)
    fly(together, script, [])
    for index, scale in enumerate((0.95, 1.0, 1.05)):
        alone = SimulatedFleet(CF21, 1, start=[START[index]], thrust_scale=scale, **room)
        # the same times for the commands of the others, so that rounding of the times is the same
        time = 0.0
        for pause, receiver, roll, pitch, yaw_rate in script:
            time += pause
            alone.advance_to(time)
            if receiver == index:
                alone.command(0, roll, pitch, yaw_rate, HOVER * (1.0 + roll / 100.0))
        alone.advance_to(END)
        assert_allclose(alone.bodies.position[0], together.bodies.position[index], rtol=0, atol=1e-13)
        assert_allclose(alone.bodies.quaternion[0], together.bodies.quaternion[index], rtol=0, atol=1e-13)


def test_another_seed_is_another_flight() -> None:
    ends = []
    for seed in (0, 0, 1):
        fleet = SimulatedFleet(CF21, 1, start=[START[0]], flying=True, wind=Wind(gust=0.5), seed=seed)
        fleet.advance_to(0.4)
        ends.append(fleet.poses()[0])
    assert_array_equal(ends[0], ends[1])
    assert np.linalg.norm(ends[0] - ends[2]) > 1e-4


@settings(max_examples=50)
@given(st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3)), st.floats(-3.0, 3.0))
def test_ideal_chain_from_the_wire_achieves_the_commanded_acceleration(
    v: tuple[float, float, float], yaw: float
) -> None:
    fleet = SimulatedFleet(CF21, 1, dynamics="ideal", start=[[0, 0, 50]], yaw=yaw, flying=True)
    thrust, roll, pitch = input_from_acceleration(v, yaw)
    fleet.command(0, np.rad2deg(roll), np.rad2deg(pitch), 0.0, float(CF21.pwm_from_thrust(thrust)))
    fleet.advance_to(0.1)
    clipped = min(thrust, CF21.thrust_max)
    achieved = acceleration_from_input((clipped, roll, pitch), yaw)
    assert_allclose(fleet.bodies.velocity[0], achieved * 0.1, atol=1e-12)
    assert_allclose(fleet.bodies.position[0] - (0, 0, 50), achieved * 0.005, atol=1e-12)


def hover_force(battery: Battery, pwm: float, seconds: float = 1.0) -> tuple[float, SimulatedFleet]:
    """Return the force, N, after holding a thrust command, high above the floor."""
    fleet = SimulatedFleet(CF21, 1, start=[[0, 0, 500]], flying=True, battery=battery)
    for k in range(round(seconds * 10)):
        fleet.command(0, 0.0, 0.0, 0.0, pwm)
        fleet.advance_to((k + 1) / 10)
    return float(fleet.bodies.thrust[0]) * CF21.mass, fleet


@pytest.mark.parametrize("voltage", [3.5, 3.8, 4.2])
def test_hover_pwm_of_31_8_grams_carries_31_8_grams_to_a_motor_step_at_any_voltage(voltage: float) -> None:
    force, _ = hover_force(Battery(voltage=voltage), 42593.0, seconds=2.0)
    assert 0.0318 * GRAVITY - 0.0045 < force <= 0.0318 * GRAVITY + 1e-4  # an 8-bit step is up to 4.5 mN, rounded down


def test_battery_compensation_holds_the_force_until_the_motor_command_is_full() -> None:
    rested, _ = hover_force(Battery(voltage=4.0), 60000.0)
    sagging, fleet = hover_force(Battery(voltage=4.0, sag=0.5), 60000.0)
    assert sagging == pytest.approx(rested, rel=0.02)
    assert fleet.power.voltage[0] == pytest.approx(4.0 - 0.5 * sagging / CF21.force_max, abs=0.01)
    weak, fleet = hover_force(Battery(voltage=3.0, sag=0.5), 60000.0)
    assert fleet.power.ratio[0] == 1.0
    assert weak < 0.9 * rested


def test_the_battery_drains_with_the_load() -> None:
    _, fleet = hover_force(Battery(voltage=4.0, drain=0.1), HOVER, seconds=2.0)
    assert 4.0 - fleet.power.voltage[0] == pytest.approx(0.1 * 2.0 * HOVER / 65535, rel=0.02)


def test_motor_commands_come_in_8_bit_steps_and_in_11_bit_steps_with_dshot() -> None:
    brushless = VehicleProfile.load(VEHICLES / "brushless.yaml")
    for profile, low, high in ((CF21, 10, 30), (brushless, 100, 300)):
        pwm = np.linspace(0.9, 1.1, 2000) * float(profile.pwm_from_thrust(GRAVITY))
        fleet = SimulatedFleet(profile, 2000)
        forces = fleet.power.step(pwm, np.full(2000, True))
        assert low < len(np.unique(forces)) < high
        assert (forces <= pwm * profile.force_max / 65535 + 1e-9).all()


@pytest.mark.parametrize("dynamics", ["identified", "ideal"])
def test_a_bent_thrust_map_gives_the_force_that_the_profile_promises(dynamics: str) -> None:
    bent = dataclasses.replace(CF21, thrust_slope=0.75, force_max=0.4)
    pwm = np.linspace(0.8, 1.1, 200) * float(bent.pwm_from_thrust(GRAVITY))
    fleet = SimulatedFleet(bent, 200, dynamics=dynamics)
    forces = fleet.power.step(pwm, np.full(200, True))
    assert forces == pytest.approx(bent.mass * bent.thrust_from_pwm(pwm), rel=0.02)  # 8-bit steps
    assert abs(np.polyfit(np.log(pwm), np.log(forces), 1)[0] - 0.75) < 0.03


@pytest.mark.parametrize("dynamics", ["identified", "ideal"])
def test_the_force_goes_with_the_voltage_under_load_as_the_profile_says(dynamics: str) -> None:
    drone, battery = (
        dataclasses.replace(CF21, thrust_voltage=0.5, voltage=3.6),
        Battery(voltage=4.2, sag=0.3, drain=2.0),
    )
    pwm = np.full(1, 40000.0)
    fleets = [SimulatedFleet(each, 1, dynamics=dynamics, battery=battery) for each in (drone, CF21)]
    for _ in range(100):  # the battery empties by 0.2 V
        before = fleets[0].power.voltage.copy()
        force, same = (fleet.power.step(pwm, np.full(1, True)) for fleet in fleets)
        if dynamics == "ideal":  # else the steps of the motor command differ a little
            assert force == pytest.approx(same * (before / 3.6) ** 0.5, rel=1e-12)
    assert force == pytest.approx(same * (before / 3.6) ** 0.5, rel=0.02)
    assert 3.6 < before[0] < 4.0


def test_idling_motors_never_pull_downward() -> None:
    brushless = VehicleProfile.load(VEHICLES / "brushless.yaml")
    fleet = SimulatedFleet(brushless, 1, battery=Battery(voltage=3.0))  # where the force curve's fit is below 0
    assert fleet.power.step(np.zeros(1), np.full(1, True))[0] == 0.0


def test_a_force_below_the_motors_smallest_is_none() -> None:
    smallest = 65535 * 4.0 * CF21.motors.force_min / CF21.force_max
    assert hover_force(Battery(), 0.99 * smallest, seconds=0.2)[1].power.ratio[0] == 0.0
    assert hover_force(Battery(), 1.01 * smallest, seconds=0.2)[1].power.ratio[0] > 0.0


@pytest.mark.parametrize("dynamics", ["ideal", "identified"])
def test_thrust_scale_scales_the_force(dynamics: str) -> None:
    fleet = SimulatedFleet(
        CF21, 2, dynamics=dynamics, start=[[0, 0, 500], [1, 0, 500]], flying=True, thrust_scale=[1.0, 0.9]
    )
    for k in range(20):
        for index in range(2):
            fleet.command(index, 0.0, 0.0, 0.0, HOVER)
        fleet.advance_to((k + 1) / 10)
    assert fleet.bodies.thrust[1] == pytest.approx(0.9 * fleet.bodies.thrust[0], rel=1e-4)


@pytest.mark.parametrize(("dynamics", "dead_time"), [("ideal", 0.0), ("identified", 0.002)])
def test_a_command_acts_after_its_delay(dynamics: str, dead_time: float) -> None:
    fleet = SimulatedFleet(CF21, 1, dynamics=dynamics, start=[[0, 0, 9]], flying=True, command_delay=0.02)
    fleet.advance_to(0.1)
    fleet.command(0, 10.0, 0.0, 0.0, HOVER)
    fleet.advance_to(0.1 + 0.02 + dead_time)
    assert fleet.bodies.angles[0, 0] == 0.0
    fleet.advance_to(fleet.time + STEP)
    assert fleet.bodies.angles[0, 0] > 0.0


@pytest.mark.parametrize("yaw_mode", YawMode)
def test_a_flying_start_hovers_until_the_watchdog_speaks(yaw_mode: YawMode) -> None:
    fleet = SimulatedFleet(CF21, 1, dynamics="ideal", start=[[0, 0, 1]], yaw=2.0, flying=True, yaw_mode=yaw_mode)
    fleet.advance_to(2.0)
    assert_allclose(fleet.poses()[0], [[0, 0, 1]], atol=1e-9)
    assert_allclose(fleet.bodies.angles, [[0, 0, 2.0]], atol=1e-9)
    fleet.advance_to(4.0)
    assert_allclose(fleet.poses()[0], [[0, 0, 0]])


def test_measurements_are_the_truth_at_their_stamps() -> None:
    fleet = SimulatedFleet(CF21, 3, start=START, flying=True)
    truth = {0.0: fleet.poses()}
    for k in range(1, 51):
        fleet.advance_to(k * 0.01)
        truth[round(fleet.time, 6)] = fleet.poses()
    samples = fleet.measurements(0.5)
    assert len(samples) == 3 * 51
    for sample in samples:
        positions, quaternions = truth[round(sample.stamp, 6)]
        assert_array_equal(sample.position, positions[sample.drone])
        assert_array_equal(sample.quaternion, quaternions[sample.drone])
    assert fleet.measurements(0.5) == []


@pytest.mark.parametrize("rate", [30.0, 100.0, 240.0])
def test_measurements_come_at_their_rate_on_the_grid(rate: float) -> None:
    fleet = SimulatedFleet(CF21, 1, capture=MotionCapture(rate=rate))
    fleet.advance_to(2.0)
    stamps = np.array([sample.stamp for sample in fleet.measurements(2.0)])
    late = stamps - np.arange(len(stamps)) / rate
    assert len(stamps) == 2 * rate + 1
    assert (late > -1e-9).all()
    assert (late < STEP).all()


def test_measurements_are_late_by_the_latency_under_their_true_stamp() -> None:
    fleet = SimulatedFleet(CF21, 1, capture=MotionCapture(latency=0.05))
    fleet.advance_to(1.0)
    assert max(sample.stamp for sample in fleet.measurements(0.7)) == pytest.approx(0.65)
    assert min(sample.stamp for sample in fleet.measurements(1.0)) == pytest.approx(0.66)


def test_noise_and_drop_out_are_as_asked() -> None:
    fleet = SimulatedFleet(CF21, 10, capture=MotionCapture(rate=500.0, noise=1e-3, dropout=0.25))
    fleet.advance_to(2.0)
    samples = fleet.measurements(2.0)
    errors = np.array([sample.position - fleet.poses()[0][sample.drone] for sample in samples])
    assert len(samples) == pytest.approx(0.75 * 10 * 1001, rel=0.03)
    assert_allclose(errors.std(axis=0), 1e-3, rtol=0.05)
    assert_allclose(errors.mean(axis=0), 0.0, atol=6e-5)


@pytest.mark.parametrize("draw", [(0.0, 0.0, 0.0), (3.0, -4.1, 5.1), (-30.0, 40.0, 1.0), (0.3, 0.4, -7.0)])
def test_noise_keeps_a_bound_that_is_a_multiple_of_its_standard_deviation(draw: tuple[float, float, float]) -> None:
    generator = Mock()
    generator.standard_normal.return_value, generator.random.return_value = np.array([draw]), np.ones(1)
    recorder = PoseSampler(MotionCapture(noise=2.0), generator)
    recorder.take(0.0, np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]))
    (sample,) = recorder.release(0.0)
    x, y, z = np.array(draw)
    assert_allclose(np.hypot(*sample.position[:2]), 2.0 * min(np.hypot(x, y), NOISE_BOUND))
    assert_allclose(sample.position[2], 2.0 * np.clip(z, -NOISE_BOUND, NOISE_BOUND))
    assert_allclose(sample.position[0] * y, sample.position[1] * x)  # its direction is that drawn


def test_gaps_are_silent() -> None:
    fleet = SimulatedFleet(CF21, 1, capture=MotionCapture(gaps=((0.2, 0.8),)))
    fleet.advance_to(1.0)
    stamps = [sample.stamp for sample in fleet.measurements(1.0)]
    assert not [stamp for stamp in stamps if 0.2 <= stamp < 0.8]
    assert len(stamps) == 101 - 60


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"dynamics": "perfect"}, "ideal"),
        ({"count": 0}, "count"),
        ({"start": [[0.0, 0.0, 0.0]]}, r"\(2, 3\)"),
        ({"start": [[0.0, 0.0, np.nan]] * 2}, "finite"),
        ({"yaw": [1.0, 2.0, 3.0]}, "yaw"),
        ({"thrust_scale": 0.0}, "thrust_scale"),
        ({"thrust_scale": [1.0]}, "thrust_scale"),
        ({"command_delay": -1.0}, "command_delay"),
        ({"floor": np.inf}, "floor"),
    ],
)
def test_impossible_arguments_are_refused(change: dict[str, object], complaint: str) -> None:
    with pytest.raises(FlatsatError, match=complaint):
        SimulatedFleet(**({"profile": CF21, "count": 2} | change))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "make",
    [
        lambda: MotionCapture(rate=0.0),
        lambda: MotionCapture(noise=-1.0),
        lambda: MotionCapture(dropout=1.1),
        lambda: MotionCapture(gaps=((2.0, 1.0),)),
        lambda: MotionCapture(latency=np.nan),
        lambda: Battery(voltage=0.0),
        lambda: Battery(sag=5.0),
        lambda: Battery(drain=-1.0),
    ],
)
def test_impossible_equipment_is_refused(make: type) -> None:
    with pytest.raises(FlatsatError, match="must be"):
        make()


def test_time_does_not_run_backward_and_strangers_are_refused() -> None:
    fleet = SimulatedFleet(CF21, 1)
    fleet.advance_to(1.0)
    for time in (0.5, np.nan, np.inf):
        with pytest.raises(FlatsatError, match="time"):
            fleet.advance_to(time)
    with pytest.raises(FlatsatError, match="index"):
        fleet.command(1, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(FlatsatError, match="index"):
        fleet.reboot(-1)


@pytest.mark.parametrize("sent", [-1.0, 65536.0, np.nan, np.inf])
def test_a_thrust_that_no_packet_can_carry_is_refused(sent: float) -> None:
    fleet = SimulatedFleet(CF21, 1)
    with pytest.raises(FlatsatError, match="65535"):
        fleet.command(0, 0.0, 0.0, 0.0, sent)
    with pytest.raises(FlatsatError, match="65535"):
        fleet.firmware.receive(0, 0.0, 0.0, 0.0, sent, 0)


@pytest.mark.parametrize(
    ("call", "refused"),
    [
        (lambda fleet: fleet.take_off(1, 1.0, 2.0), "index = 1: must be from 0 to 0"),
        (lambda fleet: fleet.take_off(0, np.nan, 2.0), "height = nan m: must be"),
        (lambda fleet: fleet.take_off(0, 1.0, -2.0), "duration = -2.0 s: must be"),
        (lambda fleet: fleet.take_off(0, 1.0, 2.0, np.inf), "yaw = inf rad: must be"),
        (lambda fleet: fleet.land(0, np.inf, 2.0), "height = inf"),
        (lambda fleet: fleet.land(0, 0.0, np.inf), "duration = inf"),
        (lambda fleet: fleet.go_to(0, [0.0, np.nan, 1.0], 0.0, 1.0), "an entry of position = nan"),
        (lambda fleet: fleet.go_to(0, [0.0, 1.0], 0.0, 1.0), "shape of position = "),
        (lambda fleet: fleet.go_to(0, [[0.0, 1.0, 2.0]], 0.0, 1.0), r"shape of position = \(1, 3\): must be \(3,\)"),
        (lambda fleet: fleet.go_to(0, [0.0, 0.0, 1.0], np.nan, 1.0), "yaw = nan rad: must be"),
        (lambda fleet: fleet.go_to(0, [0.0, 0.0, 1.0], 0.0, np.nan), "duration = nan s: must be"),
        (lambda fleet: fleet.notify_setpoints_stop(-1), "index = -1"),
    ],
)
def test_a_bad_high_level_command_is_refused_by_name(call: object, refused: str) -> None:
    with pytest.raises(FlatsatError, match=refused):
        call(SimulatedFleet(CF21, 1))  # type: ignore[operator]


def test_a_command_under_way_does_not_change_with_its_senders_array() -> None:
    fleet, place = SimulatedFleet(CF21, 1, flying=True, start=[[0.0, 0.0, 1.0]]), np.array([0.0, 0.0, 1.5])
    fleet.notify_setpoints_stop(0)
    fleet.go_to(0, place, 0.0, 1.0)
    place[2] = 0.5
    fleet.advance_to(3.0)
    assert fleet.poses()[0][0, 2] > 1.4


def test_a_profile_may_clip_the_thrust_lower() -> None:
    profile = dataclasses.replace(CF21, pwm_max=50000.0)
    fleet = SimulatedFleet(profile, 1, dynamics="ideal", start=[[0, 0, 9]], flying=True)
    fleet.command(0, 0.0, 0.0, 0.0, 60000.0)
    fleet.advance_to(0.1)
    assert fleet.bodies.thrust[0] == pytest.approx(CF21.thrust_from_pwm(50000.0))

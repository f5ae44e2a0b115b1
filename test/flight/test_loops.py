"""The loop of flight certificates: what is claimed of a flight, and when it is not."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.resources import config_path
from flatsat_ros.base.strict_yaml import read_yaml
from flatsat_ros.certificate.certificate import Certificate, load_certificate
from flatsat_ros.certificate.flight_tube import AxisTube
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import YawMode
from flatsat_ros.flight import telemetry
from flatsat_ros.flight.assumptions import Assumption
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import GoalMode, Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture, Sample

VEHICLE = load_vehicle("cf21")
POLICY = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=VEHICLE.dynamics.drag_z)


@pytest.fixture(scope="module")
def certificate() -> Certificate:
    return load_certificate("cf21_flight_50hz")


@dataclass
class Flown:
    """A flight of one drone: what it was told and where it was, tick by tick."""

    times: FloatArray
    rows: FloatArray
    error: FloatArray  # true position less reference, m
    ticks: list[Tick]

    def column(self, name: str) -> FloatArray:
        return np.asarray(self.rows[:, telemetry.FIELDS.index(name)])

    def from_on(self, time: float) -> np.ndarray:
        return np.asarray((self.times >= time) & (self.column("mode") == Mode.FLY))


class Room:
    """A simulated drone that hovers at 1 m, and its pilot."""

    def __init__(
        self,
        certificate: Certificate,
        policy: Policy = POLICY,
        delay: float = 0.028,
        mu: float = 2.0,
        wind: Wind | None = None,
    ) -> None:
        self.fleet = SimulatedFleet(
            VEHICLE,
            1,
            start=[[0.0, 0.0, 1.0]],
            flying=True,
            capture=MotionCapture(noise=5e-4),
            command_delay=delay,
            wind=wind,
        )
        self.pilot = Pilot(certificate, Tuning(mu, 0.05, 1.0, certificate.gain_max), policy, 1)
        self.frozen = np.inf  # since when motion capture repeats itself, s
        self.times: list[float] = []
        self.rows: list[FloatArray] = []
        self.error: list[FloatArray] = []
        self.ticks: list[Tick] = []
        self.next = 0.0
        self.fly(0.4)
        self.pilot.set_goal(0, [0.0, 0.0, 1.0])

    @property
    def count(self) -> int:
        return self.fleet.count

    @property
    def yaw_mode(self) -> YawMode:
        return self.fleet.yaw_mode

    def advance_to(self, time: float) -> None:
        self.fleet.advance_to(time)

    def command(self, index: int, roll: float, pitch: float, yaw: float, thrust_pwm: float) -> None:
        self.fleet.command(index, roll, pitch, yaw, thrust_pwm)

    def measurements(self, time: float) -> list[Sample]:
        """The poses, all at the place of the last good one once they are frozen."""
        samples = self.fleet.measurements(time)
        for sample in samples:
            if sample.stamp < self.frozen:
                self._place = sample.position
        return [sample._replace(position=self._place + 1e-5 * np.sin(1e3 * sample.stamp)) for sample in samples]

    def fly(self, until: float) -> Flown:
        self.next = fly(self.pilot, self, VEHICLE, until, self._note, start=self.next)
        return Flown(np.array(self.times), np.array(self.rows), np.array(self.error), self.ticks)

    def _note(self, now: float, samples: object, tick: Tick, sent: object) -> None:
        self.times.append(now)
        self.rows.append(telemetry.rows(tick)[0])
        self.error.append(self.fleet.poses()[0][0] - tick.reference[0, :3])
        self.ticks.append(tick)


@pytest.fixture(scope="module")
def calm(certificate: Certificate) -> Flown:
    """A goal, another one, and a landing in still air."""
    room = Room(certificate)
    room.fly(3.0)
    room.pilot.set_goal(0, [0.8, 0.3, 1.2])
    return room.fly(11.0)


def test_on_the_way_to_a_goal_the_drone_is_in_its_tube_and_the_tube_is_claimed(
    calm: Flown, certificate: Certificate
) -> None:
    late = calm.from_on(3.0)
    assert late.sum() > 390
    assert certificate.flight is not None
    assert np.hypot(*calm.error[late, :2].T).max() < certificate.flight.horizontal.tube.position
    assert np.abs(calm.error[late, 2]).max() < certificate.flight.vertical.tube.position
    assert calm.column("guaranteed")[late].mean() >= 0.95
    assert (calm.column("tube")[late] == certificate.flight.horizontal.tube.position).all()


def test_a_tick_that_is_a_little_late_is_no_jump_of_a_reference_that_is_given_just_then() -> None:
    room = Room(ADAPTIVE)
    room.pilot.set_goal(0, [2.0, 0.0, 1.0])
    room.fly(2.8)
    path = room.pilot.follows(0)
    assert path is not None
    assert np.linalg.norm(path.sample(2.8)[3:6]) > 0.3
    room.next += 0.008
    room.pilot.set_reference(0, path)
    flown = room.fly(2.9)
    assert Assumption.REFERENCE not in flown.column("assumption")[flown.times > 2.8]


def test_a_reference_that_begins_with_the_flight_of_a_drone_has_not_jumped() -> None:
    room = Room(ADAPTIVE)
    flown = room.fly(1.5)
    assert flown.from_on(0.4).sum() > 50
    assert Assumption.REFERENCE not in flown.column("assumption")
    room.pilot.hand_over(0)
    room.fly(1.6)
    room.pilot.set_goal(0, [0.0, 0.0, 1.0])
    flown = room.fly(3.0)
    assert flown.from_on(1.6).sum() > 50
    assert Assumption.REFERENCE not in flown.column("assumption")


def since_when(flown: Flown, begin: float) -> float:
    """How long after a time the guarantee was last claimed, s."""
    claimed = flown.times[(flown.times >= begin) & (flown.column("guaranteed") == 1.0)]
    return float(claimed[-1]) - begin if claimed.size else 0.0


def test_wind_ends_the_claim_and_is_named(certificate: Certificate) -> None:
    room = Room(certificate)
    assert room.fly(3.0).column("guaranteed")[-1] == 1.0
    room.fleet.wind = Wind(mean=(3.0, 0.0, 0.0))
    flown = room.fly(6.0)
    assert since_when(flown, 3.0) < 2.0
    assert flown.column("assumption")[-1] == Assumption.DISTURBANCE
    assert any("it is disturbed" in report.text for tick in flown.ticks for report in tick.reports)
    assert "it is disturbed" in room.pilot.unclaimed(0)
    # and again when it is twice as strong, in a landing as well
    room.pilot.land(0)
    room.fleet.wind = Wind(mean=(8.0, 0.0, 0.0))
    told = [report.text for tick in room.fly(7.5).ticks if tick.mode[0] == Mode.FLY for report in tick.reports]
    disturbances = [float(text.split("disturbed, ")[1].split()[0]) for text in told if "it is disturbed" in text]
    assert max(disturbances) > 2.0 * disturbances[0]


def test_poses_that_stand_still_while_the_drone_is_to_move_end_the_claim(certificate: Certificate) -> None:
    room = Room(certificate)
    room.fly(3.0)
    room.pilot.set_goal(0, [1.0, 0.0, 1.0])
    room.fly(5.0)
    room.frozen = 5.0
    flown = room.fly(7.5)
    assert flown.column("guaranteed")[flown.times <= 5.0][-1] == 1.0
    assert since_when(flown, 5.0) < 2.0


def test_lost_poses_end_the_claim(certificate: Certificate) -> None:
    assert certificate.flight is not None
    room = Room(certificate)
    room.fly(3.0)
    room.frozen = -np.inf
    room.measurements = lambda time: []  # type: ignore[method-assign]
    flown = room.fly(3.25)
    assert flown.column("assumption")[-1] == Assumption.POSE_AGE
    assert since_when(flown, 3.0) <= certificate.flight.pose_age + certificate.period


@pytest.mark.parametrize("delay", [0.0, 0.028, 0.06])
def test_at_rest_the_commands_are_quiet_whatever_the_link(delay: float, certificate: Certificate) -> None:
    flown = Room(certificate, delay=delay, mu=5.0).fly(7.0)
    late = flown.from_on(4.0)
    assert late.sum() > 100
    for name in ("phi", "theta"):
        assert np.degrees(np.ptp(flown.column(name)[late])) < 4.0
    assert np.abs(flown.error[late]).max() < 0.01


ADAPTIVE = Certificate.from_document(read_yaml(config_path("cf21_adaptive_50hz")))  # not proved again here
STEPS = replace(POLICY, goal_mode=GoalMode.STEP, thrust_error_max=0.0)


@pytest.mark.parametrize(
    ("name", "least", "most"), [("cf21_flight_50hz", 0.0, 0.85), ("cf21_adaptive_50hz", 0.9, 1.15)]
)
def test_the_gain_shortens_the_way_to_a_set_point_where_it_is_slow_without(
    certificate: Certificate, name: str, least: float, most: float
) -> None:
    times, claimed = [], []
    for mu in (0.0, 2.0):
        room = Room(certificate if name == certificate.name else ADAPTIVE, STEPS, mu=mu)
        room.fly(2.0)
        room.pilot.set_goal(0, [1.05, 1.04, 1.85])
        flown = room.fly(5.0)
        away = np.linalg.norm(flown.error, axis=1)
        times.append(float(flown.times[np.flatnonzero(away > 0.05)[-1]]) - 2.0)
        claimed.append(flown.column("guaranteed")[(flown.times > 2.0) & (away > 0.11)].any())
        assert (flown.column("assumption")[flown.times == 2.0] == Assumption.REFERENCE).all()
    assert least < times[1] / times[0] < most
    assert not any(claimed)


def test_what_is_not_compensated_raises_the_gain_and_that_shrinks_the_error() -> None:
    """With compensation off, and with wind that disturbs more than the certificate lets it compensate."""
    wind = Wind(mean=(2.0, 0.0, 0.0))
    errors = {}
    for mu in (0.0, 2.0):
        for most in (0.0, 0.8):
            flown = Room(ADAPTIVE, replace(STEPS, disturbance_max=most), mu=mu, wind=wind).fly(5.0)
            late = flown.from_on(4.0)
            errors[mu, most] = float(np.linalg.norm(flown.error[late], axis=1).mean())
            assert (flown.column("gamma")[-1] > 1.5) == (mu > 0.0)
            assert not flown.column("guaranteed")[late].any()
    for most in (0.0, 0.8):
        assert errors[2.0, most] < 0.6 * errors[0.0, most]
    assert errors[0.0, 0.8] < 0.6 * errors[0.0, 0.0]


def test_whoever_is_outside_although_all_seems_as_assumed_brakes_and_lands(certificate: Certificate) -> None:
    assert certificate.flight is not None
    axis = certificate.flight.horizontal
    narrow = replace(axis, tube=replace(axis.tube, position=1e-4), back=replace(axis.back, rate=10.0))
    wrong = replace(certificate, flight=replace(certificate.flight, horizontal=narrow))
    room = Room(wrong)
    room.fly(3.0)
    room.pilot.set_goal(0, [1.0, 0.0, 1.0])
    flown = room.fly(9.0)
    assert Assumption.TUBE in flown.column("assumption")
    told = [report.text for tick in flown.ticks for report in tick.reports]
    assert any(
        "it is outside its tube although all seems to be as assumed" in text and "it brakes and lands" in text
        for text in told
    )
    assert room.fleet.poses()[0][0, 2] < 0.9


def test_a_stiff_law_in_gusts_is_not_taken_for_one_that_swings(certificate: Certificate) -> None:
    flown = Room(certificate, wind=Wind(gust=2.0)).fly(10.0)
    assert (flown.column("mode")[flown.times > 1.0] == Mode.FLY).all()
    assert np.linalg.norm(flown.error[flown.times > 1.0], axis=1).max() < 0.3


def test_with_two_poses_in_a_second_the_drone_does_not_build_up_a_swing(certificate: Certificate) -> None:
    room = Room(certificate)
    room.fly(2.0)
    seen = room.measurements
    room.measurements = lambda time: [s for s in seen(time) if round(100.0 * s.stamp) % 50 == 0]  # type: ignore[method-assign]
    flown = room.fly(8.0)
    # it sinks a little whenever it is level, and is given up at last
    place = flown.error + np.array([tick.reference[0, :3] for tick in flown.ticks])
    assert np.abs(place[:, :2]).max() < 0.1
    assert place[:, 2].max() < 1.05


def test_a_reference_whose_drag_needs_more_than_the_input_set_has_is_flown_as_far_as_that_goes() -> None:
    heavy = load_certificate("cf21_adaptive_50hz")
    assert heavy.flight is not None
    limits = replace(heavy.limits, thrust_max=heavy.limits.gravity + 0.3)
    sides, upright = (replace(axis, tube=AxisTube(0.1, 0.1, 0.01, 0.01)) for axis in heavy.flight.axes)
    section = replace(heavy.flight, margin=0.1, disturbance=0.05, horizontal=sides, vertical=upright)
    weak = replace(heavy, limits=limits, flight=section)
    policy = replace(POLICY, goal_mode=GoalMode.STEP, ceiling=30.0)
    pilot = Pilot(weak, Tuning(0.0, 0.05, 1.0, weak.gain_max), policy, 1)
    climb = Trajectory(np.array([1.0, 20.0]), np.array([[[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], *[[0.0] * 3] * 6]]))
    pilot.set_reference(0, climb)
    needed = 0.0
    for number in range(100):
        now = 0.02 * number
        pilot.measure(0, now, climb.sample(max(now, 1.0))[:3].tolist(), [0.0, 0.0, 0.0, 1.0], now)
        tick = pilot.tick(now)
        needed = max(needed, float(tick.output.acceleration[0, 2]))
        assert weak.limits.contains(tick.output.acceleration).all()
    assert tick.mode[0] == Mode.FLY
    assert needed == pytest.approx(0.3)  # 1 m/s of climb makes 0.42 m/s^2 of drag


@pytest.mark.parametrize(("delay", "told"), [(0.02, False), (0.034, False), (0.08, True)])
def test_a_link_slower_than_assumed_is_told_within_five_seconds_of_motion(delay: float, told: bool) -> None:
    room = Room(ADAPTIVE, delay=delay)
    room.fly(3.0)
    room.pilot.set_goal(0, [1.2, 0.8, 1.4])
    flown = room.fly(8.0)
    moving = flown.times >= 3.0
    assert (Assumption.LATENESS in flown.column("assumption")[moving]) == told
    assert (flown.column("guaranteed")[moving].min() == 1.0) == (not told)
    texts = [report.text for tick in flown.ticks for report in tick.reports]
    assert any("it follows its commands too late or too early" in text for text in texts) == told

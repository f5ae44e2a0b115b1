"""Plans in flight: all set out, stand still and go on together, and keep apart; who leaves makes the others stop."""

from __future__ import annotations

import pickle
import subprocess
import tempfile
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.separation import IN_THE_AIR
from flatsat_ros.flight.tick import Tick
from flatsat_ros.law.gain import Tuning
from flatsat_ros.planning.gathering import first_proved
from flatsat_ros.plans import Bounds, Curve, Plan, PlannedDrone, Tube
from flatsat_ros.plans.gathering import COMMAND, Move, Planner
from flatsat_ros.plans.laps import Laps
from flatsat_ros.plans.performance import Performance, PlanPhase
from flatsat_ros.plans.prepared import PreparedPlan, received
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import Sample

CERTIFICATE, VEHICLE = load_certificate("cf21_50hz"), load_vehicle("cf21")
NAMES = ("cf1", "cf2", "cf3")
STARTS = ((0.0, 0.0, 1.0), (1.6, 0.0, 1.0))


def curve(start: Sequence[float], goal: Sequence[float], aside: float) -> Curve:
    """From rest to rest in 8 s, with a detour to the side, m."""
    share = np.clip((np.arange(17) - 3) / 10, 0.0, 1.0)[:, np.newaxis]
    way = share**3 * (10 - 15 * share + 6 * share**2)
    points = (
        np.array(start) + way * np.subtract(goal, start) + 16 * (way * (1 - way)) ** 2 * np.array([0.0, aside, 0.0])
    )
    return Curve.rounded([round(8e6 * i / 12) for i in range(13)], points)


def swap(tube: float = 0.08, names: Sequence[str] = NAMES[:2]) -> PreparedPlan:
    bounds = Bounds(0.8, 2.0, 20.0, np.array([-1.0, -1.0, 0.0]), np.array([3.0, 1.0, 2.0]))
    ways = [curve(STARTS[0], STARTS[1], -0.3), curve(STARTS[1], STARTS[0], 0.3)]
    drones = [PlannedDrone(name, way, 0.12, Tube(tube)) for name, way in zip(names, ways, strict=True)]
    limits = CERTIFICATE.limits
    plan = Plan.of(drones, name="swap", certificate=CERTIFICATE.name, limits=limits, bounds=bounds)
    plan.verify()
    return PreparedPlan.of(plan)


class Lab:
    """Three simulated drones, of which two have a plan."""

    def __init__(
        self,
        plan: PreparedPlan | None = None,
        planner: Planner | None = None,
        stand: Sequence[Sequence[float]] = ((0.1, 0.0), (1.6, 0.1)),
    ) -> None:
        policy = Policy(disturbance_max=0.8, drag=VEHICLE.dynamics.drag_z)
        self.pilot = Pilot(CERTIFICATE, Tuning(2.0, 0.05, 1.0, CERTIFICATE.gain_max), policy, 3, NAMES)
        self.fleet = SimulatedFleet(VEHICLE, 3, start=[[*place, 0.0] for place in (*stand, (0.8, 2.0))])
        self.plan = swap() if plan is None else plan
        self.performance = Performance(self.plan, self.pilot, NAMES, planner)
        self.now, self.told, self.least = 0.0, [], np.inf
        self.fly(1.0)

    def fly(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        end = self.now + seconds
        while self.now < end - 1e-6 and not until():
            self.told += [report.text for report in self.performance.look(self.now)]
            following = self.now + CERTIFICATE.period
            fly(self.pilot, self.fleet, VEHICLE, following, self._observe, start=self.now)
            self.now = following

    def _observe(self, now: float, samples: list[Sample], tick: Tick, sent: object) -> None:
        place = self.fleet.bodies.position
        if place[:2, 2].min() > 0.5:
            self.least = min(self.least, float(np.linalg.norm((place[0] - place[1]) * IN_THE_AIR)))

    def fly_until(self, phase: PlanPhase, seconds: float = 20.0) -> None:
        self.fly(seconds, lambda: self.performance.phase is phase)
        assert self.performance.phase is phase, self.told

    def off(self, ends: Sequence[Sequence[float]]) -> float:
        return float(np.linalg.norm(self.fleet.bodies.position[:2] - ends, axis=1).max())


@pytest.fixture(scope="module")
def flown() -> Lab:
    """From the floor to the first places, off, paused, resumed, to the end; the distance at the pause is noted."""
    lab = Lab()
    assert "cf1, cf2 go to their places" in lab.performance.start(lab.now)
    lab.fly_until(PlanPhase.FLYING)
    lab.fly(3.0)
    lab.performance.pause(lab.now)
    lab.fly_until(PlanPhase.PAUSED)
    lab.fly(3.0)
    lab.stood = lab.fleet.bodies.position[:2].copy()  # type: ignore[attr-defined]
    lab.fly(1.0)
    lab.moved = float(np.abs(lab.fleet.bodies.position[:2] - lab.stood).max())  # type: ignore[attr-defined]
    lab.performance.resume(lab.now)
    lab.fly_until(PlanPhase.FLOWN)
    lab.fly(2.0)
    return lab


def test_drones_go_to_their_places_fly_the_plan_and_hold_at_its_end(flown: Lab) -> None:
    assert flown.off([STARTS[1], STARTS[0]]) < 0.03
    assert flown.told[0].startswith("the plan is flown from")
    assert flown.told[-1] == "the plan has been flown to its end: all hold their last places"


def test_they_keep_what_is_proved_at_any_pace(flown: Lab) -> None:
    (pair,) = flown.plan.plan.pairs
    tubes = 2 * 0.08
    assert pair.distance * 1e-4 - tubes <= flown.least < pair.distance * 1e-4 + tubes


def test_a_pause_ends_on_the_way_at_the_same_progress(flown: Lab) -> None:
    assert flown.moved < 0.02  # type: ignore[attr-defined]
    stood = flown.stood  # type: ignore[attr-defined]
    progress = np.linspace(0.0, 8.0, 4001)
    ways = np.array([[flown.plan.references[name].sample(t)[:3] for t in progress] for name in NAMES[:2]])
    away = np.linalg.norm(ways - stood[:, np.newaxis], axis=2).max(axis=0)
    best = int(away.argmin())
    assert away[best] < 0.03
    assert 2.5 < progress[best] < 6.0


@pytest.mark.parametrize("left", [0.02, 0.2, 0.34])
def test_a_pause_in_the_last_moment_of_a_plan_lets_all_stand_at_their_ends(left: float) -> None:
    lab = Lab()
    lab.performance.start(lab.now)
    lab.fly_until(PlanPhase.FLYING)
    lab.fly(20.0, lambda: lab.performance._until - lab.now <= left)
    lab.performance.pause(lab.now)
    lab.fly_until(PlanPhase.PAUSED)
    lab.fly(3.0)
    assert lab.off([STARTS[1], STARTS[0]]) < 0.05
    assert lab.least > 0.5
    lab.performance.resume(lab.now)
    lab.fly_until(PlanPhase.FLOWN)
    assert lab.off([STARTS[1], STARTS[0]]) < 0.05


def test_laps_are_flown_and_end_where_they_began() -> None:
    angles = 2 * np.pi * np.arange(12) / 12
    way = np.stack([0.8 - 0.8 * np.cos(angles), 0.8 * np.sin(angles), np.ones(12)], axis=1)
    knots = [round(1e6 * i) for i in range(13)]
    ways = [Curve.rounded(knots, np.roll(way, shift, axis=0), closed=True) for shift in (2, 8)]
    bounds = Bounds(0.8, 2.0, 20.0, np.array([-1.0, -1.0, 0.0]), np.array([3.0, 1.0, 2.0]))
    drones = [PlannedDrone(name, own, 0.12, Tube(0.08)) for name, own in zip(NAMES, ways, strict=False)]
    plan = Plan.of(
        drones, name="round", certificate=CERTIFICATE.name, limits=CERTIFICATE.limits, bounds=bounds, laps=Laps(1, 4.0)
    )
    plan.verify()
    lab = Lab(PreparedPlan.of(plan))
    lab.performance.start(lab.now)
    lab.fly_until(PlanPhase.FLYING)
    begin = lab.performance.origin
    lab.fly(8.3)
    half = [own.trajectory().sample(lab.now - begin - 2.0)[:3] for own in ways]  # a ramp makes half as much progress
    assert lab.off(half) < 0.08
    lab.fly_until(PlanPhase.FLOWN)
    assert lab.now - begin == pytest.approx(16.0, abs=0.1)
    lab.fly(1.0)
    assert lab.off([own.trajectory().sample(0.0)[:3] for own in ways]) < 0.03
    assert lab.least >= plan.pairs[0].distance * 1e-4 - 2 * 0.08


def test_if_one_leaves_the_plan_the_others_stand_still() -> None:
    lab = Lab()
    lab.performance.start(lab.now)
    lab.fly_until(PlanPhase.FLYING)
    lab.fly(1.5)
    lab.pilot.land(0)
    lab.fly_until(PlanPhase.PAUSED, 8.0)
    assert any("cf1 does not follow the plan any more" in text for text in lab.told)
    lab.fly(1.5)
    assert np.abs(lab.fleet.bodies.velocity[1]).max() < 0.05
    assert lab.pilot.mode[1] == 2
    with pytest.raises(FlatsatError, match="only one that is flown can be paused"):
        lab.performance.pause(lab.now)


ORDERS: dict[str, Callable[[Pilot], object]] = {
    "land": lambda pilot: pilot.land(0),
    "hold": lambda pilot: pilot.hold(0),
    "a goal": lambda pilot: pilot.set_goal(0, [-0.5, 0.0, 0.8]),
    "hand_over": lambda pilot: pilot.hand_over(0),
}


@pytest.mark.parametrize(("order", "after"), [("land", 0.1), ("a goal", 0.1), *((order, 2.5) for order in ORDERS)])
def test_who_is_told_something_else_while_all_gather_is_not_sent_to_its_place_again(order: str, after: float) -> None:
    lab = Lab()
    lab.performance.start(lab.now)
    lab.fly(after)
    ORDERS[order](lab.pilot)
    told = lab.pilot.destination(0) if order == "a goal" else None
    lab.fly(10.0)
    assert lab.performance.phase is PlanPhase.ABORTED
    assert any("the plan does not begin: cf1 was told something else" in text for text in lab.told)
    assert lab.pilot.mode[0] == (2 if order in ("hold", "a goal") else 0)
    assert lab.off([lab.fleet.bodies.position[0], STARTS[1]]) < 0.1
    if told is not None:
        assert lab.fleet.bodies.position[0] == pytest.approx(told, abs=0.05)
    lab.performance.start(lab.now)
    assert lab.performance.phase is PlanPhase.GATHERING


def test_who_lands_or_stands_without_being_told_to_while_all_gather_is_not_sent_again() -> None:
    lab = Lab()
    lab.performance.start(lab.now)
    lab.fly(2.5)
    lab.pilot.traffic.land(1)  # as one does that leaves the box, or its tube
    lab.fly(10.0)
    assert any("the plan does not begin: cf2 lands" in text for text in lab.told)
    assert lab.pilot.mode[1] == 0
    assert lab.fleet.bodies.position[1, 2] < 0.02


def test_a_landing_on_the_way_to_the_places_ends_the_gathering_once_the_others_stand_still() -> None:
    lab = Lab(planner=by_a_process, stand=((1.5, 0.1), (0.1, -0.1)))
    lab.performance.start(lab.now)
    lab.fly(20.0, lambda: any("the way to the places is flown" in text for text in lab.told))
    lab.fly(1.5)
    lab.pilot.land(0)
    lab.fly(15.0)
    assert any("cf1 does not follow the way to the places any more" in text for text in lab.told)
    assert any("the plan does not begin: cf1 was told something else" in text for text in lab.told)
    assert lab.performance.phase is PlanPhase.ABORTED
    assert lab.pilot.mode[:2].tolist() == [0, 2]


def test_a_plan_that_begins_while_its_drones_land_takes_them_up_again() -> None:
    lab = Lab(planner=by_a_process)
    for index in (0, 1):
        lab.pilot.take_off(index, 0.8)
    lab.fly(4.0)
    for index in (0, 1):
        lab.pilot.land(index)
    lab.fly(0.5)
    lab.performance.start(lab.now)
    lab.fly_until(PlanPhase.FLYING, 30.0)


@pytest.mark.parametrize("order", ["land", "hold", "hand_over"])
def test_who_is_told_something_else_before_it_gets_its_part_of_the_plan_gets_none(order: str) -> None:
    lab = Lab()
    lab.performance.start(lab.now)
    lab.fly_until(PlanPhase.FLYING)
    ORDERS[order](lab.pilot)
    lab.fly_until(PlanPhase.PAUSED)
    lab.fly(8.0)
    assert any("cf1 does not follow the plan any more" in text for text in lab.told)
    assert lab.off(STARTS if order == "hold" else [lab.fleet.bodies.position[0], STARTS[1]]) < 0.1
    assert lab.pilot.mode[0] == (2 if order == "hold" else 0)


def test_an_aborted_plan_stands_still_then_lands() -> None:
    lab = Lab()
    lab.performance.start(lab.now)
    lab.fly_until(PlanPhase.FLYING)
    lab.fly(2.0)
    said = lab.performance.abort(lab.now)
    assert "their distances proved until then" in said
    lab.fly_until(PlanPhase.ABORTED, 8.0)
    lab.fly(12.0, lambda: float(lab.fleet.bodies.position[:, 2].max()) < 0.01)
    assert lab.fleet.bodies.position[:, 2].max() < 0.05
    assert "the plan is aborted: all land where they are" in lab.told


def test_a_plan_begins_only_with_drones_that_can_fly() -> None:
    lab = Lab()
    lab.pilot.arm(1, False)
    with pytest.raises(FlatsatError, match="cf2: the drone is disarmed"):
        lab.performance.start(lab.now)
    assert lab.performance.phase is PlanPhase.READY
    with pytest.raises(FlatsatError, match="the plan is ready: only one that is flown can be aborted"):
        lab.performance.abort(lab.now)
    with pytest.raises(FlatsatError, match="only one that is paused can be resumed"):
        lab.performance.resume(lab.now)


def test_all_that_cannot_fly_are_named_and_nobody_is_sent() -> None:
    lab = Lab()
    lab.pilot.arm(0, False)
    lab.pilot.arm(1, False)
    with pytest.raises(FlatsatError, match=r"cf1: the drone is disarmed.*; cf2: the drone is disarmed"):
        lab.performance.start(lab.now)
    lab.fly(1.0)
    assert not lab.pilot.mode.any()


def test_a_place_that_is_taken_at_first_is_gone_to_later() -> None:
    lab = Lab()
    lab.pilot.set_goal(2, STARTS[1])
    lab.fly(6.0)
    lab.performance.start(lab.now)  # cf3 hovers where cf2 shall begin
    lab.fly(3.0)
    assert lab.performance.phase is PlanPhase.GATHERING
    lab.pilot.set_goal(2, [0.8, 2.0, 1.0])
    lab.fly_until(PlanPhase.FLYING)
    lab.performance.abort(lab.now)


def test_a_plan_that_is_aborted_while_its_drones_gather_leaves_them_on_the_ground() -> None:
    lab = Lab()
    lab.performance.start(lab.now)
    lab.performance.abort(lab.now)
    lab.fly(2.0)
    assert lab.fleet.bodies.position[:, 2].max() < 0.01


def test_all_stand_still_when_one_is_outside_its_tube() -> None:
    lab = Lab(swap(tube=0.06))
    lab.performance.start(lab.now)
    lab.fly_until(PlanPhase.FLYING)
    lab.performance._tubes[1] = 0.0  # as if it were away from its reference
    lab.fly_until(PlanPhase.PAUSED, 8.0)
    assert any("cf2 is outside its tube: all stand still" in text for text in lab.told)


def test_plans_for_other_drones_or_limits_are_refused() -> None:
    lab = Lab()
    with pytest.raises(FlatsatError, match="drone = 'cf9': must be one of cf1, cf2, cf3"):
        Performance(swap(names=("cf1", "cf9")), lab.pilot, NAMES)
    paper = load_certificate("paper_robust")
    pilot = Pilot(paper, Tuning(2.0, 0.05, 1.0, paper.gain_max), Policy(), 3, NAMES)
    with pytest.raises(FlatsatError, match="thrust_max of certificate 'paper_robust'"):
        Performance(swap(), pilot, NAMES)


def by_a_process(move: Move) -> Callable[[], PreparedPlan]:
    """Plan as the controller does, but wait for it: simulated time stands still."""
    with tempfile.TemporaryFile() as output:
        subprocess.run(COMMAND, input=pickle.dumps(move), stdout=output, check=True)
        output.seek(0)
        found = received(output)
    return lambda: found


def test_drones_that_have_to_change_places_first_do_so_by_a_plan() -> None:
    lab = Lab(planner=by_a_process, stand=((1.5, 0.1), (0.1, -0.1)))
    lab.performance.start(lab.now)
    lab.fly(20.0, lambda: any("by a plan" in text for text in lab.told))
    assert lab.fleet.bodies.position[:2, 2] == pytest.approx(0.5, abs=0.02)  # where they have climbed to
    lab.least = np.inf
    lab.fly_until(PlanPhase.FLYING)
    lab.fly(0.1)
    # whoever reads when the plan begins does not take the way to its places for it
    flown = [text.partition(" is flown from")[0] for text in lab.told if " is flown from" in text]
    assert flown == ["the way to the places", "the plan"]
    assert lab.off(STARTS) < 0.03
    assert lab.least > 2 * 0.12


def test_without_a_plan_each_goes_to_its_place_alone() -> None:
    def refuse(_: Move) -> Callable[[], PreparedPlan]:
        raise FlatsatError("there is none")

    lab = Lab(planner=refuse)
    lab.performance.start(lab.now)
    lab.fly_until(PlanPhase.FLYING)
    assert "no way for all to their places is planned: there is none; each goes there alone" in lab.told


def test_who_stands_too_near_to_another_for_a_plan_is_not_planned_for() -> None:
    plan = swap().plan
    goals = dict(zip(NAMES, map(np.array, STARTS), strict=False))
    found = first_proved(Move(plan, {"cf1": np.array([0.0, 0.0, 0.5]), "cf2": np.array([0.36, 0.0, 0.5])}, goals))
    assert [drone.body for drone in found.plan.drones] == pytest.approx([0.098, 0.098])  # 0.36 m less two tubes
    for drone in found.plan.drones:
        assert found.references[drone.name].end == pytest.approx(goals[drone.name])
    with pytest.raises(
        FlatsatError, match=r"distance of two drones = 0\.3 m: must be at least 0\.32 m, to plan how they"
    ):
        first_proved(Move(plan, {"cf1": np.array([0.0, 0.0, 0.5]), "cf2": np.array([0.3, 0.0, 0.5])}, goals))

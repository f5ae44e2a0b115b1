"""Drones that keep out of each other's way: what is refused, what waits, who yields, and that people are told."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import GoalMode, Policy
from flatsat_ros.flight.separation import IN_THE_AIR
from flatsat_ros.flight.tick import Tick
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.gain import Tuning
from flatsat_ros.planning.spline import spline_through
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.fleet import SimulatedFleet

CERTIFICATE = load_certificate("cf21_50hz")
TUNING = Tuning(2.0, 0.05, 1.0, CERTIFICATE.gain_max)
SEPARATION = Policy.separation
LEVEL = (0.0, 0.0, 0.0, 1.0)
PERIOD = CERTIFICATE.period


class Ideal:
    """Drones that are where their references are, but for an offset."""

    def __init__(
        self, places: Sequence[Sequence[float]], policy: Policy | None = None, others: Sequence[str] = ()
    ) -> None:
        names = [f"cf{number + 1}" for number in range(len(places))]
        self.pilot = Pilot(CERTIFICATE, TUNING, policy or Policy(), len(places), names, others)
        self.place = np.array(places, dtype=float)
        self.offset = np.zeros_like(self.place)
        self.unseen: set[int] = set()  # whose poses are missing: they stay where they are
        self.now = 0.0
        self.least = np.inf  # of the distances so far
        self.told: list[tuple[int, str]] = []
        self.inputs: list[list[float]] = []  # of the first drone

    def fly(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD)):
            for index, place in enumerate(self.place):
                if index in self.unseen:
                    continue
                # with noise, without which a z at rest would be taken for one that is lost
                seen = place + 1e-5 * np.sin(1e4 * self.now + np.arange(3.0))
                self.pilot.measure(index, self.now, tuple(seen), LEVEL, self.now)
            tick = self.pilot.tick(self.now)
            self.inputs.append(tick.input[0].tolist())
            self.told += [(report.drone, report.text) for report in tick.reports]
            flying = tick.mode == Mode.FLY
            self.place[flying] = (tick.reference[:, :3] + self.offset)[flying]
            away = (self.place[:, np.newaxis] - self.place) * IN_THE_AIR
            apart = np.linalg.norm(away, axis=2) + np.diag(np.full(len(away), np.inf))
            self.least = min(self.least, float(apart.min()))
            self.now += PERIOD

    def heard(self, drone: int, pattern: str) -> bool:
        return any(index == drone and re.search(pattern, text) for index, text in self.told)

    def is_at(self, drone: int, place: Sequence[float]) -> bool:
        return bool(np.linalg.norm(self.place[drone] - place) < 0.02)


def hovering(places: Sequence[Sequence[float]], policy: Policy | None = None, others: Sequence[str] = ()) -> Ideal:
    """Drones that hover where they are."""
    world = Ideal(places, policy, others)
    world.fly(0.2)
    for index, place in enumerate(places):
        world.pilot.set_goal(index, place)
    world.fly(0.5)
    assert (world.pilot.mode == Mode.FLY).all()
    assert not world.told
    return world


def test_crossing_goals_are_reached_one_after_the_other() -> None:
    vehicle = load_vehicle("cf21")
    fleet = SimulatedFleet(vehicle, 2, start=np.array([[0.0, 0.0, 0.0], [1.0, -1.2, 0.0]]))
    pilot = Pilot(CERTIFICATE, TUNING, Policy(disturbance_max=0.8), 2)
    goals, told, least = np.array([[2.0, 0.0, 0.6], [1.0, 0.8, 0.6]]), [], [np.inf]

    def observe(_now: float, _samples: object, tick: Tick, _sent: object) -> None:
        told.extend(text for drone, text in tick.reports if drone == 1)
        first, second = fleet.bodies.position
        least.append(float(np.linalg.norm((first - second) * IN_THE_AIR)))

    now = fly(pilot, fleet, vehicle, 0.5)
    for index in range(2):
        pilot.take_off(index, 0.6)
    now = fly(pilot, fleet, vehicle, 5.0, start=now)
    for index, goal in enumerate(goals):
        pilot.set_goal(index, goal)
    fly(pilot, fleet, vehicle, 15.0, observe, start=now)
    assert np.linalg.norm(fleet.bodies.position - goals, axis=1).max() < 0.1
    assert min(least) > SEPARATION
    assert "drone 0" in told[0]
    assert "waits" in told[0]
    assert "sets out" in told[-1]


def test_a_drone_with_neighbours_at_a_distance_is_commanded_as_if_it_were_alone() -> None:
    def inputs(*places: Sequence[float]) -> list[list[float]]:
        world = Ideal(places)
        world.fly(0.2)
        world.pilot.take_off(0, 0.8)
        world.fly(2.0)
        world.pilot.set_goal(0, [0.0, 1.0, 1.0])
        world.fly(1.0)
        return world.inputs

    alone = inputs([0.0, 0.0, 0.0])
    among = inputs([0.0, 0.0, 0.0], [0.9, 0.0, 0.0], [1.2, 3.0, 1.0])
    # products of one row and of several are rounded otherwise on some processors
    np.testing.assert_allclose(among, alone, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("aside", [0.0, 0.3])
def test_a_goal_where_another_drone_rests_or_goes_is_refused_by_name(aside: float) -> None:
    world = hovering([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0]])
    with pytest.raises(FlatsatError, match=r"where cf2 rests = .* m: must be at least 0\.45 m"):
        world.pilot.set_goal(0, [2.0, aside, 1.0])
    world.pilot.set_goal(1, [2.0, 3.0, 1.0])
    with pytest.raises(FlatsatError, match="where cf2 goes"):
        world.pilot.set_goal(0, [2.0, 3.0 - aside, 1.2])
    world.fly(6.0)
    assert world.is_at(0, [0.0, 0.0, 1.0])
    world.pilot.set_goal(0, [2.0, 0.0, 1.0])  # it has left
    world.fly(6.0)
    assert world.is_at(0, [2.0, 0.0, 1.0])


def test_a_drone_on_the_ground_whose_goal_waits_does_not_take_off_once_all_are_told_to_land() -> None:
    world = Ideal([[0.0, -2.0, 1.0], [0.0, 0.0, 0.0]])
    world.fly(0.2)
    world.pilot.set_goal(0, [0.0, 2.0, 1.0])
    world.fly(0.5)
    world.pilot.set_goal(1, [0.0, 0.0, 2.0])
    assert world.pilot.traffic.is_waiting(1)
    for index in (0, 1):
        world.pilot.land(index)
    world.fly(8.0)  # the first one has come down beside its way
    assert world.pilot.mode[1] == Mode.IDLE
    assert world.heard(1, "its take-off is called off: it is told to land")


def test_a_ring_of_exchanged_goals_is_refused_and_nobody_moves() -> None:
    places = [[0.0, 0.0, 1.0], [1.2, 0.0, 1.0], [0.6, 1.0, 1.0]]
    world = hovering(places)
    for index in range(3):
        with pytest.raises(FlatsatError, match=f"where cf{(index + 1) % 3 + 1} rests"):
            world.pilot.set_goal(index, places[(index + 1) % 3])
    world.fly(1.0)
    assert all(world.is_at(index, place) for index, place in enumerate(places))


def test_goals_behind_each_other_are_given_up_and_told() -> None:
    world = hovering([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    world.pilot.set_goal(0, [2.0, 0.0, 1.0])
    world.pilot.set_goal(1, [-1.0, 0.0, 1.0])
    world.fly(11.0)
    for index, name in ((0, "cf2"), (1, "cf1")):
        assert world.heard(index, f"waits .* {name}")
        assert world.heard(index, f"given up.* {name}")
    assert world.least > 0.99
    world.pilot.set_goal(0, [0.0, 1.0, 1.0])  # a way around
    world.fly(4.0)
    assert world.is_at(0, [0.0, 1.0, 1.0])


def test_drones_that_wait_for_each_other_set_out_together_where_that_is_clear() -> None:
    angles = np.radians([[0.0, 120.0, 240.0], [140.0, 260.0, 380.0]])  # each passes where the next one is
    places, goals = (
        np.stack([radius * np.cos(angle), radius * np.sin(angle), np.ones(3)], axis=1)
        for radius, angle in zip((0.7, 1.4), angles, strict=True)
    )
    world = hovering(places.tolist())
    for index, goal in enumerate(goals):
        world.pilot.set_goal(index, goal)
    world.fly(8.0)
    assert all(world.is_at(index, goal) for index, goal in enumerate(goals.tolist()))
    assert all(world.heard(index, "as those in it set out, too") for index in range(3))
    assert world.least > SEPARATION


def test_trajectories_of_a_swap_may_come_one_after_the_other() -> None:
    places = [[0.0, 0.0, 1.0], [1.25, 0.0, 1.0], [0.625, 1.08, 1.0]]
    world = hovering(places)
    for index in range(3):
        swap = spline_through([places[(index + leg) % 3] for leg in range(3)], 4.0)
        world.pilot.set_reference(index, swap.shifted(world.now + 0.3))
        world.fly(0.1)
    world.fly(8.5)
    assert all(world.is_at(index, places[(index + 2) % 3]) for index in range(3))
    assert not world.told


def test_a_trajectory_brakes_for_a_drone_that_stays_in_its_way() -> None:
    world = hovering([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0]])
    world.pilot.set_reference(0, spline_through([[0, 0, 1], [4, 0, 1]], 8.0).shifted(world.now))
    world.fly(4.0)
    assert world.heard(0, "goal waits until the way is clear: .* cf2")
    world.pilot.set_goal(1, [2.0, 2.0, 1.0])
    world.fly(9.0)
    assert world.is_at(0, [4.0, 0.0, 1.0])
    assert world.least > SEPARATION


def test_a_drone_without_which_its_trajectory_has_gone_on_is_led_to_its_end() -> None:
    world = hovering([[0.0, 0.0, 1.0]])
    world.pilot.set_reference(0, spline_through([[0, 0, 1], [3, 1, 1]], 5.0).shifted(world.now))
    world.fly(1.0)
    world.unseen = {0}
    world.fly(2.5)
    assert world.pilot.mode[0] == Mode.DESCEND
    world.unseen = set()
    world.fly(6.0)
    assert world.heard(0, "has gone on without it: it goes to the end of that")
    assert world.is_at(0, [3.0, 1.0, 1.0])


def test_drones_whose_swap_broke_off_keep_apart_and_reach_its_ends_or_tell_why_not() -> None:
    places = [[0.0, 0.0, 1.0], [1.25, 0.0, 1.0], [0.625, 1.08, 1.0]]
    world = hovering(places)
    for index in range(3):
        swap = spline_through([places[(index + leg) % 3] for leg in range(4)], 4.0)
        world.pilot.set_reference(index, swap.shifted(world.now))
    world.fly(6.0)
    world.unseen = {0}
    world.fly(1.2)
    world.unseen = set()
    world.fly(13.0)
    assert all(world.is_at(i, place) or world.heard(i, "goal is given up") for i, place in enumerate(places))
    assert world.least > SEPARATION
    assert len(world.told) < 20, "nobody sets out again and again"


def test_a_trajectory_that_is_near_a_resting_drone_at_once_is_refused() -> None:
    world = hovering([[0.0, 0.0, 1.0], [0.5, 0.0, 1.0]])
    with pytest.raises(FlatsatError, match=r"distance from cf2 in 0\.\d s"):
        world.pilot.set_reference(0, spline_through([[0, 0, 1], [0.4, 0, 1]], 1.5).shifted(world.now))


def test_a_trajectory_that_meets_another_on_the_move_is_refused() -> None:
    world = hovering([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0]])
    world.pilot.set_reference(0, spline_through([[0, 0, 1], [2, 0, 1]], 4.0).shifted(world.now))
    with pytest.raises(FlatsatError, match=r"distance from cf1 in [12]\.\d s"):
        world.pilot.set_reference(1, spline_through([[2, 0, 1], [0, 0, 1]], 4.0).shifted(world.now))


def test_nobody_lands_on_or_takes_off_beside_another_unless_there_is_room() -> None:
    world = Ideal([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.3, 0.0, 0.0]])
    world.fly(0.2)
    world.pilot.take_off(0, 1.0)  # a metre beside a drone that stands
    with pytest.raises(FlatsatError, match=r"where cf3 stands = 0\.3"):
        world.pilot.take_off(1, 0.2)
    world.fly(4.0)
    world.pilot.set_goal(0, [1.1, 0.0, 1.0])  # over drones that stand
    world.fly(4.0)
    assert world.is_at(0, [1.1, 0.0, 1.0])
    with pytest.raises(FlatsatError, match="distance from cf2 in"):
        world.pilot.land(0)
    with pytest.raises(FlatsatError, match="where cf1 rests"):
        world.pilot.take_off(1, 0.5)


def test_drones_make_room_for_one_that_lands() -> None:
    world = hovering([[0.0, 0.0, 1.5], [-1.5, 0.0, 0.6]])
    world.pilot.set_goal(1, [3.0, 0.0, 0.6])
    world.pilot.land(0)
    world.fly(3.0)
    assert world.heard(1, "waits .* cf1")
    assert world.least > SEPARATION


def test_drones_that_are_too_near_both_brake_and_the_younger_yields() -> None:
    world = hovering([[0.0, 0.0, 1.0], [0.0, 1.0, 1.0]])
    world.pilot.set_goal(0, [4.0, 0.0, 1.0])
    world.pilot.set_goal(1, [4.0, 1.0, 1.0])
    world.fly(2.0)
    for _ in range(70):  # the second is carried off toward the first
        world.offset[1, 1] -= 0.01
        world.fly(PERIOD)
    world.fly(0.5)
    assert [index for index, text in world.told if f"at least {SEPARATION:g} m" in text] == [0, 1]
    assert world.heard(0, "m from cf2, .* brakes until its way is clear")
    assert world.heard(1, "m from cf1, .* brakes and stays")
    world.fly(8.0)
    assert world.is_at(0, [4.0, 0.0, 1.0])
    assert world.place[1, 0] < 3.5


def test_in_step_mode_nothing_is_refused_but_it_is_told() -> None:
    world = hovering([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]], Policy(goal_mode=GoalMode.STEP))
    world.pilot.set_goal(0, [1.0, 0.0, 1.0])
    world.pilot.set_goal(0, [0.0, 0.0, 1.0])
    for _ in range(75):
        world.offset[0, 0] += 0.01
        world.fly(PERIOD)
    assert [index for index, text in world.told if f"at least {SEPARATION:g} m" in text] == [0, 1]
    assert world.heard(0, r"m from cf2, must be [^:]*$")
    assert world.pilot.mode.tolist() == [Mode.FLY, Mode.FLY]


def test_robots_that_others_fly_count_where_they_are_seen() -> None:
    fresh = Ideal([[0.0, 0.0, 0.0]], others=["blimp"])
    fresh.pilot.traffic.see(0, [2.0, 0.0, 1.0], 0.0)
    fresh.pilot.set_reference(0, spline_through([[0, 0, 0], [1.8, 0, 1]], 4.0))  # nothing is known of its own place
    world = hovering([[0.0, 0.0, 1.0]], others=["blimp"])
    world.pilot.traffic.see(0, [2.0, 0.0, 1.0], world.now)
    with pytest.raises(FlatsatError, match="where blimp rests"):
        world.pilot.set_goal(0, [2.0, 0.2, 1.0])
    world.pilot.set_goal(0, [4.0, 0.0, 1.0])
    world.fly(0.1)
    assert world.heard(0, "waits .* blimp")
    for _ in range(20):
        world.pilot.traffic.see(0, [2.0, 2.0, 1.0], world.now)
        world.fly(0.1)
    assert world.heard(0, "sets out")
    assert not world.heard(0, "no pose")
    world.fly(1.0)
    assert world.heard(0, "no pose of blimp")
    world.pilot.traffic.see(0, world.place[0] + (0.35, 0.0, 0.0), world.now)
    world.fly(0.6)
    assert world.heard(0, "poses of blimp are back")
    assert world.heard(0, r"0\.\d\d m from blimp, .* brakes and stays")


def test_nobody_is_sent_to_or_through_where_a_drone_in_the_air_was_seen_last() -> None:
    world = hovering([[0.0, 0.0, 1.0], [1.5, 0.0, 1.0], [3.0, 0.0, 1.0]])
    world.unseen = {0}
    world.fly(0.5)
    assert world.pilot.mode[0] == Mode.LEVEL
    with pytest.raises(FlatsatError, match="where cf1 was seen last"):
        world.pilot.set_goal(1, [0.0, 0.2, 1.0])
    world.pilot.set_goal(1, [-1.5, 0.0, 1.0])
    assert world.pilot.traffic.is_waiting(1)
    world.pilot.set_goal(2, [3.0, 1.0, 1.0])
    world.fly(1.0)
    assert world.pilot.mode[0] == Mode.DESCEND
    assert world.is_at(1, [1.5, 0.0, 1.0])
    world.fly(24.0)
    assert world.pilot.mode[0] == Mode.CUT
    assert world.is_at(1, [-1.5, 0.0, 1.0])
    assert world.is_at(2, [3.0, 1.0, 1.0])


def test_a_goal_that_waits_does_not_set_out_because_who_is_in_its_way_is_lost() -> None:
    world = hovering([[0.0, 0.0, 1.0], [1.5, 0.0, 1.0]])
    world.pilot.set_goal(1, [-1.5, 0.0, 1.0])
    world.fly(0.5)
    assert world.pilot.traffic.is_waiting(1)
    world.unseen = {0}
    world.fly(1.5)
    assert world.pilot.mode[0] == Mode.DESCEND
    assert world.pilot.traffic.is_waiting(1)
    assert world.is_at(1, [1.5, 0.0, 1.0])


def test_a_landing_or_a_disarming_forgets_the_goal_that_waits() -> None:
    world = hovering([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    world.pilot.set_goal(0, [2.0, 0.0, 1.0])
    world.fly(0.1)
    world.pilot.land(0)
    world.pilot.set_goal(1, [1.0, 2.0, 1.0])
    world.fly(1.0)
    assert not world.heard(0, "sets out")
    assert world.place[0, 2] < 0.95


def test_the_clock_set_back_lets_goals_wait_on() -> None:
    world = hovering([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    world.fly(3.0)
    world.pilot.set_goal(0, [2.0, 0.0, 1.0])
    world.fly(0.2)
    world.now -= 3.0
    world.fly(0.5)
    world.pilot.set_goal(1, [1.0, 1.0, 1.0])
    world.fly(6.0)
    assert world.is_at(0, [2.0, 0.0, 1.0])


def test_a_single_trajectory_point_is_a_goal_like_any_other() -> None:
    world = hovering([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    with pytest.raises(FlatsatError, match="where cf2 rests"):
        world.pilot.set_reference(0, Trajectory.hold([1.0, 0.0, 1.0]))


@pytest.mark.parametrize("below", [(0.0, 0.0), (0.3, 0.1), (-0.1, 0.35)])
def test_at_the_end_of_the_controller_a_drone_above_another_lands_aside(below: tuple[float, float]) -> None:
    world = hovering([[0.0, 0.0, 2.0], [*below, 0.9]])
    world.pilot.retire()
    world.fly(0.3)
    assert world.heard(0, r"^cf2 lands|^cf2 rests below: it lands 0\.55 m aside")
    world.fly(6.0)
    assert world.pilot.mode[0] == Mode.FLY
    assert world.place[0, 2] < 1.0
    assert np.hypot(*(world.place[0, :2] - below)) > SEPARATION
    assert np.hypot(*(world.place[1, :2] - below)) < 0.01
    assert world.least > SEPARATION


def test_where_no_place_aside_is_free_or_known_that_is_told() -> None:
    narrow = Policy(walls=(-0.3, -0.3, 0.3, 0.3))
    world = hovering([[0.0, 0.0, 2.0], [0.0, 0.0, 0.9]], narrow)
    world.pilot.retire()
    world.fly(0.3)
    assert world.heard(0, "cf2 rests below, and no place aside is free: it lands there")
    world = hovering([[0.0, 0.0, 2.0], [0.0, 0.0, 0.9]])
    world.unseen = {0}
    world.fly(2.0)
    assert world.heard(0, "cf2 rests below, onto which it may sink")
    assert not world.heard(1, "below")


def test_beside_another_drone_one_lands_where_it_is() -> None:
    world = hovering([[0.0, 0.0, 1.0], [0.46, 0.0, 0.9], [0.0, 0.5, 0.0]])
    world.pilot.retire()
    world.fly(2.0)
    assert np.abs(world.place[:, :2] - [[0.0, 0.0], [0.46, 0.0], [0.0, 0.5]]).max() < 0.01
    assert not any(world.heard(index, "aside|free") for index in range(3))

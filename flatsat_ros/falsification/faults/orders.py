"""What users and their programs do: goals, landings, services, parameters, and the end of the controller."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from flatsat_ros.falsification.faults.criteria import Criteria, End
from flatsat_ros.falsification.faults.fault import ALL, Action, Fault, commands, poses
from flatsat_ros.falsification.faults.phases import Phase
from flatsat_ros.falsification.faults.scene import Scene
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim import faults

_REFUSED = "refused"
_UNDISTURBED = Criteria(End.DONE, distance=0.5, told=_REFUSED)
_FLIES_ON = Criteria(End.ALOFT, distance=0.5)
_LANDS = Criteria(End.DOWN)
# a goal or a trajectory ends a landing
_OR_LANDED = {Phase.LANDING: Criteria(End.SAFE, distance=0.5)}

# each of them is refused: rate, threshold, initial gain, cap
_GARBAGE = (
    (math.nan, 0.05, 1.0, 5.0),
    (2.0, -0.05, 1.0, 5.0),
    (2.0, 0.05, 0.5, 5.0),
    (2.0, 0.05, 1.0, 1e9),
    (math.inf, 0.05, 1.0, 5.0),
    (-1.0, 0.05, 1.0, 5.0),
)


def _goal(offset: tuple[float, float, float], *, flown: bool = True) -> Action:
    """Give a goal that is off the drone by an offset, m; flown if the way there belongs to the path."""

    def act(scene: Scene) -> None:
        goal = scene.place[0] + np.array(offset)
        if flown:
            scene.record.extend_path(0, scene.place[0].copy(), goal)
        scene.go_to(0, goal)

    return act


def _goal_below(scene: Scene) -> None:
    scene.go_to(0, scene.place[0] * (1.0, 1.0, 0.0) - (0.0, 0.0, 1.0))


def _goal_of(value: float) -> Action:
    def act(scene: Scene) -> None:
        scene.ask(0, lambda pilot: pilot.set_reference(0, Trajectory.hold([value, 0.0, 1.0])))

    return act


def _land(scene: Scene) -> None:
    scene.record.extend_path(0, scene.place[0].copy())
    scene.land(0)


def _goal_at_neighbour(scene: Scene) -> None:
    """Go to where the neighbour is, 5 cm above it."""
    scene.record.extend_path(0, scene.place[0].copy(), scene.place[1].copy())
    scene.go_to(0, scene.place[1] + (0.0, 0.0, 0.05))


def _goals_crossing(scene: Scene) -> None:
    """Let two drones go to each other's place."""
    first, second = scene.place[0].copy(), scene.place[1].copy()
    for drone, begin, goal in ((0, first, second), (1, second, first)):
        scene.record.extend_path(drone, begin, goal)
        scene.go_to(drone, goal)


def _goals_in_a_row() -> tuple[tuple[float, Action], ...]:
    """Give thirty goals in 3 s, somewhere within half a metre of the drone."""

    def act(scene: Scene, number: int) -> None:
        way = np.random.default_rng([scene.seed, number]).uniform(-0.3, 0.3, 3)
        goal = scene.record.paths[0][0] + (0.0, 0.0, 1.0) + way
        scene.record.extend_path(0, scene.place[0].copy(), goal)
        scene.go_to(0, goal)

    return tuple((0.1 * number, lambda scene, n=number: act(scene, n)) for number in range(30))


def _trajectory(begin: tuple[float, float, float], end: tuple[float, float, float], seconds: float) -> Action:
    """Fly a trajectory whose ends are off the drone, m."""

    def act(scene: Scene) -> None:
        points = scene.place[0] + np.array([begin, end])
        rest = np.zeros((2, 3))
        scene.ask(
            0,
            lambda pilot: pilot.set_reference(
                0, Trajectory.through([scene.time, scene.time + seconds], points, rest, rest)
            ),
        )

    return act


def _garbage(scene: Scene) -> None:
    for values in _GARBAGE:
        scene.ask(0, lambda pilot, v=values: pilot.retune(Tuning(*v)))  # type: ignore[misc]


def _asked(ask: Callable[[Scene], None]) -> tuple[tuple[float, Action], ...]:
    return ((0.0, ask),)


def _arm_race() -> tuple[tuple[float, Action], ...]:
    """Two programs arm, disarm, take off and land against each other for 3 s, at random."""

    def act(scene: Scene, number: int) -> None:
        choice = np.random.default_rng([scene.seed, number]).integers(4)
        if choice < 2:
            scene.ask(0, lambda pilot: pilot.arm(0, bool(choice)))
        elif choice == 2:
            scene.take_off(0, 0.5)
        else:
            scene.land(0)

    return tuple((0.1 * number, lambda scene, n=number: act(scene, n)) for number in range(30))


def _disarm(scene: Scene) -> None:
    scene.ask(0, lambda pilot: pilot.arm(0, False))


def _hand_over(scene: Scene) -> None:
    """Leave a drone to its own commander, as the controller does where the link has these services."""
    if scene.ask(0, lambda pilot: pilot.hand_over(0)):
        scene.fleet.notify_setpoints_stop(0)
        scene.fleet.go_to(0, (0.0, 0.0, 0.0), 0.0, 1.0, relative=True)


def _kill(scene: Scene) -> None:
    scene.pilot = None


def _start_again(scene: Scene) -> None:
    scene.start_controller()


def _goal_again(scene: Scene) -> None:
    for drone in range(scene.fleet.count):
        scene.go_to(drone, scene.record.paths[drone][-1])


def _goal_here(scene: Scene) -> None:
    for drone in range(scene.fleet.count):
        scene.record.extend_path(drone, scene.place[drone].copy())
        scene.go_to(drone, scene.place[drone])


def _taken_over(name: str, meaning: str, fault: Action, **more: Any) -> Fault:
    """Return a fault of a controller that starts in flight and shall hold the drones where they are."""
    return Fault(
        f"taken_over_{name}",
        f"as controller_restarted, but {meaning}, and the goals are where the drones are",
        ((0.0, _kill), (0.8, _start_again), (0.8, fault), (1.1, _goal_here)),
        # as of those that took off; of two, a metre apart, that both go astray by as much nobody keeps them apart
        Criteria(End.SAFE, told=r"pose|yaw|axis|sign|command|innovation|predict", separation=0.0),
        victims=ALL,
        **more,
    )


def _end_controller(scene: Scene) -> None:
    scene.end_controller()


def _land_below(scene: Scene) -> None:
    """Let the second drone land."""
    scene.land(1)


def _fly_above(scene: Scene) -> None:
    """Let the first drone fly to where it is a metre above the second one."""
    goal = scene.place[1] + (0.0, 0.0, 1.0)
    scene.record.extend_path(0, scene.place[0].copy(), goal)
    scene.record.forget_touches()  # in a landing it may be down already, and is told to rise again
    scene.go_to(0, goal)


def _empty(scene: Scene) -> None:
    """Let the battery of the first drone be empty."""
    scene.readings[0] = scene.vehicle.battery.landing_voltage - 0.05


def _above(name: str, meaning: str, happens: Action, bounds: Criteria, *others: int) -> Fault:
    """Return a fault of a drone that hovers above one that stands; others land with them."""
    steps = ((0.0, _land_below), (7.0, _fly_above), (14.0, happens))
    return Fault(name, meaning, steps, bounds, victims=(0, 1, *others), watched=16.0)


ORDER_FAULTS = (
    Fault("land_in_climb", "land, 0.7 s after a goal 1 m above", ((0.0, _goal((0.0, 0.0, 1.0))), (0.7, _land)), _LANDS),
    Fault(
        "land_after_poses_back",
        "land, 0.3 s after poses came back that were lost for 1 s",
        ((0.0, poses(lambda _: faults.lost)), (1.0, lambda scene: scene.link.poses.clear()), (1.3, _land)),
        _LANDS,
    ),
    Fault(
        "land_far_from_goal",
        "land, 1 s after a goal 9 m away",
        ((0.0, _goal((0.0, 9.0, 0.0), flown=False)), (1.0, _land)),
        Criteria(End.DOWN, distance=1.5),
    ),
    Fault("land_twice", "land, twice within 0.5 s", ((0.0, _land), (0.5, _land)), _LANDS),
    _above(
        "land_above_empty",
        "the battery of a drone is empty that is a metre above one that stands",
        _empty,
        Criteria(End.DOWN, told=r"below: it lands .* aside|touched down"),
    ),
    _above(
        "land_above_ctrl_c",
        "Ctrl-C, while a drone is a metre above one that stands",
        _end_controller,
        Criteria(End.DOWN),
        2,
    ),
    _above(
        "land_above_blind",
        "no pose of a drone that is a metre above one that stands",
        poses(lambda _: faults.lost),
        # without poses it can only be told
        Criteria(End.DOWN, told=r"below, onto which it may sink|touched down", separation=0.0),
    ),
    Fault("goal_10m", "a goal 10 m away", _asked(_goal((0.0, 10.0, 0.0))), _FLIES_ON, _OR_LANDED, watched=16.0),
    Fault("goal_100m", "a goal 100 m away", _asked(_goal((0.0, 100.0, 0.0))), _FLIES_ON, _OR_LANDED),
    Fault("goal_up_10m", "a goal 10 m above", _asked(_goal((0.0, 0.0, 10.0))), _FLIES_ON, _OR_LANDED),
    Fault("goal_below_floor", "a goal 1 m below the floor", _asked(_goal_below), _UNDISTURBED),
    Fault("goal_huge", "a goal of 1.7e308 m", _asked(_goal_of(1.7e308)), _UNDISTURBED),
    Fault("goal_nan", "a goal of NaN", _asked(_goal_of(math.nan)), _UNDISTURBED),
    Fault(
        "goal_at_neighbour",
        "a goal 5 cm above another drone",
        _asked(_goal_at_neighbour),
        Criteria(End.ALOFT, told=r"refused|separat|near|yield|wait"),
        {Phase.LANDING: Criteria(End.SAFE, told=r"refused|separat|near|yield|wait")},
    ),
    Fault(
        "goals_crossing",
        "two drones get each other's place for a goal",
        _asked(_goals_crossing),
        Criteria(End.ALOFT),
        {Phase.LANDING: Criteria(End.SAFE)},
        victims=(0, 1),
    ),
    Fault("goals_in_a_row", "thirty goals in 3 s", _goals_in_a_row(), _FLIES_ON, _OR_LANDED),
    Fault(
        "trajectory_too_fast",
        "a trajectory of 2 m within 0.5 s",
        _asked(_trajectory((0.0, 0.0, 0.0), (0.0, 2.0, 0.0), 0.5)),
        _UNDISTURBED,
    ),
    Fault(
        "trajectory_far_away",
        "a trajectory that begins 3 m away",
        _asked(_trajectory((0.0, 3.0, 0.0), (0.0, 3.5, 0.0), 3.0)),
        Criteria(End.SAFE),
    ),
    Fault("parameters", "six parameters that are refused", _asked(_garbage), _UNDISTURBED),
    Fault("disarm", "disarm", _asked(_disarm), _UNDISTURBED),
    Fault("take_off_again", "take off, though in flight", _asked(lambda scene: scene.take_off(0, 0.5)), _UNDISTURBED),
    Fault("arm_race", "two programs arm, disarm, take off and land for 3 s", _arm_race(), Criteria(End.SAFE)),
    Fault("hand_over", "hand over to the drone's own commander", _asked(_hand_over), _FLIES_ON, _OR_LANDED),
    Fault(
        "controller_restarted",
        "the controller is killed, starts again after 0.8 s and gets its goals again 0.3 s later",
        ((0.0, _kill), (0.8, _start_again), (1.1, _goal_again)),
        Criteria(End.DONE),
        {Phase.LANDING: Criteria(End.SAFE)},
        victims=ALL,
    ),
    _taken_over(
        "yaw_reversed", "orientations are 180 degrees off about z", poses(lambda _: faults.turned(math.pi), ALL)
    ),
    _taken_over(
        "yaw_90deg", "orientations are 90 degrees off about z", poses(lambda _: faults.turned(math.pi / 2.0), ALL)
    ),
    _taken_over("pitch_negated", "the pitch has the other sign", commands(lambda _: faults.pitch_negated(*ALL))),
    _taken_over(
        "repeated",
        "motion capture gives each drone's pose then again and again, with fresh stamps",
        poses(lambda _: faults.repeated(), ALL),
        watched=45.0,  # none knows how they moved: they get ever less thrust, for half a minute
    ),
    *(
        Fault(
            f"ctrl_c_{height:g}m",
            f"Ctrl-C, {height:g} m above the floor",
            _asked(_end_controller),
            _LANDS,
            victims=ALL,
            height=height,
        )
        for height in (1.0, 2.0, 3.0, 5.0)
    ),
    Fault(
        "ctrl_c_blind",
        "no pose, 1 s later Ctrl-C",
        ((0.0, poses(lambda _: faults.lost, ALL)), (1.0, _end_controller)),
        _LANDS,
        victims=ALL,
    ),
    Fault("nothing", "nothing goes wrong", (), Criteria(End.DONE, distance=0.2, arrival=0.03), victims=ALL),
)  # fmt: skip

"""Faults of motion capture: poses that are missing, late, wrong, or somebody else's."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

from flatsat_ros.falsification.faults.criteria import Criteria, End
from flatsat_ros.falsification.faults.fault import ALL, EARLY, ONE, Action, Fault, end, from_the_start, poses
from flatsat_ros.falsification.faults.phases import Phase
from flatsat_ros.falsification.faults.scene import Scene
from flatsat_ros.flight.policy import YawSource
from flatsat_ros.sim import faults
from flatsat_ros.sim.faults import PoseFault

_POSE = r"pose"
_SURVIVED = Criteria(End.DONE, distance=0.5)
_TOLD_AND_SURVIVED = Criteria(End.DONE, told=_POSE)
_DOWN = Criteria(End.DOWN, told=_POSE)
_SAFE = Criteria(End.SAFE, told=_POSE)
# a wrong sign is noticed within 0.3 m of a hover; the rest is the way to the floor
_WRONG = Criteria(End.SAFE, told=r"pose|yaw|axis|sign|command|innovation|predict")
# a coordinate that stands still is noticed before the drone has gone 0.3 m; without it the drone sinks level
_STILL = Criteria(End.DOWN, distance=0.5, told=r"\b[xyz]\b has stood still")
_MIRRORED = replace(_STILL, told=r"pose|\bz\b")
_NO_TAKE_OFF = Criteria(End.GROUNDED, told=r"orientation|yaw")


def _rise(scene: Scene) -> None:
    """Give the drone a goal a metre above."""
    goal = scene.place[0] + (0.0, 0.0, 1.0)
    scene.record.extend_path(0, goal)
    scene.go_to(0, goal)


def _still(name: str, meaning: str, *make: Callable[[Scene], PoseFault], height: float = 1.0) -> Fault:
    """Return a fault of poses one of whose coordinates stands still, in a take-off to 1 m from before it on.

    In poses that are rounded it is seen in the air only.
    """
    early = EARLY if height == 1.0 and len(make) == 1 else None
    steps = tuple((0.0, poses(one)) for one in make)
    # from 3 m it drifts for longer while it sinks
    bounds = _STILL if height == 1.0 else replace(_STILL, distance=1.0)
    return Fault(name, meaning, steps, bounds, height=height, since_take_off=early)


def _lost(_: Scene) -> PoseFault:
    return faults.lost


def _for(
    seconds: float, make: Callable[[Scene], PoseFault], victims: tuple[int, ...] = ONE
) -> tuple[tuple[float, Action], ...]:
    return (0.0, poses(make, victims)), (seconds, end)


def _loss(seconds: float, bounds: Criteria, victims: tuple[int, ...] = ONE, height: float = 1.0) -> Fault:
    whose = "one drone" if victims is ONE else "all drones"
    name = f"poses_lost_{seconds:g}s{'' if victims is ONE else '_all'}{'' if height == 1.0 else f'_{height:g}m'}"
    above = "" if height == 1.0 else f", {height:g} m above the floor"
    return Fault(
        name,
        f"no pose of {whose} for {seconds:g} s{above}",
        _for(seconds, _lost, victims),
        bounds,
        # before the thrust has been learnt: low rather than high
        {Phase.TAKE_OFF: replace(bounds, impact=max(bounds.impact, 1.5))},
        victims=victims,
        height=height,
        watched=10.0 if seconds < 10.0 else 3.0,
    )


def _lasting(
    name: str,
    meaning: str,
    make: Callable[[Scene], PoseFault],
    bounds: Criteria,
    *,
    victims: tuple[int, ...] = ONE,
    special: Mapping[Phase, Criteria] | None = None,
    since_take_off: float | None = None,
) -> Fault:
    step = (0.0, poses(make, victims))
    return Fault(name, meaning, (step,), bounds, special or {}, victims=victims, since_take_off=since_take_off)


POSE_FAULTS = (
    _loss(0.2, _SURVIVED),
    _loss(0.5, _TOLD_AND_SURVIVED),
    _loss(1.0, _TOLD_AND_SURVIVED),
    _loss(1.0, _TOLD_AND_SURVIVED, ALL),
    _loss(3.0, _SAFE),
    _loss(15.0, _DOWN),
    _loss(15.0, _DOWN, ALL),
    _loss(15.0, _DOWN, height=2.0),
    _loss(15.0, _DOWN, height=3.0),
    # beyond the height for which 1 m/s is promised
    _loss(15.0, Criteria(End.DOWN, impact=1.5, told=_POSE), height=5.0),
    Fault(
        "poses_pause_take_off",
        "a take-off is accepted, and in the same moment the poses pause for 0.5 s",
        _for(0.5, _lost),
        _TOLD_AND_SURVIVED,
        # carried out, so that nothing need be told
        {Phase.TAKE_OFF: Criteria(End.DONE, distance=0.5)},
        since_take_off=0.0,
    ),
    _lasting("poses_half", "50 % of the poses are lost", lambda s: faults.thinned(0.5, s.seed), _SURVIVED),
    _lasting("poses_tenth", "90 % of the poses are lost", lambda s: faults.thinned(0.9, s.seed), _SURVIVED),
    _lasting(
        "poses_tenth_all", "90 % of all poses are lost", lambda s: faults.thinned(0.9, s.seed), _SURVIVED, victims=ALL
    ),
    _lasting("poses_10hz", "10 poses in a second", lambda _: faults.slowed(10.0), _SURVIVED),
    _lasting("poses_5hz", "5 poses in a second", lambda _: faults.slowed(5.0), _SURVIVED),
    _lasting("poses_2hz", "2 poses in a second", lambda _: faults.slowed(2.0), _SAFE),
    _lasting("poses_late_0.1s", "poses arrive 0.1 s late, stamps are right", lambda _: faults.delayed(0.1), _SURVIVED),
    _lasting("poses_late_0.2s", "poses arrive 0.2 s late, stamps are right", lambda _: faults.delayed(0.2), _SAFE),
    _lasting("poses_late_0.3s", "poses arrive 0.3 s late, stamps are right", lambda _: faults.delayed(0.3), _SAFE),
    *(
        from_the_start(
            f"poses_late_{late:g}s",
            f"poses arrive {late:g} s late, stamps are right",
            poses(lambda _, late=late: faults.delayed(late), ALL),  # type: ignore[misc]
            bounds,
        )
        for late, bounds in (
            (0.1, Criteria(End.DOWN, distance=0.5)),
            (0.2, Criteria(End.DOWN, distance=0.5, told=_POSE)),
            (0.3, Criteria(End.DOWN, told=_POSE)),
        )
    ),
    _lasting("poses_noisy", "noise of 5 mm", lambda s: faults.noisy(0.005, s.seed), _SURVIVED),
    _lasting(
        "poses_jumping", "every second one pose is 1 m off", lambda _: faults.jumping((1.0, 0.0, 0.0), 1.0), _SURVIVED
    ),
    _lasting("poses_shifted", "poses are 0.5 m off for good", lambda _: faults.moved((0.0, 0.5, 0.0)), _WRONG),
    _lasting("poses_shifted_far", "poses are 3 m off for good", lambda _: faults.moved((0.0, 3.0, 0.0)), _WRONG),
    _lasting(
        "second_source",
        "a second source, 1 m off, is heard in bursts of 0.5 s",
        lambda _: faults.doubled((0.0, 1.0, 0.0), 0.5, 0.5),
        _SAFE,
    ),
    _lasting(
        "second_source_near",
        "a second source, 5 cm off, is heard all the time",
        lambda _: faults.doubled((0.05, 0.0, 0.0), 1.0, 0.0),
        Criteria(End.SAFE, distance=0.5),
    ),
    Fault(
        "position_nan_1s",
        "positions are NaN for 1 s",
        _for(1.0, lambda _: faults.without_position()),
        _TOLD_AND_SURVIVED,
    ),
    _lasting("position_nan", "positions are NaN for good", lambda _: faults.without_position(), _DOWN),
    _lasting(
        "position_mm",
        "positions are in millimetres",
        lambda _: faults.scaled(1000.0),
        _DOWN,
        special={Phase.TAKE_OFF: _SAFE},
        since_take_off=EARLY,
    ),
    Fault(
        "poses_zero_1s",
        "position and quaternion are 0 for 1 s: not seen",
        _for(1.0, lambda _: faults.zeroed()),
        _TOLD_AND_SURVIVED,
    ),
    _lasting("poses_zero", "position and quaternion are 0 for good: not seen", lambda _: faults.zeroed(), _DOWN),
    Fault(
        "poses_repeated_1s",
        "the last pose again and again for 1 s, with fresh stamps",
        _for(1.0, lambda _: faults.repeated()),
        Criteria(End.SAFE),
    ),
    replace(
        _lasting(
            "poses_repeated", "the last pose again and again, with fresh stamps", lambda _: faults.repeated(), _DOWN
        ),
        watched=36.0,  # soon after a take-off motors run on for a while when it is down
    ),
    _still("poses_x_frozen", "x stays as it is, y and z live", lambda _: faults.frozen(0)),
    _still("poses_y_frozen", "y stays as it is, x and z live", lambda _: faults.frozen(1)),
    _still("poses_z_frozen", "z stays as it is, x and y live", lambda _: faults.frozen(2)),
    _still("poses_z_frozen_3m", "z stays as it is, 3 m above the floor", lambda _: faults.frozen(2), height=3.0),
    _still(
        "poses_z_frozen_mm",
        "z stays as it is, in poses of whole millimetres",
        lambda _: faults.frozen(2),
        lambda _: faults.rounded(1e-3),
    ),
    Fault(
        "poses_z_frozen_goal",
        "z stays as it is, and there is a goal 1 m above",
        ((0.0, poses(lambda _: faults.frozen(2))), (0.0, _rise)),
        _STILL,
    ),
    Fault(
        "poses_z_frozen_noisy",
        "z stays as it is but for noise of 0.5 mm, and there is a goal 1 m above",
        ((0.0, poses(lambda s: faults.frozen(2, s.seed, 5e-4))), (0.0, _rise)),
        Criteria(End.DOWN, told=r"\bz stays within"),
        # it hops, by a thrust that is not known yet, until it should have been seen to leave the ground
        {Phase.TAKE_OFF: Criteria(End.DOWN, impact=1.5, distance=1.5, told="not seen to leave the ground")},
        since_take_off=EARLY,
        watched=36.0,
    ),
    _lasting(
        "poses_z_mirrored",
        "z has the other sign",
        lambda _: faults.mirrored(2),
        _MIRRORED,
        since_take_off=EARLY,
    ),
    from_the_start(
        "poses_z_mirrored_thrust_plus_10",
        "z has the other sign, with 10 % of thrust too much",
        poses(lambda _: faults.mirrored(2), ALL),
        replace(_MIRRORED, told=r"has z the other sign"),
        fleet={"thrust_scale": 1.1},
    ),
    _lasting("poses_mm", "poses of whole millimetres", lambda _: faults.rounded(1e-3), _SURVIVED),
    _lasting(
        "bodies_exchanged",
        "two drones have each other's poses",
        lambda _: faults.exchanged(0, 1),
        Criteria(End.SAFE, told=r"pose|exchange|other|innovation|predict"),
        victims=(0, 1),
    ),
    *(
        from_the_start(
            f"bodies_exchanged{name}",
            f"two drones have each other's poses{meaning}",
            poses(lambda _: faults.exchanged(0, 1), (0, 1)),
            Criteria(End.DOWN, told=r"exchange"),
            victims=(0, 1),
            fleet={"thrust_scale": scale},
        )
        for name, meaning, scale in (
            ("", "", 1.0),
            # one leaves the ground first, which holds the other one there
            ("_weaker", ", and the first has 15 % less thrust than the second", (0.92, 1.08)),
        )
    ),
    _lasting(
        "yaw_reversed",
        "orientations are 180 degrees off about z",
        lambda _: faults.turned(math.pi),
        _WRONG,
        since_take_off=EARLY,
    ),
    _lasting(
        "yaw_off_90deg",
        "orientations are 90 degrees off about z",
        lambda _: faults.turned(math.pi / 2.0),
        _WRONG,
        since_take_off=EARLY,
    ),
    _lasting(
        "y_up",
        "motion capture's y points up",
        lambda _: faults.y_up(),
        _WRONG,
        since_take_off=EARLY,
    ),
    _lasting(
        "orientation_nan",
        "orientations are NaN for good",
        lambda _: faults.without_orientation(),
        Criteria(End.SAFE, told=r"orientation|yaw"),
        special={Phase.TAKE_OFF: _NO_TAKE_OFF},
        since_take_off=EARLY,
    ),
    Fault(
        "yaw_assumed_90deg",
        "poses without orientation, yaw_source is assumed, and the drones are turned by 90 degrees",
        (),
        Criteria(End.SAFE, told=r"yaw_source"),
        victims=ALL,
        fleet={
            "yaw": math.pi / 2.0,
            "yaw_source": YawSource.ASSUMED,
            "poses": (faults.without_orientation(),),
        },
    ),
)  # fmt: skip

"""Faults of time: stamps of another clock, clocks that are set, a controller that stands still."""

from __future__ import annotations

import math

from flatsat_ros.falsification.faults.criteria import Criteria, End
from flatsat_ros.falsification.faults.fault import ALL, EARLY, Action, Fault, poses
from flatsat_ros.falsification.faults.phases import Phase
from flatsat_ros.falsification.faults.scene import EPOCH, Scene
from flatsat_ros.sim import faults

_STAMP = r"stamp|clock|ahead|behind"
_LATE = r"late|stall|stood still|silent|behind|motors|climb"


def _stamps(name: str, meaning: str, shift: float, bounds: Criteria | None = None) -> Fault:
    """Shift the stamps of one drone's poses; by default the drone must come down, or not take off at all."""
    grounded = Criteria(End.GROUNDED, told=_STAMP)
    return Fault(
        name,
        meaning,
        ((0.0, poses(lambda _: faults.restamped(shift))),),
        bounds or Criteria(End.DOWN, told=_STAMP),
        {Phase.TAKE_OFF: bounds or grounded},
        since_take_off=EARLY,
    )


def _clock(name: str, meaning: str, change: float, *clocks: str) -> Fault:
    def act(scene: Scene) -> None:
        scene.set_clock(change, *clocks)

    return Fault(name, meaning, ((0.0, act),), Criteria(End.DONE, distance=0.5), victims=ALL)


def _stall(seconds: float) -> Action:
    return lambda scene: scene.pass_by(seconds)


CLOCK_FAULTS = (
    _stamps("stamps_ahead_0.05s", "stamps are 0.05 s ahead", 0.05, Criteria(End.DONE, distance=0.5)),
    _stamps("stamps_ahead_0.5s", "stamps are 0.5 s ahead", 0.5),
    _stamps("stamps_ahead_1h", "stamps are an hour ahead", 3600.0),
    _stamps("stamps_behind_0.1s", "stamps are 0.1 s behind", -0.1, Criteria(End.DONE, distance=0.5)),
    _stamps("stamps_behind_0.25s", "stamps are 0.25 s behind", -0.25, Criteria(End.SAFE)),
    _stamps("stamps_behind_1s", "stamps are 1 s behind", -1.0),
    _stamps("stamps_other_clock", "stamps count from the start of another machine", 5e4 - EPOCH),
    Fault(
        "stamps_zero",
        "stamps are 0",
        ((0.0, poses(lambda _: faults.stamped(-EPOCH))),),
        Criteria(End.DOWN, told=_STAMP),
        {Phase.TAKE_OFF: Criteria(End.GROUNDED, told=_STAMP)},
        since_take_off=EARLY,
    ),
    _clock("clock_back_10s", "the clock of controller and motion capture is set back 10 s", -10.0, "here", "there"),
    _clock("clock_ahead_60s", "the clock of controller and motion capture is set ahead 60 s", 60.0, "here", "there"),
    _clock("clock_back_10s_here", "the clock of the controller's machine alone is set back 10 s", -10.0, "here"),
    Fault(
        "stall_0.2s",
        "the controller stands still for 0.2 s, five times",
        tuple((1.0 * number, _stall(0.2)) for number in range(5)),
        Criteria(End.DONE, distance=0.5),
        victims=ALL,
    ),
    Fault(
        "stall_1s",
        "the controller stands still for 1 s",
        ((0.0, _stall(1.0)),),
        Criteria(End.DONE),
        victims=ALL,
    ),
    Fault(
        "stall_5s",
        "the controller stands still for 5 s: after 2 s the firmware stops the motors",
        ((0.0, _stall(5.0)),),
        Criteria(End.DOWN, impact=math.inf, told=_LATE),
        {Phase.LANDING: Criteria(End.DOWN, impact=math.inf)},
        victims=ALL,
    ),
)

"""Flight modes: when a drone is steered, when it is levelled and when its motors rest. A pure state machine.

    IDLE --reference, estimate--> UNLOCK (on the ground) --unlock time--> FLY <--> LEVEL --level time--> CUT
      |                                                                   ^                              |
      +-------------------------- reference, estimate, in the air --------+     UNLOCK <--new reference--+

    FLY --landing, touched down--> REST --rest time--> IDLE
    FLY --told to climb, held on the ground for the lift-off time--> UNLOCK, the second time CUT
    IDLE --armed on the ground--> UNLOCK --unlock time--> IDLE

IDLE is silent, so that starting the controller never takes a drone away from whoever flies it. A command is computed
from poses in FLY only. In LEVEL, when the estimate is not usable, the drone is kept level and sinks slowly; with poses
back in time it flies on. CUT stops the motors and stays until the user gives a new reference. A drone that does not
lift off is cut, too: its gain grown by then, it would leap when somebody arms it. REST streams zero thrust after a
landing for longer than the firmware's watchdogs wait: silence right after it would lock the drone until reboot. A drone
that somebody else shall fly first is unlocked as it is armed: taken over in the air, still locked, it would fall.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

from flatsat_ros.base.errors import require, require_positive


class Mode(IntEnum):
    """What is done with one drone. Arrays are compared with a `.value`, which numpy takes ten times faster."""

    IDLE = 0
    UNLOCK = 1
    FLY = 2
    LEVEL = 3
    CUT = 4
    REST = 5


@dataclass(frozen=True)
class Policy:
    """The figures of the state machine.

    Attributes:
        pose_timeout: age, s, above which a pose is stale and the drone is levelled.
        level_time: s of level descent without poses before the motors are cut.
        unlock_time: s of zero thrust that open the firmware's thrust lock before take-off.
        lift_off_time: s of a commanded climb that leave the drone on the ground after which the motors are cut.
        rest_time: s of zero thrust after touch-down; the firmware needs more than 1.8 s.
        ground_height: m, world frame: a drone below it is taken to stand on the ground when its reference arrives.
        level_thrust: thrust while levelled, as a fraction of gravity, at most 1, so that it sinks slowly.
        disturbance_max: largest disturbance, m/s^2, that is compensated in flight; 0 is the paper's law.
        thrust_error_max: largest error of the thrust, as a fraction, that is estimated and corrected; 0 estimates none.

    Raises:
        FlatsatError: a time or the fraction is not above 0, a fraction is above its bound, or the height is not finite.
    """

    pose_timeout: float = 0.3
    level_time: float = 3.0
    unlock_time: float = 0.3
    lift_off_time: float = 3.0
    rest_time: float = 2.5
    ground_height: float = 0.15
    level_thrust: float = 0.95
    disturbance_max: float = 0.0
    thrust_error_max: float = 0.0

    def __post_init__(self) -> None:
        for name in ("pose_timeout", "level_time", "unlock_time", "lift_off_time", "rest_time"):
            require_positive(name, getattr(self, name), "s")
        require_positive("level_thrust", self.level_thrust, "g")
        require(self.level_thrust <= 1.0, "level_thrust", f"{self.level_thrust} g", "at most 1 g, or it would climb")
        most = self.disturbance_max
        require(0.0 <= most < math.inf, "disturbance_max", f"{most} m/s^2", "a finite number of at least 0")
        error = self.thrust_error_max
        require(0.0 <= error <= 0.5, "thrust_error_max", error, "0 to 0.5")
        require(math.isfinite(self.ground_height), "ground_height", f"{self.ground_height} m", "a finite number")


def next_mode(
    mode: Mode,
    elapsed: float,
    *,
    requested: bool,
    usable: bool,
    height: float,
    down: bool,
    policy: Policy,
    opening: bool = False,
    stuck: bool = False,
    again: bool = False,
) -> Mode:
    """Return the mode that follows.

    Args:
        mode: the present one.
        elapsed: s since it began.
        requested: a reference was given since the motors were last cut.
        usable: the estimate can be flown on.
        height: estimated z, m.
        down: the drone was asked to land and has touched down.
        policy: the figures.
        opening: the drone was armed on the ground, to be unlocked without flying.
        stuck: the drone was told to climb and stayed on the ground for the lift-off time.
        again: it has been unlocked a second time already; the first time its link may not have been there yet.
    """
    if mode is Mode.FLY:
        if not usable:
            return Mode.LEVEL
        if down:
            return Mode.REST
        if stuck:
            return Mode.CUT if again else Mode.UNLOCK
        return Mode.FLY
    if mode is Mode.REST:
        return Mode.IDLE if elapsed >= policy.rest_time else Mode.REST
    if mode is Mode.LEVEL:
        if usable:
            return Mode.FLY
        return Mode.CUT if elapsed >= policy.level_time else Mode.LEVEL
    if not (usable and (requested or (opening and mode is not Mode.CUT))):
        return Mode.IDLE if mode is Mode.UNLOCK else mode
    if mode is Mode.UNLOCK:
        unlocked = Mode.FLY if requested else Mode.IDLE
        return unlocked if elapsed >= policy.unlock_time else Mode.UNLOCK
    if not requested:
        return Mode.UNLOCK if height < policy.ground_height else Mode.IDLE
    in_the_air = mode is Mode.IDLE and height >= policy.ground_height
    return Mode.FLY if in_the_air else Mode.UNLOCK

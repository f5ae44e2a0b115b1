"""What people are told about a flight: lines of the log, and statuses of /diagnostics."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence

from rclpy.impl.rcutils_logger import RcutilsLogger

from flatsat_ros.certificate.sets import Place
from flatsat_ros.flight.battery import Charge
from flatsat_ros.flight.modes import Event, Mode, Transition
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.tick import Tick
from flatsat_ros.nodes.ros.diagnostics import Level, RobotCondition
from flatsat_ros.nodes.ros.throttle import Throttle

# modes that no drone enters by anybody's wish
_TROUBLE = (Mode.LEVEL, Mode.DESCEND, Mode.CUT, Mode.FALLEN)
# take-offs that do not come
_LOST = {event.value for event in (Event.TAKE_OFF_LOST, Event.UNHEARD, Event.POSE_LOST_GROUNDED)}

# the same line is logged again after this time at the earliest, s: about a drone, and about a clock
_SILENCE, _CLOCK_SILENCE = 1.0, 10.0


class ThrottledLog:
    """Lines of the log, each kind of line about a drone at most once a second.

    Attributes:
        events: how many changes of mode and other reports there were of each robot so far, logged or not.
        newest: the text of the last one.
    """

    def __init__(self, logger: RcutilsLogger, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin with nothing logged; the clock shows s and is never set."""
        self._logger, self._throttle = logger, Throttle(clock)
        self.events: Counter[str] = Counter()
        self.newest: dict[str, str] = {}

    def transition(self, robot: str, transition: Transition, held: str = "") -> None:
        """Log a change of a robot's flight mode; an error where it was not wanted.

        Args:
            robot: its name.
            transition: the change.
            held: why it may stay on the ground against the command, if that is known.
        """
        _, before, after, reason = transition
        self._note(robot, f"{before.name} -> {after.name}: {reason}")
        times = self._throttle.admit(f"{robot} {before.name} {after.name}", _SILENCE)
        if times is None:
            return
        text = f"{robot}: {before.name} -> {after.name}: {reason}{times}"
        if reason in (Event.HELD.value, Event.NOT_LIFTED.value) and held:
            text += f"; {held}"
        if after in _TROUBLE or reason in _LOST:
            self._logger.error(text)
        else:
            self._logger.info(text)

    def report(self, robot: str, text: str) -> None:
        """Log something else that people should know of a robot."""
        self._note(robot, text)
        times = self._throttle.admit(f"{robot} {text[:20]}", _SILENCE)
        if times is not None:
            self._logger.warning(f"{robot}: {text}{times}")

    def refusals(self, robots: str, sentences: Sequence[str]) -> None:
        """Log why a request was refused for some robots, or for all."""
        if sentences and (times := self._throttle.admit(f"{robots} refused", _SILENCE)) is not None:
            self._logger.error("; ".join(sentences) + times)

    def _note(self, robot: str, text: str) -> None:
        self.events[robot] += 1
        self.newest[robot] = text

    def clock(self, jump: float) -> None:
        """Log by how much the ROS clock was set, s; 0.0 for not at all."""
        if jump and (times := self._throttle.admit("clock", _CLOCK_SILENCE)) is not None:
            self._logger.warning(f"the clock was set by {jump:+.3f} s{times}: stamps are read on it from now on")


def report_flight(
    robot: str, index: int, pilot: Pilot, tick: Tick, now: float, rivals: str, values: dict[str, object]
) -> RobotCondition:
    """Return the status of one drone.

    Args:
        robot: its name.
        index: its index.
        pilot: flies it.
        tick: the last one.
        now: s.
        rivals: who publishes in its place, empty for nobody.
        values: what else there is to report.
    """
    mode, where = Mode(pilot.mode[index]), tick.assessment
    place, flying = Place(where.place[index]), mode is Mode.FLY
    outside = "outside the certified sets" if flying and place is Place.OUTSIDE else ""
    if flying and where.broken is not None:
        outside = pilot.unclaimed(index)
    charge, voltage = pilot.batteries.charges[index], pilot.batteries.voltages[index]
    battery = "" if charge is Charge.GOOD else f"battery {charge.name.lower()}"
    figures: dict[str, object] = {
        "V/eps": f"{where.relative_level[index]:.4g}",
        "set": place.name,
        "guaranteed": bool(where.guaranteed[index]) and flying,
        **({} if where.tube is None else {"tube m": f"{where.tube[0]:.3f}, {where.tube[1]:.3f} vertically"}),
        "gamma": f"{tick.output.gain[index]:.4g}",
        "applied gain": f"{tick.output.applied_gain[index]:.4g}",
        "pose age s": f"{now - pilot.estimator.newest[index]:.3f}",
        "poses refused": int(pilot.estimator.rejected[index]),
        "battery V": f"{voltage:.2f}",
    }
    bad = mode in _TROUBLE or rivals or charge is Charge.EMPTY
    level = Level.ERROR if bad else Level.WARN if outside or battery else Level.OK
    text = ": ".join(filter(None, (mode.name, outside, battery, rivals)))
    return RobotCondition(robot, robot, level, text, figures | values)

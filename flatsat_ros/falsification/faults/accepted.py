"""Rows that may break a bound: what happens instead, and what a user must do about it.

A fault is listed with all the phases in which it may break its bounds. Where a loop is unstable it depends on chance in
which of these phases it does. Wider bounds hold there all the same. The list must not name what does not exist, nor a
fault for which the flight layer was made. A fault that keeps its bounds in all of its phases is reported, so that it
can be taken off the list.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from flatsat_ros.base.errors import refusal, require
from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE
from flatsat_ros.falsification.faults.criteria import Criteria, DroneOutcome, End, Remark, broken

FAULTS_MAX = 5  # faults that may have accepted rows

# what brought drones down before they had a supervisor: every row of these must pass
NEVER = frozenset(
    {
        "land_in_climb", "land_after_poses_back", "land_far_from_goal", "goal_up_10m",
        "pose_bytes", "goal_orientation", "goal_huge",
        "emergency", "emergency_all", "emergency_reboot", "sim_drone_killed",
        "poses_repeated", "poses_zero", "yaw_reversed", "y_up", "pitch_negated",
        "bodies_exchanged", "bodies_exchanged_from_start", "bodies_exchanged_weaker_from_start",
        "table", "step", "low_floor",
        "poses_lost_15s", "poses_lost_15s_all", "poses_lost_15s_2m", "poses_lost_15s_3m", "poses_lost_15s_5m",
        "thrust_plus_10_poses_lost_1m", "thrust_plus_10_poses_lost_3m",
        "ctrl_c_1m", "ctrl_c_2m", "ctrl_c_3m", "ctrl_c_5m", "ctrl_c", "sighup",
        "use_sim_time", "clock_back_10s", "trajectory_long",
        "goal_below_floor", "goal_100m", "goal_at_neighbour", "goals_crossing",
        "thrust_minus_20", "thrust_minus_20_0.5m", "thrust_minus_12_0.5m",
        "battery_sagging", "battery_empty", "second_controller", "second_source", "pose_frame", "orientation_nan",
        "stamps_other_clock", "stamps_zero", "poses_pause_take_off",
    }
)  # fmt: skip


@dataclass(frozen=True)
class Accepted:
    """A fault some of whose rows may break a bound.

    Attributes:
        fault: its name.
        phases: in which it may, with the default certificate.
        bounds: what the drones with the fault keep then all the same.
        happens: what happens then, with its figure.
        advice: what a user must do.
        others: phases in which it may with other certificates alone.
    """

    fault: str
    phases: tuple[str, ...]
    bounds: Criteria
    happens: str
    advice: str
    others: tuple[str, ...] = ()

    @property
    def all_phases(self) -> tuple[str, ...]:
        """In which it may with some certificate."""
        return (*self.phases, *self.others)


class Judged(Protocol):
    """A row as far as it is needed here."""

    @property
    def fault(self) -> str:
        """Its fault."""

    @property
    def phase(self) -> str:
        """Its phase."""

    @property
    def passed(self) -> bool:
        """Whether it kept all bounds."""


_AIR = ("hover", "moving", "take-off", "swap")
_ALL = (*_AIR, "landing")
_BLOWN = r"wind|disturb|away|limit|tilt"
_LATE = "Measure the delay of the radio before the flight, and let fewer drones share a dongle."
ACCEPTED: tuple[Accepted, ...] = (
    Accepted(
        "wind_4",
        (),
        Criteria(End.SAFE, distance=4.0, told=_BLOWN),
        "Tilted by all that a certificate for 10 degrees allows it does not hold its place against 4 m/s: it drifts up "
        "to 3 m within seconds, says so, and lands where it is.",
        "Keep fans, open windows and rotors of larger drones away: the air may move with 3.5 m/s at most.",
        others=_ALL,
    ),
    Accepted(
        "wind_6",
        _AIR,
        Criteria(End.SAFE, impact=2.5, distance=15.0, told=_BLOWN),
        "A sudden wind of 6 m/s carries it 1.8 m away; it says so, comes back, and flies on instead of "
        "landing. With a certificate for 10 degrees of tilt it is carried up to 13 m away and lands where it is.",
        "Keep fans, open windows and rotors of larger drones away, and fly inside a net.",
    ),
    Accepted(
        "propeller",
        ("hover",),
        Criteria(End.DOWN, impact=math.inf, distance=2.0, told=r"fall|tumble|motors"),
        "It tumbles, is thrown up to 1.6 m sideways, and falls.",
        "Look at propellers before every flight, and stand 2 m away or behind a net.",
    ),
    Accepted(
        "commands_late_0.2s",
        _ALL,
        Criteria(End.SAFE, impact=1.5, speed=1.0, again=True),
        "A loop whose commands come 0.1 s later than its certificate assumes is unstable: it swings, by up to 0.7 m "
        "until it is flown softly, and again when that ends; it may hop at its landing.",
        _LATE,
    ),
    Accepted(
        "commands_late_0.3s",
        _ALL,
        Criteria(End.SAFE, impact=2.0, speed=1.0, again=True),
        "Commands so much later than the certificate allows for make it swing until it is flown softly, mostly by less "
        "than 1 m. Of seven landings that had begun before, each with another noise, three met the floor with 1.0 to "
        "1.2 m/s; of seven swaps one drone got 1.6 m off its path, and met the floor with 2.0 m/s: not accepted.",
        _LATE,
    ),
)


def is_accepted(
    certificate: str,
    fault: str,
    phase: str,
    outcomes: Sequence[DroneOutcome],
    victims: Sequence[int],
    remarks: Iterable[Remark],
    *,
    lands: bool,
    accepted: Iterable[Accepted] = ACCEPTED,
) -> bool:
    """Tell whether a flight that broke a bound is accepted: its fault is on the list, and it kept the bounds there.

    Args:
        certificate: name of that which was flown.
        fault: its name.
        phase: of the flight.
        outcomes: of all drones.
        victims: the drones with the fault.
        remarks: what was told since the fault.
        lands: the drones were on their way to the floor.
        accepted: the list.
    """
    for entry in accepted:
        phases = entry.phases if certificate == DEFAULT_CERTIFICATE else entry.all_phases
        if entry.fault == fault and phase in phases:
            return not any(broken(outcomes, entry.bounds, victims, remarks, lands=lands))
    return False


def require_sound(accepted: Collection[Accepted], exist: Collection[tuple[str, str]]) -> None:
    """Refuse a list that accepts what does not exist, what must never be accepted, or too much.

    Args:
        accepted: the list.
        exist: fault and phase of every row that there is.

    Raises:
        FlatsatError: the list is not sound; the text names the entry.
    """
    for entry in accepted:
        require(entry.fault not in NEVER, "accepted", entry.fault, "", "a fault other than those that must always pass")
        phases = entry.all_phases
        require(bool(phases), f"phases of {entry.fault}", phases, "", "those in which it may break a bound")
        for phase in phases:
            require((entry.fault, phase) in exist, "accepted", f"{entry.fault}:{phase}", "", "a row of the matrix")
        for text in (entry.happens, entry.advice):
            require(text.endswith("."), f"text of {entry.fault}", text, "", "a sentence")
    faults = sorted({entry.fault for entry in accepted})
    if len(faults) != len(accepted):
        raise refusal("accepted", ", ".join(entry.fault for entry in accepted), "", "each fault once")
    require(len(faults) <= FAULTS_MAX, "number of accepted faults", len(faults), "", f"at most {FAULTS_MAX}")


def not_needed(rows: Iterable[Judged], accepted: Iterable[Accepted] = ACCEPTED) -> list[str]:
    """Return the faults on the list that kept all bounds in each of their phases, flown with the default certificate.

    One that was not flown in all of them is left out: where it breaks its bounds may be luck.
    """
    passed = {(row.fault, row.phase) for row in rows if row.passed}
    listed = [(e.fault, {(e.fault, phase) for phase in e.phases}) for e in accepted]
    return [fault for fault, which in listed if which and which <= passed]

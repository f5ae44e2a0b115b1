"""Rows that may break a bound: what happens instead, and what a user must do about it.

The list cannot rot: whatever is on it must exist and fail, and no fault may be on it that the flight layer was made
for.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Protocol

from flatsat_ros.base.errors import refusal, require
from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE

FAULTS_MAX = 5  # faults that may have accepted rows

# what brought drones down before they had a supervisor: every row of these must pass
NEVER = frozenset(
    {
        "land_in_climb", "land_after_poses_back", "land_far_from_goal", "goal_up_10m",
        "pose_bytes", "goal_orientation", "goal_huge",
        "emergency", "emergency_all", "emergency_reboot", "sim_drone_killed",
        "poses_repeated", "poses_zero", "bodies_exchanged", "yaw_reversed", "y_up", "pitch_negated",
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
        happens: what happens then, with its figure.
        advice: what a user must do.
        others: phases in which it may with other certificates alone.
    """

    fault: str
    phases: tuple[str, ...]
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
_LATE = "Measure the delay of the radio before the flight, and let fewer drones share a dongle."
ACCEPTED: tuple[Accepted, ...] = (
    Accepted(
        "wind_4",
        (),
        "Tilted by all that a certificate for 10 degrees allows it does not hold its place against 4 m/s: it drifts up "
        "to 3 m within seconds, says so, and lands where it is.",
        "Keep fans, open windows and rotors of larger drones away: the air may move with 3.5 m/s at most.",
        others=(*_AIR, "landing"),
    ),
    Accepted(
        "wind_6",
        _AIR,
        "A sudden wind of 6 m/s carries it 1.8 m away; it says so, comes back, and flies on instead of "
        "landing. With a certificate for 10 degrees of tilt it is carried up to 13 m away and lands where it is.",
        "Keep fans, open windows and rotors of larger drones away, and fly inside a net.",
    ),
    Accepted(
        "propeller",
        ("hover",),
        "It tumbles, is thrown up to 1.6 m sideways, and falls.",
        "Look at propellers before every flight, and stand 2 m away or behind a net.",
    ),
    Accepted(
        "commands_late_0.2s",
        ("moving", "take-off", "swap"),
        "A loop whose commands come 0.1 s later than its certificate assumes is unstable: it swings, by up to 0.46 m "
        "until it is flown softly, and again when that ends.",
        _LATE,
    ),
    Accepted(
        "commands_late_0.3s",
        ("hover",),
        "Commands so much later than the certificate allows for make it swing up and down until it is told to sink, at "
        "the speed that it has by then: it meets the floor with up to 1.1 m/s, with certificates without a flight "
        "section 1.9 m/s.",
        _LATE,
        others=("take-off", "swap"),
    ),
)


def accepted_rows(certificate: str, accepted: Iterable[Accepted] = ACCEPTED) -> frozenset[tuple[str, str]]:
    """Return fault and phase of what is accepted of flights with a certificate, by its name."""
    usual = certificate == DEFAULT_CERTIFICATE
    return frozenset((e.fault, phase) for e in accepted for phase in (e.phases if usual else e.all_phases))


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


def require_failing(rows: Iterable[Judged], accepted: Iterable[Accepted] = ACCEPTED) -> None:
    """Refuse rows, flown with the default certificate, that are accepted although they keep all bounds.

    Raises:
        FlatsatError: there are such rows; the text names them.
    """
    listed = accepted_rows(DEFAULT_CERTIFICATE, accepted)
    kept = [f"{row.fault}:{row.phase}" for row in rows if row.passed and (row.fault, row.phase) in listed]
    if kept:
        raise refusal("accepted", ", ".join(kept), "", "rows that break a bound; these pass: take them off the list")

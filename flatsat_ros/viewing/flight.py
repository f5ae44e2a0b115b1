"""A recorded flight: samples of each drone over time, what happened, and what is known of the controller's set-up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.flight.modes import Mode

POSE_FIELDS = ("x", "y", "z", "qx", "qy", "qz", "qw")  # m, and x, y, z, w of the orientation, body -> world
COMMAND_FIELDS = ("roll", "pitch", "yaw", "thrust")  # degrees, degrees, as on the wire; PWM


@dataclass(frozen=True, eq=False)
class Channel:
    """Samples of one kind.

    Attributes:
        fields: names of the values.
        samples: (n, 1 + len(fields)): time, s, rising, and the values.
        stamps: (n,) of poses, s: when they were measured, on the clock of whoever measured; None where nobody says.
    """

    fields: tuple[str, ...]
    samples: FloatArray
    stamps: FloatArray | None = None

    def column(self, name: str) -> FloatArray:
        """Return the values (n,) of the field with a name."""
        return np.asarray(self.samples[:, 1 + self.fields.index(name)])

    @property
    def times(self) -> FloatArray:
        """(n,) s."""
        return np.asarray(self.samples[:, 0])


@dataclass(frozen=True, eq=False)
class Track:
    """What was recorded of one drone.

    Attributes:
        name: of the drone.
        channels: by kind, those that were recorded: `pose` (`POSE_FIELDS`), `tick` (the telemetry's fields), `command`
            (`COMMAND_FIELDS`), `battery` (voltage, V).
    """

    name: str
    channels: Mapping[str, Channel]


@dataclass(frozen=True)
class LoggedEvent:
    """Something that happened.

    Attributes:
        time: s.
        drone: whose, empty for none in particular.
        severity: info, warning or error.
        text: for people.
    """

    time: float
    drone: str
    severity: str
    text: str


@dataclass(frozen=True, eq=False)
class Flight:
    """A whole flight; times are s from its begin.

    Attributes:
        title: where it comes from.
        tracks: of the drones.
        events: in the order of time.
        setup: what the recording says of the controller: names and values.
        notes: what is missing in the recording, a sentence each.
    """

    title: str
    tracks: Sequence[Track]
    events: Sequence[LoggedEvent] = ()
    setup: Mapping[str, object] = field(default_factory=dict)
    notes: Sequence[str] = ()

    @property
    def duration(self) -> float:
        """Time of the last sample, s."""
        ends = [c.times[-1] for track in self.tracks for c in track.channels.values() if len(c.times)]
        return float(max(ends, default=0.0))


def with_mode_events(flight: Flight) -> Flight:
    """Return the flight with an event for each change of a flight mode that the telemetry shows."""
    found = list(flight.events)
    for track in flight.tracks:
        ticks = track.channels.get("tick")
        if ticks is None or len(ticks.times) == 0:
            continue
        modes = ticks.column("mode").astype(int)
        for index in np.flatnonzero(np.diff(modes)) + 1:
            before, after = (_mode_name(modes[i]) for i in (index - 1, index))
            severity = "error" if after in ("LEVEL", "DESCEND", "CUT", "FALLEN") else "info"
            found.append(LoggedEvent(float(ticks.times[index]), track.name, severity, f"{before} → {after}"))
    return replace(flight, events=sorted(found, key=lambda event: event.time))


def _mode_name(value: int) -> str:
    return Mode(value).name if value in {mode.value for mode in Mode} else str(value)

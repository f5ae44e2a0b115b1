"""The figures of a flight: a row for each drone, and the smallest distance between two."""

from __future__ import annotations

from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from flatsat_ros.base.arrays import BoolArray, FloatArray
from flatsat_ros.flight.modes import Mode
from flatsat_ros.viewing.flight import Channel, Flight, Track

_GAP = 0.5  # s: nothing is said of a drone's place in longer gaps between its poses
_BELOW = 0.03  # m: a reference so far below all places where the drone was leads into the floor, to land
_SETTLED = 2.0  # s after lift-off, from which on a share of the time is guaranteed


class FigureColumn(NamedTuple):
    """A figure: its name, and its unit."""

    name: str
    unit: str


COLUMNS = (
    FigureColumn("poses", "Hz"),
    FigureColumn("error RMS", "cm"),
    FigureColumn("error max", "cm"),
    FigureColumn("guaranteed", "% of FLY"),
    FigureColumn("T min", "m/s²"),
    FigureColumn("T max", "m/s²"),
    FigureColumn("tilt max", "°"),
    FigureColumn("gain max", ""),
    FigureColumn("tick 99 %", "\N{MICRO SIGN}s"),
    FigureColumn("battery min", "V"),
)


def figures_of(flight: Flight) -> dict[str, Any]:
    """Return the table of a flight: `columns`, `rows` of drone and values (None: not recorded), `lines` of text."""
    return {
        "columns": [column._asdict() for column in COLUMNS],
        "rows": [{"drone": track.name, "values": _row(track)} for track in flight.tracks],
        "lines": _lines(flight),
    }


def _row(track: Track) -> list[float | None]:
    pose, battery = track.channels.get("pose"), track.channels.get("battery")
    rate = None
    if pose is not None and len(pose.times) > 1 and pose.times[-1] > pose.times[0]:
        rate = (len(pose.times) - 1) / float(pose.times[-1] - pose.times[0])
    voltages = battery.column("voltage") if battery is not None else np.zeros(0)
    voltages = voltages[np.isfinite(voltages)]
    lowest = float(voltages.min()) if voltages.size else None
    return [rate, *_tick_figures(track.channels.get("tick"), pose), lowest]


@np.errstate(invalid="ignore", over="ignore")  # what was recorded need not be finite
def _tick_figures(ticks: Channel | None, pose: Channel | None) -> list[float | None]:
    if ticks is None or len(ticks.times) == 0:
        return [None] * 8
    duration = float(np.quantile(ticks.column("tick_us"), 0.99))
    flying = ticks.column("mode") == Mode.FLY
    if not flying.any():
        return [None] * 7 + [duration]
    following = flying & ~_sinking(ticks, pose)
    error = np.sqrt(sum(ticks.column(f"error_{axis}")[following] ** 2 for axis in "xyz"))
    thrust, roll, pitch = (ticks.column(name)[flying] for name in ("T", "phi", "theta"))
    times = ticks.times[flying]
    settled = times >= times[0] + _SETTLED
    proven = ticks.column("guaranteed")[flying][settled]
    return [
        100.0 * float(np.sqrt((error**2).mean())) if error.size else None,
        100.0 * float(error.max()) if error.size else None,
        100.0 * float(proven.mean()) if proven.size else None,
        float(thrust.min()),
        float(thrust.max()),
        float(np.degrees(np.arccos(np.cos(roll) * np.cos(pitch))).max()),
        float(ticks.column("gamma")[flying].max()),
        duration,
    ]


def _sinking(ticks: Channel, pose: Channel | None) -> BoolArray:
    """Tell of each tick (n,) whether its reference lies below the floor: at the end of a landing it goes on sinking."""
    height = pose.column("z") if pose is not None else np.zeros(0)
    known = np.isfinite(height)
    if pose is None or not known.any():
        return np.zeros(ticks.times.shape, dtype=bool)
    height = height[known]
    reference = np.interp(ticks.times, pose.times[known], height) - ticks.column("error_z")
    return np.asarray(reference < height.min() - _BELOW)


def _lines(flight: Flight) -> list[str]:
    nearest = separation(flight)
    if nearest is None:
        return []
    distance, one, other, time = nearest
    return [f"Smallest distance of two drones: {distance:.2f} m, {one} and {other}, at {time:.1f} s."]


def separation(flight: Flight) -> tuple[float, str, str, float] | None:
    """Return the smallest distance of two drones, m, their names and when, s; None if two were never seen together.

    Between its poses a drone moves on straight lines.
    """
    poses = {track.name: track.channels["pose"] for track in flight.tracks if "pose" in track.channels}
    found = []
    for (one, first), (other, second) in combinations(poses.items(), 2):
        times = np.union1d(first.times, second.times)
        with np.errstate(invalid="ignore", over="ignore"):  # what was recorded need not be finite
            between = _places(second, times) - _places(first, times)
            begin, change = between[:-1], np.diff(between, axis=0)
            square = (change * change).sum(axis=1)
            # of begin + share change the nearest to 0
            share = np.clip(-(begin * change).sum(axis=1) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
            distance = np.linalg.norm(begin + share[:, np.newaxis] * change, axis=1)
        if np.isfinite(distance).any():
            index = int(np.nanargmin(distance))
            time = times[index] + share[index] * (times[index + 1] - times[index])
            found.append((float(distance[index]), one, other, float(time)))
    return min(found, default=None)


def _places(pose: Channel, times: FloatArray) -> FloatArray:
    """Return the positions (n, 3) at times (n,), NaN in gaps and outside what was recorded."""
    if len(pose.times) < 2:
        return np.full((times.size, 3), np.nan)
    after = np.clip(np.searchsorted(pose.times, times), 1, len(pose.times) - 1)
    gap = pose.times[after] - pose.times[after - 1]
    at_sample = (times == pose.times[after]) | (times == pose.times[after - 1])
    seen = (times >= pose.times[0]) & (times <= pose.times[-1]) & ((gap <= _GAP) | at_sample)
    found = np.column_stack([np.interp(times, pose.times, pose.column(axis)) for axis in "xyz"])
    return np.where(seen[:, np.newaxis], found, np.nan)

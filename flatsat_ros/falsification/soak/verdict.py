"""What came of a long flight, in figures and as a verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from flatsat_ros.falsification.soak.usage import MIB, ProcessUsage

# MiB, that a process may grow by in the second half, along the regression line: what the allocators of Python and C
# keep of a moment's garbage is less; a hundred bytes kept at every tick are 9 MiB in half an hour
GROWTH_MAX = 2.0
MISSED_MAX = 0.01  # of all ticks


@dataclass
class Soak:
    """A long flight as it was watched.

    Attributes:
        drones: their number.
        period: of the controller's tick, s.
        samples: of each process, by name, in order of time.
        ticks: how many the controller made while it was watched.
        watched: s, from the first of these ticks to the last.
        flights: from take-off to landing, how many there were.
        unsteady: at how many looks, one a second, a drone was held level for want of poses.
        left: files of shared memory and processes that were there after the end.
        problems: what went wrong in flight.
    """

    drones: int
    period: float
    samples: dict[str, list[ProcessUsage]] = field(default_factory=dict)
    ticks: int = 0
    watched: float = 0.0
    flights: int = 0
    unsteady: int = 0
    left: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    @property
    def missed(self) -> int:
        """How many ticks there were too few."""
        return max(0, round(self.watched / self.period) + 1 - self.ticks)


def memory_growth(samples: Sequence[ProcessUsage]) -> tuple[float, float]:
    """Return the growth of memory by regression over the second half: MiB in that half, and MiB per hour.

    Args:
        samples: of one process, in order of time.
    """
    times, memory = np.array([(s.time, s.memory) for s in _second_half(samples)]).T
    if len(times) < 2:
        return 0.0, 0.0
    slope = float(np.polyfit(times - times[0], memory, 1)[0])
    return slope * float(times[-1] - times[0]), slope * 3600.0


def verdict(soak: Soak) -> list[str]:
    """Return what speaks against a flight, each as a sentence; nothing if it passed."""
    found = list(soak.problems)
    for name, samples in soak.samples.items():
        if len(samples) < 4:
            found.append(f"{name} was looked at {len(samples)} times: too short a time for a verdict")
            continue
        grown, _ = memory_growth(samples)
        if not grown <= GROWTH_MAX:
            found.append(f"{name} grew by {grown:.1f} MiB in the second half: at most {GROWTH_MAX:g} MiB are allowed")
        for what, before, after in _peaks(samples):
            if after > before:
                found.append(f"{name} had up to {before} {what} in the first half and {after} in the second")
    if soak.missed > MISSED_MAX * (soak.missed + soak.ticks):
        found.append(f"the controller missed {soak.missed} ticks beside {soak.ticks}: more than {MISSED_MAX:.0%}")
    found += [f"left behind: {name}" for name in soak.left]
    return found


def summary(soak: Soak) -> dict[str, object]:
    """Return the figures of a flight that was watched, and its verdict, as they go into the file.

    Args:
        soak: the flight.
    """
    problems = verdict(soak)
    return {
        "passed": not problems,
        "problems": problems,
        "minutes": round(soak.watched / 60.0, 2),
        "drones": soak.drones,
        "flights": soak.flights,
        "seconds_without_poses": soak.unsteady,
        "ticks": soak.ticks,
        "ticks_missed": soak.missed,
        "left_behind": soak.left,
        "processes": {name: _figures(samples) for name, samples in soak.samples.items() if samples},
    }


def lines(figures: Mapping[str, object]) -> list[str]:
    """Return a summary in words, line by line."""
    ticks, missed = figures["ticks"], figures["ticks_missed"]
    text = [
        f"{figures['drones']} drones, {figures['minutes']} min, {figures['flights']} flights; "
        f"{ticks} ticks, {missed} missed; {figures['seconds_without_poses']} s in which a drone had no poses"
    ]
    processes = figures["processes"]
    assert isinstance(processes, dict)
    for name, usage in processes.items():
        text.append(
            f"{name}: {usage['memory_mib'][0]} to {usage['memory_mib'][1]} MiB, "
            f"{usage['growth_mib_per_hour']:+} MiB/h in the second half; "
            + ", ".join(f"{usage[what][0]} to {usage[what][1]} {what}" for what in ("descriptors", "threads"))
            + f"; shared memory {usage['shared_mib'][0]} to {usage['shared_mib'][1]} MiB"
        )
    return text


def _figures(samples: Sequence[ProcessUsage]) -> dict[str, object]:
    """Return what one process used first and last, and how its memory grew."""
    grown, hourly = memory_growth(samples)
    ends = samples[0], samples[-1]
    return {
        "memory_mib": [round(end.memory, 1) for end in ends],
        "growth_mib": round(grown, 3),
        "growth_mib_per_hour": round(hourly, 2),
        "descriptors": [end.descriptors for end in ends],
        "threads": [end.threads for end in ends],
        "shared_mib": [round(sum(end.shared.values()) / MIB, 1) for end in ends],
    }


def _second_half(samples: Sequence[ProcessUsage]) -> Sequence[ProcessUsage]:
    return samples[len(samples) // 2 :]


def _peaks(samples: Sequence[ProcessUsage]) -> list[tuple[str, int, int]]:
    """Return, for what must not grow at all, its name and the most of it in the first half and in the second."""
    first, second = samples[: len(samples) // 2], _second_half(samples)

    def peaks(what: str, of: Callable[[ProcessUsage], int]) -> tuple[str, int, int]:
        return what, max(map(of, first)), max(map(of, second))

    return [
        peaks("descriptors", lambda s: s.descriptors),
        peaks("threads", lambda s: s.threads),
        peaks("bytes of shared memory", lambda s: sum(s.shared.values())),
    ]

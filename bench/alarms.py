"""False alarms: ordinary flights, drawn at random, in which nothing is broken, and what is said of them all the same.

    .venv/bin/python bench/alarms.py --seeds FIRST LAST

A line a flight: what was drawn and done, how far a drone was off its reference at most, what was said that may be said,
and below it each alarm. What may be said when, and why, stands in `flatsat_ros/falsification/ordinary/sayings.py`. A
seed gives the same flight every time. In the end the alarms are counted by kind, a flight once; exit code 1 if there
are any.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections import Counter

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from flatsat_ros.falsification.ordinary.drawn import drawn
from flatsat_ros.falsification.ordinary.flight import OrdinaryFlight, Said
from flatsat_ros.falsification.ordinary.sayings import alarms


def kind(text: str) -> str:
    """Return a saying without its figures, and without its bound."""
    return re.sub(r"-?\d[\d.]*", "#", text)


def main() -> int:
    """Fly, and print; return the exit code."""
    parser = argparse.ArgumentParser(description="Look for false alarms in ordinary flights.")
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 199), metavar=("FIRST", "LAST"))
    first, last = parser.parse_args().seeds
    minutes, clean, found = 0.0, 0, Counter[str]()
    for seed in range(first, last + 1):
        what = drawn(seed)
        flown = OrdinaryFlight(what).fly()
        minutes += flown.seconds * len(what.places) / 60.0
        false = list(alarms(what, flown))
        clean += not false
        found.update({kind(said.text) for said in false})
        said = Counter(kind(said.text) for said in flown.said if said.text.startswith("tube")).most_common()
        told = "; ".join(f"{count} x {text.removeprefix('tube not claimed: ')}" for text, count in said)
        print(f"{seed}: {what}; {flown.seconds:.0f} s: {', '.join(flown.done)}; worst {100.0 * flown.worst:.1f} cm")
        print(f"    not claimed: {told or 'never'}")
        for alarm in false:
            print(f"    ALARM {describe(alarm)}")
        sys.stdout.flush()
    flights = last - first + 1
    print(f"{flights} flights, {minutes:.0f} drone minutes, {clean} without a false alarm")
    for text, count in found.most_common():
        print(f"{count:>5} flights: {text}")
    return 1 if found else 0


def describe(alarm: Said) -> str:
    """Return an alarm as people read it."""
    return f"drone {alarm.drone} at {alarm.time:.2f} s ({alarm.doing}): {alarm.text}"


if __name__ == "__main__":
    sys.exit(main())

"""What may be said of a flight in which nothing is broken, because it is true of it; all else is a false alarm."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import NamedTuple

from flatsat_ros.falsification.ordinary.drawn import Drawn, Start
from flatsat_ros.falsification.ordinary.flight import Flown, Said

# m: farthest from its reference in still air, and in the air that may be drawn, as in the matrix of faults
WORST_STILL, WORST_BLOWN = 0.25, 0.5


class Allowed(NamedTuple):
    """A saying that is no alarm.

    Attributes:
        text: regular expression of all of it.
        why: it is true.
        when: of which flights, and when in them.
    """

    text: str
    why: str
    when: Callable[[Drawn, Said], bool] = lambda _drawn, _said: True


def _doing(*what: str) -> Callable[[Drawn, Said], bool]:
    return lambda _, said: said.doing in what


_NOT_EXPECTED = (
    r"tube not claimed: (it is disturbed|its disturbance changes within a second|its poses are not where they are "
    r"expected), .*"
)
_ON_TABLE = _doing("land on a table", "land in a climb on a table")
_LANDS = _doing("land", "land in a climb", "land on a table", "land in a climb on a table")
_CLIMBS = _doing("take off")
_TAKES = _doing("take over")
ALLOWED = (
    Allowed(r"IDLE to UNLOCK: a reference is there .*", "it was told to take off", _CLIMBS),
    Allowed(r"UNLOCK to FLY: the thrust lock is open", "it was told to take off", _CLIMBS),
    Allowed(
        r"IDLE to FLY: .* the drone is in the air",
        "it is taken over, or stands higher than the floor",
        _doing("take over", "take off"),
    ),
    Allowed(
        r"FLY to DESCEND: told to climb, but it is not seen to leave the ground: in case it has, it sinks .*"
        r"|DESCEND to UNLOCK: told to climb, but it stays where it is, on something: unlocked",
        "its thrust lock was closed, on a table",
        lambda drawn, said: drawn.start is Start.TABLE and said.doing == "take off",
    ),
    Allowed(r"FLY to IDLE: handed over", "it was", _doing("hand over")),
    Allowed(r"FLY to REST: touched down", "it was told to land", _LANDS),
    Allowed(r"REST to IDLE: rested after the landing", "it was told to land", _LANDS),
    Allowed(r"its goal (waits|is near) .*|its way is clear: it sets out", "other drones are in the way"),
    Allowed(
        r"tube not claimed: it is (disturbed|outside its tube although all seems to be as assumed), .*",
        "the wind is more than is assumed, or gusts change faster, and neither is always seen",
        lambda drawn, _: drawn.disturbs,
    ),
    Allowed(_NOT_EXPECTED, "what is not known yet of its thrust disturbs it", _doing("take off", "take over")),
    Allowed(
        r"tube not claimed: its applied gain is outside the interval, .*",
        "until it has left the ground for a while it is flown softly sideways, and the wind blows it off",
        lambda drawn, said: drawn.blows and said.doing == "take off",
    ),
    Allowed(_NOT_EXPECTED, "a table carries it that nobody knew of", _ON_TABLE),
    Allowed(
        r"tube not claimed: its reference asks for more than is assumed, (?!inf).*",
        "it was moving when it was taken over, and brakes",
        _TAKES,
    ),
    Allowed(
        r"tube not claimed: its disturbance changes within a second, .*",
        "gusts change faster than is assumed",
        lambda drawn, _: drawn.wind.gust > 0.0,
    ),
    Allowed(
        r"tube not claimed: its poses are not where they are expected, .*",
        "gusts change faster than is assumed, or poses are noisier",
        lambda drawn, _: drawn.wind.gust > 0.0 or drawn.is_noisy,
    ),
)


def alarms(drawn: Drawn, flown: Flown) -> Iterator[Said]:
    """Yield what was said of a flight that is not true, and what went wrong in it.

    Args:
        drawn: what the flight was made of.
        flown: what came of it.
    """
    for said in flown.said:
        if not any(re.fullmatch(each.text, said.text) and each.when(drawn, said) for each in ALLOWED):
            yield said
    yield from flown.wrong
    most = WORST_BLOWN if drawn.blows else WORST_STILL
    if flown.worst > most:
        yield Said(flown.seconds, 0, f"one was {flown.worst:.2f} m off its reference", "fly")

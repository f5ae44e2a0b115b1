"""The batteries of N drones: when to warn, when to land, and who must not take off.

Every message is judged when it comes; nothing is done in a tick. A level is reached when all readings since `HOLD` were
at or below it, and left when all readings since `HOLD` were above. The reason: voltage sags under thrust. Paths take
at most 4 % more of it than a hover; a gust or a correction takes more, for a second or two, and must land no drone.
The firmware waits likewise, for 5 s, before it switches off at a lower voltage: the landing begins earlier. On the
ground no motor makes the voltage sag, so that there the newest reading alone decides on a take-off.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple, Protocol

# so long, s, all readings must agree
HOLD = 3.0
# a battery that powers a drone has between this share of the landing voltage, and this multiple of the warning voltage
_LEAST, _MOST = 0.5, 2.0


class VoltageLimits(Protocol):
    """At what voltages, V, to warn and to land; `crazyflie.BatteryLimits` has them."""

    @property
    def warning_voltage(self) -> float:
        """V, above landing_voltage."""

    @property
    def landing_voltage(self) -> float:
        """V."""


class Charge(IntEnum):
    """What a battery is good for."""

    GOOD = 0
    LOW = 1
    EMPTY = 2


class Finding(NamedTuple):
    """What a voltage shows that was not known before.

    Attributes:
        charge: that was reached; GOOD for a reading that is ignored.
        text: the value and its limit, for people.
    """

    charge: Charge
    text: str


class Batteries:
    """What is known of N batteries.

    Attributes:
        voltages: newest reading of each drone, V; NaN before the first.
        charges: of each drone; GOOD before the first reading.
    """

    def __init__(self, count: int) -> None:
        self.voltages = [math.nan] * count
        self.charges = [Charge.GOOD] * count
        # since when all readings were above the warning level, at or below it, at or below the landing level, s; NaN:
        # the newest was not
        self._since = [[math.nan] * 3 for _ in range(count)]
        self._refusal = [""] * count
        self._doubted = [False] * count

    def measure(self, index: int, voltage: float, limits: VoltageLimits, now: float) -> Finding | None:
        """Take in a reading of drone index.

        Args:
            index: which drone.
            voltage: V, under whatever load there is. What no such battery has is ignored, and told of once.
            limits: of this drone.
            now: s, not before that of the reading before.

        Returns:
            What is to be told, None for nothing new.
        """
        landing, warning = limits.landing_voltage, limits.warning_voltage
        if not _LEAST * landing <= voltage <= _MOST * warning:
            if self._doubted[index]:
                return None
            self._doubted[index] = True
            valid = f"from {_LEAST * landing:g} to {_MOST * warning:g} V"
            return Finding(Charge.GOOD, f"battery = {voltage:g} V: must be {valid}: such values are ignored")
        self.voltages[index] = voltage
        since = self._since[index]
        for level, holds in enumerate((voltage > warning, voltage <= warning, voltage <= landing)):
            since[level] = math.nan if not holds else now if math.isnan(since[level]) else since[level]
        before, charge = self.charges[index], self._judge(index, now)
        self.charges[index] = charge
        held = f" for {HOLD:g} s" if charge is Charge.EMPTY else ""
        above = f"battery = {voltage:.2f} V: must be above {warning:g} V{held} before the drone takes off"
        self._refusal[index] = above if held or voltage <= warning else ""
        if charge <= before:
            return None
        limit, then = (landing, "") if charge is Charge.EMPTY else (warning, f": the drone lands at {landing:g} V")
        return Finding(charge, f"battery = {voltage:.2f} V: at or below {limit:g} V for {HOLD:g} s{then}")

    def refusal(self, index: int) -> str:
        """Return why drone index must not take off, empty if it may: so after a landing until the voltage is back."""
        return self._refusal[index]

    def _judge(self, index: int, now: float) -> Charge:
        """Return the charge of drone index after a reading; a comparison with NaN does not hold."""
        above, low, empty = (now - since >= HOLD for since in self._since[index])
        if empty:
            return Charge.EMPTY
        if above:
            return Charge.GOOD
        return max(self.charges[index], Charge.LOW) if low else self.charges[index]

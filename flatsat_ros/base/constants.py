"""Constants of nature and of units, each with its unit."""

from __future__ import annotations

GRAVITY = 9.81  # m/s^2
NANOSECONDS = 1_000_000_000  # of a second

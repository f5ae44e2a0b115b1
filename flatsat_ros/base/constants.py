"""Constants of nature, of units and of rooms in which drones fly, each with its unit."""

from __future__ import annotations

GRAVITY = 9.81  # m/s^2
NANOSECONDS = 1_000_000_000  # of a second
FARTHEST_PLACE = 1e4  # m: nothing in a flying room is farther from its origin

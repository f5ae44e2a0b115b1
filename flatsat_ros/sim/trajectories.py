"""Trajectories that are uploaded to a Crazyflie: pieces of polynomials in its memory, and how they are flown.

A restatement of bitcraze/crazyflie-firmware, release 2026.08, crtp_commander_high_level.c and pptraj.c.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import FloatArray, finite_array
from flatsat_ros.base.errors import require, require_positive

COEFFICIENTS = 8  # pptraj.h PP_SIZE: polynomials of degree 7
CAPACITY = 255  # pieces: their number has 8 bits
ON_BOARD = 31  # pieces that a real drone holds; TRAJECTORY_MEMORY_SIZE, 4096 bytes of 132 bytes each
NUMBERS = 31  # crtp_commander_high_level.h NUM_TRAJECTORY_DEFINITIONS
# of a polynomial p(s) the coefficients of p(1 - s) are _REVERSE @ those of p
_REVERSE = np.array([[(-1.0) ** i * math.comb(j, i) for j in range(COEFFICIENTS)] for i in range(COEFFICIENTS)])


class Piece(NamedTuple):
    """A part of a trajectory.

    Attributes:
        duration: s, above 0.
        coefficients: (8, 4) of x, y, z, m, and yaw, rad, world, by ascending powers of time / duration.
    """

    duration: float
    coefficients: FloatArray

    @classmethod
    def of(cls, duration: float, coefficients: ArrayLike) -> Piece:
        """Return a checked piece.

        Args:
            duration: s.
            coefficients: (8, 4) of x, y, z, m, and yaw, rad, by ascending powers of time in seconds.

        Raises:
            FlatsatError: the duration is not above 0, or the coefficients are not 8 by 4 finite numbers.
        """
        require_positive("duration of a piece", duration, "s")
        array = finite_array("coefficients of a piece", coefficients, 4)
        valid = f"{(COEFFICIENTS, 4)}: of degree {COEFFICIENTS - 1}, for x, y, z and yaw"
        require(array.shape == (COEFFICIENTS, 4), "shape of coefficients of a piece", array.shape, "", valid)
        return cls(float(duration), array * duration ** np.arange(COEFFICIENTS)[:, None])

    def reversed(self) -> Piece:
        """Return the piece backward in time."""
        return Piece(self.duration, _REVERSE @ self.coefficients)

    def shifted(self, shift: FloatArray) -> Piece:
        """Return the piece elsewhere, (4,) m and rad."""
        moved = self.coefficients.copy()
        moved[0] += shift
        return Piece(self.duration, moved)


class TrajectoryMemory:
    """The memory of one drone for trajectories: places for pieces, and numbers for rows of them.

    It holds more than that of a real drone, which crazyswarm2's own example overflows: whoever uploads should tell.
    """

    def __init__(self) -> None:
        """Hold nothing."""
        self._pieces: list[Piece | None] = [None] * CAPACITY
        self._rows: dict[int, range] = {}

    def upload(self, trajectory: int, offset: int, pieces: Sequence[Piece]) -> None:
        """Write pieces from a place on, over those that are there, and call them by a number.

        Raises:
            FlatsatError: there is no such number, no piece, or no place for so many.
        """
        require(0 <= trajectory < NUMBERS, "number of a trajectory", trajectory, "", f"from 0 to {NUMBERS - 1}")
        require(len(pieces) > 0, "pieces of a trajectory", len(pieces), "", "at least 1")
        last = offset + len(pieces)
        require(offset >= 0 and last <= CAPACITY, "last place of a trajectory", last, "", f"at most {CAPACITY} pieces")
        self._pieces[offset:last] = pieces
        self._rows[trajectory] = range(offset, last)

    def pieces_of(self, trajectory: int, time_scale: float, reverse: bool) -> list[Piece]:
        """Return the pieces of a trajectory in the order in which they are flown, none if it is not defined.

        Args:
            trajectory: its number.
            time_scale: how many times as long they take.
            reverse: whether they are flown backward in time.
        """
        pieces = [piece for place in self._rows.get(trajectory, ()) if (piece := self._pieces[place]) is not None]
        if reverse:
            pieces = [piece.reversed() for piece in pieces[::-1]]
        return [Piece(time_scale * piece.duration, piece.coefficients) for piece in pieces]

"""Whether drones move sideways as they are commanded, and what is done about a yaw that is found wrong by that."""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray, any_of
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.astray import AstrayDetector
from flatsat_ros.flight.policy import YawSource

# a yaw that is learnt from motion follows it with this time constant, s; if a drone is astray again so soon, s, after
# it was corrected at once, it is no matter of its yaw
_YAW_TIME = 0.5
_YAW_SETTLES = 3.0
# a certificate that knows nothing of lag and delay does not make the drone answer sooner than after this, s
_LATE = 0.15
# With a stiff law, whether a drone moves as it is commanded to is seen by its places at so many looks: its estimated
# velocity believes in the commands, and follows a drone that does otherwise late. A soft law leaves time for that, and
# lets gusts move a drone so far that they would be taken for a wrong sign.
_PLACES = 2


class CommandCheck:
    """Looks at what comes of what is commanded to N drones.

    Attributes:
        assumed: (N,) whose yaw is assumed, as nobody sees it; None where none ever is.
    """

    def __init__(self, certificate: Certificate, yaw_source: YawSource, period: float, count: int) -> None:
        """Begin without a past.

        Args:
            certificate: tells how late commands act, and whether the law is stiff.
            yaw_source: where yaws come from that nobody sees.
            period: between two looks, s.
            count: N.
        """
        self._late = max(certificate.lag + certificate.delay, _LATE)
        self._stiff, self._source, self._period = certificate.flight is not None, yaw_source, period
        turns = yaw_source is not YawSource.MEASURED
        # a command counts from its tick on, but has been obeyed when the next one is given only
        late = self._late + certificate.period if self._stiff else self._late
        self._astray = AstrayDetector(count, period, late, turns=turns, wary=self._stiff)
        # at the last looks, newest last: where each was measured, m, and when, s; and what follows of that, m/s
        self._places, self._stamps = np.zeros((_PLACES + 1, count, 2)), np.zeros((_PLACES + 1, count))
        self._velocity = np.zeros((count, 2))
        self._turns = np.zeros(count)  # corrections of yaws that are learnt from motion, rad, not yet made
        self._settling = np.zeros(count)  # s, until the yaw may be found wrong again
        self.assumed: np.ndarray | None = None
        self._reports: list[tuple[int, str]] = []

    def reports(self) -> list[tuple[int, str]]:
        """Return what is to be told, drone and text, once."""
        reports, self._reports = self._reports, []
        return reports

    def look(
        self,
        push: FloatArray,
        velocity: FloatArray,
        measured: tuple[FloatArray, FloatArray] | None,
        yaw: FloatArray,
        judged: np.ndarray,
        standing: np.ndarray,
        unseen: np.ndarray | None,
        told: np.ndarray,
    ) -> np.ndarray:
        """Return who does not move as commanded, (N,).

        Args:
            push: (N, 2) horizontal change of velocity that was commanded since the last look, m/s.
            velocity: (N, 2) estimated, m/s.
            measured: (N,) stamps of the newest poses, s, and their positions (N, 3), m; None: the estimate serves.
            yaw: (N,) psi, rad.
            judged: (N,) who is steered, and in the air if it moves.
            standing: (N,) who was not seen to move since it was taken over.
            unseen: (N,) whose yaw is assumed, or learnt from motion, see `take_turns`; nobody's if None.
            told: (N,) of whom it has been told that they go astray.
        """
        if self._stiff and measured is not None:
            velocity = self._measured_velocity(*measured)
        assumed = self.assumed = unseen if self._source is YawSource.ASSUMED else None
        astray = self._astray.astray(push, velocity, yaw, judged, assumed, standing)
        if assumed is not None:
            self._tell_turns(astray & assumed & ~told)
        elif unseen is not None and any_of(unseen):
            return self._learn_yaw(astray, unseen & judged)
        return astray

    def _measured_velocity(self, stamps: FloatArray, places: FloatArray) -> FloatArray:
        """Return how fast the drones were over the last looks by nothing but measured places, (N, 2) m/s.

        What estimates places changes once some drone is steered no more: those of all would move by what a wrong sign
        has made of them.
        """
        self._places[:-1], self._stamps[:-1] = self._places[1:], self._stamps[1:]
        self._places[-1], self._stamps[-1] = places[:, :2], np.maximum(stamps, 0.0)
        elapsed = self._stamps[-1] - self._stamps[0]
        moved = elapsed > 0.0
        way = (self._places[-1] - self._places[0]) / np.where(moved, elapsed, 1.0)[:, np.newaxis]
        self._velocity = np.where(moved[:, np.newaxis], way, self._velocity)
        return self._velocity

    def answer(self, index: int) -> FloatArray | None:
        """Return what comes of what is commanded to drone index, see `AstrayDetector.answer`."""
        return self._astray.answer(index)

    def under_way(self, acceleration: FloatArray) -> float:
        """Return the change of velocity, m/s, by commands (3,), m/s^2, that have not acted yet, sideways."""
        return self._late * float(np.hypot(*acceleration[:2]))

    def take_turns(self) -> FloatArray:
        """Return by how much the yaws are to be corrected, (N,) rad, since the last call."""
        turns, self._turns = self._turns, np.zeros_like(self._turns)
        return turns

    def _learn_yaw(self, astray: np.ndarray, learning: np.ndarray) -> np.ndarray:
        """Learn yaws from motion: slowly, and at once where a drone would be astray; return who is astray after all."""
        angle = np.where(learning, self._astray.turns(), 0.0)
        self._settling = np.maximum(self._settling - self._period, 0.0)
        found = astray & learning & (np.abs(angle) > 0.0) & (self._settling == 0.0)
        turns = np.where(found, angle, self._period / _YAW_TIME * angle)
        self._turns, self._settling[found] = self._turns + turns, _YAW_SETTLES
        self._astray.correct(turns, found)
        for index in map(int, np.flatnonzero(found)):
            text = f"its motion is turned by {np.degrees(angle[index]):.0f} deg from its commands: its yaw is corrected"
            self._reports.append((index, text))
        return np.asarray(astray & ~found)

    def _tell_turns(self, astray: np.ndarray) -> None:
        """Tell by how much the assumed yaw of drones (N,) is wrong that go astray, if it is that."""
        if not any_of(astray):
            return
        angle = self._astray.turns()
        for index in map(int, np.flatnonzero(astray & (np.abs(angle) > 0.0))):
            turned = f"its motion is turned by {np.degrees(angle[index]):.0f} deg from its commands"
            self._reports.append((index, f"{turned}: the yaw that yaw_source assumes is wrong"))

"""The loop of certificates without a flight section: the law acts on the estimate.

They have no model that tells where a drone should be. What tells that commands or poses come late is that the drone
swings: what disturbs it in height, or the law's corrections (`flight.following_check`). Then it is flown softly for a
while (`flight.doubt`), and nothing is claimed. References that jump make a drone swing by themselves: there, it is not.
"""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray, all_of
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.doubt import Doubt
from flatsat_ros.flight.estimator import Estimator
from flatsat_ros.flight.guarantee import Assessment, GuaranteeMonitor
from flatsat_ros.flight.loops import COMPENSATED_SHARE, OF_VECTOR, Aim, Loop, Steered, shortened
from flatsat_ros.flight.policy import GoalMode, Policy
from flatsat_ros.flight.references import References
from flatsat_ros.law.controller import Output

_LASTING = 1.0  # s: what disturbs a drone for longer is no swing


class DirectLoop(Loop):
    """The law acts on the estimate, about the reference's acceleration less the disturbance."""

    def __init__(self, certificate: Certificate, policy: Policy, references: References, estimator: Estimator) -> None:
        count = len(estimator.yaw)
        self._references, self._estimator, self._most = references, estimator, policy.disturbance_max
        self._monitor = GuaranteeMonitor(certificate, count)
        self._spent = np.zeros(count)
        self._base = np.zeros((count, 9))
        self._jumps = policy.goal_mode is GoalMode.STEP
        self._doubt = Doubt.of_swings(certificate.matrix, certificate.period, count)
        self._doubts, self._gain = np.zeros((count, 2), dtype=bool), np.ones(count)
        self._error: FloatArray | None = None  # estimate less reference, where the law is given another
        self._lasting, self._pace = np.zeros((count, 3)), certificate.period / _LASTING  # disturbance, m/s^2

    def estimate(self, now: float, thorough: bool, gained: FloatArray | None) -> FloatArray:
        """Return the estimates."""
        return self._estimator.estimate(now)

    def aim(self, now: float, estimated: FloatArray, reference: FloatArray, drones: Steered) -> Aim:
        """Return estimate and reference."""
        state, push = estimated[:, :6], estimated[:, 6:]
        most = np.minimum(self._most, COMPENSATED_SHARE * self._references.margin)
        error = None
        if self._is_doubted(now, estimated, reference, drones):
            doubts, error = self._doubts, state - reference[:, :6]
            state = reference[:, :6] + self._doubt.soften(error, doubts, self._gain)
            push = np.where(doubts[:, OF_VECTOR], self._doubt.slowed(now, lambda: self._lasting, push), push)
        disturbance, self._spent = shortened(push, most, drones.flying)
        base = self._base = reference.copy()
        base[:, 6:] -= disturbance
        self._error = error
        return Aim(state, base, error, disturbance)

    def _is_doubted(self, now: float, estimated: FloatArray, reference: FloatArray, drones: Steered) -> bool:
        """Find whose loop swings up and down; tell whether there are any."""
        if self._jumps:
            return False
        doubt, push = self._doubt, estimated[:, 6:]
        self._lasting += self._pace * (push - self._lasting)
        swing = np.zeros((len(push), 2))
        swing[:, 1] = np.abs(push[:, 2] - self._lasting[:, 2])
        if drones.touching is not None:  # what carries a drone pushes it, too
            swing[drones.touching] = 0.0
        doubt.look(now, drones.flying & ~drones.grounded, np.zeros(len(push)), swing)
        if drones.landing is not None and drones.touching is not None:
            doubt.land(now, drones.landing & ~drones.touching)
        if doubt.any:
            doubt.hold(now, estimated[:, :6] - reference[:, :6], drones.touching)
            self._doubts = doubt.of(now)
        return doubt.any

    def assess(self, output: Output, acceleration: FloatArray, flying: np.ndarray) -> Assessment:
        """Return where the drones are in the certified sets."""
        spent, self._gain = self._spent, output.gain
        margin = self._references.margin - spent
        fixed = self._references.at_rest & (spent == 0.0)
        error = output.error
        if self._error is not None:  # the law was given less of it
            error, fixed = self._error, fixed & ~self._doubts.any(axis=1)
        assessment = self._monitor.assess(error, margin, fixed)
        base = self._base[:, 6:].copy()
        if not all_of(flying):
            base = np.where(flying[:, np.newaxis], base, 0.0)
        self._monitor.follow(acceleration - base)
        return assessment

    @property
    def doubted(self) -> np.ndarray | None:
        """(N,) who is flown softly in height; None for nobody."""
        return self._doubts[:, 1] if self._doubt.any else None

    def ease(self, now: float, swings: np.ndarray) -> np.ndarray:
        """Fly those softly who swing, see `Loop.ease`."""
        return self._doubt.ease(now, swings)

    def reports(self, flying: np.ndarray) -> list[tuple[int, str]]:
        """Return who is flown softly."""
        return self._doubt.reports()

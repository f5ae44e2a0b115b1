"""How drones sink that are not steered, by what is known of their heights, climb rates and thrusts."""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray, any_of
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.braking import Braking
from flatsat_ros.flight.command_check import CommandCheck
from flatsat_ros.flight.descent import BlindDescent
from flatsat_ros.flight.detectors import LiftOffDetector
from flatsat_ros.flight.exchange import ExchangeDetector
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.thrust import ThrustScale
from flatsat_ros.flight.unmoved import UnmovedDetector

# the lift of a drone that is to sink without poses is the mean over about this time, s: a gust does not last
_LIFT_TIME = 1.0
# a drone that sinks without being steered is pushed down by this, 1/s, times the speed at which it climbs instead, and
# by no more than this, m/s^2
_CLIMBS_NOT, _CLIMBS_NOT_MOST = 1.0, 1.0
# One whose poses mislead about what is up has left the ground upward all the same, wherever they show it: along that
# way it is pushed by this, 1/s, times what is missing to this speed, m/s: up and down by so much at most, m/s^2.
_SINKS, _SINKS_BEYOND, _SINKS_MOST = 2.0, 0.4, (1.0, 2.5)


class Sinking:
    """The descents of N drones.

    Attributes:
        descent: without position.
        braking: of those that sink because they do not move as commanded.
        misled: (N,) who sinks, and its height is not what its poses say.
        stands: (N,) who sinks, and its poses stand still.
    """

    def __init__(
        self,
        certificate: Certificate,
        policy: Policy,
        count: int,
        *,
        thrust: ThrustScale,
        lift_off: LiftOffDetector,
        unmoved: UnmovedDetector,
        exchange: ExchangeDetector,
        command_check: CommandCheck,
    ) -> None:
        """Begin with nobody sinking.

        Args:
            certificate: its limits.
            policy: the figures of the flight layer.
            count: N.
            thrust: what is learnt of the thrusts.
            lift_off: tells where those are that were not seen to leave the ground, or left it another way than upward.
            unmoved: tells where those are whose heights stand still.
            exchange: tells where those are that are seen under each other's names.
            command_check: tells what comes of commands.
        """
        self.descent = BlindDescent(certificate.limits.gravity, policy.drag, policy.level_thrust, count)
        self.braking = Braking(certificate.limits, count)
        self._thrust, self._lift_off, self._unmoved = thrust, lift_off, unmoved
        self._exchange, self._command_check = exchange, command_check
        self._floor = policy.floor
        self._lift = np.zeros(count)  # what lifts each beside its thrust, m/s^2, without gusts
        self._up = np.zeros((count, 3))  # of the misled, the direction in which they have left the ground
        self.misled, self.stands = np.zeros((2, count), dtype=bool)

    def learn(self, seconds: float, disturbance: FloatArray, learning: np.ndarray) -> None:
        """Learn from one look what lifts drones, and what comes of the commands of those that brake.

        Args:
            seconds: since the last one.
            disturbance: (N,) estimated, vertical, m/s^2.
            learning: (N,) whose disturbance is to be relied on.
        """
        for index in map(int, np.flatnonzero(self.braking.active) if any_of(self.braking.active) else ()):
            self.braking.learn(index, self._command_check.answer(index))
        self._lift += (seconds / _LIFT_TIME) * np.where(learning, disturbance - self._lift, 0.0)

    def forget_lift(self, drones: np.ndarray) -> None:
        """Forget what lifts some drones, (N,): what was seen of it was late."""
        self._lift[drones] = 0.0

    def mislead(self, index: int, place: FloatArray) -> None:
        """Take drone index, seen at a place (3,), m, for one that has left the ground another way than upward."""
        self._up[index] = self._lift_off.upward(index, place)
        self.misled[index] = True

    def begin(
        self,
        index: int,
        now: float,
        estimated: FloatArray,
        ground: float,
        acceleration: FloatArray,
        *,
        held: bool,
        repeated: bool,
        answers: bool,
    ) -> None:
        """Let drone index sink from now on.

        Args:
            index: which drone.
            now: s.
            estimated: (9,) of it, position, velocity, disturbance: m, m/s, m/s^2.
            ground: height of what it stood on last, m.
            acceleration: (3,) commanded at the last tick, m/s^2.
            held: it was not seen to take off.
            repeated: its poses repeat: it may have moved since unseen.
            answers: it does not move as commanded, but somehow.
        """
        height, climb = float(estimated[2]), float(estimated[5])
        lift, unseen = float(self._lift[index]) if self._thrust.is_settled(index) else None, held
        if held:
            (height, climb), lift = self._lift_off.unseen(index), None
            height += float(estimated[2])
            self._thrust.forget(index)  # it was not too weak for a take-off after all
            self._thrust.take_over(index)
        elif self.stands[index]:
            (rise, climb), lift = self._unmoved.climb(index), 0.0  # what was learnt last is not its lift
            unseen = not self._thrust.is_settled(index)
            height += rise
        elif index in self._exchange.places:
            (height, climb), lift = self._exchange.places[index], 0.0
        elif self.misled[index]:  # that may be its height, and its speed the climb rate
            height = self._lift_off.risen(index, estimated[:3])
            climb = float(np.linalg.norm(estimated[3:6]))
        ground = min(ground, self._floor)  # what it stood on may not be below it any more
        self.descent.begin(index, now, height - ground, climb, lift, unseen=unseen, unsure=repeated and lift is None)
        known = answers and index not in self._exchange.places
        answer = self._command_check.answer(index) if known else None
        self.braking.begin(index, answer, estimated[3:5], self._command_check.under_way(acceleration))

    def end(self, index: int) -> None:
        """Let drone index sink no more: it is down."""
        self.braking.active[index] = self.misled[index] = self.stands[index] = False
        self._exchange.forget(index)

    def thrusts(self, now: float, velocity: FloatArray, usable: np.ndarray) -> FloatArray:
        """Return the thrusts (N,), m/s^2, of drones that sink without being steered.

        What was learnt of the thrust may be wrong: one that is seen to climb all the same gets less.

        Args:
            now: s.
            velocity: (N, 3) estimated, m/s.
            usable: (N,) who has one.
        """
        climbs = np.clip(_CLIMBS_NOT * velocity[:, 2], 0.0, _CLIMBS_NOT_MOST)
        if self._exchange.any:
            climbs, usable = self._exchange.pushed(velocity[:, 2], climbs, usable)
        if any_of(self.misled):
            sinks = -(velocity * self._up).sum(axis=1) - _SINKS_BEYOND
            climbs = np.where(self.misled, np.clip(-_SINKS * sinks, -_SINKS_MOST[0], _SINKS_MOST[1]), climbs)
        return self.descent.thrust(now) - np.where(usable, climbs, 0.0)

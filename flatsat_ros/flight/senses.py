"""What is known of N drones beyond their estimates: the ground below them, their thrust, and whether they obey."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from flatsat_ros.base.arrays import FloatArray, any_of
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.command_check import CommandCheck
from flatsat_ros.flight.detectors import TouchDownDetector
from flatsat_ros.flight.exchange import ExchangeDetector
from flatsat_ros.flight.falls import FallDetector
from flatsat_ros.flight.following_check import FollowingCheck
from flatsat_ros.flight.footing import NEAR_GROUND, Footing
from flatsat_ros.flight.guidance import Guidance
from flatsat_ros.flight.looks import Looks
from flatsat_ros.flight.modes import AIRBORNE, Mode
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.pose_gaps import PoseGaps
from flatsat_ros.flight.sinking import Sinking
from flatsat_ros.flight.strays import Strays
from flatsat_ros.flight.supervisor import Sight
from flatsat_ros.flight.thrust import ThrustScale
from flatsat_ros.flight.unmoved import DOUBTFUL, STILL, UnmovedDetector

_UNMOVED = "poses whose z stays within {0:g} m, while commands should have changed it by {1:.2f} m: are they its own?"
_EXCHANGED = "it moves as another drone is commanded: their poses may be exchanged"


class Senses:
    """The detectors, the thrust scale and the descents, fed with what a tick shows.

    Attributes:
        thrust: scales of the thrust.
        footing: who stands on something.
        looks: when the detectors look.
        strays: who does not move as commanded.
        sinking: of drones that are not steered.
    """

    def __init__(self, certificate: Certificate, policy: Policy, count: int) -> None:
        self.thrust = ThrustScale(count, policy.thrust_error_max, quick=certificate.flight is not None)
        self.looks, self.footing = Looks(certificate.period, count), Footing(policy, certificate.limits.gravity, count)
        self._gravity, period = certificate.limits.gravity, self.looks.period
        self._sight: Sight | None = None  # of the last look; None: something has changed since
        self._touch_down, self._fall = TouchDownDetector(count), FallDetector(count, period)
        self._command_check = CommandCheck(certificate, policy.yaw_source, period, count)
        self._following_check = FollowingCheck(certificate, policy.drag, count)
        self._gaps, self._unmoved = PoseGaps(count, period), UnmovedDetector(count, period)
        model = None if certificate.flight is None else certificate.flight.vertical.design.model
        late = certificate.delay + certificate.lag if model is None else model.delay + model.lag
        self._exchange = ExchangeDetector(count, period, late)
        self.sinking = Sinking(
            certificate, policy, count, thrust=self.thrust, lift_off=self.footing.lift_off, unmoved=self._unmoved,
            exchange=self._exchange, command_check=self._command_check,
        )  # fmt: skip
        self.strays = Strays(count)
        # steered in the air, away from the ground; or near it, and not about to stand on it
        self._free, self._risen = np.zeros((2, count), dtype=bool)
        self._stood = (np.zeros(count, dtype=bool),) * 2  # who stood at the last look, and at the one before

    def set_clock_back(self, now: float) -> None:
        """Let nothing last longer because the clock was set back to now, s."""
        self.sinking.descent.set_clock_back(now)
        self._fall.set_clock_back(now)
        self._following_check.set_clock_back(now)

    def look(
        self, now: float, estimated: FloatArray, usable: np.ndarray, steered: np.ndarray, guidance: Guidance
    ) -> Sight:
        """Return what the supervisor needs to know.

        Args:
            now: s.
            estimated: (N, 9) position, velocity, disturbance: m, m/s, m/s^2.
            usable: (N,) whose estimate can be flown on.
            steered: (N,) who is steered until now.
            guidance: who lands, and the ground below each.
        """
        if self._sight is not None and not self.due:
            return Sight(estimated[:, 2], usable, *self._sight[2:])
        footing, upward, above = self.footing, self.looks.acceleration[:, 2], self.looks.above
        state, disturbance = estimated[:, :6], estimated[:, 6:]
        flying = steered & usable
        footing.look(now, state[:, :3], upward, self.thrust.scale, flying)
        self._judge_lift_off(state[:, :3])
        height = state[:, 2] - guidance.ground

        def aloft() -> np.ndarray:
            high = usable & (height > NEAR_GROUND)
            return np.asarray(high[self._exchange.name] & ~self.sinking.misled)

        immobile = footing.held
        if any_of(footing.held) or any_of(self.sinking.stands):
            immobile = (footing.held | self.sinking.stands) & footing.immobile(state, usable)
        self._sight = Sight(
            height=state[:, 2],
            usable=usable,
            touched_down=self._touch_down.carried(now, state[:, 2], upward, above, flying & guidance.landing),
            held=footing.held,
            fell=self._fall.fell(now, state, disturbance[:, 2], upward, height, flying & ~footing.standing),
            astray=self.strays.who,
            descended=self.sinking.descent.over(now, aloft, self.sinking.stands, immobile),
            grounded=footing.grounded,
            resting=immobile & footing.taken_over if any_of(immobile) else immobile,
        )
        return self._sight

    def _judge_lift_off(self, place: FloatArray) -> None:
        """Take those for astray that leave the ground another way than upward; they are at places (N, 3), m."""
        found = self.footing.astray(place[:, 2])
        if found is None:
            return
        for index in self.strays.add(found):
            self.sinking.mislead(index, place[index])
            self.strays.tell([(index, self.footing.describe(index, place[index]))])

    def _judge_still(
        self,
        estimated: FloatArray,
        push: FloatArray,
        error: FloatArray,
        watched: np.ndarray,
        resting: np.ndarray | None,
    ) -> None:
        """Take those for astray that are watched and seen to stand still, see `UnmovedDetector.look`."""
        if resting is not None:
            watched = watched | resting
        if self._gaps.any:
            watched = watched & self._gaps.passed()
        unmoved = self._unmoved
        for index in self.strays.add(unmoved.look(estimated, push, error, watched, self.thrust.settled, resting)):
            self.strays.tell([(index, _UNMOVED.format(STILL, float(unmoved.way[index])))])
            self.sinking.stands[index] = True

    def note(
        self,
        acceleration: FloatArray,
        estimated: FloatArray,
        error: FloatArray,
        yaw: FloatArray,
        flying: np.ndarray,
        landing: np.ndarray,
        unseen: np.ndarray | None = None,
        newest: FloatArray | None = None,
        measured: FloatArray | None = None,
        doubted: np.ndarray | None = None,
    ) -> np.ndarray:
        """Learn from one tick; return who is steered and has left the ground, not to land on it now, (N,).

        Args:
            acceleration: (N, 3) commanded, m/s^2.
            estimated: (N, 9), see `look`.
            error: (N, 6) state minus reference, m and m/s.
            yaw: (N,) psi, rad.
            flying: (N,) who is steered.
            landing: (N,) who lands, and may be carried by something when it is low.
            unseen: (N,) whose yaw is assumed, or learnt from motion, see `take_turns`; nobody's by default.
            newest: (N,) stamps of the newest poses, s; by default there are new ones.
            measured: (N, 3) positions measured then, m; given with the stamps.
            doubted: (N,) who is flown softly in height, see `flight.doubt`; nobody by default.
        """
        if not self.looks.note(acceleration, error[:, 2]):
            return np.asarray(self._risen & flying)
        footing, strays, push = self.footing, self.strays, self.looks.take_push()
        period, upward, disturbance = self.looks.period, acceleration[:, 2], estimated[:, 6:]
        standing = footing.standing
        high = flying & (estimated[:, 2] >= footing.low)
        free = self._free = high & ~standing
        steered = free & ~landing
        resting = high & footing.taken_over & ~landing if any_of(standing) else None
        self._judge_still(estimated, push[:, 2], error[:, 2], steered, resting)
        new = self._gaps.look(newest)
        certain = np.abs(self._unmoved.way) < DOUBTFUL
        lifted = flying & ~footing.grounded
        learning = lifted & (high | ~landing) & certain
        # what is learnt quickly is not learnt again from a disturbance that no new pose has confirmed
        span: float | FloatArray = period * new if self.thrust.quick else period
        lifting = footing.lifting(estimated, upward, flying)
        self.thrust.learn(upward + self._gravity, disturbance[:, 2], learning, lifting, span, doubted)
        # of one that was taken over and stands on something nothing comes; it is judged once it was seen to move
        judged = lifted | self.sinking.braking.active
        seen = None if newest is None or measured is None else (newest, measured)
        if seen is not None:
            stamps, height = seen[0].copy(), seen[1][:, 2].copy()
            self._fall.note(upward, stamps, height)
            low = flying & ~free
            for index in self._exchange.look(push[:, 2], stamps, height, disturbance[:, 2], steered, low):
                strays.tell([(index, _EXCHANGED)])
                strays.who[index] = True
        velocity, check = estimated[:, 3:5], self._command_check
        astray = check.look(push[:, :2].copy(), velocity, seen, yaw, judged, standing, unseen, strays.who)
        strays.tell(check.reports())
        strays.add(astray)
        self.sinking.learn(period, disturbance[:, 2], high & certain)
        (stood, earlier), self._stood = self._stood, (standing, self._stood[0])
        if any_of(landing):
            # who has just left its place is in the air though it lands: neither does it come down at once, nor are its
            # poses taken for old ones there
            landing = landing & ~(stood | earlier)
        self._risen = free | (flying & ~standing & ~landing)
        return self._risen

    def take_turns(self) -> FloatArray:
        """Return by how much the yaws are to be corrected, (N,) rad, since the last call."""
        return self._command_check.take_turns()

    def at_limit(
        self,
        now: float,
        base: FloatArray,
        disturbance: FloatArray,
        error: FloatArray,
        landing: np.ndarray,
        ease: Callable[[float, np.ndarray], np.ndarray],
    ) -> list[int]:
        """Return who shall land because the limit of its tilt does not let it follow, and told so once per flight.

        Args:
            now: s.
            base: (N, 9) the law's reference: its acceleration is commanded without an error, m/s^2.
            disturbance: (N, 3) estimated, m/s^2.
            error: (N, 6) state minus reference, m and m/s.
            landing: (N,) who lands.
            ease: flies those softly who swing, see `flight.following_check`.
        """
        if not self.looks.looked:
            return []
        strays, check = self.strays, self._following_check
        astray, late = check.look(
            now, self.looks.acceleration, base, disturbance, error, self._free, landing, self._command_check.assumed,
            strays.who, ease,
        )  # fmt: skip
        strays.tell(check.reports())
        if any_of(astray):
            self.sinking.forget_lift(late)
            strays.add(astray)
        return [int(index) for index in np.flatnonzero(check.blown)] if any_of(check.blown) else []

    @property
    def due(self) -> bool:
        """Whether the detectors look at the tick that comes."""
        return self._sight is None or self.looks.looked

    def stand(self, index: int, place: FloatArray) -> None:
        """Take drone index, which is steered, for one that stands at a place (3,), m, and is about to take off."""
        self._sight = None
        self.footing.begin(index, place, unlocked=True)

    def enter(
        self,
        index: int,
        before: Mode,
        after: Mode,
        estimated: FloatArray,
        now: float,
        guidance: Guidance,
        repeated: bool = False,
    ) -> float | None:
        """Take note of a changed mode.

        Args:
            index: whose.
            before: mode until now.
            after: mode from now on.
            estimated: (9,) of the drone.
            now: s.
            guidance: the ground below it.
            repeated: its poses repeat, though it may move; they do not by default.

        Returns:
            The height, m, of the ground on which it is known to stand; None if nothing new is known of that.
        """
        self._sight, footing = None, self.footing
        if after is Mode.LEVEL or (after is Mode.DESCEND and before is Mode.FLY):
            self.sinking.begin(
                index, now, estimated, float(guidance.ground[index]), self.looks.acceleration[index],
                held=bool(footing.held[index]), repeated=repeated,
                answers=after is Mode.DESCEND and bool(self.strays.who[index]),
            )  # fmt: skip
        if after is Mode.FLY and before in AIRBORNE:
            self._gaps.resume(index)
        if after in (Mode.CUT, Mode.REST, Mode.FALLEN, Mode.IDLE):
            self.strays.who[index] = self._following_check.blown[index] = False
            self.sinking.end(index)
        if after not in AIRBORNE:
            footing.held[index] = False
        if after is Mode.FALLEN or (before in AIRBORNE and after is Mode.UNLOCK):
            self.thrust.forget(index)
        if before is Mode.IDLE and after is Mode.FLY:
            self.thrust.take_over(index)
        if after is Mode.UNLOCK or (after is Mode.FLY and before not in AIRBORNE):
            unlocked = after is Mode.UNLOCK or before is Mode.UNLOCK
            footing.begin(index, estimated[:3], unlocked=unlocked)
            height = float(estimated[2])
            return height if after is Mode.UNLOCK or height < footing.low else None
        return None

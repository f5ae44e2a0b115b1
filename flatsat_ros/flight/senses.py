"""What is known of N drones beyond their estimates: the ground below them, their thrust, and whether they obey."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from flatsat_ros.base.arrays import FloatArray, any_of
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.command_check import CommandCheck
from flatsat_ros.flight.detectors import LIFTED_OFF, LiftOffDetector, TouchDownDetector
from flatsat_ros.flight.exchange import ExchangeDetector
from flatsat_ros.flight.falls import FallDetector
from flatsat_ros.flight.following_check import FollowingCheck
from flatsat_ros.flight.guidance import Guidance
from flatsat_ros.flight.modes import AIRBORNE, Mode
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.pose_gaps import PoseGaps
from flatsat_ros.flight.sinking import Sinking
from flatsat_ros.flight.supervisor import Sight
from flatsat_ros.flight.thrust import ThrustScale
from flatsat_ros.flight.unmoved import DOUBTFUL, STILL, UnmovedDetector

# the detectors look so often, s: they judge by what lasts for tenths of a second
_LOOK = 0.05
# near the ground, m, a drone is not judged by its motion: something may carry it
_NEAR_GROUND = 0.15
# a drone on the ground that is commanded upward by this, m/s^2, and has not risen by so much, m, has too little thrust:
# its estimated velocity believes in the commands, or shows the noise of the poses
_LIFTING = 0.3
_LIFTING_RISE = 0.005
# so many times the thrust of a hover lift whoever can be flown, or as many as the weakest drone needs that is flown
_ENOUGH = 1.3
# who was taken over and has risen less than this, m, may stand on something that is higher than the floor
_RESTS = 0.01
# one that is not even so far, m, from its place in any direction does not move; noise of 2 mm in the poses shows less
_IMMOBILE = 0.006
_SLID = "told to climb, it moves sideways instead: is z up in the poses?"
_SUNK = "told to climb, it is seen {0:.2f} m below where it stood, at most {1:g} m: has z the other sign?"
_UNMOVED = "poses whose z stays within {0:g} m, while commands should have changed it by {1:.2f} m: are they its own?"
_EXCHANGED = "it moves as another drone is commanded: their poses may be exchanged"
# a drone that moves faster than this, m/s, does not stand; noise of 2 mm in the poses shows half of that
_MOVING = 0.2


class Senses:
    """The detectors, the thrust scale and the descents, fed with what a tick shows.

    Attributes:
        thrust: scales of the thrust.
        sinking: of drones that are not steered.
        grounded: (N,) who was unlocked on the ground and has not left it yet.
    """

    def __init__(self, certificate: Certificate, policy: Policy, count: int) -> None:
        gravity = certificate.limits.gravity
        self.thrust = ThrustScale(count, policy.thrust_error_max, quick=certificate.flight is not None)
        self._every = max(1, round(_LOOK / certificate.period))  # ticks from look to look
        self._tick, self._period = certificate.period, self._every * certificate.period
        self._ticks = 0
        self._sight: Sight | None = None  # of the last look; None: something has changed since
        self._gravity = gravity
        self._policy = policy
        self._touch_down = TouchDownDetector(count)
        enough = max(_ENOUGH, 1.0 / max(1.0 - policy.thrust_error_max, 1e-3))
        self._lift_off = LiftOffDetector(count, policy.lift_off_time, enough)
        self._fall = FallDetector(count, self._period)
        self._command_check = CommandCheck(certificate, policy.yaw_source, self._period, count)
        self._following_check = FollowingCheck(certificate, policy.drag, count)
        self._gaps = PoseGaps(count, self._period)
        self._unmoved = UnmovedDetector(count, self._period)
        model = None if certificate.flight is None else certificate.flight.vertical.design.model
        late = certificate.delay + certificate.lag if model is None else model.delay + model.lag
        self._exchange = ExchangeDetector(count, self._period, late)
        self.sinking = Sinking(
            certificate, policy, count, thrust=self.thrust, lift_off=self._lift_off, unmoved=self._unmoved,
            exchange=self._exchange, command_check=self._command_check,
        )  # fmt: skip
        self._reports: list[tuple[int, str]] = []
        self._unlocked = np.zeros(count, dtype=bool)  # it stood on the ground when its flight began
        self.grounded = self._unlocked & self._lift_off.standing
        self._gone_astray = np.zeros(count, dtype=bool)  # until it is down
        self._held = np.zeros(count, dtype=bool)  # it was not seen to take off, until its motors stop
        self._free = np.zeros(count, dtype=bool)  # steered in the air, away from the ground
        self._acceleration = np.zeros((count, 3))  # commanded at the last tick, m/s^2
        self._above = np.zeros(count)  # height above the reference then, m
        self._push = np.zeros((count, 3))  # commanded change of velocity since the last look, m/s

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
        state, disturbance = estimated[:, :6], estimated[:, 6:]
        upward = self._acceleration[:, 2]
        flying = steered & usable
        scale = self.thrust.scale
        self._held = self._held | self._lift_off.held(now, state[:, :3], upward, scale, self._gravity, flying)
        self._judge_lift_off(state)
        standing = self._lift_off.standing
        self.grounded = self._unlocked & standing
        height = state[:, 2] - guidance.ground

        def aloft() -> np.ndarray:
            high = usable & (height > _NEAR_GROUND)
            return np.asarray(high[self._exchange.name] & ~self.sinking.misled)

        immobile = self._held
        if any_of(self._held) or any_of(self.sinking.stands):
            # not seen to move; without poses the estimate does, by the commands
            immobile = ~usable | (self._lift_off.moved(state) < _IMMOBILE)
        self._sight = Sight(
            height=state[:, 2],
            usable=usable,
            touched_down=self._touch_down.carried(now, state[:, 2], upward, self._above, flying & guidance.landing),
            held=self._held,
            fell=self._fall.fell(now, state, disturbance[:, 2], upward, height, flying & ~standing),
            astray=self._gone_astray,
            descended=self.sinking.descent.over(now, aloft, self.sinking.stands, immobile),
            grounded=self.grounded,
            resting=immobile & usable & self._resting if any_of(immobile) else immobile,
        )
        return self._sight

    def resting(self, estimated: FloatArray) -> np.ndarray:
        """Return who was taken over, wherever that was, and has not risen since, (N,), by estimates (N, 9)."""
        return np.asarray(self._resting & (self._lift_off.above(estimated) < _RESTS))

    @property
    def _resting(self) -> np.ndarray:
        """Who was taken over and was not seen to leave its place, (N,)."""
        return np.asarray(self._lift_off.standing & ~self._unlocked)

    def _judge_lift_off(self, state: FloatArray) -> None:
        """Take those for astray that leave the ground another way than upward; state is (N, 6), m, m/s."""
        if not (any_of(self._lift_off.slid) or any_of(self._lift_off.sunk)):
            return
        slid = self._lift_off.slid & self._unlocked
        # one that was unlocked in somebody's hand may well sink
        sunk = self._lift_off.sunk & self._unlocked & (state[:, 2] < self._low - LIFTED_OFF)
        anew = (slid | sunk) & ~self._gone_astray
        if not any_of(anew):
            return
        for index in map(int, np.flatnonzero(anew)):
            depth = self._lift_off.risen(index, state[index, :3]) - state[index, 2]
            self.sinking.mislead(index, state[index, :3])
            self._reports.append((index, _SLID if slid[index] else _SUNK.format(depth, LIFTED_OFF)))
        self._gone_astray = self._gone_astray | anew

    def _judge_still(
        self, estimated: FloatArray, error: FloatArray, watched: np.ndarray, resting: np.ndarray | None
    ) -> None:
        """Take those for astray that are watched, (N,), and seen to stand still, (N,) m off, see `flight.unmoved`."""
        if resting is not None:
            watched = watched | resting
        if self._gaps.any:
            watched = watched & self._gaps.passed()
        unmoved = self._unmoved.look(estimated, self._push[:, 2], error, watched, self.thrust.settled, resting)
        anew = unmoved & ~self._gone_astray
        if not any_of(anew):
            return
        for index in map(int, np.flatnonzero(anew)):
            self._reports.append((index, _UNMOVED.format(STILL, float(self._unmoved.way[index]))))
        self.sinking.stands |= anew
        self._gone_astray = self._gone_astray | self.sinking.stands

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
        """Learn from one tick; return who is steered in the air, away from the ground, (N,).

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
        self._acceleration, self._above = acceleration, error[:, 2]
        self._push += self._tick * acceleration
        self._ticks += 1
        if self._ticks % self._every:
            return np.asarray(self._free & flying)
        disturbance = estimated[:, 6:]
        standing = self._lift_off.standing
        high = flying & (estimated[:, 2] >= self._low)
        free = high & ~standing
        lifting = standing
        if any_of(standing):
            low = self._lift_off.above(estimated) < _LIFTING_RISE
            lifting = flying & standing & (acceleration[:, 2] >= _LIFTING) & low
        steered = free & ~landing
        resting = high & self._resting & ~landing if any_of(standing) else None
        self._judge_still(estimated, error[:, 2], steered, resting)
        new = self._gaps.look(newest)
        certain = np.abs(self._unmoved.way) < DOUBTFUL
        lifted = flying & ~self.grounded
        learning = lifted & (high | ~landing) & certain
        span: float | FloatArray = self._period
        # what is learnt quickly is not learnt again from a disturbance that no new pose has confirmed
        if self.thrust.quick:
            span = self._period * new
        self.thrust.learn(acceleration[:, 2] + self._gravity, disturbance[:, 2], learning, lifting, span, doubted)
        # of one that was taken over and stands on something nothing comes; it is judged once it was seen to move
        judged = lifted | self.sinking.braking.active
        seen = None if newest is None or measured is None else (newest, measured)
        if seen is not None:
            stamps, height = seen[0].copy(), seen[1][:, 2].copy()
            self._fall.note(acceleration[:, 2], stamps, height)
            upward, low = disturbance[:, 2], flying & ~free
            for index in self._exchange.look(self._push[:, 2], stamps, height, upward, steered, low):
                self._reports.append((index, _EXCHANGED))
                self._gone_astray[index] = True
        velocity, told = estimated[:, 3:5], self._gone_astray
        astray = self._command_check.look(self._push[:, :2].copy(), velocity, seen, yaw, judged, standing, unseen, told)
        self._reports += self._command_check.reports()
        self._gone_astray = self._gone_astray | astray
        self.sinking.learn(self._period, disturbance[:, 2], high & certain)
        self._push[:], self._free = 0.0, free
        return self._free

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
        if not self.looked:
            return []
        told, assumed = self._gone_astray, self._command_check.assumed
        astray, late = self._following_check.look(
            now, self._acceleration, base, disturbance, error, self._free, landing, assumed, told, ease
        )
        self._reports += self._following_check.reports()
        if any_of(astray):
            self.sinking.forget_lift(late)
            self._gone_astray = self._gone_astray | astray
        blown = self._following_check.blown
        return [int(index) for index in np.flatnonzero(blown)] if any_of(blown) else []

    def reports(self) -> list[tuple[int, str]]:
        """Return what is to be told, drone and text, once."""
        reports, self._reports = self._reports, []
        return reports

    @property
    def due(self) -> bool:
        """Whether the detectors look at the tick that comes."""
        return self._sight is None or self._ticks % self._every == 0

    @property
    def looked(self) -> bool:
        """Whether the detectors looked at the last tick."""
        return self._ticks % self._every == 0

    @property
    def _low(self) -> float:
        """Height below which something may carry a drone, m."""
        return self._policy.floor + _NEAR_GROUND

    def moves(self, index: int, state: FloatArray) -> bool:
        """Tell whether drone index, whose state is (6,), is seen to move: then it does not stand on anything."""
        return float(np.abs(state[3:]).max()) > _MOVING

    def enter(
        self, index: int, before: Mode, after: Mode, estimated: FloatArray, now: float, guidance: Guidance
    ) -> float | None:
        """Take note of a changed mode.

        Args:
            index: whose.
            before: mode until now.
            after: mode from now on.
            estimated: (9,) of the drone.
            now: s.
            guidance: the ground below it.

        Returns:
            The height, m, of the ground on which it is known to stand; None if nothing new is known of that.
        """
        self._sight = None
        height = float(estimated[2])
        if after is Mode.LEVEL or (after is Mode.DESCEND and before is Mode.FLY):
            self.sinking.begin(
                index, now, estimated, float(guidance.ground[index]), self._acceleration[index],
                held=bool(self._held[index]), answers=after is Mode.DESCEND and bool(self._gone_astray[index]),
            )  # fmt: skip
        if after is Mode.FLY and before in AIRBORNE:
            self._gaps.resume(index)
        if after in (Mode.CUT, Mode.REST, Mode.FALLEN, Mode.IDLE):
            self._gone_astray[index] = self._following_check.blown[index] = False
            self.sinking.end(index)
        if after not in AIRBORNE:
            self._held[index] = False
        if after is Mode.FALLEN or (before in AIRBORNE and after is Mode.UNLOCK):
            self.thrust.forget(index)
        if before is Mode.IDLE and after is Mode.FLY:
            self.thrust.take_over(index)
        if after is Mode.UNLOCK or (after is Mode.FLY and before not in AIRBORNE):
            self._unlocked[index] = after is Mode.UNLOCK or before is Mode.UNLOCK
            self._lift_off.begin(index, estimated[:3], taken_over=not self._unlocked[index])
            self.grounded = self._unlocked & self._lift_off.standing
            return height if after is Mode.UNLOCK or height < self._low else None
        return None

"""Heights that stand still though commands should change them, on the ground and in the air."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.flight.detectors import LiftOffDetector
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.senses import Senses
from flatsat_ros.flight.unmoved import UnmovedDetector

PERIOD, GRAVITY = 0.05, 9.81
ON, NONE = np.ones(1, dtype=bool), np.zeros(1, dtype=bool)
# of a swing, at the turn of which a drone whose commands come a quarter of a second late stands still for long
TURN = [(1.8, 5), (0.0, 6)] + [
    (push, 1) for push in (-2.4, -2.4, -2.2, -2.0, -1.5, -0.8, 0.0, 0.6, 1.2, 1.8, 2.2, 2.7, 3.0, 3.0, 3.0, 3.0, 3.0)
]
COMMANDS = st.lists(st.floats(-3.0, 3.0), min_size=10, max_size=60)


def first_alarm(
    heights: np.ndarray,
    climbs: np.ndarray,
    commands: np.ndarray,
    reference: np.ndarray,
    balance: float = 0.0,
    gust: float = 0.0,
    settled: np.ndarray = ON,
) -> int:
    """The look at which a height is found to stand still, -1 for never; one value a look each; gusts come sideways."""
    detector = UnmovedDetector(1, PERIOD)
    for look, (height, climb, command, wanted) in enumerate(zip(heights, climbs, commands, reference, strict=True)):
        sideways = gust * math.sin(2.0 * math.pi * PERIOD * look / 2.0)  # m/s^2
        estimated = np.array([[0.0, 0.0, height, 0.0, 0.0, climb, sideways, 0.0, balance]])
        error = np.array([height - wanted])
        if detector.look(estimated, np.array([PERIOD * command]), error, ON, settled)[0]:
            return look
    return -1


@pytest.mark.parametrize("missed", ["none", "some", "so many that it was held level"])
def test_a_velocity_that_is_wrong_after_poses_were_missed_makes_no_height_stand_still(missed: str) -> None:
    certificate, told = load_certificate("cf21_50hz"), []
    senses, gap = Senses(certificate, Policy(), 1), 10 if missed == "some" else 0  # ticks
    if missed.startswith("so many"):
        senses.enter(0, Mode.LEVEL, Mode.FLY, np.zeros(9), 0.0, SimpleNamespace(ground=np.zeros(1)))  # type: ignore[arg-type]
    for tick in range(-gap, 100):
        climb = 4.0 * math.exp(-max(tick, 0) * certificate.period / 0.1)  # m/s, estimated of a drone that hovers
        estimated, error = np.zeros((1, 9)), np.zeros((1, 6))
        estimated[0, 2], estimated[0, 5], error[0, 2] = 1.0 + max(-tick, 0), climb, -0.3  # without poses it is led on
        newest = np.full(1, float(max(tick, 0)))
        senses.note(np.zeros((1, 3)), estimated, error, np.zeros(1), ON, NONE, newest=newest)
        told += senses.strays.reports()
    assert any("stays within" in text for _, text in told) is (missed == "none")


def noise(count: int, seed: int, deviation: float = 1e-3) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, deviation, count)


@given(commands=COMMANDS, balance=st.floats(-2.0, 2.0), away=st.floats(-5.0, 5.0), seed=st.integers(0, 99))
@settings(max_examples=40)
def test_a_height_that_follows_its_commands_is_never_taken_for_still(
    commands: list[float], balance: float, away: float, seed: int
) -> None:
    count = len(commands)
    climbs = PERIOD * np.cumsum(np.array(commands) + balance)
    heights = PERIOD * np.cumsum(climbs)
    seen = heights + noise(count, seed)
    assert first_alarm(seen, climbs, np.array(commands), heights + away, balance) == -1


@given(
    pieces=st.lists(st.tuples(st.floats(-3.0, 3.0), st.integers(1, 12)), min_size=3, max_size=10),
    late=st.integers(0, 5),
    balance=st.floats(-0.4, 0.4),
    away=st.sampled_from([-0.2, 0.2]),
)
@example(pieces=TURN, late=5, balance=0.3, away=-0.2)
@settings(max_examples=60)
def test_who_obeys_late_does_not_stand_still_at_the_turn_of_its_swing_while_its_thrust_is_not_known(
    pieces: list[tuple[float, int]], late: int, balance: float, away: float
) -> None:
    commands = np.array([push for push, looks in pieces for _ in range(looks)])
    done = np.r_[np.zeros(late), commands][: len(commands)]
    climbs = PERIOD * np.cumsum(done)
    heights = PERIOD * np.cumsum(climbs)
    assert first_alarm(heights, climbs, commands, heights - away, balance, settled=NONE) == -1


@given(strength=st.floats(0.6, 3.0), sign=st.sampled_from([-1.0, 1.0]), seed=st.integers(0, 99))
@settings(max_examples=40)
def test_a_still_height_is_found_within_the_way_that_the_drone_may_go(strength: float, sign: float, seed: int) -> None:
    ramp = sign * strength * PERIOD * np.arange(60)  # m/s^2: the reference goes away, and the command grows
    still = 1.0 + noise(60, seed)
    found = first_alarm(still, noise(60, seed + 1, 0.01), ramp, 1.0 + sign * 0.3 * PERIOD * np.arange(60))
    assert found > 0
    true = PERIOD * np.cumsum(PERIOD * np.cumsum(ramp))
    assert 0.1 < abs(true[found]) < 0.8


@given(strength=st.floats(0.6, 0.85), sign=st.sampled_from([-1.0, 1.0]), seed=st.integers(0, 99))
@settings(max_examples=20)
def test_where_the_air_is_rough_a_gust_may_hold_a_height_for_a_while(strength: float, sign: float, seed: int) -> None:
    calm, still = np.zeros(40), 1.0 + noise(100, seed)
    ramp = sign * strength * np.r_[calm, np.minimum(PERIOD * np.arange(1.0, 61.0), 1.0)]  # m/s^2
    away = 1.0 + sign * 0.3 * PERIOD * np.arange(100)
    early, late = (first_alarm(still, 0.0 * still, ramp, away, gust=gust) for gust in (0.1, 0.8))
    assert early > 40
    assert late == -1
    assert first_alarm(still, 0.0 * still, 3.0 * ramp, away, gust=0.8) > 0, "but not against any command"


@given(commands=COMMANDS, seed=st.integers(0, 99))
@settings(max_examples=20)
def test_a_still_height_near_its_reference_may_be_one_that_gusts_are_countered_at(
    commands: list[float], seed: int
) -> None:
    still, nothing = 1.0 + noise(len(commands), seed), np.zeros(len(commands))
    assert first_alarm(still, nothing, np.array(commands), nothing + 1.05) == -1


@given(commands=COMMANDS, away=st.floats(-1.0, 1.0), seed=st.integers(0, 99))
@settings(max_examples=20)
def test_a_still_height_is_no_matter_of_a_reference_that_has_rested_for_long(
    commands: list[float], away: float, seed: int
) -> None:
    pause = round(3.2 / PERIOD)
    count = pause + len(commands)
    still, nothing = 1.0 + noise(count, seed), np.zeros(count)
    assert first_alarm(still, nothing, np.r_[nothing[:pause], commands], nothing + 1.0 + away) == -1


@pytest.mark.parametrize(("share", "rises", "held"), [(1.32, 0.0, False), (1.4, 0.0, True), (1.4, 0.2, False)])
def test_more_thrust_than_the_weakest_drone_needs_lifts_it_or_it_is_not_seen(
    share: float, rises: float, held: bool
) -> None:
    detector, found = LiftOffDetector(1, 3.0, 1.333), False
    detector.begin(0, np.zeros(3))
    for look in range(20):
        place = np.array([[0.0, 0.0, rises * (PERIOD * look) ** 2]])
        upward = np.array([(share * 0.9 - 1.0) * GRAVITY])  # as much with a scale of 0.9
        found |= bool(detector.held(PERIOD * look, place, upward, np.array([0.9]), GRAVITY, ON)[0])
    assert found is held
    rise, climb = detector.unseen(0)
    if held:  # of a drone that gives what it is asked for
        assert climb == pytest.approx((share - 1.0) * GRAVITY * 19 * PERIOD)
        assert rise == pytest.approx((share - 1.0) * GRAVITY * (19 * PERIOD) ** 2 / 2.0, rel=0.1)

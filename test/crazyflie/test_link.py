"""The link without a radio: addresses, pacing, the set-points at the end."""

from __future__ import annotations

import itertools
import math
import re
from collections import defaultdict

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.link import REST, ZERO_TIME, Address, PacketQueue, ShutdownSequence, sendable
from flatsat_ros.crazyflie.wire import WireSetpoint, YawMode

LIFETIME = 0.25
HOVER = WireSetpoint(1.0, 2.0, 3.0, 40000.0)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("radio://0/80", "radio://0/80/2M/E7E7E7E7E7"),
        ("radio://0/80/2M", "radio://1/080/2M/e7e7e7e7e7"),
        ("radio://0/80/2M/E7E7E7E701", "radio://0/80/2M/E7E7E7E701?safelink=0&rate_limit=100"),
        ("radio://0/80/1M/07", "radio://0/80/1M/0000000007"),
        ("udp://localhost:19850", "udp://127.0.0.1:19850"),
    ],
)
def test_one_drone_is_known_by_all_its_uris(one: str, other: str) -> None:
    assert Address.parse(one).drone == Address.parse(other).drone


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("radio://0/80/2M/E7E7E7E701", "radio://0/80/2M/E7E7E7E702"),
        ("radio://0/80/2M/E7E7E7E701", "radio://0/81/2M/E7E7E7E701"),
        ("radio://0/80/2M/E7E7E7E701", "radio://0/80/1M/E7E7E7E701"),
        ("udp://127.0.0.1:19850", "udp://127.0.0.1:19851"),
        ("udp://10.0.0.1:19850", "udp://10.0.0.2:19850"),
    ],
)
def test_different_drones_differ(one: str, other: str) -> None:
    assert Address.parse(one).drone != Address.parse(other).drone


def test_a_dongle_is_shared_and_a_udp_connection_is_not() -> None:
    uris = ["radio://0/80/2M/E7E7E7E701", "radio://0/90/1M", "radio://1/80", "udp://a:1", "udp://a:2"]
    transports = [Address.parse(uri).transport for uri in uris]
    assert transports[0] == transports[1]
    assert len(set(transports)) == 4


def test_options_that_cflib_does_not_know_are_named() -> None:
    assert Address.parse("radio://0/80?safelink=0&rate_limit=100&autoping=1").ignored == ("safelink", "autoping")
    with pytest.raises(FlatsatError, match=r"must be radio://0/\.\.\. for the first dongle"):
        Address.parse("radio://*/80/2M/E7E7E7E701")


@pytest.mark.parametrize(
    "uri",
    ["", "radio", "radio://0", "radio://0/126", "radio://0/80/3M", "radio://0/80/2M/XY", "udp://a", "udp://a:0",
     "udp://a:65536", "usb://0", "udp://a:1/b", "radio://0/80?rate_limit=0", "radio://0/80?rate_limit=x&safelink=0",
     "radio://*/80/2M/E7E7E7E701"],
)  # fmt: skip
def test_what_is_no_uri_is_refused_by_name(uri: str) -> None:
    with pytest.raises(FlatsatError, match=re.escape(f"'{uri}'")):
        Address.parse(uri)


def test_thrust_is_clipped_and_cut_to_a_whole_number() -> None:
    thrusts = [-1.0, 0.0, 999.9, 40000.7, 60000.0, 1e9]
    assert [sendable(HOVER._replace(thrust=t), 60000.0).thrust for t in thrusts] == [0, 0, 999, 40000, 60000, 60000]
    assert sendable(HOVER, 60000.0) == HOVER


@pytest.mark.parametrize("position", range(4))
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e39])
def test_what_does_not_fit_the_packet_is_refused(position: int, bad: float) -> None:
    values = list(HOVER)
    values[position] = bad
    with pytest.raises(FlatsatError, match="must be finite"):
        sendable(WireSetpoint(*values), 60000.0)


arrivals = st.lists(st.tuples(st.integers(0, 3), st.floats(0.0, 0.05)), max_size=60)


def play(
    queue: PacketQueue[int, int], offers: list[tuple[int, float]], tick: float = 0.001
) -> list[tuple[float, int, int, float]]:
    """Offer packets (stream, time after the one before), numbered; return (time, stream, number, age) as they leave."""
    times = list(itertools.accumulate(delay for _, delay in offers))
    sent, number, now = [], 0, 0.0
    while number < len(offers) or queue.wait(range(4), now) < math.inf:
        while number < len(offers) and times[number] <= now:
            queue.offer(offers[number][0], number, now)
            number += 1
        wait = queue.wait(range(4), now)
        taken = queue.take(range(4), now)
        assert (taken is None) == (wait > 0.0)
        if taken:
            sent.append((now, *taken, now - times[taken[1]]))
        now += tick
    return sent


@given(offers=arrivals)
def test_a_queue_keeps_period_gap_and_age(offers: list[tuple[int, float]]) -> None:
    period, gap = 0.02, 0.004
    queue: PacketQueue[int, int] = PacketQueue(4, period=period, gap=gap)
    sent = play(queue, offers)
    rounding = 1e-9
    times = [time for time, *_ in sent]
    assert all(b - a >= gap - rounding for a, b in itertools.pairwise(times))
    by_stream = defaultdict(list)
    for time, stream, number, age in sent:
        by_stream[stream].append((time, number))
        # at worst its own period, and the gaps of all who waited longer
        assert age <= period + 4 * gap + 0.002
    for stream, packets in by_stream.items():
        assert all(b[0] - a[0] >= period - rounding for a, b in itertools.pairwise(packets))
        assert all(b[1] > a[1] for a, b in itertools.pairwise(packets)), "a newer packet is never followed by an older"
        assert packets[-1][1] == max(n for n, (s, _) in enumerate(offers) if s == stream), "the newest always arrives"
    assert len(sent) + sum(queue.overtaken.values()) == len(offers)


def test_a_burst_for_several_drones_leaves_one_after_the_other_and_the_first_at_once() -> None:
    queue: PacketQueue[int, int] = PacketQueue(4, period=0.01, gap=0.0025)
    sent = play(queue, [(0, 0.0), (1, 0.0), (2, 0.0), (3, 0.0)], tick=0.0005)
    assert [(time, stream) for time, stream, *_ in sent] == [
        (pytest.approx(0.0025 * stream), stream) for stream in range(4)
    ]


@given(count=st.integers(1, 8), durations=st.lists(st.floats(0.01, 0.02), min_size=16, max_size=80))
def test_every_stream_has_its_turn_on_a_link_that_cannot_keep_up(count: int, durations: list[float]) -> None:
    queue: PacketQueue[int, float] = PacketQueue(count, period=0.01, gap=0.001)
    turns, now, renewal = [0] * count, 0.0, 0.005
    for number, duration in enumerate(durations):
        for stream in range(count):  # all are renewed together, in the same order
            queue.offer(stream, now, now)
        taken = queue.take(range(count), now)
        assert taken is not None
        assert taken == (number % count, now)
        turns[taken[0]] += 1
        now += duration + renewal
    assert max(turns) - min(turns) <= 1


def test_what_got_lost_goes_out_again_at_once_unless_there_is_newer() -> None:
    queue: PacketQueue[int, str] = PacketQueue(1, period=0.01, gap=0.0)
    queue.again(0)
    assert queue.wait([0], 0.0) == math.inf
    queue.offer(0, "old", 0.0)
    assert queue.take([0], 0.0) == (0, "old")
    queue.again(0)
    assert queue.take([0], 0.001) == (0, "old")
    queue.offer(0, "new", 0.002)
    queue.again(0)
    assert queue.take([0], 0.002) == (0, "new")
    assert queue.wait([0], 0.002) == math.inf


def test_a_packet_that_waited_too_long_is_thrown_away() -> None:
    queue: PacketQueue[int, str] = PacketQueue(1, period=0.01, gap=0.0, lifetime=LIFETIME)
    queue.offer(0, "old", 0.0)
    assert queue.take([0], LIFETIME + 0.01) is None
    assert queue.overtaken[0] == 1
    assert queue.wait([0], LIFETIME + 0.01) == math.inf


def test_who_does_not_fetch_its_packet_blocks_nobody() -> None:
    queue: PacketQueue[int, str] = PacketQueue(2, period=0.01, gap=0.005)
    queue.offer(0, "of a blocked link", 0.0)
    for k in range(20):
        queue.offer(1, "of a good link", 0.011 * k)
        assert queue.take([1], 0.011 * k) == (1, "of a good link")


@pytest.mark.parametrize(
    ("period", "gap", "reason"),
    [(0.0, 0.0, "period"), (0.3, 0.0, "period"), (0.01, 0.006, "2 streams"), (0.01, -1.0, "gap")],
)
def test_a_queue_that_cannot_keep_its_promise_is_refused(period: float, gap: float, reason: str) -> None:
    with pytest.raises(FlatsatError, match=reason):
        PacketQueue(2, period=period, gap=gap)


def test_stopping_is_zero_thrust_for_more_than_two_seconds() -> None:
    stop = ShutdownSequence(descent=0.0, thrust=0.0)
    assert ZERO_TIME > 2.0
    assert [stop.setpoint(t, 20.0) for t in (0.0, 2.0, ZERO_TIME - 0.01)] == [REST] * 3
    assert stop.setpoint(ZERO_TIME, 20.0) is None


def test_landing_is_a_level_descent_and_then_zero_thrust() -> None:
    land = ShutdownSequence(descent=3.0, thrust=36000.0)
    assert [land.setpoint(t, 20.0) for t in (0.0, 2.99)] == [REST._replace(thrust=36000.0)] * 2
    assert [land.setpoint(t, 20.0) for t in (3.0, 3.0 + ZERO_TIME - 0.01)] == [REST] * 2
    assert land.setpoint(3.0 + ZERO_TIME, 20.0) is None


def test_a_descent_keeps_a_yaw_that_is_an_angle() -> None:
    land = ShutdownSequence(3.0, 36000.0, yaw_mode=YawMode.ANGLE)
    assert land.setpoint(2.99, 20.0) == REST._replace(thrust=36000.0, yaw=20.0)
    assert land.setpoint(3.0, 20.0) == REST

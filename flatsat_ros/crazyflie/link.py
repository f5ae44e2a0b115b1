"""What a link to real drones decides whatever its radio: whom a URI means, when to send, how to leave a drone."""

from __future__ import annotations

import math
import re
import threading
from collections import Counter
from collections.abc import Collection, Hashable, Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Generic, TypeVar

import numpy as np

from flatsat_ros.base.constants import FARTHEST_PLACE
from flatsat_ros.base.errors import quoted, refusal, require
from flatsat_ros.crazyflie.wire import WireSetpoint, YawMode

S = TypeVar("S", bound=Hashable)
P = TypeVar("P")

# s: the firmware locks a drone that got zero thrust for a shorter time and then nothing, until it is rebooted
ZERO_TIME = 2.2
REST = WireSetpoint(0.0, 0.0, 0.0, 0.0)
QUALITY = "link quality %"  # what it is called among the values that a link reports
# link quality, %, at which a drone's reception is poor, or so bad that it must land; for so long, s
POOR_QUALITY, BAD_QUALITY, QUALITY_HOLD = 90.0, 80.0, 3.0
_UNIT = 0.1  # of a quaternion's length: 16 bits for each number leave 0.001
_FLOAT_MAX = float(np.finfo(np.float32).max)

_RADIO = re.compile(
    r"radio://(?P<dongle>\w+)/(?P<channel>\d{1,3})(/(?P<rate>250K|1M|2M))?(/(?P<address>[0-9A-F]{2,10}))?"
)
_LIMIT = re.compile(r"[1-9][0-9]{0,5}")  # packets per second
_UDP = re.compile(r"udp://(?P<host>[\w.-]+):(?P<port>\d{1,5})")


@dataclass(frozen=True)
class Address:
    """Where a drone is reached.

    Attributes:
        uri: as cflib takes it.
        transport: name of what the drone's packets pass through: the dongle, which several drones may share, or over
            UDP the connection of this drone alone.
        drone: name of the drone itself: the same however its URI is written and whatever the dongle.
        ignored: names of its options that cflib does not know, and crazyswarm2's cpp back end may.
    """

    uri: str
    transport: str
    drone: str
    ignored: tuple[str, ...] = ()

    @classmethod
    def parse(cls, uri: str) -> Address:
        """Read a URI.

        Args:
            uri: radio://dongle/channel/rate/address, where rate (2M) and address (E7E7E7E7E7) may be left out, or
                udp://host:port; either may end with options, ?rate_limit=100&safelink=0.

        Raises:
            FlatsatError: it is neither, or what cflib would take of it is not valid.
        """
        plain, _, query = uri.partition("?")
        if plain.lower().startswith("radio://*"):
            raise refusal("URI", uri, "", "radio://0/... for the first dongle: any of them, *, is not known to cflib")
        options = dict(option.partition("=")[::2] for option in query.split("&") if option)
        limit = options.pop("rate_limit", "1")
        require(bool(_LIMIT.fullmatch(limit)), f"rate_limit of {quoted(uri)}", limit, "", "a whole number above 0")
        ignored = tuple(options)
        if found := _RADIO.fullmatch("radio" + plain[5:].upper() if plain.lower().startswith("radio") else ""):
            channel, rate, address = int(found["channel"]), found["rate"] or "2M", found["address"] or "E7E7E7E7E7"
            require(channel <= 125, f"channel of {quoted(uri)}", channel, "", "from 0 to 125")
            return cls(uri, f"radio {found['dongle']}", f"radio {channel} {rate} {address:0>10}", ignored)
        if found := _UDP.fullmatch(plain):
            port = int(found["port"])
            require(0 < port < 65536, f"port of {quoted(uri)}", port, "", "from 1 to 65535")
            host = found["host"].lower().replace("localhost", "127.0.0.1")
            return cls(uri, f"udp {host} {port}", f"udp {host} {port}", ignored)
        valid = "radio://dongle/channel/rate/address, as in radio://0/80/2M/E7E7E7E701, or udp://host:port"
        raise refusal("URI", uri, "", valid)


def sendable(setpoint: WireSetpoint, pwm_max: float) -> WireSetpoint:
    """Return the set-point with its thrust clipped to 0..pwm_max and cut to a whole number, as the packet holds it.

    Args:
        setpoint: in the units of the link.
        pwm_max: largest thrust that the vehicle takes, PWM.

    Raises:
        FlatsatError: a value is not finite in the 32 bits that it has in the packet, which the firmware would not
            notice.
    """
    require_packable("set-point", setpoint)
    return setpoint._replace(thrust=float(int(min(max(setpoint.thrust, 0.0), pwm_max))))


def require_packable(name: str, values: Iterable[float]) -> None:
    """Refuse numbers that are not finite in the 32 bits that each has in a packet.

    Raises:
        FlatsatError: names them.
    """
    numbers = tuple(values)
    if not all(abs(value) <= _FLOAT_MAX for value in numbers):
        raise refusal(name, numbers, "", f"finite and within {_FLOAT_MAX:.3g}")


def require_pose(position: Sequence[float], quaternion: Sequence[float]) -> None:
    """Refuse what a drone says of its pose if no drone can have it: its estimator has failed, or a packet is damaged.

    Args:
        position: (3,) m.
        quaternion: (4,) x, y, z, w.

    Raises:
        FlatsatError: a number is not finite, the place is beyond FARTHEST_PLACE, or the quaternion not of unit length.
    """
    length = math.sqrt(sum(value * value for value in quaternion))
    inside, valid = all(abs(value) <= FARTHEST_PLACE for value in position), f"within {FARTHEST_PLACE:g} m"
    require(inside, "position", position, "m", valid)
    require(abs(length - 1.0) <= _UNIT, "length of the quaternion", length, "", f"1, up to {_UNIT:g}")


class SupervisorInfo(IntFlag):
    """The bits of the log variable supervisor.info: supervisor.c updateLogData. Bits above these are not used here."""

    CAN_BE_ARMED = 1 << 0
    ARMED = 1 << 1
    AUTO_ARMING = 1 << 2
    CAN_FLY = 1 << 3
    FLYING = 1 << 4
    TUMBLED = 1 << 5
    LOCKED = 1 << 6
    CRASHED = 1 << 7


class Reception(IntEnum):
    """How well a drone is reached."""

    GOOD = 0
    POOR = 1
    BAD = 2


class LinkQuality:
    """Judges the link quality that cflib tells of a radio: 100 % less 10 for each time that packets were repeated.

    A dongle repeats up to three times, so that 70 % is the least. At 90 % about every second packet on the air gets
    lost, at 80 % four of five, and two of five set-points do not arrive at all.

    Attributes:
        reception: of the last readings.
    """

    def __init__(self) -> None:
        self.reception = Reception.GOOD
        # since when all readings were above the limit of POOR, at or below it, at or below that of BAD, s
        self._since = [math.nan] * 3

    def measure(self, quality: float, now: float) -> bool:
        """Take in a reading, %, at a time, s; return whether the reception is worse than before.

        For QUALITY_HOLD all readings must agree; a reception that was bad is so until it is good.
        """
        for level, holds in enumerate((quality > POOR_QUALITY, quality <= POOR_QUALITY, quality <= BAD_QUALITY)):
            self._since[level] = (
                math.nan if not holds else now if math.isnan(self._since[level]) else self._since[level]
            )
        above, poor, bad = (now - since >= QUALITY_HOLD for since in self._since)
        before = self.reception
        self.reception = Reception.GOOD if above else max(before, Reception.BAD if bad else Reception(int(poor)))
        return self.reception > before


class PacketQueue(Generic[S, P]):
    """The packets that wait for their turn on one dongle: of each stream the newest, and when it may be sent.

    A stream is what goes to one drone for one purpose, such as its set-points. Of a stream at most one packet is sent
    per `period`, and packets of all streams are at least `gap` apart. A packet that waits is replaced by a newer one of
    its stream, and thrown away when it has waited for `lifetime`: a set-point of the past must not fly a drone after
    its link was blocked. Every method may be called from any thread; `now` is the present, s, on the caller's clock.

    Attributes:
        overtaken: by stream, how many packets were replaced or thrown away unsent.
    """

    def __init__(self, streams: int, *, period: float, gap: float, lifetime: float = 0.25) -> None:
        """Begin with nothing waiting.

        Args:
            streams: number of streams that share the queue.
            period: least time between two packets of a stream, s, above 0.
            gap: least time between any two packets, s; all streams together must fit into a period.
            lifetime: longest time that a packet waits, s, above the period.

        Raises:
            FlatsatError: an argument is out of its bounds.
        """
        require(0.0 < period < lifetime, "period", period, "s", f"above 0 and below {lifetime} s")
        most = period / max(streams, 1)
        fit = f"from 0 to {most:.4g} s, to fit {streams} streams into {period:.4g} s"
        require(0.0 <= gap <= most, "gap", gap, "s", fit)
        self._period, self._gap, self._lifetime = period, gap, lifetime
        self._waiting: dict[S, tuple[float, P]] = {}
        self._sent: dict[S, float] = {}
        self._taken: dict[S, tuple[float, P]] = {}
        self._last = -math.inf
        self._lock = threading.Lock()
        self.overtaken: Counter[S] = Counter()

    def offer(self, stream: S, packet: P, now: float) -> None:
        """Let a packet wait for its turn, in place of the one of its stream that waits."""
        with self._lock:
            self.overtaken[stream] += stream in self._waiting
            self._waiting[stream] = now, packet

    def wait(self, streams: Collection[S], now: float) -> float:
        """Return the time, s, until one of these streams has a packet to send, inf if none of them waits."""
        with self._lock:
            return min((self._due(stream) - now for stream in streams if stream in self._waiting), default=math.inf)

    def take(self, streams: Collection[S], now: float) -> tuple[S, P] | None:
        """Return stream and packet of what may be sent now, None if there is none.

        Of several it is the stream that was sent least recently: each has its turn, however often others are renewed.
        """
        with self._lock:
            ready = []
            for stream in streams:
                if stream not in self._waiting:
                    continue
                if now - self._waiting[stream][0] > self._lifetime:
                    self.overtaken[stream] += 1
                    del self._waiting[stream]
                elif self._due(stream) <= now:
                    ready.append(stream)
            if not ready:
                return None
            chosen = min(ready, key=lambda stream: (self._sent.get(stream, -math.inf), self._waiting[stream][0]))
            self._sent[chosen] = self._last = now
            self._taken[chosen] = self._waiting.pop(chosen)
            return chosen, self._taken[chosen][1]

    def again(self, stream: S) -> None:
        """Send next what was taken last of a stream, because it got lost, or what has come since, without a pause."""
        with self._lock:
            if stream in self._taken:
                self._waiting.setdefault(stream, self._taken.pop(stream))
            self._sent.pop(stream, None)

    def _due(self, stream: S) -> float:
        return max(self._sent.get(stream, -math.inf) + self._period, self._last + self._gap)


@dataclass(frozen=True)
class ShutdownSequence:
    """The set-points with which a drone that was flown is left when the link ends.

    A level descent, where wanted, then zero thrust for ZERO_TIME.

    Attributes:
        descent: duration of the level descent, s; 0 stops the motors at once.
        thrust: during the descent, PWM.
        yaw_mode: what the yaw on the wire means: the descent keeps an angle and sets a rate to 0.
    """

    descent: float
    thrust: float
    yaw_mode: YawMode = YawMode.RATE

    def setpoint(self, elapsed: float, yaw: float) -> WireSetpoint | None:
        """Return the set-point to send, None when the last one was sent.

        Args:
            elapsed: time since the link began to end, s.
            yaw: of the last set-point before that, in the units of the wire.
        """
        if elapsed < self.descent:
            return REST._replace(thrust=self.thrust, yaw=yaw if self.yaw_mode is YawMode.ANGLE else 0.0)
        return REST if elapsed < self.descent + ZERO_TIME else None

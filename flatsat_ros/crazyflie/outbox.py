"""What is sent to one drone, in which order and until when; by which radio is not decided here.

Set-points and external poses wait in a `PacketQueue` that all drones of a dongle share; an arming request goes before
them. An emergency stop ends everything else. When the link is to end, a drone that was flown gets the
`ShutdownSequence` first.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import replace
from enum import Enum
from typing import NamedTuple, Protocol

from flatsat_ros.crazyflie.link import REST, PacketQueue, ShutdownSequence
from flatsat_ros.crazyflie.wire import WireSetpoint

EMERGENCY_PERIOD = 0.1  # s between two emergency stops
EMERGENCY_END = 0.5  # s that an emergency stop is repeated at least, also when the link is to end
NOTICES = 5  # that no set-point follows, since one packet may be lost
FIRMWARE_PATIENCE = 2.0  # s without a set-point after which the firmware stops the motors


class Stream(Enum):
    """What is sent to a drone again and again; the newest counts."""

    SETPOINT = "set-points sent"
    EXTERNAL_POSE = "external poses sent"


class Sender(Protocol):
    """Sends single packets to one drone."""

    def setpoint(self, setpoint: WireSetpoint) -> None:
        """Send a set-point that `sendable` returned."""

    def external_pose(self, position: tuple[float, ...], quaternion: tuple[float, ...] | None) -> None:
        """Send a position, m, or with a quaternion x, y, z, w a pose."""

    def arming(self, armed: bool) -> None:
        """Send the request to arm or disarm."""

    def emergency_stop(self) -> None:
        """Send the request to stop the motors until reboot."""

    def no_more_setpoints(self) -> None:
        """Send the notice that no set-point follows."""


# sends one packet
Packet = Callable[[Sender], None]


class _Ending(NamedTuple):
    """How a drone is left, once its link is to end."""

    since: float  # s
    sequence: ShutdownSequence | None  # none for a drone that was never flown


class Outbox:
    """What one drone is to be sent. Every time, now, is the present on the caller's clock, s.

    `send` belongs to one thread, and so does `pull`; the other methods may be called from any.

    Attributes:
        pulled: whether the link takes what is sent again and again with `pull`, when it can transmit; `send` does not
            send it then.
        sent: number of packets sent, by stream.
        stopped: whether an emergency stop was asked for.
        leaving: whether the link is to end.
    """

    def __init__(self, robot: str, queue: PacketQueue[tuple[str, Stream], Packet], shutdown: ShutdownSequence) -> None:
        """Begin with nothing to send.

        Args:
            robot: its name, which tells its streams from those of others.
            queue: shared by all drones of one dongle.
            shutdown: how the drone is left if it was flown.
        """
        self.sent: Counter[Stream] = Counter()
        self.stopped = self.leaving = self.pulled = False
        self._queue, self._shutdown = queue, shutdown
        self._streams = {stream: (robot, stream) for stream in Stream}
        self._requests: deque[Packet] = deque()
        self._newest, self._last_setpoint = REST, -math.inf  # set-point, and when one was sent last
        self._first_stop, self._next_stop = math.inf, -math.inf  # s
        self._ending: _Ending | None = None
        self._ended = False  # the last set-point has gone out
        self._last: tuple[str, Stream] | None = None  # stream that was sent from last

    @property
    def overtaken(self) -> int:
        """How many set-points were replaced by newer ones or thrown away as too old."""
        return self._queue.overtaken[self._streams[Stream.SETPOINT]]

    def command(self, setpoint: WireSetpoint, now: float) -> None:
        """Send a set-point that `sendable` returned, unless a newer one comes before its turn."""
        if not (self.leaving or self.stopped):
            self._newest = setpoint
            self._offer_setpoint(setpoint, now)

    def locate(self, position: tuple[float, ...], quaternion: tuple[float, ...] | None, now: float) -> None:
        """Send an external position, m, or with a quaternion x, y, z, w a pose; both finite."""
        stream = self._streams[Stream.EXTERNAL_POSE]
        self._queue.offer(stream, lambda sender: sender.external_pose(position, quaternion), now)

    def arm(self, armed: bool) -> None:
        """Send an arming request as soon as possible."""
        self._requests.append(lambda sender: sender.arming(armed))

    def forget_requests(self) -> None:
        """Drop requests that were not sent yet: they may be about a drone that was rebooted since."""
        self._requests.clear()

    def stop_motors(self) -> None:
        """Send the emergency stop over and over, and nothing else any more."""
        self.stopped = True

    def leave(self) -> None:
        """Send what the drone needs to be left alone, then nothing."""
        self.leaving = True

    def wait(self, now: float) -> float:
        """Return the time, s, until `send` may send a packet of a stream, at least 0, inf if none waits."""
        return math.inf if self.pulled else max(self._queue.wait(self._streams.values(), now), 0.0)

    def pull(self, sender: Sender, now: float) -> bool:
        """Send the newest packet of a stream if there is one whose turn it is; return whether there was."""
        return not (self.stopped or self._ended) and self._send_one(sender, now)

    def lose(self) -> None:
        """Take note that what was pulled last did not arrive: it, or what is newer, goes out next."""
        if self._last is not None:
            self._queue.again(self._last)

    def send(self, sender: Sender, now: float) -> bool:
        """Send what is due; return False when the last packet was sent."""
        if self.leaving and self._ending is None:
            self._ending = _Ending(now, self._choose_ending(now))
        if self.stopped:
            return self._repeat_stop(sender, now)
        while self._requests:
            self._requests.popleft()(sender)
        if self._ending is not None and not self._go_on_ending(self._ending, sender, now):
            return False
        if not self.pulled:
            self._send_one(sender, now)
        return True

    def _send_one(self, sender: Sender, now: float) -> bool:
        """Send a packet of a stream, if there is one whose turn it is; return whether there was."""
        taken = self._queue.take(self._streams.values(), now)
        if taken is None:
            return False
        self._last, packet = taken
        _, stream = self._last
        packet(sender)
        self.sent[stream] += 1
        if stream is Stream.SETPOINT:
            self._last_setpoint = now
        return True

    def _offer_setpoint(self, setpoint: WireSetpoint, now: float) -> None:
        self._queue.offer(self._streams[Stream.SETPOINT], lambda sender: sender.setpoint(setpoint), now)

    def _repeat_stop(self, sender: Sender, now: float) -> bool:
        """Repeat the emergency stop: which of them arrive nobody knows."""
        if now >= self._next_stop:
            self._first_stop, self._next_stop = min(self._first_stop, now), now + EMERGENCY_PERIOD
            sender.emergency_stop()
        return self._ending is None or now - max(self._ending.since, self._first_stop) < EMERGENCY_END

    def _choose_ending(self, now: float) -> ShutdownSequence | None:
        """Return how to leave the drone: alone if it was never flown; without a descent if its motors rest already."""
        if self._last_setpoint == -math.inf:
            return None
        return self._shutdown if self.flies(now) else replace(self._shutdown, descent=0.0)

    def flies(self, now: float) -> bool:
        """Tell whether its motors turn by set-points of ours."""
        return self._newest.thrust > 0.0 and now - self._last_setpoint <= FIRMWARE_PATIENCE

    def _go_on_ending(self, ending: _Ending, sender: Sender, now: float) -> bool:
        """Offer the next set-point of the shutdown sequence; return False when it is over."""
        if ending.sequence is None:
            return False
        setpoint = ending.sequence.setpoint(now - ending.since, self._newest.yaw)
        if setpoint is not None:
            self._offer_setpoint(setpoint, now)
            return True
        self._ended = True
        for _ in range(NOTICES):
            sender.no_more_setpoints()
        return False

"""What cflib sends of an outbox: packet by packet, or in the drone's turn on a dongle.

cflib is GPL: this module is loaded by the executable cflib_bridge only.

In cflib's radio driver a packet waits for the drone's turn on the dongle, and one that got lost is sent again and
again: set-points would arrive several turns old. They are put in at the last moment instead, see `Turn`. cflib has no
public place for that: what its driver is given to send, it keeps until the drone has confirmed it.
"""

from __future__ import annotations

import struct
import time
from array import array
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from cflib.crazyflie import Crazyflie
from cflib.crazyflie.localization import Localization
from cflib.crtp.crtpstack import CRTPPacket, CRTPPort

from flatsat_ros.crazyflie.outbox import Outbox
from flatsat_ros.crazyflie.wire import WireSetpoint

# headers of packets that hold nothing or ask for an echo, and the bits in them with which the radio numbers packets
_EMPTY, _ECHO, _LINK_BITS = 0xFF, 0xFC, 0x0C


class CflibSender:
    """Sends packets through cflib: see `crazyflie.outbox.Sender`."""

    def __init__(self, cf: Crazyflie) -> None:
        self._cf = cf

    def _send(self, packet: CRTPPacket) -> None:
        self._cf.send_packet(packet)

    def setpoint(self, setpoint: WireSetpoint) -> None:
        """Send it with the sign of the pitch turned around, as crazyswarm2's cpp back end does."""
        values = setpoint.roll, -setpoint.pitch, setpoint.yaw, int(setpoint.thrust)
        self._send(CRTPPacket(CRTPPort.COMMANDER << 4, struct.pack("<fffH", *values)))

    def external_pose(self, position: tuple[float, ...], quaternion: tuple[float, ...] | None) -> None:
        """Send it with the attitude or, without a quaternion, the position alone."""
        channel, data = Localization.POSITION_CH, struct.pack("<fff", *position)
        if quaternion is not None:
            channel = Localization.GENERIC_CH
            data = struct.pack("<Bfffffff", Localization.EXT_POSE, *position, *quaternion)
        self._send(CRTPPacket(CRTPPort.LOCALIZATION << 4 | channel, data))

    def arming(self, armed: bool) -> None:
        """Send the request."""
        self._cf.supervisor.send_arming_request(armed)

    def emergency_stop(self) -> None:
        """Send the request."""
        self._cf.supervisor.send_emergency_stop()

    def no_more_setpoints(self) -> None:
        """Send the notice."""
        self._cf.commander.send_notify_setpoint_stop()


class _LatePacket:
    """A packet for a dongle that is decided on when the dongle reads it, once."""

    def __init__(self, decide: Callable[[], Sequence[int]]) -> None:
        self._decide = decide
        self._bytes: Sequence[int] | None = None

    def __iter__(self) -> Iterator[int]:
        """Return its bytes."""
        if self._bytes is None:
            self._bytes = self._decide()
        return iter(self._bytes)


class Turn(CflibSender):
    """What one drone is sent when its turn on a dongle has come: the newest set-point, or external pose.

    cflib's radio driver sends one packet after the other, the same until the drone has confirmed it, and an empty one
    if there is nothing to say. What comes again and again takes the place of the empty ones, and of those that measure
    the time to the drone and back. The packets of all drones of a dongle wait for it in one queue: a `_LatePacket` is
    opened at its end.
    """

    def __init__(self, cf: Crazyflie, outbox: Outbox, answered: Callable[[], bool]) -> None:
        """Take the place of what the driver transmits with, from now on.

        Args:
            cf: its link is a radio.
            outbox: what the drone is to be sent.
            answered: whether the drone has answered: before, it gets no set-points.
        """
        super().__init__(cf)
        self._outbox, self._answered = outbox, answered
        self._packet: CRTPPacket | None = None
        self._transmit = cf.link._radio.send_packet
        cf.link._radio.send_packet = self._take_turn
        outbox.pulled = True

    def _send(self, packet: CRTPPacket) -> None:
        self._packet = packet

    def _take_turn(self, data: Sequence[int]) -> Any:
        """Transmit a packet, in a thread of cflib's, and return the acknowledgement, which has the drone's answer."""
        header = data[0] | _LINK_BITS
        # with data behind it, the header of an empty packet asks for this numbering
        spare = header == _ECHO or (header == _EMPTY and len(data) == 1)
        if not (spare and self._answered()):
            return self._transmit(data)
        self._packet = None
        acknowledged = self._transmit(_LatePacket(partial(self._decide, data)))
        if self._packet is not None and (acknowledged is None or not acknowledged.ack):
            self._outbox.lose()
        return acknowledged

    def _decide(self, data: Sequence[int]) -> Sequence[int]:
        """Return what is transmitted in the place of a packet of the driver's; in the thread of the dongle."""
        self._outbox.pull(self, time.monotonic())
        if self._packet is None:
            return data
        numbered = self._packet.get_header() & ~_LINK_BITS | data[0] & _LINK_BITS
        return array("B", [numbered, *self._packet.datal])

"""cflib's radio driver without a radio: what takes the place of its empty packets when a drone's turn has come."""

from __future__ import annotations

import itertools
import random
import struct
import time
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from flatsat_ros.crazyflie.link import Address, PacketQueue, ShutdownSequence
from flatsat_ros.crazyflie.outbox import Outbox, Stream
from flatsat_ros.crazyflie.wire import WireSetpoint

pytest.importorskip("cflib", reason="the bridge is an extra")

from cflib.crtp import radiodriver

from flatsat_ros.nodes import cflib_link

pytestmark = pytest.mark.in_process

PARAMETERS, NULL, ECHO = [0x2C, 3], [0xFF], [0xFC, 1, 2]


def outbox(robot: str = "cf1", queue: PacketQueue[Any, Any] | None = None) -> Outbox:
    return Outbox(robot, queue or PacketQueue(2, period=0.01, gap=0.0), ShutdownSequence(0.0, 0.0))


def setpoint(number: float) -> bytes:
    return struct.pack("<fffH", number, -2.0, 3.0, 4000)


class Dongle:
    """Notes what is transmitted.

    Attributes:
        sent: packets.
        heard: whether the drone confirms them.
    """

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.heard = True

    def send_packet(self, data: Sequence[int]) -> Any:
        self.sent.append(bytes(data))
        return SimpleNamespace(ack=self.heard)


def test_the_newest_set_point_takes_the_place_of_what_says_nothing() -> None:
    dongle, box, answered = Dongle(), outbox(), [False]
    cflib_link._Turn(SimpleNamespace(link=SimpleNamespace(_radio=dongle)), box, lambda: answered[0])
    assert box.pulled

    def turn(data: list[int], number: float = 0.0) -> bytes:
        if number:
            box.command(WireSetpoint(number, 2.0, 3.0, 4000.0), time.monotonic())
        dongle.send_packet(data)
        return dongle.sent[-1]

    assert turn(NULL, 1.0) == bytes(NULL), "not before the drone has answered"
    answered[0] = True
    assert turn(PARAMETERS) == bytes(PARAMETERS)
    assert turn([0xFF, 5, 1]) == bytes([0xFF, 5, 1]), "the request for numbered packets"
    dongle.heard = False
    assert turn([0xF7]) == bytes([0x34]) + setpoint(1.0), "the number of the packet stays"
    assert turn(NULL) == bytes([0x3C]) + setpoint(1.0), "it was lost"
    dongle.heard = True
    assert turn(NULL, 2.0) == bytes([0x3C]) + setpoint(2.0), "lost again, and there is a newer one"
    assert turn(NULL) == bytes(NULL), "each only once"
    box.locate((1.0, 2.0, 3.0), None, time.monotonic())
    assert turn(ECHO) == bytes([0x6C]) + struct.pack("<fff", 1.0, 2.0, 3.0)
    box.locate((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0), time.monotonic() + 0.02)
    time.sleep(0.03)
    assert turn(ECHO) == bytes([0x6D]) + struct.pack("<B7f", 8, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0)
    assert turn(ECHO) == bytes(ECHO)


class SharedDongle:
    """Stands in for cflib's Crazyradio: packets take their time, and drones only confirm them.

    Attributes:
        packets: how many were transmitted, to all drones.
        delivered: of each address, the numbers of the set-points that arrived, and how many packets there were by then.
    """

    version, DR_250KPS, DR_1MPS, DR_2MPS = 0.5, 0, 1, 2
    packets: int
    delivered: dict[int, list[tuple[int, int]]]

    def __init__(self, devid: int = 0) -> None:
        self._random, self._address = random.Random(devid), 0

    def send_packet(self, data: Sequence[int]) -> Any:
        time.sleep(self._random.uniform(0.002, 0.008))
        type(self).packets += 1
        raw = bytes(data)
        if raw[0] & 0xF3 == 0x30:
            entry = round(struct.unpack("<f", raw[1:5])[0]), self.packets
            self.delivered.setdefault(self._address, []).append(entry)
        return SimpleNamespace(ack=True, data=b"\xfc\0", retry=0, powerDet=False)

    def set_address(self, address: Sequence[int]) -> None:
        self._address = int(address[-1])

    def set_channel(self, _: int) -> None: ...
    def set_data_rate(self, _: int) -> None: ...
    def set_arc(self, _: int) -> None: ...
    def close(self) -> None: ...


def test_set_points_do_not_wait_for_more_than_their_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(radiodriver, "Crazyradio", SharedDongle)
    monkeypatch.setattr(radiodriver.RadioManager, "_radios", [])
    SharedDongle.packets, SharedDongle.delivered = 0, {}
    cflib_link.initialise()
    drones, issued = range(1, 5), {}
    queue: PacketQueue[tuple[str, Stream], Any] = PacketQueue(len(drones), period=0.01, gap=0.001)
    links = [
        cflib_link.Link(
            f"cf{number}",
            Address.parse(f"radio://0/80/2M/E7E7E7E7{number:02X}"),
            outbox(f"cf{number}", queue),
            cflib_link.Settings(0, 60.0, None),
            *3 * [lambda *_: None],
        )
        for number in drones
    ]
    for link in links:
        link.start()
    for number in itertools.count(1):
        issued[number] = SharedDongle.packets
        for link in links:
            link.command(WireSetpoint(float(number), 0.0, 0.0, 0.0))
        time.sleep(0.01)
        if min(len(SharedDongle.delivered.get(address, ())) for address in drones) >= 20:
            break
        assert number < 3000
    for link in links:
        link.stop_motors()
        link.leave()
    # one round until its turn, one in the dongle's queue, and one if the turn was needed for something else
    for entries in SharedDongle.delivered.values():
        assert max(packets - issued[number] for number, packets in entries) <= 3 * len(drones) + 1
        assert [number for number, _ in entries] == sorted(number for number, _ in entries)
    for link in links:
        link._thread.join(5.0)
        assert not link.alive

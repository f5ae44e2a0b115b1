"""cflib's radio driver without a radio: what takes the place of its empty packets when a drone's turn has come."""

from __future__ import annotations

import itertools
import math
import os
import random
import struct
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from crtp_endpoint import Endpoint
from rclpy.node import Node

from flatsat_ros.crazyflie.link import QUALITY, Address, PacketQueue, ShutdownSequence
from flatsat_ros.crazyflie.outbox import Outbox, Stream
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.sim.fleet import SimulatedFleet

pytest.importorskip("cflib", reason="the bridge is an extra")

from cflib.crtp import radiodriver
from usb._interop import as_array

from flatsat_ros.nodes import cflib_link, cflib_sender
from flatsat_ros.nodes.cflib_bridge import CflibBridge

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


def test_the_endpoint_of_these_tests_outlives_drones_that_are_switched_off() -> None:
    drones = Endpoint(SimulatedFleet(load_vehicle("cf21"), 1))
    for _ in range(2000):
        drones.switch_on()
        drones.switch_off(0)
    drones.close()


def test_the_newest_set_point_takes_the_place_of_what_says_nothing() -> None:
    dongle, box, answered = Dongle(), outbox(), [False]
    cflib_sender.Turn(SimpleNamespace(link=SimpleNamespace(_radio=dongle)), box, lambda: answered[0])
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


def test_cflibs_own_dongle_opens_a_late_packet_as_it_writes_it() -> None:
    """In the place of the USB device is what pyusb does first with what it shall write."""
    opened: list[str] = []
    written: list[bytes] = []
    dongle = object.__new__(radiodriver.Crazyradio)
    dongle.devid, dongle.current_address, dongle.current_channel = 0, None, 2
    dongle.handle = SimpleNamespace(
        write=lambda endpoint, data, timeout: written.append(bytes(as_array(data))), read=lambda *_, **__: [1]
    )
    packet = cflib_sender._LatePacket(lambda: opened.append("once") or [0x30, 1, 2])
    assert opened == []
    assert dongle.send_packet(packet).ack
    assert (written, list(packet), opened) == ([bytes([0x30, 1, 2])], [0x30, 1, 2], ["once"])


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
        raw = bytes(data)
        time.sleep(self._random.uniform(0.002, 0.008))
        type(self).packets += 1
        if raw[0] & 0xF3 == 0x30:
            entry = round(struct.unpack("<f", raw[1:5])[0]), self.packets
            self.delivered.setdefault(self._address, []).append(entry)
        answer = raw if raw == b"\xff\5\1" else b"\xfc\0"  # it numbers packets
        return SimpleNamespace(ack=True, data=answer, retry=0, powerDet=False)

    def set_address(self, address: Sequence[int]) -> None:
        self._address = int(address[-1])

    def set_channel(self, _: int) -> None: ...
    def set_data_rate(self, _: int) -> None: ...
    def set_arc(self, _: int) -> None: ...
    def close(self) -> None: ...


def test_a_transmission_carries_the_newest_set_point_of_when_it_begins(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(radiodriver, "Crazyradio", SharedDongle)
    monkeypatch.setattr(radiodriver.RadioManager, "_radios", [])
    SharedDongle.packets, SharedDongle.delivered = 0, {}
    cflib_link.initialise()
    drones, issued, opened = range(1, 5), {}, []
    open_link = cflib_link._Crazyflie.open_link
    monkeypatch.setattr(
        cflib_link._Crazyflie, "open_link", lambda cf, uri: (open_link(cf, uri), opened.append(cf.link))
    )
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
        for link in links:
            link.command(WireSetpoint(float(number), 0.0, 0.0, 0.0))
        issued[number] = SharedDongle.packets
        time.sleep(0.01)
        if min(len(SharedDongle.delivered.get(address, ())) for address in drones) >= 20:
            break
        assert number < 3000
    for link in links:
        link.stop_motors()
        link.leave()
    for entries in SharedDongle.delivered.values():
        # packet p begins when p - 1 are through: by then no newer set-point had been given
        assert all(issued.get(number + 1, math.inf) >= packets - 1 for number, packets in entries)
        assert [number for number, _ in entries] == sorted(number for number, _ in entries)
    # the driver repeats requests until they are confirmed: others would take the turns of set-points
    assert not any(driver.needs_resending for driver in opened)
    for link in links:
        link._thread.join(5.0)
        assert not link.alive


def test_what_a_drone_stops_to_report_is_asked_for_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(cflib_link, "DEAD_STREAM", 0.3)
    endpoint = Endpoint(SimulatedFleet(load_vehicle("cf21"), 1))
    endpoint.switch_on()
    cflib_link.initialise()
    poses: list[Any] = []
    lines: list[str] = []
    link = cflib_link.Link(
        "cf1",
        Address.parse(endpoint.uris[0]),
        outbox(),
        cflib_link.Settings(10, 10.0, str(tmp_path)),
        lambda *pose: poses.append(pose),
        lambda _: None,
        lines.append,
    )

    def wait_for(condition: Callable[[], bool]) -> None:
        end = time.monotonic() + 20.0
        while not condition():
            assert time.monotonic() < end
            time.sleep(0.01)

    try:
        link.start()
        wait_for(lambda: len(poses) > 3)
        with endpoint.lock:
            endpoint.drones[0].blocks.clear()
        poses.clear()
        wait_for(lambda: any("stateEstimate.x" in line and "asked for again" in line for line in lines))
        wait_for(lambda: len(poses) > 3)
        assert link.connections == 1
    finally:
        link.leave()
        link._thread.join(5.0)
        endpoint.close()


@pytest.fixture
def bridge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[CflibBridge]:
    """A bridge that publishes the pose of one drone, to which it is not connected."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(cflib_link.Link, "start", lambda _: None)
    # no other bridge of this machine, of another worker or run, has claimed it
    uri = f"udp://127.0.0.1:{1024 + os.getpid() * 7919 % 64000}"
    rclpy.init(args=["--ros-args", "-p", "pose_rate:=100.0", "-p", f"uris:=['{uri}']"])
    node = CflibBridge()
    yield node
    for claim in node._claims:
        claim.close()
    Node.destroy_node(node)
    rclpy.try_shutdown()


LEVEL = (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("tell", "reason"),
    [
        (lambda link: link._on_pose((1e30, 0.0, 0.0), LEVEL), "position"),
        (lambda link: link._on_pose((math.nan, 0.0, 0.0), LEVEL), "position"),
        (lambda link: link._on_pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)), "length of the quaternion"),
        (lambda link: link._on_pose((0.0, 0.0, 0.0), (math.inf, 0.0, 0.0, 0.0)), "length of the quaternion"),
        (lambda link: link._on_battery(math.nan), "battery"),
        (lambda link: link._on_battery(-1e9), "battery"),
    ],
)
def test_what_no_drone_can_tell_is_not_published(bridge: CflibBridge, tell: Callable[[Any], None], reason: str) -> None:
    (link,) = bridge.links
    published: list[Any] = []
    for publisher in bridge.publishers:
        publisher.publish = published.append
    link._on_pose((1.0, 2.0, 3.0), LEVEL)
    link._on_battery(3.9)
    assert len(published) == 2
    tell(link)
    assert len(published) == 2
    assert bridge.faults.count("cf1") == 1
    assert reason in bridge.faults.newest("cf1")


def test_of_a_poor_link_is_told_and_a_bad_one_lands_the_drone(
    bridge: CflibBridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    (link,), now, asked = bridge.links, [0.0], []
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    (landing,) = bridge._watch._landings
    monkeypatch.setattr(landing, "service_is_ready", lambda: True)
    monkeypatch.setattr(landing, "call_async", lambda request: asked.append(request) or SimpleNamespace(
        add_done_callback=lambda _: None
    ))  # fmt: skip
    link.connected = True

    def look(quality: float, seconds: float) -> str:
        link.values[QUALITY] = quality
        for _ in range(round(seconds / 0.2)):
            now[0] += 0.2
            link.command(WireSetpoint(0.0, 0.0, 0.0, 40000.0))
            link.outbox.send(SimpleNamespace(setpoint=lambda _: None), now[0])
            bridge._watch._look()
        return bridge._watch._report(0)[0].text

    assert look(100.0, 5.0) == "not connected", "the condition of a link that is told of no poor quality"
    assert look(85.0, 2.0) == "not connected", "a short loss is no poor link"
    assert look(85.0, 2.0) == "link poor"
    assert asked == []
    assert look(75.0, 4.0) == "link bad"
    assert len(asked) == 1
    assert look(75.0, 4.0) == look(85.0, 4.0) == "link bad"
    assert len(asked) == 1
    assert look(95.0, 4.0) == "not connected"
    assert look(75.0, 4.0) == "link bad"
    assert len(asked) == 2

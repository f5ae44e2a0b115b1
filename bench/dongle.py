"""How old set-points are when they reach the drones of one dongle: our link over cflib's radio driver, without a radio.

In the place of cflib's Crazyradio stands one in which every packet takes 2 to 20 ms and some get lost, or their
acknowledgement does; behind it are the simulated drones of the tests, over UDP. A round is the time between two turns
of a drone; ages of set-points on arrival are printed over the longest round and over the mean one. Other load of the
machine spoils them.

    .venv/bin/python bench/dongle.py [DRONES] [LOSS]    for example 8 0.3; without, 1 to 8 drones with 0 and 0.3
"""

from __future__ import annotations

import os
import random
import socket
import struct
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "test" / "support"))

from cflib.crtp import radiodriver
from crtp_endpoint import Endpoint

from flatsat_ros.crazyflie.link import Address, PacketQueue, ShutdownSequence
from flatsat_ros.crazyflie.outbox import Outbox
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.nodes import cflib_link
from flatsat_ros.sim.fleet import SimulatedFleet

TICK = 0.02  # s between two set-points
SECONDS = 6.0  # s that are measured


class Radio:
    """A drone's end of the link: it numbers packets, so that none is lost or taken twice (esb.c of crazyflie2-nrf).

    Two bits of a header tell whether the packet is another than the last one, and whether the last answer arrived.
    """

    def __init__(self, port: int) -> None:
        """Speak for the drone behind a UDP port."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port))
        self._socket.setblocking(False)
        self._up = self._down = 1
        self._answer = b""

    def hear(self, raw: bytes) -> bytes:
        """Take a packet, and return the answer that goes with its acknowledgement."""
        if raw == b"\xff\x05\x01":  # number packets from now on
            self._up = self._down = 1
            return raw
        up, down = raw[0] >> 3 & 1, raw[0] >> 2 & 1
        if up != self._up:
            self._up = up
            if len(raw) > 1:
                self._socket.send(raw)
        if down != self._down:
            self._down = down
            try:
                self._answer = self._socket.recv(64)
            except (BlockingIOError, ConnectionError):
                self._answer = b"\xf3"
        return bytes([self._answer[0] & 0xF3 | self._up << 3 | self._down << 2]) + self._answer[1:]


class Dongle:
    """Stands in for cflib's Crazyradio.

    Attributes:
        ports: UDP port of each drone, by the last byte of its address.
        loss: probability that a packet or its acknowledgement gets lost.
        turns: of each drone, times of its packets, s.
        arrivals: (drone, number of the set-point, time s).
    """

    version, DR_250KPS, DR_1MPS, DR_2MPS = 0.5, 0, 1, 2
    ports: dict[int, int]
    turns: dict[int, list[float]]
    arrivals: list[tuple[int, int, float]]
    loss = 0.0

    def __init__(self, devid: int = 0) -> None:
        self._random, self._drone = random.Random(devid), 0
        self._radios: dict[int, Radio] = {}

    def send_packet(self, data: Sequence[int]) -> Any:
        """Take the time of a packet, hand it over unless it gets lost, and return what the drone has said meanwhile."""
        raw = bytes(data)
        time.sleep(self._random.uniform(0.002, 0.02))
        self.turns.setdefault(self._drone, []).append(time.monotonic())
        lost = self._random.random() < self.loss
        answer = b""
        if not lost or self._random.random() < 0.5:
            answer = self._radios.setdefault(self._drone, Radio(self.ports[self._drone])).hear(raw)
            if raw[0] & 0xF3 == 0x30:
                number = round(struct.unpack("<f", raw[1:5])[0])
                self.arrivals.append((self._drone, number, time.monotonic()))
        return SimpleNamespace(ack=not lost, data=b"" if lost else answer, retry=3 * lost, powerDet=False)

    def set_address(self, address: Sequence[int]) -> None:
        """Choose the drone of the next packet."""
        self._drone = int(address[-1])

    def set_channel(self, _: int) -> None:
        """All are on one."""

    set_data_rate = set_arc = set_channel

    def close(self) -> None:
        """Nothing is open."""


def measure(drones: int, loss: float) -> None:
    """Print how old the set-points of so many drones are."""
    Dongle.loss, Dongle.turns, Dongle.arrivals = loss, {}, []
    endpoint = Endpoint(
        SimulatedFleet(load_vehicle("cf21"), drones, start=[(float(i), 0.0, 0.0) for i in range(drones)])
    )
    endpoint.switch_on()
    Dongle.ports = {number + 1: drone.port for number, drone in enumerate(endpoint.drones)}
    queue: PacketQueue[Any, Any] = PacketQueue(drones, period=0.01, gap=0.001)
    links = [
        cflib_link.Link(
            f"cf{number}",
            Address.parse(f"radio://{drones}/80/2M/E7E7E7E7{number:02X}"),
            Outbox(f"cf{number}", queue, ShutdownSequence(0.0, 0.0)),
            cflib_link.Settings(0, 60.0, None),
            *3 * [lambda *_: None],
        )
        for number in range(1, drones + 1)
    ]
    for link in links:
        link.start()
    started = time.monotonic()
    while not all(link._streams for link in links):  # tables of contents take turns that set-points do not get then
        time.sleep(0.1)
    print(f"tables of {drones} drones: {time.monotonic() - started:.0f} s; ", end="", flush=True)
    begin, issued = time.monotonic(), {}
    for number in range(1, round(SECONDS / TICK)):
        for drone, link in enumerate(links, start=1):
            issued[drone, number] = time.monotonic()
            link.command(WireSetpoint(float(number), 0.0, 0.0, 0.0))
        time.sleep(max(begin + number * TICK - time.monotonic(), 0.0))
    first: dict[tuple[int, int], float] = {}
    for drone, number, at in list(Dongle.arrivals):
        first.setdefault((drone, number), at)
    ages = np.array([at - issued[key] for key, at in first.items()])
    rounds = np.concatenate([np.diff([at for at in turns if at > begin]) for turns in list(Dongle.turns.values())])
    each = [sum(key[0] == drone for key in first) for drone in range(1, drones + 1)]
    print(
        f"{drones} drones, {100 * loss:.0f} % lost: round {1e3 * rounds.mean():.0f} ms, longest "
        f"{1e3 * rounds.max():.0f} ms; age at most {1e3 * ages.max():.0f} ms, {ages.max() / rounds.max():.2f} of the "
        f"longest and {ages.max() / rounds.mean():.2f} of the mean round, median {np.median(ages) / rounds.mean():.2f} "
        f"of that; {min(each)} to {max(each)} set-points",
        flush=True,
    )


def main() -> None:
    """Measure what the command line asks for."""
    os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp()
    radiodriver.Crazyradio = Dongle
    cflib_link.initialise()
    given = sys.argv[1:]
    for loss in [float(given[1])] if len(given) > 1 else [0.0, 0.3]:
        for drones in [int(given[0])] if given else [1, 2, 4, 8]:
            measure(drones, loss)
    os._exit(0)  # the links go on


if __name__ == "__main__":
    main()

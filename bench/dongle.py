"""How old set-points are when they reach the drones of one dongle: our link over cflib's radio driver, without a radio.

In the place of cflib's Crazyradio stands one in which every packet takes 2 to 20 ms and some get lost, or their
acknowledgement does; behind it are the simulated drones of the tests, over UDP. Ages are printed over the longest time
between two turns of a drone, the round, and their median over the mean one. Other load of the machine spoils them.

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

import contextlib

from cflib.crtp import radiodriver
from crtp_endpoint import Endpoint

from flatsat_ros.crazyflie.link import Address, PacketQueue, ShutdownSequence
from flatsat_ros.crazyflie.outbox import Outbox
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.nodes import cflib_link
from flatsat_ros.sim.fleet import SimulatedFleet

TICK = 0.02  # s between two set-points
TABLES = 2.0  # s for each drone's tables of contents
SECONDS = 6.0  # s that are measured


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
        self._sockets: dict[int, socket.socket] = {}

    def send_packet(self, data: Sequence[int]) -> Any:
        """Take the time of a packet, hand it over unless it gets lost, and return what the drone has said meanwhile."""
        time.sleep(self._random.uniform(0.002, 0.02))
        raw = bytes(data)
        self.turns.setdefault(self._drone, []).append(time.monotonic())
        lost = self._random.random() < self.loss
        answer = b""
        if not lost or self._random.random() < 0.5:
            if raw[0] & 0xF3 == 0x30:
                number = round(struct.unpack("<f", raw[1:5])[0])
                self.arrivals.append((self._drone, number, time.monotonic()))
            link = self._link()
            if len(raw) > 1:
                link.send(raw)
            with contextlib.suppress(BlockingIOError, ConnectionError):
                answer = b"" if lost else link.recv(64)
        return SimpleNamespace(ack=not lost, data=answer, retry=3 * lost, powerDet=False)

    def _link(self) -> socket.socket:
        if self._drone not in self._sockets:
            made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            made.connect(("127.0.0.1", self.ports[self._drone]))
            made.setblocking(False)
            self._sockets[self._drone] = made
        return self._sockets[self._drone]

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
    time.sleep(TABLES * (1 + drones))
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
        f"{1e3 * rounds.max():.0f} ms; age over it at most {ages.max() / rounds.max():.2f}, median over the mean round "
        f"{np.median(ages) / rounds.mean():.2f}; {min(each)} to {max(each)} set-points",
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

"""Crazyflies that answer over UDP: what cflib asks and sends, one CRTP packet per datagram, in front of `sim.fleet`.

The packets are those of crazyflie-firmware's src/modules/src/{crtp_*,log,param,mem}.c as cflib 0.1.34 speaks to them.
Written from the firmware's side and without cflib, so that a misunderstanding of cflib's shows.
"""

from __future__ import annotations

import binascii
import random
import select
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from crtp_commands import Commands

from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.log_variables import VARIABLES
from flatsat_ros.sim.state_machine import State

PROTOCOL = 12
_PATIENCE = 0.002  # s
_CATCH_UP = 0.25  # s, as in sim_drone
_PIECE = 30  # bytes of a packet
# types of log variables, log.h
_UINT8, _UINT16, _INT8, _INT16, _FLOAT, _FP16 = 1, 2, 4, 5, 7, 8
_FORMAT = {_UINT8: "<B", _UINT16: "<H", _INT8: "<b", _INT16: "<h", _FLOAT: "<f", _FP16: "<e"}
_KINDS = {"supervisor.info": _UINT16, "pm.vbatMV": _UINT16, "pm.state": _INT8, "radio.rssi": _UINT8}
_CREATE, _START, _STOP, _RESET = 6, 3, 4, 5
_RSSI = 40  # -dBm
# types of parameters, param.h
_BYTE, _REAL = 0x08, 0x06
_VALUE = {_BYTE: "<B", _REAL: "<f"}

Table = Sequence[tuple[str, int]]
# what our own bridge asks for, and two parameters: longer tables take longer to connect
BRIEF_LOG: Table = (
    *((f"stateEstimate.{name}", _FLOAT) for name in ("x", "y", "z", "qx", "qy", "qz", "qw")),
    ("pm.vbat", _FLOAT),
    ("supervisor.info", _UINT16),
)
BRIEF_PARAMETERS: Table = (("stabilizer.controller", _BYTE), ("flightmode.stabModeYaw", _BYTE))
# of the tables of a real drone what the simulated one has
LOG: Table = tuple(
    (name, _INT16 if name.startswith("stateEstimateZ.") else _KINDS.get(name, _FLOAT))
    for name in (*VARIABLES, "radio.rssi")
)
PARAMETERS: Table = (
    *BRIEF_PARAMETERS,
    *((name, _BYTE) for name in ("stabilizer.estimator", "commander.enHighLevel", "hlCommander.groupmask")),
    *((name, _BYTE) for name in ("led.bitmask", "ring.effect", "usd.logging")),
    *((name, _REAL) for name in ("locSrv.extPosStdDev", "locSrv.extQuatStdDev", "hlCommander.vtoff")),
)


class Received(NamedTuple):
    """One packet from the ground."""

    time: float  # s, monotonic
    header: int
    data: bytes

    @property
    def port(self) -> tuple[int, int]:
        """Port and channel; the two bits between them mean nothing."""
        return self.header >> 4, self.header & 3


@dataclass
class Block:
    """One block of log variables."""

    variables: list[tuple[int, int]]  # index in the table, type to send
    period: float = 0.0  # s; 0: stopped
    due: float = 0.0


@dataclass
class Drone:
    """One radio address.

    Attributes:
        port: UDP port.
        received: what came, the newest last.
        deaf: neither hears nor answers, as one that is out of range.
        delay: s, of every answer.
        loss: probability that a packet of either direction vanishes.
        parameters: values of those that were set; the others are 1.
    """

    port: int
    socket: socket.socket | None = None
    peer: tuple[str, int] | None = None
    blocks: dict[int, Block] = field(default_factory=dict)
    received: deque[Received] = field(default_factory=lambda: deque(maxlen=100_000))
    answers: deque[tuple[float, bytes]] = field(default_factory=deque)
    deaf: bool = False
    delay: float = 0.0
    loss: float = 0.0
    parameters: dict[str, float] = field(default_factory=dict)

    def of(self, port: int, channel: int) -> list[Received]:
        """What came on a port and channel."""
        return [packet for packet in list(self.received) if packet.port == (port, channel)]

    @property
    def uri(self) -> str:
        """Where cflib finds it."""
        return f"udp://127.0.0.1:{self.port}"


class Endpoint:
    """A fleet in real time behind UDP ports of this machine.

    Attributes:
        fleet: change it only under `lock`.
        drones: their links, switched off at first.
    """

    def __init__(
        self, fleet: SimulatedFleet, seed: int = 0, log: Table = BRIEF_LOG, parameters: Table = BRIEF_PARAMETERS
    ) -> None:
        self.fleet = fleet
        self.lock = threading.Lock()
        self.drones = [Drone(_free_port()) for _ in range(fleet.count)]
        self._log_table, self._parameters = log, parameters
        self._commands = [Commands(fleet, index) for index in range(fleet.count)]
        self._random = random.Random(seed)
        # a socket that is closed leaves it by itself, even while the thread waits
        self._arrivals = select.epoll()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="endpoint", daemon=True)
        self._thread.start()

    @property
    def uris(self) -> list[str]:
        """All of them."""
        return [drone.uri for drone in self.drones]

    def switch_on(self, *indices: int) -> None:
        """Boot drones, all by default: until then nobody listens at their ports."""
        with self.lock:
            for index in indices or range(len(self.drones)):
                drone = self.drones[index]
                drone.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                drone.socket.setblocking(False)
                drone.socket.bind(("127.0.0.1", drone.port))
                self._arrivals.register(drone.socket, select.EPOLLIN)
                drone.peer, drone.blocks, drone.parameters = None, {}, {}
                self._commands[index] = Commands(self.fleet, index)
                self.fleet.reboot(index)

    def switch_off(self, index: int) -> None:
        """Close a drone's port: packets to it are refused."""
        with self.lock:
            open_socket, self.drones[index].socket = self.drones[index].socket, None
            if open_socket:
                open_socket.close()

    def print(self, index: int, text: str) -> None:
        """Have a drone print, in pieces as the firmware does."""
        with self.lock:
            raw = text.encode()
            for start in range(0, len(raw), _PIECE):
                self._answer(self.drones[index], 0, 0, raw[start : start + _PIECE])

    def close(self) -> None:
        """Switch all off."""
        assert self._thread.is_alive(), "the endpoint broke down: see the exception of its thread"
        self._closing.set()
        self._thread.join()
        for index in range(len(self.drones)):
            self.switch_off(index)
        self._arrivals.close()

    def _run(self) -> None:
        seen, room = time.monotonic(), 0.0
        while not self._closing.is_set():
            self._arrivals.poll(_PATIENCE)
            now = time.monotonic()
            with self.lock:
                room += min(now - seen, _CATCH_UP)
                seen = now
                self.fleet.advance_to(room)
                for index, drone in enumerate(self.drones):
                    self._hear(index, drone, now)
                    self._log(index, drone, now)
                    self._send(drone, now)

    def _hear(self, index: int, drone: Drone, now: float) -> None:
        while drone.socket:
            try:
                data, peer = drone.socket.recvfrom(64)
            except BlockingIOError:
                return
            except ConnectionError:  # the ground closed its port
                drone.peer = None
                continue
            if drone.deaf or self._random.random() < drone.loss:
                continue
            drone.peer = peer
            packet = Received(now, data[0], data[1:])
            drone.received.append(packet)
            handle = self._handlers().get(packet.port)
            for answer in handle(index, packet.data) if handle else ():
                self._answer(drone, *packet.port, answer)

    def _handlers(self) -> dict[tuple[int, int], Callable[[int, bytes], Iterator[bytes]]]:
        """By port and channel, what answers."""
        return {
            (15, 1): lambda _, data: iter([b"Bitcraze Crazyflie\0"]),
            (15, 0): lambda _, data: iter([data]),
            (13, 1): lambda _, data: iter([bytes([0, PROTOCOL])]),
            (5, 0): lambda _, data: _table(data, self._log_table, extra=b"\x10\x80"),
            (2, 0): lambda _, data: _table(data, self._parameters),
            (2, 1): self._on_parameter_read,
            (2, 2): self._on_parameter_write,
            (2, 3): self._on_parameter_by_name,
            (4, 0): lambda index, data: iter([self._commands[index].on_memory_question(data)]),
            (4, 2): lambda index, data: iter([self._commands[index].on_write(data)]),
            (5, 1): self._on_log_command,
            (3, 0): self._on_setpoint,
            (7, 0): self._on_generic_setpoint,
            (7, 1): self._on_notify,
            (8, 0): lambda index, data: iter([self._commands[index].on_high_level(data)]),
            (9, 1): self._on_supervisor,
        }

    def _on_log_command(self, index: int, data: bytes) -> Iterator[bytes]:
        blocks, command = self.drones[index].blocks, data[0]
        block = data[1] if len(data) > 1 else 0
        if command == _RESET:
            blocks.clear()
        elif command == _CREATE:
            entries = [struct.unpack_from("<BH", data, at) for at in range(2, len(data), 3)]
            blocks[block] = Block([(number, kind & 0x0F) for kind, number in entries])
        elif command == _START:
            blocks[block].period = data[2] / 100.0
        elif command == _STOP:
            blocks[block].period = 0.0
        yield bytes([command, block, 0])

    def _on_parameter_read(self, index: int, data: bytes) -> Iterator[bytes]:
        name, kind = self._parameters[struct.unpack_from("<H", data)[0]]
        yield data[:2] + b"\0" + struct.pack(_VALUE[kind], self.drones[index].parameters.get(name, 1))

    def _on_parameter_write(self, index: int, data: bytes) -> Iterator[bytes]:
        name, kind = self._parameters[struct.unpack_from("<H", data)[0]]
        self._set(index, name, *struct.unpack_from(_VALUE[kind], data, 2))
        yield data

    def _on_parameter_by_name(self, index: int, data: bytes) -> Iterator[bytes]:
        group, name, rest = data[1:].split(b"\0", 2)
        self._set(index, f"{group.decode()}.{name.decode()}", *struct.unpack_from(_VALUE[rest[0]], rest, 1))
        yield data[: -len(rest)] + b"\0"

    def _set(self, index: int, name: str, value: float) -> None:
        self.drones[index].parameters[name] = value
        if name == "hlCommander.groupmask":
            self.fleet.firmware.high_level.group_mask[index] = int(value)

    def _on_setpoint(self, index: int, data: bytes) -> Iterator[bytes]:
        roll, pitch, yaw, thrust = struct.unpack_from("<fffH", data)
        # the packet's pitch is the negative of ours
        self.fleet.command(index, roll, -pitch, yaw, thrust)
        return iter(())

    def _on_generic_setpoint(self, index: int, data: bytes) -> Iterator[bytes]:
        self._commands[index].on_setpoint(data)
        return iter(())

    def _on_notify(self, index: int, data: bytes) -> Iterator[bytes]:
        if data[0] == 0:
            self.fleet.firmware.notify_setpoints_stop(index)
        return iter(())

    def _on_supervisor(self, index: int, data: bytes) -> Iterator[bytes]:
        firmware = self.fleet.firmware
        if data[0] == 1:
            accepted = firmware.request_arming(index, bool(data[1]))
            yield bytes([0x81, accepted, int(firmware.armed[index])])
        elif data[0] == 3:
            firmware.request_emergency(index)

    def _log(self, index: int, drone: Drone, now: float) -> None:
        """Send what the drone logs; its estimate is the truth."""
        for number, block in drone.blocks.items():
            if block.period and now >= block.due:
                block.due = max(block.due + block.period, now)
                data = b"".join(self._value(index, variable, kind) for variable, kind in block.variables)
                stamp = round(self.fleet.time * 1000) & 0xFFFFFF
                self._answer(drone, 5, 2, bytes([number]) + stamp.to_bytes(3, "little") + data)

    def _value(self, index: int, variable: int, kind: int) -> bytes:
        name, _ = self._log_table[variable]
        value = VARIABLES[name](self.fleet, index) if name in VARIABLES else _RSSI
        return struct.pack(_FORMAT[kind], value if kind in (_FLOAT, _FP16) else int(value))

    def _answer(self, drone: Drone, port: int, channel: int, data: bytes) -> None:
        drone.answers.append((time.monotonic() + drone.delay, bytes([port << 4 | 3 << 2 | channel]) + data))

    def _send(self, drone: Drone, now: float) -> None:
        while drone.answers and drone.answers[0][0] <= now:
            _, data = drone.answers.popleft()
            lost = drone.deaf or self._random.random() < drone.loss
            if drone.socket and drone.peer and not lost:
                drone.socket.sendto(data, drone.peer)


def _table(data: bytes, entries: Sequence[tuple[str, int]], extra: bytes = b"") -> Iterator[bytes]:
    """Answer about a table of contents, whose checksum changes with its content."""
    if data[0] == 3:
        checksum = binascii.crc32(repr(entries).encode())
        yield bytes([3]) + struct.pack("<HI", len(entries), checksum) + extra
    elif data[0] == 2:
        (number,) = struct.unpack_from("<H", data, 1)
        name, kind = entries[number]
        yield data[:3] + bytes([kind]) + name.replace(".", "\0").encode() + b"\0"


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def heights(endpoint: Endpoint) -> np.ndarray:
    """Heights of all drones, m."""
    with endpoint.lock:
        return np.array(endpoint.fleet.bodies.position[:, 2])


def state(endpoint: Endpoint, index: int = 0) -> State:
    """State of a drone's firmware."""
    return State(endpoint.fleet.firmware.state[index])


def setpoints(endpoint: Endpoint, index: int = 0) -> list[tuple[float, ...]]:
    """The set-points a drone received: roll, pitch, yaw, thrust as in the packet."""
    return [struct.unpack("<fffH", packet.data) for packet in endpoint.drones[index].of(3, 0)]

"""One drone's connection through cflib: a thread that opens it, feeds it, notices that it is gone and opens it again.

cflib is GPL: this module is loaded by the executable cflib_bridge only.

Nothing of the drone's is asked before a set-point may fly: from its first answer on it gets the newest set-point, each
message once. So silence of the controller is silence on the radio, and the firmware's watchdogs keep their meaning.
"""

from __future__ import annotations

import logging
import math
import threading
import time
import warnings
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial

import cflib.crtp
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig

from flatsat_ros.crazyflie.link import REST, Address, Farewell, Lane
from flatsat_ros.crazyflie.wire import WireSetpoint

# what sends one packet
Packet = Callable[[Crazyflie], None]

_RETRY = 1.0  # s between two attempts to reach a drone that does not answer
_LOOK = 0.02  # s between two looks at the link while there is nothing to send
_STATUS_PERIOD = 500  # ms, of battery and supervisor
_EMERGENCY_PERIOD = 0.1  # s
_EMERGENCY_LAST_WORDS = 0.5  # s that an emergency stop is repeated when the bridge ends
_NOTIFICATIONS = 5  # of the end of the set-points, since one packet may be lost
_CONSOLE_LINES = 5
_FIRMWARE_PATIENCE = 2.0  # s without a set-point after which the firmware stops the motors
_CFLIB_PREFIX = "Couldn't load link driver: "

POSITION = ("stateEstimate.x", "stateEstimate.y", "stateEstimate.z")
# as half floats, so that one packet holds the pose
QUATERNION = ("stateEstimate.qx", "stateEstimate.qy", "stateEstimate.qz", "stateEstimate.qw")
VOLTAGE, SUPERVISOR = "pm.vbat", "supervisor.info"


class Stream(Enum):
    """What one drone is sent."""

    SETPOINT = "set-points sent"
    EXTERNAL_POSE = "external poses sent"


@dataclass(frozen=True)
class Settings:
    """What all links have in common.

    Attributes:
        pose_period: ms, a multiple of 10, of the on-board estimate; 0 does not ask for it.
        timeout: s without any packet after which a connection counts as lost.
        cache: folder for the tables of contents that drones send, without which connecting takes seconds; None: none.
    """

    pose_period: int
    timeout: float
    cache: str | None


class _Crazyflie(Crazyflie):  # type: ignore[misc]
    """cflib's Crazyflie that only notes the errors of its link.

    cflib closes the link right where the error is noticed. If that is within send_packet, it waits for its own ping
    thread while it holds the lock that the ping thread waits for.
    """

    error = ""
    heard = -math.inf  # monotonic s

    def hear(self, _packet: object) -> None:
        """Remember when the drone was heard last."""
        self.heard = time.monotonic()

    def note(self, text: str) -> None:
        """Take the first error for the reason."""
        self.error = self.error or text

    _link_error_cb = note


class Link:
    """One drone.

    Attributes:
        robot, address: who.
        condition: a few words about the connection, or why there is none.
        connected: whether the drone answers.
        values: by name, what the drone last told.
        counts: packets sent by stream, connections.
        console: the last lines the drone printed.
    """

    def __init__(
        self,
        robot: str,
        address: Address,
        lane: Lane[tuple[str, Stream], Packet],
        settings: Settings,
        farewell: Farewell,
        on_pose: Callable[[tuple[float, ...], tuple[float, ...]], None],
        on_battery: Callable[[float], None],
        on_line: Callable[[str], None],
    ) -> None:
        """Prepare; `start` connects.

        Args:
            robot: its name.
            address: where it is.
            lane: shared by the links of one dongle.
            settings: common to all.
            farewell: how the drone is left if it was flown.
            on_pose: called with position, m, and quaternion, x, y, z, w, in a thread of cflib's.
            on_battery: called with the voltage, V, likewise.
            on_line: called with each line of the console, likewise.
        """
        self.robot, self.address = robot, address
        self.condition, self.connected = "not connected", False
        self.values: dict[str, float] = {}
        self.counts: Counter[str] = Counter()
        self.console: deque[str] = deque(maxlen=_CONSOLE_LINES)
        self._settings, self._on_pose, self._on_battery, self._on_line = settings, on_pose, on_battery, on_line
        self._lane = lane
        self._streams = [(robot, stream) for stream in Stream]
        self._wake = threading.Event()
        self._leaving = threading.Event()
        self._emergency = threading.Event()
        self._urgent: deque[Packet] = deque()
        self._newest = REST
        self._last_sent = -math.inf  # when a set-point was sent last, monotonic s
        self._planned_farewell = farewell
        self._farewell: Farewell | None = None
        self._farewell_began: float | None = None
        self._next_emergency = 0.0
        self._line = ""
        self._heard = 0.0
        self._thread = threading.Thread(target=self._run, name=f"link of {robot}", daemon=True)

    @property
    def overtaken(self) -> int:
        """How many set-points were replaced by newer ones or thrown away as too old."""
        return self._lane.overtaken[self.robot, Stream.SETPOINT]

    @property
    def silence(self) -> float:
        """Return the time since the drone's last packet, s."""
        return time.monotonic() - self._heard

    def start(self) -> None:
        """Connect, and stay connected."""
        self._thread.start()

    def command(self, setpoint: WireSetpoint) -> None:
        """Send a set-point that `crazyflie.link.sendable` returned, unless a newer one comes before its turn."""
        if not (self._leaving.is_set() or self._emergency.is_set()):
            self._newest = setpoint
            self._offer(Stream.SETPOINT, setpoint_packet(setpoint))

    def locate(self, position: tuple[float, ...], quaternion: tuple[float, ...] | None) -> None:
        """Send an external position, m, or pose; both finite."""
        if quaternion is None:
            self._offer(Stream.EXTERNAL_POSE, lambda cf: cf.loc.send_extpos(position))
        else:
            self._offer(Stream.EXTERNAL_POSE, lambda cf: cf.loc.send_extpose(position, quaternion))

    def stop_motors(self) -> None:
        """Emergency stop, sent over and over; nothing else is sent any more, not even after a reconnection."""
        self._emergency.set()
        self._wake.set()

    @property
    def stopped(self) -> bool:
        """Whether an emergency stop was asked for."""
        return self._emergency.is_set()

    def arm(self, wanted: bool) -> bool:
        """Send an arming request; False if there is no connection to send it on."""
        if self.connected:
            self._urgent.append(lambda cf: cf.supervisor.send_arming_request(wanted))
            self._wake.set()
        return self.connected

    def leave(self) -> None:
        """Say farewell to the drone and end."""
        self._leaving.set()
        self._wake.set()

    @property
    def alive(self) -> bool:
        """Whether the link is still at work, after `leave` with its farewell."""
        return self._thread.is_alive()

    def _offer(self, stream: Stream, packet: Packet) -> None:
        self._lane.offer((self.robot, stream), packet, time.monotonic())
        self._wake.set()

    def _run(self) -> None:
        """Connect again and again: at once when a connection was lost, for a drone in flight has two seconds."""
        while not self._leaving.is_set():
            cf = _Crazyflie(rw_cache=self._settings.cache)
            lost = False
            try:
                lost = self._serve(cf)
            except Exception as error:  # cflib raises just that; it ends the connection, not the link
                cf.error = str(error)
            if cf.error:
                # what follows is a traceback
                self.condition = " ".join(cf.error.partition("\n\n")[0].removeprefix(_CFLIB_PREFIX).split())
            self.connected = False
            _close(cf)
            if not lost:
                self._leaving.wait(_RETRY)

    def _serve(self, cf: _Crazyflie) -> bool:
        """Open a connection and feed it until it is lost or all is said; return whether the drone answered."""
        ready = threading.Event()
        cf.packet_received.add_callback(cf.hear)
        cf.connection_failed.add_callback(lambda _, text: cf.note(text))
        cf.connected.add_callback(lambda _: ready.set())
        cf.console.receivedChar.add_callback(self._on_console)
        cf.link_statistics.link_quality_updated.add_callback(partial(self.values.__setitem__, "link quality %"))
        cf.link_statistics.latency_updated.add_callback(partial(self.values.__setitem__, "latency ms"))
        # a request or a report from before may be about a drone that was rebooted since
        self._urgent.clear()
        self.values.clear()
        self._heard = opened = time.monotonic()
        cf.open_link(self.address.uri)
        if cf.link:
            # over UDP a single lost packet would otherwise end the connection's set-up
            cf.link.needs_resending = True
        while not cf.error:
            self._wake.wait(self._patience())
            self._wake.clear()
            answered = cf.heard > opened
            self._heard = max(cf.heard, opened)
            if answered and not self.connected:
                self.connected, self.condition = True, "connected"
                self.counts["connections"] += 1
            if ready.is_set():
                ready.clear()
                self._listen(cf)
            if not (self._feed(cf) if answered else not self._leaving.is_set()):
                break
            if self.silence > self._settings.timeout:
                cf.note(f"silent for {self._settings.timeout:g} s")
        return self.connected

    def _patience(self) -> float:
        return min(max(self._lane.wait(self._streams, time.monotonic()), 0.0), _LOOK)

    def _feed(self, cf: _Crazyflie) -> bool:
        """Send what is due; False when all is said."""
        now = time.monotonic()
        if self._leaving.is_set() and self._farewell_began is None:
            self._farewell_began, self._farewell = now, self._choose_farewell(now)
        elapsed = None if self._farewell_began is None else now - self._farewell_began
        if self.stopped:
            return self._repeat_emergency(cf, now, elapsed)
        while self._urgent:
            self._urgent.popleft()(cf)
        if elapsed is not None and not self._say_farewell(cf, elapsed):
            return False
        if taken := self._lane.take(self._streams, time.monotonic()):
            (_, stream), packet = taken
            packet(cf)
            self.counts[stream.value] += 1
            if stream is Stream.SETPOINT:
                self._last_sent = now
        return True

    def _repeat_emergency(self, cf: _Crazyflie, now: float, elapsed: float | None) -> bool:
        """Send the emergency stop for as long as the bridge runs: which of them arrive nobody knows."""
        if now >= self._next_emergency:
            self._next_emergency = now + _EMERGENCY_PERIOD
            cf.supervisor.send_emergency_stop()
        return elapsed is None or elapsed < _EMERGENCY_LAST_WORDS

    def _choose_farewell(self, now: float) -> Farewell | None:
        """Return how to leave the drone: alone if it was never flown; no descent if its motors rest already."""
        if self._last_sent == -math.inf:
            return None
        rests = self._newest.thrust == 0.0 or now - self._last_sent > _FIRMWARE_PATIENCE
        return replace(self._planned_farewell, descent=0.0) if rests else self._planned_farewell

    def _say_farewell(self, cf: _Crazyflie, elapsed: float) -> bool:
        """Offer the next set-point of the farewell; False when it is over."""
        if self._farewell is None:
            return False
        setpoint = self._farewell.setpoint(elapsed, self._newest.yaw)
        if setpoint is not None:
            self._offer(Stream.SETPOINT, setpoint_packet(setpoint))
            return True
        for _ in range(_NOTIFICATIONS):
            cf.commander.send_notify_setpoint_stop()
        return False

    def _listen(self, cf: _Crazyflie) -> None:
        """Have the drone report its battery and supervisor, and its estimate if that was asked for."""
        known = [name for name in (VOLTAGE, SUPERVISOR) if cf.log.toc.get_element_by_complete_name(name)]
        if known:
            self._log(cf, _STATUS_PERIOD, dict.fromkeys(known), self._on_status)
        if self._settings.pose_period:
            variables = {**dict.fromkeys(POSITION, "float"), **dict.fromkeys(QUATERNION, "FP16")}
            self._log(cf, self._settings.pose_period, variables, self._on_estimate)

    def _log(
        self, cf: _Crazyflie, period: int, variables: Mapping[str, str | None], take: Callable[[dict[str, float]], None]
    ) -> None:
        block = LogConfig(",".join(variables), period)
        for name, kind in variables.items():
            block.add_variable(name, kind)
        block.data_received_cb.add_callback(lambda _stamp, data, _block: take(data))
        try:
            cf.log.add_config(block)
        except KeyError as error:
            cf.note(f"the firmware logs no such thing: {error}")
        else:
            block.start()

    def _on_status(self, data: dict[str, float]) -> None:
        self.values.update(data)
        if VOLTAGE in data:
            self._on_battery(data[VOLTAGE])

    def _on_estimate(self, data: dict[str, float]) -> None:
        self._on_pose(tuple(data[name] for name in POSITION), tuple(data[name] for name in QUATERNION))

    def _on_console(self, text: str) -> None:
        """Collect lines from the pieces that packets hold."""
        *lines, self._line = (self._line + text).split("\n")
        for line in filter(None, map(str.strip, lines)):
            self.console.append(line)
            self._on_line(line)


def setpoint_packet(setpoint: WireSetpoint) -> Packet:
    """Return what sends a set-point. cflib turns the sign of the pitch around, as crazyswarm2's cpp back end does."""
    roll, pitch, yaw, thrust = setpoint
    return lambda cf: cf.commander.send_setpoint(roll, pitch, yaw, int(thrust))


def initialise() -> None:
    """Load cflib's drivers. Of its log everything that matters comes to us by callbacks as well."""
    cflib.crtp.init_drivers()
    logging.getLogger("cflib").setLevel(logging.CRITICAL + 1)
    # for old firmware cflib sends the old packets
    warnings.filterwarnings("ignore", message="The supervisor subsystem requires CRTP protocol version 12")


def _close(cf: _Crazyflie) -> None:
    """Close the link itself first: close_link would send a set-point without thrust, in the air a cut.

    The rest waits a second for cflib's threads, which a drone in flight does not have.
    """
    if cf.link:
        cf.link.close()

    def dispose() -> None:
        cf.link_statistics.stop()
        cf.close_link()

    threading.Thread(target=dispose, name="closing", daemon=True).start()

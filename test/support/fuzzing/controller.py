"""What a controller hears: poses, goals, trajectories, batteries, orders and parameters of one of two drones in flight.

Of the messages that not every ROS installation has, those of crazyswarm2's status and of named poses are made up here.

Whatever comes, every command stays within the limits, the other drone flies on, and sound poses are still taken.
"""

from __future__ import annotations

import math
import pickle
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from geometry_msgs.msg import PoseStamped, Twist
from hypothesis import strategies as st
from rclpy.parameter import Parameter
from room import EPOCH, Room, pose
from std_msgs.msg import Header
from std_srvs.srv import SetBool

from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.stamps import StampClock
from flatsat_ros.nodes.pose_sources import PoseSource
from flatsat_ros.nodes.ros import messages
from flatsat_ros.nodes.ros.messages import NANOSECONDS
from fuzzing.cdr import poses, trajectories
from fuzzing.damage import FLOATS
from fuzzing.kind import Attempt, Kind
from fuzzing.nodes import own_context, refusals, silenced
from fuzzing.sequence import Item, decoded, sequences

_TOPICS = ("pose", "goal_pose", "trajectory")
_BATTERY, _ORDER, _PARAMETER, _STATUS, _BODIES = range(3, 8)
_NAMES = ("cf1", "cf1", "cf1", "cf3", "", "cf1\0", "\xff" * 300)
_FRAMES = ("world", "world", "world", "", "map", "w" * 300)
_ORDERS = ("takeoff", "land", "hold", "hand_over", "arm", "disarm")
_TUNING = ("mu", "v_inf", "gamma_0", "gamma_max", "nu")
_PARAMETERS = (*_TUNING, *(f"robots.cf1.{name}" for name in _TUNING), "restart_gain", "floor", "use_sim_time")
# when both drones hover, s: the stamp of poses
_SECOND = EPOCH // NANOSECONDS + 6
# of sound poses at the end, after which they must be taken again
_TICKS = 7


_PARAMETER_ITEM = st.builds(
    lambda name, kind, number: struct.pack("<BBd", name, kind, number),
    st.integers(0, len(_PARAMETERS) - 1), st.integers(0, 7), FLOATS,
)  # fmt: skip


def _parameter(content: bytes) -> Parameter:
    """Return a parameter: a double mostly, else something of another type."""
    name, kind, number = struct.unpack("<BBd", content[:10].ljust(10, b"\0"))
    others: dict[int, object] = {0: None, 1: name, 2: True, 3: "fast", 4: [number], 5: [number] * 3}
    return Parameter(_PARAMETERS[name % len(_PARAMETERS)], value=others.get(kind, number))


_BODIES_ITEM = st.builds(
    lambda frame, second, nanosecond, bodies: struct.pack("<BiI", frame, second, nanosecond) + b"".join(bodies),
    st.integers(0, len(_FRAMES) - 1),
    st.sampled_from([_SECOND, _SECOND, _SECOND, 0, -1, 2**31 - 1, -(2**31)]),
    st.sampled_from([0, 20_000_000, 10**9, 2**32 - 1]),
    st.lists(
        st.builds(
            lambda name, values: struct.pack("<B7d", name, *values),
            st.integers(0, len(_NAMES) - 1),
            st.lists(FLOATS, min_size=7, max_size=7) | st.just([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        ),
        max_size=4,
    ),
)  # fmt: skip


def _bodies(content: bytes) -> SimpleNamespace:
    """Return a message of named poses."""
    frame, second, nanosecond = struct.unpack("<BiI", content[:9].ljust(9, b"\0"))
    header = Header(frame_id=_FRAMES[frame % len(_FRAMES)])
    header.stamp.sec, header.stamp.nanosec = second, nanosecond
    entries = []
    for at in range(9, len(content) - 56, 57):
        name, *values = struct.unpack_from("<B7d", content, at)
        posed = PoseStamped()
        messages.fill_pose(posed, 0, values[:3], values[3:])
        entries.append(SimpleNamespace(name=_NAMES[name % len(_NAMES)], pose=posed.pose))
    return SimpleNamespace(header=header, poses=entries)


_ITEMS: st.SearchStrategy[Item] = st.one_of(
    st.tuples(st.just(0), poses(_SECOND)),
    st.tuples(st.just(1), poses(0)),
    st.tuples(st.just(2), trajectories()),
    st.tuples(st.integers(0, 2), st.binary(max_size=100)),
    st.tuples(st.just(_BATTERY), st.floats(width=32).map(lambda volts: struct.pack("<f", volts))),
    st.tuples(st.just(_ORDER), st.binary(min_size=1, max_size=1)),
    st.tuples(st.just(_PARAMETER), _PARAMETER_ITEM),
    st.tuples(st.just(_STATUS), st.floats(width=32).map(lambda volts: struct.pack("<f", volts))),
    st.tuples(st.just(_BODIES), _BODIES_ITEM),
)


class _Recorded:
    """Takes the place of a publisher of set-points, and requires that each is within the limits."""

    def __init__(self, tilt_max: float, pwm_max: float) -> None:
        self.count = 0
        self._least, self._pwm_max = math.cos(tilt_max) - 1e-9, pwm_max

    def publish(self, message: Twist) -> None:
        sent: WireSetpoint = messages.command_from_message(message)
        self.count += 1
        assert all(map(math.isfinite, sent)), sent
        assert 0.0 <= sent.thrust <= self._pwm_max, sent
        assert math.cos(math.radians(sent.roll)) * math.cos(math.radians(sent.pitch)) >= self._least, sent

    def get_subscription_count(self) -> int:
        return 1


class _Attacked:
    """A room in which both drones hover, again and again from the same moment."""

    def __init__(self) -> None:
        self.room = Room("-p", "certificate:=cf21_50hz")
        self.room.hover("cf1", "cf2")
        node, self._ticks = self.room.node, self.room._ticks
        self._places = self.room.fleet.bodies.position.copy()
        limits = node._certificate.limits
        self._wires = [_Recorded(limits.tilt_max, vehicle.pwm_max) for vehicle in node._setup.vehicles]
        node._commands._publishers = self._wires  # type: ignore[assignment]
        self._refused = refusals(node)
        self._pilot = pickle.dumps(vars(node._pilot))
        resort = {name: value for name, value in vars(node._commands.last_resort).items() if name != "_clock"}
        self._last_resort, self._parameters = pickle.dumps(resort), dict(node._parameters)

    def attempt(self, data: bytes) -> bool:
        """Deliver the messages of an input, a tick after each."""
        self._begin_again()
        items = decoded(data)
        for code, content in items:
            self._deliver(code, content)
            self._tick()
        for _ in range(_TICKS):
            last = self._tick()
        node = self.room.node
        assert not node._broken
        assert self._wires[1].count == len(items) + _TICKS, "one command in every tick for the other drone"
        assert node._pilot.mode[1] == Mode.FLY
        assert np.isfinite(last).all()
        assert (node._pilot.estimator.newest >= node._stamps.now - 1e-6).all(), "sound poses are taken"
        return not self._refused

    def _begin_again(self) -> None:
        node, room = self.room.node, self.room
        vars(node._pilot).clear()
        vars(node._pilot).update(pickle.loads(self._pilot))
        vars(node._commands.last_resort).update(pickle.loads(self._last_resort))
        node._parameters = dict(self._parameters)
        room._ticks, node._broken = self._ticks, False
        self._refused.clear()
        node._durations.clear()
        for queue, wire in zip(node._sources.queues, self._wires, strict=True):
            queue.clear()
            wire.count = 0
        start = self.room._steady()
        node._stamps = StampClock(2, lambda: EPOCH + room._steady(), room._steady)
        node._stamps._origin -= start

    def _tick(self) -> np.ndarray:
        """Let a tick pass in which both drones are seen where they are; return the inputs (2, 4)."""
        self.room._ticks += 1
        wobble = 1e-5 * math.sin(self.room._ticks)  # the very same place, or one coordinate, would be an old pose
        for robot, (x, y, z) in zip(self.room.node.robots, self._places, strict=True):
            data = pose((x + wobble, y + wobble, z + wobble), (0.0, 0.0, 0.0, 1.0), stamp=EPOCH + self.room._steady())
            self.room.deliver(f"{robot}/pose", data)
        self.room.node._on_tick()
        tick = self.room.node._last
        assert tick is not None
        limits = self.room.node._certificate.limits
        assert (tick.input[:, 0] <= limits.thrust_max * (1.0 + 1e-9)).all()
        return np.asarray(tick.input)

    def _deliver(self, code: int, content: bytes) -> None:
        if code < len(_TOPICS):
            self.room.deliver(f"cf1/{_TOPICS[code]}", content)
        elif code == _BATTERY:
            (volts,) = struct.unpack("<f", content[:4].ljust(4, b"\0"))
            self.room.deliver("cf1/battery", messages.battery_message(0, volts))
        elif code == _ORDER:
            name = _ORDERS[content[:1][0] % len(_ORDERS)] if content else "land"
            if "arm" in name:
                answer = self.room.ask("cf1/flatsat/arm", SetBool, data=name == "arm")
            else:
                answer = self.room.ask(f"cf1/flatsat/{name}")
            self._refused += [] if answer.success else [name]
            assert "error of the program" not in answer.message
        elif code == _STATUS:
            (volts,) = struct.unpack("<f", content[:4].ljust(4, b"\0"))
            with self.room.node.faults.contain("cf1/status"):
                status = SimpleNamespace(battery_voltage=volts, pm_state=0, supervisor_info=len(content))
                self.room.node._status.take(0, status)
        elif code == _BODIES:
            sources = self.room.node._sources
            usual, sources._current[0] = sources._current[0], PoseSource.POSES
            with self.room.node.faults.contain("poses"):
                sources._on_bodies(PoseSource.POSES, _bodies(content))
            sources._current[0] = usual
        elif code == _PARAMETER:
            (result,) = self.room.node.set_parameters([_parameter(content)])
            self._refused += [] if result.successful else ["parameter"]


@contextmanager
def _open(_: Path) -> Iterator[Attempt]:
    with own_context():
        attacked = _Attacked()
    with silenced(attacked.room.node):
        yield attacked.attempt


CONTROLLER = Kind(sequences(_ITEMS), _open)

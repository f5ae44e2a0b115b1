"""What the simulated drones are told: set-points and high-level commands of one of two, and times that jump.

Whatever comes, the other drone hovers on.
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
import rclpy
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Twist
from hypothesis import strategies as st
from std_srvs.srv import Empty, SetBool, Trigger

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.messages import NANOSECONDS
from flatsat_ros.nodes.server_commands import COMMANDS
from flatsat_ros.nodes.sim_drone import SimDrone
from flatsat_ros.sim.fleet import SimulatedFleet
from fuzzing.damage import FLOATS
from fuzzing.kind import Attempt, Kind
from fuzzing.nodes import arguments, own_context, refusals, silenced
from fuzzing.sequence import Item, decoded, sequences

EPOCH = 1_700_000_000 * NANOSECONDS
_COMMAND, _TAKE_OFF, _LAND, _GO_TO, _NOTIFY, _SERVICE, _JUMP = range(7)
_STEP = 5_000_000  # ns, between two messages
_SECONDS = st.sampled_from([0, 1, 2, -1, 2**31 - 1, -(2**31)])

_SOUND = (*[st.floats(-20.0, 20.0)] * 3, st.floats(0.0, 65535.0))
_WAYS = st.tuples(
    st.lists(FLOATS | st.floats(-2.0, 2.0), min_size=4, max_size=4), _SECONDS, st.integers(0, 2**32 - 1)
).map(lambda way: struct.pack("<4diI", *way[0], way[1], way[2]))
_ITEMS: st.SearchStrategy[Item] = st.one_of(
    st.tuples(st.just(_COMMAND), st.tuples(*_SOUND).map(lambda v: struct.pack("<4d", *v))),
    st.tuples(st.just(_COMMAND), st.lists(FLOATS, min_size=4, max_size=4).map(lambda v: struct.pack("<4d", *v))),
    st.tuples(
        st.sampled_from([_TAKE_OFF, _LAND, _GO_TO]),
        st.tuples(
            st.lists(FLOATS | st.floats(-2.0, 2.0), min_size=4, max_size=4), _SECONDS, st.integers(0, 2**32 - 1)
        ).map(lambda v: struct.pack("<4diI", *v[0], v[1], v[2])),
    ),
    st.tuples(st.integers(_NOTIFY, _SERVICE), st.binary(min_size=1, max_size=1)),
    st.tuples(st.just(_JUMP), st.sampled_from([0.0, 0.2, 60.0, -60.0, 1e6, -1e6]).map(lambda s: struct.pack("<d", s))),
)


class _Simulated:
    """Two drones that hover, again and again from the same moment, on a clock of the test's."""

    def __init__(self, node: SimDrone) -> None:
        self.node, self._now = node, EPOCH
        node.get_clock = lambda: SimpleNamespace(  # type: ignore[method-assign, assignment, return-value]
            now=lambda: SimpleNamespace(nanoseconds=self._now)
        )
        self._refused = refusals(node)
        ((self._fleet, _),) = node._fleets
        vehicle = load_vehicle("cf21")
        self._hover = float(vehicle.pwm_from_thrust(GRAVITY))
        start = [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]]
        self._flying = pickle.dumps(vars(SimulatedFleet(vehicle, 2, start=start, flying=True)))
        self._callbacks = {s.topic_name: s.callback for s in node.subscriptions}
        self._services = {s.srv_name: s.callback for s in node.services}

    def attempt(self, data: bytes) -> bool:
        """Deliver the messages of an input, some time after each."""
        vars(self._fleet).update(pickle.loads(self._flying))
        self._now = EPOCH
        self._refused.clear()
        self.node._seen = self.node._epoch = self.node._started = EPOCH
        items = decoded(data)
        for code, content in items:
            self._deliver(code % 7, content)
            self._advance(_STEP)
        self._advance(_STEP)
        positions, quaternions = self._fleet.poses()
        assert np.isfinite(positions[1]).all()
        assert np.isfinite(quaternions[1]).all()
        assert abs(positions[1, 2] - 1.0) < 0.1, "the other drone hovers on"
        assert len(self._fleet._packets) <= 2 * len(items) + 4
        assert [len(report.text) < 100 for report in self.node._report(0)] == [True, True]
        return not self._refused

    def _advance(self, nanoseconds: int) -> None:
        self._now += nanoseconds
        message = Twist()
        messages.fill_command(message, WireSetpoint(0.0, 0.0, 0.0, self._hover))
        self._callbacks["/simulation/cf2/cmd_vel_legacy"](message)
        self.node._advance()

    def _deliver(self, code: int, content: bytes) -> None:
        x, y, z, yaw, sec, nanosec = struct.unpack("<4diI", content[:40].ljust(40, b"\0"))
        if code == _COMMAND:
            message = Twist()
            messages.fill_command(message, WireSetpoint(x, y, z, yaw))
            self._callbacks["/simulation/cf1/cmd_vel_legacy"](message)
        elif code == _JUMP:
            seconds = x if math.isfinite(x) else 0.0
            self._now = max(self._now + round(max(min(seconds, 1e6), -1e6) * NANOSECONDS), 0)
        elif code == _SERVICE:
            name = ("arm", "reboot", "emergency", "all/emergency")[content[0] % 4 if content else 0]
            kind = {"arm": SetBool, "reboot": Trigger}.get(name, Empty)
            request = kind.Request(**({"data": bool(content[:1] < b"\x80")} if kind is SetBool else {}))
            if not name.startswith("all"):  # the other drone's motors would stop, too
                self._services[f"cf1/{name}"](request, kind.Response())
        else:
            name = (interfaces.TAKEOFF, interfaces.LAND, interfaces.GO_TO, interfaces.NOTIFY)[code - 1]
            request = SimpleNamespace(height=x, goal=Point(x=x, y=y, z=z), yaw=yaw, relative=sec % 2 == 0, group_mask=0)
            request.duration = Duration(sec=sec, nanosec=nanosec)
            with self.node.faults.contain(f"cf1/{name}"):
                COMMANDS[name][1](self.node.drones[0], request)


@contextmanager
def _open(_: Path) -> Iterator[Attempt]:
    with own_context():
        rclpy.init(args=arguments("sim_drone", "simulation", "robot_names:=[cf1, cf2]"))
        node = SimDrone()
    with silenced(node):
        yield _Simulated(node).attempt


SIMULATION = Kind(sequences(_ITEMS, 4), _open)

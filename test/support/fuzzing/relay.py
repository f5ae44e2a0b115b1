"""What the relay with faults passes on, and what it is told to do to it."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from hypothesis import strategies as st
from rclpy.parameter import Parameter

from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.nodes.fault_relay import COMMAND_FAULTS, POSE_FAULTS, FaultRelay
from flatsat_ros.nodes.ros import messages
from fuzzing.damage import FLOATS
from fuzzing.kind import Attempt, Kind
from fuzzing.nodes import arguments, own_context, refusals, silenced
from fuzzing.sequence import Item, decoded, sequences

_POSE, _COMMAND, _FAULT = range(3)
_FAULTS = (*(("pose_fault", name) for name in POSE_FAULTS), *(("command_fault", name) for name in COMMAND_FAULTS),
           ("faulty", "all"), ("faulty", "cf1"), ("faulty", "cf9"), ("pose_fault", "none"))  # fmt: skip
_STAMPS = st.sampled_from([0, 1, -1, 1_700_000_000, 2**31 - 1, -(2**31)])

_ITEMS: st.SearchStrategy[Item] = st.one_of(
    st.tuples(
        st.just(_POSE),
        st.tuples(st.lists(FLOATS, min_size=7, max_size=7), _STAMPS, st.integers(0, 2**32 - 1)).map(
            lambda v: struct.pack("<7diI", *v[0], v[1], v[2])
        ),
    ),
    st.tuples(st.just(_COMMAND), st.lists(FLOATS, min_size=4, max_size=4).map(lambda v: struct.pack("<4d", *v))),
    st.tuples(st.just(_FAULT), st.integers(0, len(_FAULTS) - 1).map(lambda number: bytes([number]))),
)


@contextmanager
def _open(_: Path) -> Iterator[Attempt]:
    with own_context():
        rclpy.init(args=arguments("fault_relay", "relay", "robot_names:=[cf1, cf2]"))
        node = FaultRelay()
    callbacks = {s.topic_name.rpartition("/")[2]: s.callback for s in node.subscriptions if "cf1" in s.topic_name}
    refused = refusals(node)

    def deliver(code: int, content: bytes) -> None:
        *values, sec, nanosec = struct.unpack("<7diI", content[:64].ljust(64, b"\0"))
        if code == _POSE:
            message = PoseStamped()
            messages.fill_pose(message, 0, values[:3], values[3:])
            message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
            callbacks["pose"](message)
        elif code == _COMMAND:
            command = Twist()
            messages.fill_command(command, WireSetpoint(*values[:4]))
            callbacks["cmd_vel_legacy"](command)
        else:
            name, value = _FAULTS[content[0] % len(_FAULTS) if content else 0]
            (result,) = node.set_parameters([Parameter(name, value=value)])
            refused.extend([] if result.successful else [name])

    def attempt(data: bytes) -> bool:
        refused.clear()
        node.set_parameters_atomically(
            [Parameter("pose_fault", value=""), Parameter("command_fault", value=""), Parameter("faulty", value="cf1")]
        )
        node._late.clear()
        items = decoded(data)
        for code, content in items:
            deliver(code % 3, content)
            node._send_late()
        assert len(node._late) <= len(items)
        return not refused

    with silenced(node):
        yield attempt


RELAY = Kind(sequences(_ITEMS, 8), _open)

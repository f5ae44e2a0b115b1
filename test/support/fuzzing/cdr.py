"""Serialised messages: poses, goals and trajectories, of either byte order, with lengths that lie and any numbers."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.nodes.ros import cdr
from flatsat_ros.nodes.ros.messages import NANOSECONDS
from fuzzing.damage import FLOATS, corrupted
from fuzzing.kind import Attempt, Kind, require_one_line

NOW = 1_700_000_000 * NANOSECONDS
_SECONDS = st.sampled_from([0, 1, -1, 1_700_000_000, 2**31 - 1, -(2**31)])
_NANOSECONDS = st.sampled_from([0, 20_000_000, 999_999_999, 10**9, 2**32 - 1])
_LENGTHS = st.sampled_from([0, 1, 2, 3, 100, 2001, 2**31, 2**32 - 1])
_FRAMES = st.sampled_from([b"world", b"", b"map", b"worl", b"world\0\0", b"\xff\xfe", b"w" * 300])
_NEAR = st.floats(-2.0, 2.0)


class _Writer:
    """Plain CDR, written field by field; a few of them as they should not be."""

    def __init__(self, draw: st.DrawFn) -> None:
        self._draw = draw
        big = draw(st.integers(0, 9)) == 9
        self._order, self.body = (">", bytearray()) if big else ("<", bytearray())
        self.head = b"\0\0\0\0" if big else b"\0\1\0\0"
        # in one of two messages every so manieth field is wild
        self._every = draw(st.sampled_from([0, 0, 0, 3, 10, 30]))
        self._fields = 0

    def put(self, form: str, value: float, wild: st.SearchStrategy[float]) -> None:
        self._fields += 1
        if self._every and self._fields % self._every == 0:
            value = self._draw(wild)
        self.body += bytes(-len(self.body) % struct.calcsize(form)) + struct.pack(self._order + form, value)

    def length(self, value: int) -> None:
        self.put("I", value, _LENGTHS)

    def numbers(self, *values: float) -> None:
        for value in values:
            self.put("d", value, FLOATS)

    def text(self, text: bytes) -> None:
        self.length(len(text) + 1)
        self.body += text + b"\0"

    def header(self, seconds: int) -> None:
        self.put("i", seconds, _SECONDS)
        self.put("I", 0, _NANOSECONDS)
        self.text(self._draw(_FRAMES) if self._every else b"world")

    def message(self) -> bytes:
        data = self.head + bytes(self.body)
        return self._draw(corrupted(data)) if self._draw(st.integers(0, 9)) == 9 else data


@st.composite
def poses(draw: st.DrawFn, seconds: int = NOW // NANOSECONDS) -> bytes:
    """A PoseStamped, which is a goal as well."""
    writer = _Writer(draw)
    writer.header(seconds)
    yaw = draw(_NEAR)
    writer.numbers(draw(_NEAR), draw(_NEAR), 1.0 + 0.4 * draw(_NEAR), 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    return writer.message()


@st.composite
def trajectories(draw: st.DrawFn) -> bytes:
    """A MultiDOFJointTrajectory of up to five points, at rest at its ends."""
    writer = _Writer(draw)
    writer.header(0)
    joints = draw(st.integers(0, 1))
    writer.length(joints)
    for _ in range(joints):
        writer.text(b"base_link")
    count = draw(st.integers(1, 5))
    writer.length(count)
    for point in range(count):
        at_rest = point in (0, count - 1)
        writer.length(1)
        writer.numbers(0.1 * point, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
        for _ in ("velocity", "acceleration"):
            writer.length(1)
            writer.numbers(0.0 if at_rest else 0.05 * draw(_NEAR), 0.0, 0.0, 0.0, 0.0, 0.0)
        writer.put("i", point, _SECONDS)
        writer.put("I", 0, _NANOSECONDS)
    return writer.message()


@contextmanager
def _open(_: Path) -> Iterator[Attempt]:
    def attempt(data: bytes) -> bool:
        return sum([_reads_pose(data), _reads_goal(data), _reads_trajectory(data)]) > 0

    yield attempt


def _reads_pose(data: bytes) -> bool:
    try:
        cdr.require_short(data)
        cdr.require_frame(data, b"world")
        stamp, position, quaternion = cdr.pose_from_cdr(data)
    except FlatsatError as refused:
        require_one_line(refused)
        return False
    assert len(cdr.frame_from_cdr(data)) < 256
    assert abs(stamp) < 2**63
    assert [len(position), len(quaternion)] == [3, 4]
    return True


def _reads_goal(data: bytes) -> bool:
    try:
        goal = cdr.setpoint_from_cdr(data)
    except FlatsatError as refused:
        require_one_line(refused)
        return False
    assert np.isfinite([*goal.end, goal.yaw]).all()
    return True


def _reads_trajectory(data: bytes) -> bool:
    try:
        path = cdr.trajectory_from_cdr(data, NOW, NOW - NANOSECONDS)
    except FlatsatError as refused:
        require_one_line(refused)
        return False
    assert len(path.times) <= cdr.POINTS_MAX
    assert np.isfinite(path.coefficients).all()
    assert np.isfinite([*path.end, path.yaw]).all()
    for t in (*path.times[:10], *(path.times[:10] + 1e-3), 1e9):
        assert np.isfinite(path.sample(float(t))).all()
    return True


CDR = Kind(st.one_of(poses(), trajectories(), st.binary(max_size=200)), _open)

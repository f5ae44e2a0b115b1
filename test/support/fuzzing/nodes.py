"""Nodes in this process, each in a ROS context of its own: a process that fuzzes has several of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest import mock

import rclpy
from rclpy.logging import LoggingSeverity

from flatsat_ros.nodes.ros.runtime import ProgramNode


@contextmanager
def own_context() -> Iterator[rclpy.Context]:
    """A context that is the default one, for rclpy.init and new nodes, while this lasts; see `silenced` for its end."""
    context = rclpy.Context()
    with mock.patch("rclpy.utilities.g_default_context", context):
        yield context


@contextmanager
def silenced(node: ProgramNode) -> Iterator[None]:
    """Let a node say nothing; it and its context are gone after this."""
    context, logger = node.context, node.get_logger()
    logger.set_level(LoggingSeverity.FATAL)
    try:
        yield
    finally:
        logger.set_level(LoggingSeverity.UNSET)  # the level belongs to the process
        node.destroy_node()
        context.try_shutdown()

"""Nodes in this process, each in a ROS context of its own: a process that fuzzes has several of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest import mock

import rclpy
from rclpy.logging import LoggingSeverity

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.nodes.ros.runtime import ProgramNode
from fuzzing.kind import require_one_line


def arguments(program: str, namespace: str, *parameters: str) -> list[str]:
    """Return a command line of a program in a namespace: none of the others in this process is its rival."""
    given = [word for parameter in parameters for word in ("-p", parameter)]
    return [program, "--ros-args", "-r", f"__ns:=/{namespace}", *given]


@contextmanager
def own_context(context: rclpy.Context | None = None) -> Iterator[None]:
    """Let a context, a new one by default, be the default one for rclpy.init, nodes and timers that are made meanwhile.

    `silenced` ends it.
    """
    with mock.patch("rclpy.utilities.g_default_context", context or rclpy.Context()):
        yield


def refusals(node: ProgramNode) -> list[str]:
    """Let a node's refusals, each in one line, go into a list in place of the log; any other error goes on."""
    refused: list[str] = []

    def note(name: str, error: Exception) -> None:
        if not isinstance(error, FlatsatError):
            raise error
        require_one_line(error)
        refused.append(name)

    vars(node.faults)["note"] = note
    return refused


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

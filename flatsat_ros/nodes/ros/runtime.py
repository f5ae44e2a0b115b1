"""How a node of this package lives: start, spin until a signal, leave what it flies in a safe state, end."""

from __future__ import annotations

import inspect
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import rclpy
from rclpy.callback_groups import CallbackGroup
from rclpy.client import Client
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import NameValidationException
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.service import Service
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from rclpy.utilities import remove_ros_args

from flatsat_ros.base.errors import FlatsatError, nearest_name, quoted, reason_of
from flatsat_ros.nodes.ros import messages
from flatsat_ros.nodes.ros.faults import Faults
from flatsat_ros.nodes.ros.given import Called, given_now, giving, read_given

# how long the last messages of a process may take to be acknowledged, s
ENDING_TIME = 0.5
# a signal is noticed within this time, s
_PATIENCE = 0.1
# a condition is looked at this often while a node shuts down, s
_SHUTDOWN_PATIENCE = 0.05
# what is left to do in a shutdown is said this often, s
_PROGRESS_PERIOD = 1.0
# after this time remappings that have changed nothing are told, s: what there is has been found, as a rule
_SETTLED = 5.0
# what ROS takes after --ros-args, for a hint
_ROS_ARGUMENTS = ("--param", "--params-file", "--remap", "--log-level", "--log-config-file", "--enclave")


class ProgramNode(Node):
    """A node that is a whole program.

    Its timers stand on steady time, which nobody sets, and an exception ends with the callback that raised it.

    Attributes:
        done: whether it has nothing left to do and the program shall end.
        exit_code: of the program.
        faults: what failed in callbacks so far.
        shutdown_time_max: how long a shutdown may take before it is broken off, s.
    """

    shutdown_time_max = 10.0

    def __init__(self, name: str) -> None:
        """Make the node.

        Raises:
            FlatsatError: the command line has parameters for other nodes alone.
        """
        self._given, self._own_name = given_now(), name
        self._called = Called({"/rosout"}, set())  # that topic is opened by rcl itself
        super().__init__(name)
        for sentence in self._given.require_for(self.get_fully_qualified_name(), name):
            self.get_logger().warning(sentence)
        self.done = False
        self.exit_code = 0
        self.faults = Faults(self.get_logger())
        self._steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.add_on_set_parameters_callback(self._keep_time_source)
        self._settling = self.create_timer(_SETTLED, self.tell_unused) if self._given.rules else None

    def begin_shutdown(self) -> None:
        """Begin to leave the world in a safe state; callbacks go on until `is_shut_down`."""

    def is_shut_down(self) -> bool:
        """Tell whether nothing is left to wait for."""
        return True

    def shutdown_progress(self) -> str:
        """Return a sentence on what is still waited for, told once a second; nothing by default."""
        return ""

    def finish(self) -> None:
        """Do the last thing, after the shutdown or instead of the rest of it; publishers and `spin_while` work."""

    def spin_while(self, condition: Callable[[], bool]) -> None:
        """Let callbacks run for as long as the condition holds; for `finish`."""
        executor = self.executor
        while executor is not None and condition():
            spin_once(executor, self.faults, _SHUTDOWN_PATIENCE)

    def tell_unused(self) -> None:
        """Tell once of remappings that have changed nothing."""
        if self._settling is not None:
            self._settling.cancel()
            self._settling = None
            for sentence in self._given.unused(self._called, self._own_name, self.get_name(), self.get_namespace()):
                self.get_logger().warning(sentence)

    def resolve_topic_name(self, topic: str, *, only_expand: bool = False) -> str:
        """Return the full name of a topic; rclpy asks for that of each publisher and subscription."""
        if self._given.rules:
            self._called.topics.add(super().resolve_topic_name(topic, only_expand=True))
        return str(super().resolve_topic_name(topic, only_expand=only_expand))

    def resolve_service_name(self, service: str, *, only_expand: bool = False) -> str:
        """Return the full name of a service."""
        if self._given.rules:
            self._called.services.add(super().resolve_service_name(service, only_expand=True))
        return str(super().resolve_service_name(service, only_expand=only_expand))

    def count_publishers(self, topic_name: str) -> int:
        """Count who publishes a topic, by the name that it is remapped to, as our own publishers and subscriptions."""
        return int(super().count_publishers(self.resolve_topic_name(topic_name)))

    def count_subscribers(self, topic_name: str) -> int:
        """Count who subscribes to a topic, by the name that it is remapped to."""
        return int(super().count_subscribers(self.resolve_topic_name(topic_name)))

    def create_timer(
        self,
        timer_period_sec: float,
        callback: Callable[[], object],
        callback_group: CallbackGroup | None = None,
        clock: Clock | None = None,
        autostart: bool = True,
    ) -> Timer:
        """Create a timer, on steady time unless a clock is given."""

        def call() -> None:
            with self.faults.contain(f"timer of {timer_period_sec:g} s"):
                callback()

        return super().create_timer(timer_period_sec, call, callback_group, clock or self._steady_clock, autostart)

    def create_subscription(
        self, msg_type: type[Any], topic: str, callback: Callable[[Any], object], *args: Any, **options: Any
    ) -> Subscription:
        """Create a subscription."""

        def take(message: Any) -> None:
            with self.faults.contain(topic):
                callback(message)

        return super().create_subscription(msg_type, topic, take, *args, **options)

    def create_service(
        self, srv_type: type[Any], srv_name: str, callback: Callable[[Any, Any], Any], *args: Any, **options: Any
    ) -> Service:
        """Create a service; a request whose callback fails is answered all the same."""

        def serve(request: Any, answer: Any) -> Any:
            with self.faults.contain(srv_name):
                return callback(request, answer)
            return messages.failure_answer(answer, "failed by an error of the program: see the log")

        service = super().create_service(srv_type, srv_name, serve, *args, **options)
        self.resolve_service_name(srv_name)
        return service

    def create_client(self, srv_type: type[Any], srv_name: str, *args: Any, **options: Any) -> Client:
        """Create a client of a service."""
        client = super().create_client(srv_type, srv_name, *args, **options)
        self.resolve_service_name(srv_name)
        return client

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> Any:
        """Set all parameters or none; what there is none of is refused by name, which rclpy leaves out."""
        for parameter in parameter_list:
            if not self.has_parameter(parameter.name):
                nearest = nearest_name(parameter.name, self._parameters)
                return messages.parameters_answer(f"parameter {quoted(parameter.name)[1:-1]}: not known here{nearest}")
        return super().set_parameters_atomically(parameter_list)

    def _keep_time_source(self, parameters: Sequence[Parameter]) -> Any:
        """Refuse another time source in flight: all stamps would change their meaning at once."""
        for parameter in parameters:
            if parameter.name == "use_sim_time" and parameter.value != self.get_parameter("use_sim_time").value:
                return messages.parameters_answer(
                    f"use_sim_time = {quoted(parameter.value)}: cannot change while the node runs; give it at the start"
                )
        return messages.parameters_answer()


def run(make_node: Callable[[], ProgramNode], arguments: Sequence[str] | None = None) -> int:
    """Run one node until SIGINT, SIGTERM, SIGHUP or its own `done`; return the process's exit code.

    rclpy's own signal handlers close the context under the running callbacks, after which nothing can be published;
    ours only take a note. Then the node shuts down while its callbacks go on. A second signal does not shorten that,
    but for a SIGINT: after it only `finish` is called. SIGHUP is left alone where it is ignored, as nohup wants it.
    The handlers of before are back when this returns.
    """
    arguments = list(sys.argv if arguments is None else arguments)
    with _signals() as signals:
        try:
            given = read_given(arguments)  # before rcl does, which waits for ever for what a pipe says
            rest = remove_ros_args(arguments)[1:]
            if {"-h", "--help"} & set(rest):
                print(_usage(make_node, arguments))
                return 0
            if rest:
                return _refuse(_misplaced(rest[0]))
            rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        except FlatsatError as error:
            return _refuse(str(error))
        except rclpy_implementation.UnknownROSArgsError as error:
            return _refuse(f"ROS does not take {error}: must be {', '.join(_ROS_ARGUMENTS)} with what belongs to it")
        except RuntimeError as error:  # RCLError: a value or a file that ROS does not take
            return _refuse(re.sub(r",? at \S+:\d+", "", reason_of(error)))  # without places in ROS's source
        try:
            with giving(given):
                node = make_node()
        except (FlatsatError, OSError, NameValidationException, rclpy_implementation.RCLError) as error:
            rclpy.try_shutdown()
            return _refuse(reason_of(error))
        executor: Executor = EventsExecutor()
        executor.add_node(node)
        try:
            while not signals and not node.done:
                spin_once(executor, node.faults, _PATIENCE)
            node.tell_unused()
            _shut_down(node, executor, signals)
        finally:
            with node.faults.contain("finish"):
                node.finish()
            executor.shutdown()
            node.destroy_node()
            rclpy.try_shutdown()
        return node.exit_code


def spin_once(executor: Executor, faults: Faults, patience: float) -> None:
    """Let callbacks run for at most some seconds; what rclpy's own services and futures raise ends here."""
    with faults.contain("callback"):
        executor.spin_once(timeout_sec=patience)


def _shut_down(node: ProgramNode, executor: Executor, signals: Sequence[int]) -> None:
    """Let the node shut down, saying once a second what is left, until it has, its time is over or SIGINT comes."""
    begun, said = time.monotonic(), -_PROGRESS_PERIOD
    ended_by = len(signals)
    with node.faults.contain("shutdown"):
        node.begin_shutdown()
        while not node.is_shut_down() and signal.SIGINT not in signals[ended_by:]:
            elapsed = time.monotonic() - begun
            if elapsed > node.shutdown_time_max:
                node.get_logger().error(f"not shut down within {node.shutdown_time_max:g} s: ends all the same")
                return
            if elapsed - said >= _PROGRESS_PERIOD:
                said = elapsed
                if text := node.shutdown_progress():
                    node.get_logger().info(text)
            spin_once(executor, node.faults, _SHUTDOWN_PATIENCE)


@contextmanager
def _signals() -> Iterator[Sequence[int]]:
    """Note the signals that end a program, in the order in which they come; put the old handlers back at the end."""
    noted: list[int] = []
    ending = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        ending.append(signal.SIGHUP)

    def note(number: int, _: FrameType | None) -> None:
        noted.append(number)

    before = {number: signal.signal(number, note) for number in ending}
    try:
        yield noted
    finally:
        for number, old in before.items():
            signal.signal(number, signal.SIG_DFL if old is None else old)


def _misplaced(argument: str) -> str:
    """Return why an argument that ROS would ignore is refused, and what was meant."""
    if ":=" in argument:
        return f"argument {quoted(argument)}: must stand behind --ros-args: --ros-args -p {quoted(argument)[1:-1]}"
    meant = nearest_name(argument, ("--ros-args", *_ROS_ARGUMENTS))
    return f"argument {quoted(argument)}: must be --help, or --ros-args and behind it what ROS takes{meant}"


def _usage(make_node: Callable[[], ProgramNode], arguments: Sequence[str]) -> str:
    """Return what --help says: what the program does, and where to find its parameters."""
    purpose = (inspect.getmodule(make_node) or make_node).__doc__ or ""
    return (
        f"usage: {Path(arguments[0]).name} [--ros-args [-p NAME:=VALUE ...] [--params-file FILE] [-r FROM:=TO ...]]\n\n"
        f"{purpose.strip()}\n\nParameters, topics and services: docs/interfaces.md"
    )


def _refuse(reason: str) -> int:
    print(f"error: {reason}", file=sys.stderr)
    return 2

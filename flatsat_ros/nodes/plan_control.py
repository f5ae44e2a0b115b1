"""The plan of a controller: the parameter that names it, the services that start, pause, resume and abort it."""

from __future__ import annotations

import pickle
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from flatsat_ros.base.errors import FlatsatError, quoted
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.tick import Report
from flatsat_ros.nodes.flight_report import ThrottledLog
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.parameters import declare
from flatsat_ros.nodes.ros.runtime import ProgramNode
from flatsat_ros.plans import gathering, prepared
from flatsat_ros.plans.gathering import Move
from flatsat_ros.plans.performance import Performance
from flatsat_ros.plans.prepared import PreparedPlan

_PARAMETER = "plan"
_LOOK_PERIOD = 0.1  # s, at the process that verifies


def declare_plan(node: Node) -> Path | None:
    """Declare the parameter; return the path of the plan file given at the start, None without one."""
    meaning = "plan file to be flown by the services plan/start and so on; empty for none"
    return _path_of(declare(node, _PARAMETER, "", meaning, changeable=True))


def _path_of(value: str) -> Path | None:
    """Return the path that a value of the parameter means.

    Raises:
        FlatsatError: it begins with the home of a user who is not there.
    """
    try:
        return Path(value).expanduser() if value else None
    except RuntimeError as error:
        raise FlatsatError(f"parameter {_PARAMETER} = {value!r}: must be the path of a plan file ({error})") from error


class PlanControl:
    """Loads plans, and lets people fly them.

    A plan that is set while the node runs is read and proved by a process of its own.
    """

    def __init__(
        self,
        node: ProgramNode,
        path: Path | None,
        robots: Sequence[str],
        pilot: Pilot,
        certificate: str,
        clock: Callable[[], float],
        log: ThrottledLog,
    ) -> None:
        """Load the plan given at the start, if any.

        Args:
            node: whose parameter and services they are.
            path: of the plan file given at the start; None without one.
            robots: names of the pilot's drones.
            pilot: flies them.
            certificate: name or path of its certificate.
            clock: the pilot's time, s.
            log: tells of what is refused.

        Raises:
            FlatsatError: the plan is not valid, or not for these drones or this certificate.
        """
        self._node, self._robots, self._pilot, self._clock, self._log = node, list(robots), pilot, clock, log
        self._certificate = certificate
        self._performance: Performance | None = None
        self._process: _Helper | None = None  # verifies a plan
        self._planning: _Helper | None = None  # plans how drones gather
        if path is not None:
            self._take(PreparedPlan.load(path, pilot.certificate))
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._begin)
        node.create_timer(_LOOK_PERIOD, self._look_at_process)
        for name in interfaces.PLAN_TRIGGERS:
            node.create_service(Trigger, name, self._serve(name))

    def look(self, now: float) -> list[Report]:
        """Go on with the plan at a tick, s; return what people should know."""
        return [] if self._performance is None else self._performance.look(now)

    @property
    def state(self) -> str:
        """What is done with which plan, for people; empty without a plan."""
        if self._process is not None:
            return "a plan is being verified"
        performance = self._performance
        return "" if performance is None else f"plan {performance.plan.name!r}: {performance.phase.value}"

    def close(self) -> None:
        """End the processes that verify and plan, if there are any."""
        for helper in (self._process, self._planning):
            if helper is not None:
                helper.end()
        self._process = self._planning = None

    def _take(self, plan: PreparedPlan) -> None:
        self._performance = Performance(plan, self._pilot, self._robots, self._plan_way)
        drones = ", ".join(drone.name for drone in plan.plan.drones)
        self._node.get_logger().info(f"plan {plan.plan.name!r} is proved, for {drones}: {plan.plan.duration:.1f} s")

    def _check(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        try:
            for parameter in parameters:
                if parameter.name == _PARAMETER:
                    if self._performance is not None and self._performance.is_busy:
                        raise FlatsatError(f"{self.state}: a plan can be set when none is flown; abort it first")
                    path = _path_of(parameter.value)
                    if path is not None and not path.is_file():
                        raise FlatsatError(f"plan = {quoted(parameter.value)}: must be the path of a plan file")
        except OSError as error:  # a name that is too long, a folder that may not be read
            return messages.parameters_answer(f"plan = {quoted(error.filename)}: {error.strerror}")
        except FlatsatError as error:
            return messages.parameters_answer(str(error))
        return messages.parameters_answer()

    def _begin(self, parameters: Sequence[Parameter]) -> None:
        """Let a process verify the plan that was set."""
        for parameter in parameters:
            if parameter.name == _PARAMETER:
                self.close()
                self._performance = None
                with self._node.faults.contain(_PARAMETER):
                    path = _path_of(parameter.value)
                    if path is not None:
                        self._verify(path)

    def _verify(self, path: Path) -> None:
        """Let a process read and prove a plan file.

        Raises:
            OSError: there is no room for its answer, or no process to be had.
        """
        self._process = _Helper(prepared.command(path, self._certificate))

    def _look_at_process(self) -> None:
        if self._process is None or self._process.runs:
            return
        with self._node.faults.contain(_PARAMETER):
            helper, self._process = self._process, None
            self._take(helper.answer())

    def _plan_way(self, move: Move) -> Callable[[], PreparedPlan | None]:
        """Let a process plan how drones gather."""
        if self._planning is not None:
            self._planning.end()
        try:
            helper = self._planning = _Helper(gathering.COMMAND, pickle.dumps(move))
        except OSError as error:
            raise FlatsatError(f"no process to plan it can be started: {error.strerror}") from error
        return lambda: None if helper.runs else helper.answer()

    def _serve(self, name: str) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        def serve(_: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
            try:
                if self._performance is None:
                    raise FlatsatError(self.state or "no plan is set: set the parameter plan")
                act = getattr(self._performance, name.rpartition("/")[2])
                messages.fill_answer(answer, True, act(self._clock()))
            except FlatsatError as error:
                text = f"{name} refused: {error}"
                messages.fill_answer(answer, False, text)
                self._log.refusals("plan", [text])
            except Exception as error:
                self._node.faults.note(name, error)
                messages.fill_answer(answer, False, f"{name} failed by an error of the program: see the log")
            return answer

        return serve


class _Helper:
    """A process that makes a plan ready, or makes one."""

    def __init__(self, command: Sequence[str], question: bytes = b"") -> None:
        """Start it.

        Args:
            command: its command line.
            question: what it reads from its standard input.

        Raises:
            OSError: there is no room for its answer, or no process to be had.
        """
        self._output = tempfile.TemporaryFile()  # noqa: SIM115 it is closed once the process has ended
        try:
            with tempfile.TemporaryFile() as given:
                given.write(question)
                given.seek(0)
                self._process = subprocess.Popen(command, stdin=given, stdout=self._output)
        except OSError:
            self._output.close()
            raise

    @property
    def runs(self) -> bool:
        """Whether it has no answer yet."""
        return self._process.poll() is None

    def answer(self) -> PreparedPlan:
        """Return the plan, once it has ended.

        Raises:
            FlatsatError: it is refused, or the process has failed.
        """
        with self._output:
            self._output.seek(0)
            return prepared.received(self._output)

    def end(self) -> None:
        """End it, whatever it does."""
        if self.runs:
            self._process.kill()
            self._process.wait()
        self._output.close()

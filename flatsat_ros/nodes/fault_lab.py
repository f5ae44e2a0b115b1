"""The node of `faults --live`: flies robots behind a fault relay, does to them what goes wrong, records the truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from rcl_interfaces.srv import SetParameters
from rclpy.executors import Executor
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from rclpy.task import Future
from std_srvs.srv import Empty, Trigger

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.nodes.conductor import MODE, Conductor
from flatsat_ros.nodes.fault_relay import UPSTREAM
from flatsat_ros.nodes.ros import cdr, interfaces, messages

CONTROLLER, RELAY = interfaces.CONTROLLER_NODE, "fault_relay"
_OLD = messages.NANOSECONDS // 2  # ns
_KINDS = {interfaces.EMERGENCY: Empty, interfaces.REBOOT: Trigger, "land": Trigger}


class FaultLab(Conductor):
    """A conductor that also knows the drones themselves, whose topics are below `sim/`."""

    def __init__(
        self, robots: Sequence[str], namespace: str, executor: Executor, deliver_signals: Callable[[], None]
    ) -> None:
        """Connect to the topics of the robots and of the drones, see `Conductor`."""
        super().__init__(robots, namespace, executor, deliver_signals)
        for robot in robots:
            for topic in (interfaces.POSE, interfaces.COMMAND):
                self.record(topic, topic.of(f"{UPSTREAM}/{robot}"))
        asked = [interfaces.service_of(robot, "land") for robot in robots]
        asked += [
            interfaces.drone_service_of(f"{UPSTREAM}/{robot}", name)
            for robot in robots
            for name in (interfaces.EMERGENCY, interfaces.REBOOT)
        ]
        self._askable = {name: self.create_client(_KINDS[name.rpartition("/")[2]], name) for name in asked}
        self._settable = {
            node: self.create_client(SetParameters, f"{node}/set_parameters") for node in (CONTROLLER, RELAY)
        }

    def missing(self) -> list[str]:
        """Return what is not there yet, see `Conductor`."""
        clients = [*self._askable.values(), *self._settable.values()]
        silent = [name for name in map(_truth, self._robots) if name not in self._newest]
        return super().missing() + silent + [client.srv_name for client in clients if not client.service_is_ready()]

    def heights(self) -> FloatArray:
        """Return the true height of each drone, (N,), m; nan if what was heard last is old."""
        poses = [cdr.pose_from_cdr(self._newest[_truth(robot)]) for robot in self._robots]
        return np.array([place[2] if self.now() - stamp < _OLD else np.nan for stamp, place, *_ in poses])

    def ask_landing(self, index: int) -> Future:
        """Ask the controller to land one robot."""
        return self._call(interfaces.service_of(self._robots[index], "land"))

    def ask_drone(self, index: int, name: str) -> Future:
        """Ask a drone for an emergency stop or a reboot."""
        return self._call(interfaces.drone_service_of(f"{UPSTREAM}/{self._robots[index]}", name))

    def _call(self, name: str) -> Future:
        answer: Future = self._askable[name].call_async(_KINDS[name.rpartition("/")[2]].Request())
        return answer

    def set_parameter(self, node: str, name: str, value: object) -> Future:
        """Ask CONTROLLER or RELAY to take another value of a parameter."""
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        answer: Future = self._settable[node].call_async(request)
        return answer

    def refusal(self, answer: Future) -> str:
        """Return why something was refused, nothing if it was not; the answer must be there."""
        result = answer.result()
        if isinstance(result, SetParameters.Response):
            return messages.refusal_of_parameters(result)
        return super().refusal(answer)

    def serialized(self, trajectory: Trajectory) -> bytes:
        """Return the message of a trajectory that begins at once, as it goes over the wire."""
        return bytes(serialize_message(messages.message_from_trajectory(trajectory, 0)))

    def send_serialized(self, index: int, data: bytes) -> None:
        """Send a serialised trajectory to one robot."""
        self._trajectories[index].publish(data)

    def truth(self) -> tuple[FloatArray, FloatArray]:
        """Return times (M,), s, and true positions (M, N, 3), m, of the drones so far."""
        paths = [self.poses(f"{UPSTREAM}/{robot}") for robot in self._robots]
        times = paths[0][:, 0]
        places = [np.stack([np.interp(times, path[:, 0], path[:, 1 + k]) for k in range(3)], axis=-1) for path in paths]
        return times, np.stack(places, axis=1)

    def thrusts(self, vehicle: VehicleProfile, since: float) -> FloatArray:
        """Return the largest thrust (N,), m/s^2, that each drone was sent since a time on the record's clock, s."""
        largest = []
        for robot in self._robots:
            sent = self.commands(f"{UPSTREAM}/{robot}", vehicle)
            largest.append(max((row[1] for row in sent if row[0] >= since), default=0.0))
        return np.array(largest)

    def modes(self) -> list[Mode]:
        """Return the newest flight mode of each robot."""
        return [Mode(int(self.ticks(robot)[-1, 1 + MODE])) for robot in self._robots]


def _truth(robot: str) -> str:
    """Return the topic of a drone's own poses."""
    return interfaces.POSE.of(f"{UPSTREAM}/{robot}")

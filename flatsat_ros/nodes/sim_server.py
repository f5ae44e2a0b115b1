"""Simulated Crazyflies in the place of crazyswarm2's server: its node name, services, topics and parameters.

Scripts of crazyflie_py run with it as they are, where crazyflie_interfaces is installed; without it there is what
standard types can say. It simulates what `sim_drone` simulates, and takes its parameters.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from itertools import groupby
from typing import Any, NamedTuple

from geometry_msgs.msg import TransformStamped
from rclpy.publisher import Publisher

from flatsat_ros.crazyflie.crazyflies_yaml import Robot
from flatsat_ros.crazyflie.wire import Backend
from flatsat_ros.nodes import crazyswarm
from flatsat_ros.nodes.ros import interfaces, server_messages
from flatsat_ros.nodes.ros.parameters import declare
from flatsat_ros.nodes.ros.runtime import run
from flatsat_ros.nodes.server_logging import ServerLogging
from flatsat_ros.nodes.server_parameters import ServerParameters
from flatsat_ros.nodes.sim_drone import Measured, SimDrone
from flatsat_ros.sim.proximity import Proximity


class _Together(NamedTuple):
    """A topic of all drones' poses.

    Attributes:
        publisher: of it.
        make: its message, given the stamp, ns, and name, position and quaternion of each drone.
    """

    publisher: Publisher
    make: Callable[..., Any]


class SimServer(SimDrone):
    """A SimDrone that offers besides what crazyswarm2's server offers, and what motion capture publishes."""

    program = interfaces.SIM_SERVER_NODE
    proximity = Proximity()

    def declare_more(self, robots: Sequence[Robot], pose_rate: float) -> None:
        """Declare the parameters of crazyswarm2's server; offer logging, and the poses of all drones together."""
        rate = declare(self, "odom_rate", 0.0, "odometries per second; 0: none", unit="Hz", bounds=(0.0, 100.0))
        # by what it offers the server of cflib is known, see `backends`
        self.backend = Backend.CPP if crazyswarm.services() is None else Backend.CFLIB
        ServerParameters(self, robots, self.drones)
        logging = ServerLogging(self, self.drones)
        for drone in self.drones if rate > 0.0 else ():
            logging.add_odometry(drone, rate)
        self._together = []
        if (capture := _installed("motion_capture_tracking_interfaces.msg")) is not None:
            kind, qos = capture.NamedPoseArray, interfaces.named_poses_qos(pose_rate)
            make = partial(server_messages.named_poses_message, kind, capture.NamedPose)
            self._together.append(_Together(self.create_publisher(kind, interfaces.NAMED_POSES, qos), make))
        if (transforms := _installed("tf2_msgs.msg")) is not None:
            kind = transforms.TFMessage
            make = partial(server_messages.transforms_message, kind, TransformStamped)
            self._together.append(_Together(self.create_publisher(kind, interfaces.TF, interfaces.TF_QOS), make))

    def publish_measured(self, measured: Sequence[Measured]) -> None:
        """Publish poses one by one, and together where somebody listens."""
        super().publish_measured(measured)
        wanted = [topic for topic in self._together if topic.publisher.get_subscription_count() > 0]
        for stamp, poses in groupby(measured, lambda one: one.stamp) if wanted else ():
            named = [(self.robots[one.robot], one.position, one.quaternion) for one in poses]
            for topic in wanted:
                topic.publisher.publish(topic.make(stamp, named))


def _installed(module: str) -> Any | None:
    """Return a module of messages, None where it is not installed."""
    try:
        return import_module(module)
    except ModuleNotFoundError:
        return None


def main(argv: Sequence[str] | None = None) -> int:
    """Run the simulated drones."""
    return run(SimServer, argv)


if __name__ == "__main__":
    sys.exit(main())

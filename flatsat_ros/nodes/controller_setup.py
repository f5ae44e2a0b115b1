"""What a controller is given when it starts: which robots it flies, and by which certificate, profiles and policy."""

from __future__ import annotations

from typing import NamedTuple

from rclpy.node import Node

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, Certificate, load_certificate
from flatsat_ros.crazyflie.fit import LINK_DELAY, another, require_fit
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.crazyflie.wire import YawMode
from flatsat_ros.flight.policy import Policy
from flatsat_ros.nodes.policy import declare_policy
from flatsat_ros.nodes.ros.parameters import (
    declare,
    declare_robots,
    declare_vehicles,
    declare_yaw_mode,
)


class Setup(NamedTuple):
    """What does not change while a controller runs.

    Attributes:
        robots: names of the N robots.
        vehicles: their profiles.
        certificate: what is proved of the loop; it fits all of them.
        certificate_name: by which it is found, or the path of its file.
        yaw_mode: what the yaw of a command means.
        policy: the figures of the flight layer.
        takeoff_height: how high a take-off without a goal leads, m.
        world: frame_id of poses, goals and trajectories.
    """

    robots: list[str]
    vehicles: list[VehicleProfile]
    certificate: Certificate
    certificate_name: str
    yaw_mode: YawMode
    policy: Policy
    takeoff_height: float
    world: str


def declare_setup(node: Node) -> Setup:
    """Declare the parameters and return what they say.

    Raises:
        FlatsatError: a file is missing or not valid, or the certificate does not fit a vehicle or the link.
    """
    known = declare_robots(node)
    robots = [robot.name for robot in known]
    name = declare(node, "certificate", DEFAULT_CERTIFICATE, "certificate: packaged name or path of a YAML file")
    certificate = load_certificate(name)
    vehicles = declare_vehicles(node, known)
    yaw_mode = declare_yaw_mode(node)
    for robot, vehicle in zip(robots, vehicles, strict=True):
        if certificate.limits.thrust_max > vehicle.thrust_max:
            raise FlatsatError(
                f"certificate {certificate.name!r} allows a thrust of {certificate.limits.thrust_max:.4f} m/s^2, "
                f"but {robot}, vehicle {vehicle.name!r}, lifts {vehicle.thrust_max:.4f} m/s^2: must be at most that"
                + another(certificate, vehicle)
            )
    link_delay = declare(
        node, "link_delay", LINK_DELAY, "from a command to the drone: computer, radio", unit="s", bounds=(0.0, 0.5)
    )
    for robot, vehicle in zip(robots, vehicles, strict=True):
        require_fit(certificate, vehicle, link_delay, robot)
    policy = declare_policy(node, min(vehicle.dynamics.drag_z for vehicle in vehicles))
    height = declare(
        node, "takeoff_height", 0.5, "how high the takeoff service sends a drone", unit="m", bounds=(0.05, 100.0)
    )
    world = declare(node, "world_frame", "world", "frame_id of poses, goals and trajectories")
    return Setup(robots, vehicles, certificate, name, yaw_mode, policy, height, world)

"""The matrix of faults flies with the policy that the controller has by default."""

from __future__ import annotations

import pytest
import rclpy
from rclpy.node import Node

from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.falsification.faults.scene import VEHICLE, policy_of
from flatsat_ros.nodes.policy import declare_policy

pytestmark = pytest.mark.in_process


def test_the_policy_of_simulated_faults_is_the_controllers() -> None:
    rclpy.init(args=[])
    try:
        node = Node("policy")
        vehicle = load_vehicle(VEHICLE)
        assert declare_policy(node, vehicle.dynamics.drag_z) == policy_of(vehicle)
        node.destroy_node()
    finally:
        rclpy.shutdown()

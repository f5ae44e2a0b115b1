"""Simulated Crazyflies and their controller.

With parameters of your own: ros2 launch flatsat_ros simulation.launch.py params_file:=mine.yaml
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Start both nodes with the same file of parameters."""
    file = PathJoinSubstitution([FindPackageShare("flatsat_ros"), "config", "params", "simulation.yaml"])
    parameters = LaunchConfiguration("params_file")
    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=file, description="parameters of both nodes"),
            Node(
                package="flatsat_ros",
                executable="sim_drone",
                parameters=[parameters],
                output="screen",
                sigterm_timeout="30",  # s, as below
                sigkill_timeout="30",
            ),
            Node(
                package="flatsat_ros",
                executable="controller",
                parameters=[parameters],
                output="screen",
                sigterm_timeout="30",  # s: time to finish what it does with flying drones, instead of the usual 5 s
                sigkill_timeout="30",
            ),
        ]
    )

"""A lab with crazyswarm2: its server, started by its own launch file, and the controller.

    ros2 launch flatsat_ros crazyswarm2.launch.py crazyflies_yaml_file:=/path/to/crazyflies.yaml backend:=cpp

The other arguments of crazyswarm2's launch file (mocap, teleop, rviz, ...) can be given as well. Go through the check
list of docs/hardware.md before propellers are on. Ctrl-C stops both at once: land before, through the services.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Start crazyswarm2's server and the controller with the same drones and back end."""
    crazyswarm2 = FindPackageShare("crazyflie")
    file = PathJoinSubstitution([FindPackageShare("flatsat_ros"), "config", "params", "crazyswarm2.yaml"])
    drones, backend = LaunchConfiguration("crazyflies_yaml_file"), LaunchConfiguration("backend")
    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=file, description="parameters of the controller"),
            DeclareLaunchArgument(
                "crazyflies_yaml_file",
                default_value=PathJoinSubstitution([crazyswarm2, "config", "crazyflies.yaml"]),
                description="crazyswarm2's file of drones",
            ),
            DeclareLaunchArgument(
                "backend", default_value="cpp", choices=["cpp", "cflib"], description="of crazyswarm2's server"
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(PathJoinSubstitution([crazyswarm2, "launch", "launch.py"])),
                launch_arguments={"crazyflies_yaml_file": drones, "backend": backend}.items(),
            ),
            Node(
                package="flatsat_ros",
                executable="controller",
                parameters=[
                    LaunchConfiguration("params_file"),
                    {"crazyflies_yaml": drones, "backend": backend},
                ],
                output="screen",
                sigterm_timeout="30",  # s: time to finish what it does with flying drones, instead of the usual 5 s
                sigkill_timeout="30",
            ),
        ]
    )

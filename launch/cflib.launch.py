"""A lab without crazyswarm2: the controller, and cflib_bridge to real Crazyflies.

    ros2 launch flatsat_ros cflib.launch.py params_file:=mine.yaml

Go through the check list of docs/hardware.md before propellers are on. Ctrl-C stops both nodes at once; the bridge then
stops the drones or lets them sink, as its parameter on_shutdown says. Better land before, through the services.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Start both nodes with the same file of parameters."""
    file = PathJoinSubstitution([FindPackageShare("flatsat_ros"), "config", "params", "cflib.yaml"])
    parameters = LaunchConfiguration("params_file")
    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=file, description="parameters of both nodes"),
            Node(
                package="flatsat_ros",
                executable="cflib_bridge",
                parameters=[parameters],
                output="screen",
                sigterm_timeout="30",  # s: land_time, zero thrust and the notice that set-points stop, and to spare
                sigkill_timeout="30",
            ),
            Node(
                package="flatsat_ros",
                executable="controller",
                parameters=[parameters],
                output="screen",
                sigterm_timeout="30",
                sigkill_timeout="30",
            ),
        ]
    )

"""Every topic once: name, type, quality of service. Names are relative, `<robot>/...` below the node's namespace."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Log
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray


def _reliable(depth: int) -> QoSProfile:
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)


def _best_effort(depth: int) -> QoSProfile:
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)


def _latched(depth: int) -> QoSProfile:
    """The newest messages, kept for those who come later."""
    durability = DurabilityPolicy.TRANSIENT_LOCAL
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability)


@dataclass(frozen=True)
class Topic:
    """One topic of every robot.

    Attributes:
        suffix: name below the robot's.
        kind: message type.
        publish: quality of service of our publishers.
        subscribe: quality of service of our subscriptions; best effort where it must match every publisher.
    """

    suffix: str
    kind: type[Any]
    publish: QoSProfile
    subscribe: QoSProfile

    def of(self, robot: str) -> str:
        """Return the topic's name for one robot."""
        return f"{robot}/{self.suffix}"


POSE = Topic("pose", PoseStamped, _reliable(10), _best_effort(10))
GOAL = Topic("goal_pose", PoseStamped, _reliable(10), _reliable(10))
TRAJECTORY = Topic("trajectory", MultiDOFJointTrajectory, _reliable(10), _reliable(10))
COMMAND = Topic("cmd_vel_legacy", Twist, _reliable(1), _reliable(1))
BATTERY = Topic("battery", BatteryState, _reliable(10), _best_effort(10))
TELEMETRY = Topic("flatsat/telemetry", Float64MultiArray, _reliable(10), _reliable(10))


def status_topic(kind: type[Any]) -> Topic:
    """Return the topic on which crazyswarm2's server tells of a drone, of type crazyflie_interfaces' Status."""
    return Topic("status", kind, _reliable(10), _best_effort(10))


# set-points that crazyswarm2's server takes beside COMMAND, where crazyflie_interfaces is installed
FULL_STATE, POSITION, VELOCITY, HOVER = "cmd_full_state", "cmd_position", "cmd_velocity_world", "cmd_hover"


def setpoint_topic(suffix: str, kind: type[Any]) -> Topic:
    """Return the topic of set-points of a type of crazyflie_interfaces."""
    return Topic(suffix, kind, _reliable(1), _reliable(1))


# what crazyswarm2's server and motion capture publish of all drones together, where its types are installed
NAMED_POSES, TF = "/poses", "/tf"
TF_QOS = _reliable(100)
# as little as any of their senders offers
NAMED_POSES_SUBSCRIBE, TF_SUBSCRIBE = _best_effort(1), _best_effort(100)
ODOMETRY = Topic("odom", Odometry, _reliable(10), _best_effort(10))
# of a log block that a script asked for
LOG_BLOCK = _reliable(10)


def named_poses_qos(rate: float) -> QoSProfile:
    """Return the quality of service of NAMED_POSES at a rate, Hz: a subscriber may want to be told of late ones."""
    qos = _best_effort(1)
    qos.deadline = Duration(nanoseconds=round(1e9 / rate))
    return qos


# the log of all nodes in the domain
LOG = Topic("/rosout", Log, _latched(1000), _latched(1000))

# of the controller, in its namespace, not of a robot: what it is set to
SETUP = Topic("flatsat/setup", String, _latched(1), _latched(1))
# of the controller, too: why it refused a goal or a trajectory
REFUSALS = Topic("flatsat/refusals", String, _reliable(10), _reliable(10))
# and what is to be drawn, for RViz and recordings
MARKERS = Topic("flatsat/markers", MarkerArray, _reliable(1), _reliable(1))

# The life-cycle of a flight, as services `<robot>/flatsat/<name>` and `all/flatsat/<name>`: the prefix keeps them from
# clashing with those of crazyswarm2.
ALL = "all"
TRIGGERS = ("takeoff", "land", "hold", "hand_over")
ARM = "arm"
# of the controller, for all drones of a plan together
PLAN_TRIGGERS = ("plan/start", "plan/pause", "plan/resume", "plan/abort")


def service_of(robot: str, name: str) -> str:
    """Return the name of one robot's service, or of all robots' for ALL."""
    return f"{robot}/flatsat/{name}"


# services of the drone itself, named as crazyswarm2's server names them
EMERGENCY = "emergency"
REBOOT = "reboot"
# flight by the high-level commander, where crazyflie_interfaces is installed
TAKEOFF, LAND, GO_TO, NOTIFY = "takeoff", "land", "go_to", "notify_setpoints_stop"
UPLOAD, START = "upload_trajectory", "start_trajectory"
ADD_LOGGING, REMOVE_LOGGING = "add_logging", "remove_logging"


def drone_service_of(robot: str, name: str) -> str:
    """Return the name of a service of one drone, or of all for ALL."""
    return f"{robot}/{name}"


DIAGNOSTICS = "/diagnostics"
DIAGNOSTICS_KIND = DiagnosticArray
DIAGNOSTICS_QOS = _reliable(10)

# what the nodes that people start are called, unless they are renamed
CONTROLLER_NODE = "flatsat_controller"
SIM_DRONE_NODE = "sim_drone"
SIM_SERVER_NODE = "crazyflie_server"
BRIDGE_NODE = "cflib_bridge"
PLAYER_NODE = "mocap_player"
RECORDER_NODE = "flatsat_recorder"
CONSOLE_NODE = "flatsat_console"
NODES = (CONTROLLER_NODE, SIM_DRONE_NODE, SIM_SERVER_NODE, BRIDGE_NODE, PLAYER_NODE, RECORDER_NODE, CONSOLE_NODE)

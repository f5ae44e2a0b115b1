"""Parameters: declared with what they mean, their unit and range; read into plain values."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from enum import Enum
from typing import TypeVar, cast

from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException, ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from flatsat_ros.base.errors import FlatsatError, quoted, refusal
from flatsat_ros.base.files import located
from flatsat_ros.crazyflie.crazyflies_yaml import Robot, read_crazyflies
from flatsat_ros.crazyflie.vehicle import VehicleProfile, load_vehicle
from flatsat_ros.crazyflie.wire import YawMode
from flatsat_ros.nodes.ros import messages

E = TypeVar("E", bound=Enum)
# parameters below these are ours alone; of one name in a file for several nodes, nobody knows whose it is
_PREFIXES = ("robots", "robot_types")
# how much two names must have in common, 0 to 1, for one to be taken for a misspelling of the other, or to be shown
_NEAR, _FAR = 0.75, 0.4
# parameters that there were, and what is to be given in their place
_SUCCESSORS = {"ground_height": "floor"}
# what `ros2 param dump` writes for a parameter that is unset, as ROS reads it
_UNSET = "null"

T = TypeVar("T", bool, int, float, str, "list[str]", "list[float]")


def declare(
    node: Node,
    name: str,
    default: T,
    meaning: str,
    *,
    unit: str = "",
    bounds: tuple[float, float] | tuple[int, int] | None = None,
    changeable: bool = False,
) -> T:
    """Declare one parameter and return its value.

    Args:
        node: whose parameter it is.
        name: dotted lower case.
        default: its type is the parameter's type.
        meaning: one sentence for `ros2 param describe`.
        unit: of the value.
        bounds: smallest and largest valid value.
        changeable: may be set while the node runs.

    Raises:
        FlatsatError: the value given at start has the wrong type, is out of range or is an empty array.
    """
    descriptor = messages.parameter_descriptor(meaning, unit=unit, bounds=bounds, changeable=changeable)
    kind = Parameter.Type.from_parameter_value(default).name.lower().replace("_", " ")
    hint = "; it is written with a decimal point: 1.0, not 1" if kind == "double" else ""
    try:
        value = node.declare_parameter(name, default, descriptor).value
    except InvalidParameterTypeException as error:
        raise refusal(f"parameter {name}", _given(node, name), unit, f"of type {kind}{hint}") from error
    except InvalidParameterValueException as error:
        valid = f"from {bounds[0]} to {bounds[1]}" if bounds is not None else f"another value ({error})"
        raise refusal(f"parameter {name}", _given(node, name), unit, valid) from error
    except ParameterException as error:
        raise FlatsatError(f"parameter {name}: {error}") from error
    if value is None:  # what rclpy makes of an empty array, whatever the type of the parameter
        raise FlatsatError(f"parameter {name} = []: must be of type {kind} and not empty{hint}")
    return cast(T, value)


def _given(node: Node, name: str) -> object:
    """Return the value that a parameter was given at start, as far as it is known."""
    given = node._parameter_overrides.get(name)
    return None if given is None else given.value


def declare_choice(node: Node, name: str, valid: type[E], meaning: str) -> E:
    """Declare a parameter that is one of the words of an enum, the first by default, and return its member.

    Raises:
        FlatsatError: it is another word.
    """
    words = [member.value for member in valid]
    value = declare(node, name, words[0], f"{meaning}: {', '.join(words)}")
    if value not in words:
        raise refusal(f"parameter {name}", value, "", f"one of {', '.join(words)}")
    return valid(value)


def declare_yaw_mode(node: Node) -> YawMode:
    """Declare what the yaw on the wire means."""
    return declare_choice(node, "yaw_mode", YawMode, "the yaw on the wire, flightmode.stabModeYaw 0 or 1")


def declare_override(node: Node, name: str, meaning: str, unit: str = "") -> float | None:
    """Declare a per-robot floating-point parameter that is unset at first: the common one applies until it is set.

    The value null means unset, too: so a file that `ros2 param dump` wrote can be given again.

    Raises:
        FlatsatError: the value given at start is not a floating-point number.
    """
    text = f"{meaning}; unset: the common value applies"
    descriptor = messages.parameter_descriptor(text, unit=unit, changeable=True, may_be_unset=True)
    given = node._parameter_overrides.get(name)
    null = given is not None and given.value == _UNSET
    value = require_float_or_unset(name, node.declare_parameter(name, None, descriptor, ignore_override=null).value)
    if value is None and given is not None and not null:  # see declare
        raise FlatsatError(f"parameter {name} = []: must be a floating-point number, written with a decimal point")
    return value


def require_float_or_unset(name: str, value: object) -> float | None:
    """Return a float, or None for an unset parameter.

    Raises:
        FlatsatError: it is something else.
    """
    if value is None or (isinstance(value, float)):
        return value
    raise refusal(f"parameter {name}", value, "", "a floating-point number, written with a decimal point")


def declare_robots(node: Node) -> list[Robot]:
    """Declare whose node this is: by names, which stand 1 m apart along x, or by the user's crazyflies.yaml.

    Raises:
        FlatsatError: a name is no ROS name or given twice, or the file is not valid.
    """
    names = declare(node, "robot_names", ["cf1"], "names of the drones, the prefix of their topics")
    path = declare(node, "crazyflies_yaml", "", "crazyswarm2's crazyflies.yaml: its enabled robots replace robot_names")
    if not path:
        require_robot_names(names)
        return [Robot(name, "", (float(i), 0.0, 0.0), "") for i, name in enumerate(names)]
    robots = read_crazyflies(path, node.get_logger().info)
    try:
        require_robot_names([robot.name for robot in robots])
    except FlatsatError as error:
        raise located(path, error) from error
    return robots


def declare_vehicles(node: Node, robots: Sequence[Robot]) -> list[VehicleProfile]:
    """Declare what each robot is, and return their profiles: its own over that of its type over the common one.

    Raises:
        FlatsatError: a profile is not found or not valid.
    """
    kind = "packaged name or path of a YAML file"
    common = declare(node, "vehicle", "cf21", f"vehicle profile: {kind}")
    types = {
        name: declare(node, f"robot_types.{name}.vehicle", "", f"vehicle profile of type {name}; empty: the common one")
        for name in sorted({robot.kind for robot in robots if robot.kind})
    }
    profiles = []
    for robot in robots:
        own = declare(node, f"robots.{robot.name}.vehicle", "", "vehicle profile; empty: that of its type")
        profiles.append(load_vehicle(own or types.get(robot.kind) or common))
    return profiles


def require_known_parameters(node: Node) -> None:
    """Refuse parameters that were given but not declared; called when all are, before the node acts.

    ROS ignores them, and a drone would fly otherwise than was meant. A file of parameters may serve several nodes: a
    name that is neither below one of our prefixes nor near that of a parameter is told and ignored.

    Raises:
        FlatsatError: names the parameter and its successor, or the nearest that is known.
    """
    # with the letters as they should be; a typing error in these is found, too
    known = {name.lower(): name for name in node._parameters}
    for name in node._parameter_overrides:  # rclpy shows given but undeclared parameters nowhere else
        if node.has_parameter(name):
            continue
        if name in _SUCCESSORS and node.has_parameter(_SUCCESSORS[name]):
            raise FlatsatError(f"parameter {name}: there is none any more; give {_SUCCESSORS[name]}")
        ours = name.split(".")[0] in _PREFIXES
        near = difflib.get_close_matches(name.lower(), known, n=1, cutoff=_FAR if ours else _NEAR)
        if ours or near:
            nearest = f"; the nearest is {known[near[0]]}" if near else ""
            raise FlatsatError(f"parameter {quoted(name)[1:-1]}: not known here{nearest}")
        node.get_logger().warning(f"parameter {quoted(name)[1:-1]} is not known here: ignored")


def declare_robot_name(node: Node, meaning: str) -> str:
    """Declare the name of the one robot that a node is about.

    Raises:
        FlatsatError: it is not a ROS name, or means all robots.
    """
    name = declare(node, "robot_name", "cf1", meaning)
    require_robot_names([name])
    return name


def require_robot_names(names: Sequence[str]) -> None:
    """Refuse names of robots that cannot be part of a topic name.

    Raises:
        FlatsatError: one is not a ROS name or means all robots, or one is given twice.
    """
    for name in names:
        plain = name.replace("_", "a")
        if not (plain.isascii() and plain.isalnum() and not plain[0].isdigit()):
            raise refusal(
                "robot name",
                name,
                "",
                "letters, digits and underscores, the first a letter, as ROS wants names of topics",
            )
    if "all" in names:
        raise refusal("robot name", "all", "", "another: this one stands for all robots")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise refusal("robot name", twice[0], "", "given once: names differ")

"""Stand-ins for the packages of messages that are not installed everywhere: what nodes read and write of them.

Plain classes with the fields of crazyswarm2's interfaces: no ROS can send them, but all that is done with them can be
done. The real ones are used by `make test-crazyswarm2`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Pose, Twist, Vector3
from std_msgs.msg import Header


def _kind(name: str, constants: dict[str, int] | None = None, /, **fields: Callable[[], Any]) -> type:
    """Return a class of messages with default values, which refuses other fields."""

    def begin(self: Any, **values: Any) -> None:
        assert set(values) <= set(fields), set(values) - set(fields)
        for field, default in fields.items():
            setattr(self, field, values[field] if field in values else default())

    return type(name, (), {"__init__": begin, "__slots__": tuple(fields), **(constants or {})})


def _service(name: str, request: dict[str, Callable[[], Any]], **response: Callable[[], Any]) -> type:
    parts = {"Request": _kind(f"{name}_Request", **request), "Response": _kind(f"{name}_Response", **response)}
    return type(name, (), parts)


_RISE: dict[str, Callable[[], Any]] = {"group_mask": int, "height": float, "duration": Duration}
_WAY: dict[str, Callable[[], Any]] = {"relative": bool, "goal": Point, "yaw": float, "duration": Duration}
_START: dict[str, Callable[[], Any]] = {"trajectory_id": int, "timescale": float, "reversed": bool, "relative": bool}
_POLYNOMIALS = {f"poly_{axis}": list for axis in ("x", "y", "z", "yaw")}
_STATUS = {"supervisor_info": int, "battery_voltage": float, "pm_state": int}
_MASK = {"group_mask": int}

MODULES: dict[str, list[type]] = {
    "crazyflie_interfaces.srv": [
        _service("Arm", {"arm": bool}),
        _service("Takeoff", _RISE),
        _service("Land", _RISE),
        _service("GoTo", {**_MASK, **_WAY}),
        _service("NotifySetpointsStop", {**_MASK, "remain_valid_millisecs": int}),
        _service("UploadTrajectory", {"trajectory_id": int, "piece_offset": int, "pieces": list}),
        _service("StartTrajectory", {**_MASK, **_START}),
        _service("AddLogging", {"topic_name": str, "frequency": int, "vars": list}, success=bool),
        _service("RemoveLogging", {"topic_name": str}, success=bool),
    ],
    "crazyflie_interfaces.msg": [
        _kind("FullState", header=Header, pose=Pose, twist=Twist, acc=Vector3),
        _kind("Position", header=Header, x=float, y=float, z=float, yaw=float),
        _kind("VelocityWorld", header=Header, vel=Vector3, yaw_rate=float),
        _kind("Hover", header=Header, vx=float, vy=float, yaw_rate=float, z_distance=float),
        _kind("TrajectoryPolynomialPiece", **_POLYNOMIALS, duration=Duration),
        _kind("LogDataGeneric", header=Header, timestamp=int, values=list),
        _kind("Status", {"PM_STATE_BATTERY": 0, "PM_STATE_LOW_POWER": 3}, header=Header, **_STATUS),
    ],
    "motion_capture_tracking_interfaces.msg": [
        _kind("NamedPose", name=str, pose=Pose),
        _kind("NamedPoseArray", header=Header, poses=list),
    ],
    "tf2_msgs.msg": [_kind("TFMessage", transforms=list)],
}


def install(patch: pytest.MonkeyPatch) -> dict[str, ModuleType]:
    """Put the stand-ins where the packages would be, for as long as the patch lasts; return their modules by name."""
    modules = {}
    for name, kinds in MODULES.items():
        package, module = ModuleType(name.partition(".")[0]), ModuleType(name)
        for kind in kinds:
            setattr(module, kind.__name__, kind)
        patch.setitem(sys.modules, package.__name__, sys.modules.get(package.__name__, package))
        patch.setitem(sys.modules, name, module)
        modules[name] = module
    return modules

"""References computed before a flight: smooth paths through way-points, and proved plans. Numpy, scipy and Clarabel."""

from typing import TYPE_CHECKING

from flatsat_ros._lazy import lazy_names

if TYPE_CHECKING:
    from flatsat_ros.planning.improvement import rounds
    from flatsat_ros.planning.inputs import Wishes, read_mission
    from flatsat_ros.planning.mission import Asked, Mission
    from flatsat_ros.planning.planner import Round, plan
    from flatsat_ros.planning.spline import spline_through
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "Asked": "mission",
            "Mission": "mission",
            "Round": "planner",
            "Wishes": "inputs",
            "plan": "planner",
            "read_mission": "inputs",
            "rounds": "improvement",
            "spline_through": "spline",
        },
    )

__all__ = [
    "Asked",
    "Mission",
    "Round",
    "Wishes",
    "plan",
    "read_mission",
    "rounds",
    "spline_through",
]

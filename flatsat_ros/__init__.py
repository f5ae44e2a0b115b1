"""Certified saturated control of quadcopters in the flat output space, over ROS 2.

Poses come in, an explicit law answers with thrust, roll and pitch, and what makes the answer trustworthy was computed
beforehand and travels in one YAML file, the certificate. This is what a script or a notebook imports; examples/ shows
whole programs. Each name is imported from its room when it is first used.

Stable within a major version, arguments and methods included: `InputSet`, `input_from_acceleration`,
`acceleration_from_input`, `Certificate` (`load`, `save`, `verify`), `load_certificate`, `load_vehicle`, `FlatsatError`.

Provisional, a change gets a line in the changelog: `Controller`, `Tuning`, `Pilot`, `Policy`, `Trajectory`,
`SimulatedFleet`, `fly`, `Plan`, `plan`, `read_mission`, and whatever is imported from a room itself. The rooms, and
which may know which, are drawn in docs/architecture.md and stated by test/test_layering.py.
"""

from typing import TYPE_CHECKING

from flatsat_ros._lazy import lazy_names
from flatsat_ros._version import __version__

if TYPE_CHECKING:
    from flatsat_ros.base import FlatsatError
    from flatsat_ros.certificate import Certificate, load_certificate
    from flatsat_ros.crazyflie import load_vehicle
    from flatsat_ros.flight import Pilot, Policy, Trajectory
    from flatsat_ros.law import Controller, InputSet, Tuning, acceleration_from_input, input_from_acceleration
    from flatsat_ros.planning import plan, read_mission
    from flatsat_ros.plans import Plan
    from flatsat_ros.sim import SimulatedFleet, fly
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "Certificate": "certificate",
            "Controller": "law",
            "FlatsatError": "base",
            "InputSet": "law",
            "Pilot": "flight",
            "Plan": "plans",
            "Policy": "flight",
            "SimulatedFleet": "sim",
            "Trajectory": "flight",
            "Tuning": "law",
            "acceleration_from_input": "law",
            "fly": "sim",
            "input_from_acceleration": "law",
            "load_certificate": "certificate",
            "load_vehicle": "crazyflie",
            "plan": "planning",
            "read_mission": "planning",
        },
    )

__all__ = [
    "Certificate",
    "Controller",
    "FlatsatError",
    "InputSet",
    "Pilot",
    "Plan",
    "Policy",
    "SimulatedFleet",
    "Trajectory",
    "Tuning",
    "__version__",
    "acceleration_from_input",
    "fly",
    "input_from_acceleration",
    "load_certificate",
    "load_vehicle",
    "plan",
    "read_mission",
]

"""A plan made ready for flight in a process of its own: reading and proving it must not delay a tick.

`python -m flatsat_ros.plans.prepared FILE CERTIFICATE` writes to its standard output what `received` reads.
"""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate, load_certificate
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.plans.laps import laps_of
from flatsat_ros.plans.pacing import change_duration
from flatsat_ros.plans.plan import Plan
from flatsat_ros.plans.tubes import require_tubes


@dataclass(frozen=True, eq=False)
class PreparedPlan:
    """A verified plan with what its flight needs.

    Attributes:
        plan: verified.
        references: by drone, from time 0 on.
        stop: how long all take to stand still, s.
        start: how long they take to set out again, s.
    """

    plan: Plan
    references: Mapping[str, Trajectory]
    stop: float
    start: float

    @classmethod
    def of(cls, plan: Plan) -> PreparedPlan:
        """Make a verified plan ready."""
        references = {drone.name: plan.trajectory(drone.name) for drone in plan.drones}
        ways = list(references.values())
        if plan.laps is not None:  # a change of pace looks the same in every lap
            ways = [laps_of(drone.curve.trajectory(), 2) for drone in plan.drones]
        stop, start = (change_duration(ways, plan.bounds, plan.limits, stops=stops) for stops in (True, False))
        return cls(plan, references, stop, start)

    @classmethod
    def load(cls, path: str | os.PathLike[str], certificate: Certificate) -> PreparedPlan:
        """Read a plan, verify it and make it ready.

        Raises:
            FlatsatError: see `Plan.load`; or it was made for another certificate.
        """
        plan = Plan.load(path)
        require_tubes(plan, certificate)
        return cls.of(plan)


def command(path: Path, certificate: str) -> list[str]:
    """Return the command line of the process that prepares a plan for a certificate, by its name or path."""
    return [sys.executable, "-m", "flatsat_ros.plans.prepared", str(path), certificate]


def received(output: BinaryIO) -> PreparedPlan:
    """Return what that process has written.

    Raises:
        FlatsatError: the plan was refused, or the process has failed.
    """
    try:
        found = pickle.load(output)
    except Exception as error:
        raise FlatsatError("the plan could not be prepared: its process failed, see its output above") from error
    if not isinstance(found, PreparedPlan):
        raise FlatsatError(str(found))
    return found


def main(arguments: Sequence[str]) -> None:
    """Prepare the plan that is named, for the certificate that is named."""
    path, certificate = arguments
    try:
        found: PreparedPlan | str = PreparedPlan.load(path, load_certificate(certificate))
    except FlatsatError as error:
        found = str(error)
    pickle.dump(found, sys.stdout.buffer)


if __name__ == "__main__":
    # under its own name, so that classes are found where `received` looks for them
    from flatsat_ros.plans import prepared

    prepared.main(sys.argv[1:])

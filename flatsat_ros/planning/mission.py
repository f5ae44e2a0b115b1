"""What is to be planned: drones with way-points, and the limits that their references keep."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from flatsat_ros.base.arrays import FloatArray, finite_array
from flatsat_ros.base.errors import (
    FlatsatError,
    refusal,
    require,
    require_fields,
    require_not_negative,
    require_number,
    require_positive,
)
from flatsat_ros.certificate.flight import FlightSection
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.plans import Bounds, Box, Curve, Tube, curve
from flatsat_ros.plans.drone import require_name
from flatsat_ros.plans.laps import require_laps
from flatsat_ros.plans.obstacles import require_distinct
from flatsat_ros.plans.plan import require_downwash

_FARTHEST = curve.FARTHEST / 1e9  # m from the origin, along each axis
_APART = 1e-3  # m: way-points that follow each other are at least so far apart, or a leg has no length
_DURATION = 3600.0  # s, at most


@dataclass(frozen=True, eq=False)
class Asked:
    """One drone of a mission.

    Attributes:
        name: the robot's.
        waypoints: (W, 3) m, world frame, W >= 2; the drone rests at the first and at the last.
        body: radius, m, in the downwash metric.
        yaw: held, rad.
        given: a reference from elsewhere, whose path is kept; its ends are the way-points then.
        radii: (W,) m, within which the way-points are passed; None for all exactly. Start and goal always are.

    Raises:
        FlatsatError: the name is no robot's, a number is not finite or outside its range, or a shape is wrong.
    """

    name: str
    waypoints: FloatArray
    body: float = 0.15
    yaw: float = 0.0
    radii: FloatArray | None = None
    given: Curve | None = None

    @classmethod
    def following(cls, name: str, given: Curve, body: float, yaw: float = 0.0) -> Asked:
        """Return a drone that follows a given reference.

        Args:
            name: the robot's.
            given: the reference.
            body: radius, m, in the downwash metric.
            yaw: held, rad, counter-clockwise.

        Raises:
            FlatsatError: as the class.
        """
        return cls(name, np.array([given.points[0], given.points[-1]]) * 1e-9, body, yaw, given=given)

    @property
    def places(self) -> FloatArray:
        """(K, 3) m, in whose convex hull it is if it goes straight from way-point to way-point, or as given."""
        return self.waypoints if self.given is None else np.array(self.given.points) * 1e-9

    def __post_init__(self) -> None:
        require_name(self.name)
        require_fields(self, require_positive, body="m")
        require_fields(self, require_number, yaw="rad")
        waypoints = finite_array(f"way-points of {self.name}", self.waypoints, 3)
        if waypoints.ndim != 2 or len(waypoints) < 2:
            raise refusal(f"shape of the way-points of {self.name}", waypoints.shape, "", "(W, 3) with W >= 2")
        farthest = float(np.abs(waypoints).max())
        require(farthest <= _FARTHEST, f"a way-point of {self.name}", farthest, "m", f"within {_FARTHEST:g} m")
        object.__setattr__(self, "waypoints", np.round(waypoints, 9))  # nanometres, as in a plan
        if self.radii is not None:
            radii = finite_array(f"radii of {self.name}", self.radii)
            require(radii.shape == (len(waypoints),), "number of radii", radii.shape, "", "one for each way-point")
            require(float(radii.min()) >= 0.0, f"smallest radius of {self.name}", float(radii.min()), "m", "at least 0")
            ends = [float(radii[0]), float(radii[-1])]
            require(ends == [0.0, 0.0], f"radii of start and goal of {self.name}", ends, "m", "0: both are met exactly")
            object.__setattr__(self, "radii", np.round(radii, 9))

    @property
    def allowed(self) -> FloatArray:
        """(W,) m, within which the way-points are passed; 0 for exactly."""
        return np.zeros(len(self.waypoints)) if self.radii is None else self.radii


@dataclass(frozen=True, eq=False)
class Mission:
    """What is asked of all drones.

    Attributes:
        name: of the plan.
        drones: with equally many way-points each, which all pass at the same times.
        certificate: name of the certificate that it is planned for.
        limits: that certificate's input set.
        bounds: of each reference.
        tube: how far each drone may be off its reference.
        times: (W,) s, from 0, when the way-points are passed; None for as soon as possible.
        downwash: how many times as far drones keep apart along the vertical.
        clearance: kept beside bodies and tubes, m.
        obstacles: that all drones keep away from by body, tube and clearance.
        laps: how often references are flown that begin again where they end; None for from rest to rest.
        proves: the flight section that proves a smaller tube of references that ask for less than the bounds allow,
            which is what the plan then has, unless there are laps; None where all plans have the tube above.

    Raises:
        FlatsatError: no reference can keep what is asked, as far as that can be seen without a search.
    """

    name: str
    drones: tuple[Asked, ...]
    certificate: str
    limits: InputSet
    bounds: Bounds
    tube: Tube
    times: FloatArray | None = None
    downwash: float = 2.0
    clearance: float = 0.0
    obstacles: tuple[Box, ...] = ()
    laps: int | None = None
    proves: FlightSection | None = None

    def __post_init__(self) -> None:
        require_fields(self, require_not_negative, clearance="m")
        require_fields(self, require_downwash, downwash="")
        self.bounds.within(self.limits)
        require(bool(self.drones), "number of drones", 0, "", "at least 1")
        counts = {drone.name: len(drone.waypoints) for drone in self.drones}
        require(len(counts) == len(self.drones), "names of the drones", [d.name for d in self.drones], "", "different")
        count = len(self.drones[0].waypoints)
        for name, other in counts.items():
            require(
                other == count, f"number of way-points of {name}", other, "", f"{count} as of {self.drones[0].name}"
            )
        if self.times is not None:
            times = finite_array("times of way-points", self.times)
            require(times.shape == (count,), "number of times", times.shape, "", f"{count}, one for each way-point")
            rising = bool((np.diff(times) > 0.0).all()) and times[0] == 0.0 and times[-1] <= _DURATION
            require(rising, "times of way-points", times.tolist(), "s", f"increasing from 0 to at most {_DURATION:g} s")
        if len({drone.given is None for drone in self.drones}) > 1 or (self.times is not None and self.is_given):
            raise FlatsatError("polynomials: must be given for all drones or for none, and without times")
        self._require_closed()
        for drone in self.drones:
            self._require_possible(drone)
            if drone.radii is not None and (len(self.drones) > 1 or self.obstacles):
                raise FlatsatError(f"radii of {drone.name}: must not be there beside other drones or obstacles")
        require_distinct(self.obstacles)
        self._require_apart()
        self._require_outside()

    @property
    def is_given(self) -> bool:
        """Whether the drones follow references from elsewhere."""
        return self.drones[0].given is not None

    @property
    def is_closed(self) -> bool:
        """Whether references begin again where they end."""
        return self.laps is not None

    @property
    def waypoints(self) -> FloatArray:
        """(N, W, 3) m."""
        return np.stack([drone.waypoints for drone in self.drones])

    @property
    def distances(self) -> FloatArray:
        """(N, N) m, that each two drones keep in the downwash metric; 0 for a drone and itself."""
        radii = np.array([drone.body + self.tube.radius for drone in self.drones])
        distances = radii[:, np.newaxis] + radii + self.clearance
        np.fill_diagonal(distances, 0.0)
        return np.asarray(distances)

    @property
    def reaches(self) -> FloatArray:
        """(N,) m, that each drone keeps away from obstacles in the downwash metric."""
        return np.array([drone.body + self.tube.radius + self.clearance for drone in self.drones])

    def _require_closed(self) -> None:
        """Refuse laps of ways that do not end where they begin."""
        if self.laps is None:
            return
        require_laps(self.laps)
        if self.is_given:
            raise FlatsatError("laps: must be of way-points, not of polynomials")
        require(len(self.drones[0].waypoints) > 2, "number of way-points of laps", 2, "", "at least 3")
        for drone in self.drones:
            apart = float(np.linalg.norm(drone.waypoints[-1] - drone.waypoints[0]))
            require(
                apart == 0.0, f"distance of the last way-point of {drone.name} from the first", apart, "m", "0 for laps"
            )

    def _require_possible(self, drone: Asked) -> None:
        """Refuse way-points outside the box, and two in a row at the same place."""
        for number, place in enumerate(drone.waypoints.tolist(), 1):
            for axis, value, low, high in zip("xyz", place, self.bounds.lower, self.bounds.upper, strict=True):
                if not low <= value <= high:
                    valid = f"from {low:.6g} to {high:.6g} m, in the box of the references"
                    raise refusal(f"{axis} of way-point {number} of {drone.name}", value, "m", valid)
        if drone.given is None and self.times is None:
            ways = np.linalg.norm(np.diff(drone.waypoints, axis=0), axis=1)
            if ways.min() < _APART and len(self.drones) == 1:
                number = int(ways.argmin()) + 2
                what = f"distance of way-point {number} of {drone.name} from the one before"
                raise refusal(what, float(ways.min()), "m", f"at least {_APART} m")

    def _require_apart(self) -> None:
        """Refuse two drones that are to be too near each other at the same way-point."""
        distances, stretch = self.distances, np.array([1.0, 1.0, self.downwash])
        for (i, first), (j, second) in itertools.combinations(enumerate(self.drones), 2):
            apart = np.linalg.norm((first.waypoints - second.waypoints) / stretch, axis=1)
            worst = int(apart.argmin())
            if apart[worst] < distances[i, j]:
                valid = f"at least {distances[i, j]:.6g} m, both bodies, both tubes and the clearance"
                raise FlatsatError(
                    f"distance of {first.name} and {second.name} at way-point {worst + 1} = {apart[worst]:.6g} m: must "
                    f"be {valid}; heights count by 1/{self.downwash:g}"
                )

    def _require_outside(self) -> None:
        """Refuse way-points that are too near to an obstacle."""
        for drone, reach in zip(self.drones, self.reaches.tolist(), strict=True):
            for box in self.obstacles:
                away = (drone.waypoints - np.clip(drone.waypoints, *box.corners)) / [1.0, 1.0, self.downwash]
                distances = np.linalg.norm(away, axis=1)
                worst = int(distances.argmin())
                if distances[worst] < reach:
                    raise FlatsatError(
                        f"distance of {drone.name} from {box.name} at way-point {worst + 1} = {distances[worst]:.6g} "
                        f"m: must be at least {reach:.6g} m, body, tube and the clearance; heights count by "
                        f"1/{self.downwash:g}"
                    )

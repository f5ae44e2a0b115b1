"""The plan: references of one or many drones, and what is proved about them, in one file.

Planning writes it; `Plan.verify` proves it again with integers, without a solver, and whoever flies it loads nothing
unverified. Drones keep apart by their bodies and their tubes, the distances that they may be off their references: if
each drone is inside its tube, what is proved for references holds for drones.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from flatsat_ros.base.errors import FlatsatError, refusal, require, require_fields, require_not_negative, require_number
from flatsat_ros.base.files import located
from flatsat_ros.base.strict_yaml import read_yaml, section, write_yaml
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.plans import obstacles, pairs
from flatsat_ros.plans.bounds import Bounds
from flatsat_ros.plans.drone import PlannedDrone
from flatsat_ros.plans.laps import Laps
from flatsat_ros.plans.obstacles import Box, require_distinct
from flatsat_ros.plans.pairs import DRONES_MAX, Pair
from flatsat_ros.plans.separation import closest, closest_to_boxes, pairs_of

FORMAT = 1
BYTES_MAX = 1024 * 1024  # a hundred drones with their pairs have 400 KB

_HEADER = """\
# A flatsat_ros plan: references for drones, and what is proved about them. `plan --verify` proves it again.
# limits: the input set that it was made for; thrust m/s^2, tilt rad, gravity m/s^2
# bounds: margin to that set m/s^2, within thrust_max and thrust_min m/s^2 (null: of the set itself), that is kept by
#   acceleration + drag velocity + lead (jerk + drag acceleration), drag 1/s and lead s, horizontal and vertical;
#   jerk m/s^3, snap m/s^4, speed m/s and acceleration m/s^2 (null: not bounded); the box of the references, m
# downwash: distances are |(dx, dy, dz / downwash)|; clearance m: kept beside bodies and tubes
# drones: body and tube are radii, m; a tube is how far the drone may be off its reference. Source "given": the user
#   stated the radius, nothing proves it; "certificate": that proves it for jerk and snap up to a tenth above the
#   bounds, as when the pace changes. Knots in s and control points x y z in m of a B-spline of degree 5 (each knot
#   once; those at the ends count six times) or 7 (four and eight times); way-points t x y z in s
#   and m, and within how many m they are passed
# pairs: two drones, the distance in m that they always keep, and from when to when (s) they are nearest
# laps: null for references from rest to rest; else each is one lap, flown count times: control points repeat, all set
#   out and stop along the way at one pace, within ramp s each
# obstacles: boxes that stand still: name, lower and upper corner in m; passages: each drone with each of them, as pairs
"""

_ROOT = (
    "flatsat_plan", "name", "certificate", "limits", "bounds", "downwash", "clearance", "laps", "drones", "pairs",
    "obstacles", "passages", "provenance", "hash",
)  # fmt: skip
_LIMITS = ("thrust_max", "tilt_max", "gravity", "thrust_min")
_BOUNDS = (
    "margin", "jerk_max", "snap_max", "speed_max", "acceleration_max", "thrust_max", "thrust_min", "drag", "lead",
    "lower", "upper",
)  # fmt: skip


def require_downwash(name: str, value: object, unit: str) -> float:
    """Return a downwash as a float, refusing what is not a number from 1 to 10.

    Raises:
        FlatsatError: it is not.
    """
    return require_number(name, value, unit, 1.0, 10.0)


@dataclass(frozen=True, eq=False)
class Plan:
    """References that are proved to keep their limits and to keep apart.

    Attributes:
        name: what the user calls it.
        certificate: name of the certificate it was made for.
        limits: that certificate's input set.
        bounds: what each reference keeps.
        drones: in the order of the file.
        pairs: each two of the drones, in that order.
        downwash: how many times as far drones keep apart along the vertical.
        clearance: kept beside bodies and tubes, m.
        obstacles: that all drones keep away from, as from a drone without body and tube.
        passages: each drone with each obstacle, in that order.
        provenance: how it was made; nothing reads it but people.
        laps: how often the references are flown, each one lap; None for references from rest to rest.

    Raises:
        FlatsatError: a value does not fit the others. What is claimed is checked by `verify`.
    """

    name: str
    certificate: str
    limits: InputSet
    bounds: Bounds
    drones: tuple[PlannedDrone, ...]
    pairs: tuple[Pair, ...]
    downwash: float = 2.0
    clearance: float = 0.0
    obstacles: tuple[Box, ...] = ()
    passages: tuple[Pair, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    laps: Laps | None = None

    def __post_init__(self) -> None:
        require_fields(self, require_downwash, downwash="")
        require_fields(self, require_not_negative, clearance="m")
        names = [drone.name for drone in self.drones]
        require(1 <= len(names) <= DRONES_MAX, "number of drones", len(names), "", f"from 1 to {DRONES_MAX}")
        require(len(set(names)) == len(names), "names of the drones", names, "", "different")
        degrees = sorted({drone.curve.degree for drone in self.drones})
        require(len(degrees) == 1, "degrees of the references", degrees, "", "the same for all drones")
        if {drone.curve.closed for drone in self.drones} != {self.laps is not None}:
            raise FlatsatError("references: must be closed if there are laps, and else from rest to rest")
        durations = sorted({drone.curve.duration for drone in self.drones})
        if self.laps is not None:
            require(len(durations) == 1, "durations of a lap", durations, "s", "the same for all drones")
        first, second = pairs_of(len(names))
        expected = [(names[i], names[j]) for i, j in zip(first, second, strict=True)]
        if [pair[:2] for pair in self.pairs] != expected:
            raise FlatsatError(f"pairs: must be each two of the {len(names)} drones once, in their order")
        require_distinct(self.obstacles)
        expected = [(name, box.name) for name in names for box in self.obstacles]
        if [passage[:2] for passage in self.passages] != expected:
            raise FlatsatError("passages: must be each drone with each obstacle once, in their order")

    @classmethod
    def of(
        cls, drones: Sequence[PlannedDrone], *, downwash: float = 2.0, obstacles: tuple[Box, ...] = (), **others: Any
    ) -> Plan:
        """Return a plan with the distances that can be certified; whether they are enough is for `verify` to say.

        Args:
            drones: of the plan.
            downwash: as in the plan.
            obstacles: likewise.
            others: what else a plan has.
        """
        names = [drone.name for drone in drones]
        curves = [drone.curve for drone in drones]
        kept = pairs.stated(closest(curves, downwash), names, names)
        passages = pairs.stated(closest_to_boxes(curves, obstacles, downwash), names, [box.name for box in obstacles])
        return cls(
            drones=tuple(drones), pairs=kept, downwash=downwash, obstacles=obstacles, passages=passages, **others
        )

    @property
    def duration(self) -> float:
        """Of the longest reference, s, or of all laps from rest to rest."""
        longest = max(drone.curve.duration for drone in self.drones)
        return longest if self.laps is None else self.laps.duration(longest)

    def trajectory(self, name: str) -> Trajectory:
        """Return the reference of a drone from rest to rest, from time 0 on.

        Raises:
            FlatsatError: no drone of the plan has that name.
        """
        for drone in self.drones:
            if drone.name == name:
                own = drone.curve.trajectory(drone.yaw)
                return own if self.laps is None else self.laps.flown(own)
        raise refusal("drone", name, "", f"one of {', '.join(drone.name for drone in self.drones)}")

    def required(self, *drones: PlannedDrone) -> Fraction:
        """Return the distance that two drones, or one and an obstacle, keep, m: bodies, tubes and clearance."""
        return sum((drone.radius for drone in drones), Fraction(self.clearance))

    def verify(self) -> dict[str, float]:
        """Prove every claim with integers; floating-point numbers propose separating directions and bound ramps.

        Returns:
            What is left of each claim, in its unit, at least 0: how far a limit is away from the worst control point,
            and by how much the stated distance of a pair is above what it must keep.

        Raises:
            FlatsatError: a claim does not hold; the text names drone or pair, time, limit and by how much.
        """
        self.bounds.within(self.limits)
        slacks: dict[str, float] = {}
        for drone in self.drones:
            drone.require_met()
            for claim in self.bounds.claims(drone.curve, self.limits):
                what = f"{drone.name}: {claim.name}"
                if claim.slack < 0.0:
                    raise FlatsatError(
                        f"plan {self.name!r}: '{what}' fails by {-claim.slack:.6g} {claim.unit} in the span from "
                        f"t = {claim.time:.4f} s on: must hold"
                    )
                slacks[f"{what} ({claim.unit})"] = claim.slack
        curves = [drone.curve for drone in self.drones]
        if self.laps is not None:
            self.laps.require_kept([curve.trajectory() for curve in curves], self.bounds, self.limits)
        try:
            required = [self.required(first, second) for first, second in itertools.combinations(self.drones, 2)]
            slacks |= pairs.slacks(
                self.pairs, required, "both bodies and tubes", lambda goals: closest(curves, self.downwash, goals)
            )
            required = [self.required(drone) for drone in self.drones for _ in self.obstacles]
            return slacks | pairs.slacks(
                self.passages, required, "body and tube",
                lambda goals: closest_to_boxes(curves, self.obstacles, self.downwash, goals),
            )  # fmt: skip
        except FlatsatError as error:
            raise FlatsatError(f"plan {self.name!r}: {error}") from error

    def require_made_for(self, certificate: Certificate) -> None:
        """Refuse a certificate whose input set is another than that the plan was made for.

        Raises:
            FlatsatError: it is; the text names what differs.
        """
        for name in _LIMITS:
            ours, theirs = getattr(self.limits, name), getattr(certificate.limits, name)
            if ours != theirs:
                valid = f"{ours!r} as in the plan {self.name!r}, which was made for {self.certificate!r}"
                raise refusal(f"{name} of certificate {certificate.name!r}", theirs, "", valid)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Plan:
        """Read a plan and verify it.

        Args:
            path: of the file.

        Raises:
            FlatsatError: the file cannot be read or is not exactly of its form, its hash is not that of its content, or
                a claim does not hold.
        """
        document = read_yaml(path, BYTES_MAX)
        try:
            plan = cls.from_document(document)
            plan.verify()
        except FlatsatError as error:
            raise located(path, error) from error
        return plan

    def save(self, path: str | os.PathLike[str]) -> None:
        """Verify and write the plan; the file is replaced in one step.

        Args:
            path: of the file.

        Raises:
            FlatsatError: a claim does not hold, or the file cannot be written.
        """
        self.verify()
        write_yaml(path, self.to_document(), _HEADER)

    @classmethod
    def from_document(cls, document: object) -> Plan:
        """Build a plan from the parsed YAML document, refusing whatever is not exactly its form."""
        root = section("the plan", document, _ROOT)
        if root["flatsat_plan"] != FORMAT or isinstance(root["flatsat_plan"], bool):
            raise refusal("flatsat_plan", root["flatsat_plan"], "", f"{FORMAT}, what this version reads")
        for key in ("name", "certificate"):
            require(isinstance(root[key], str) and bool(root[key]), key, root[key], "", "a non-empty string")
        require(isinstance(root["provenance"], dict), "provenance", root["provenance"], "", "a mapping")
        if root["hash"] != (digest := _digest(root)):
            raise refusal("hash", root["hash"], "", f"{digest}, that of the content, which was changed")
        if not isinstance(root["drones"], dict):
            raise refusal("drones", root["drones"], "", "a mapping from names to drones")
        return cls(
            name=root["name"],
            certificate=root["certificate"],
            limits=InputSet(**section("limits", root["limits"], _LIMITS)),
            bounds=Bounds(**section("bounds", root["bounds"], _BOUNDS)),
            laps=(laps := Laps.from_document(root["laps"])),
            drones=tuple(
                PlannedDrone.from_document(name, section, closed=laps is not None)
                for name, section in root["drones"].items()
            ),
            pairs=pairs.read("pairs", root["pairs"]),
            obstacles=obstacles.read(root["obstacles"]),
            passages=pairs.read("passages", root["passages"]),
            downwash=root["downwash"],
            clearance=root["clearance"],
            provenance=root["provenance"],
        )

    def to_document(self) -> dict[str, Any]:
        """Return the plan as plain mappings, lists, text and numbers, the form of the YAML file."""
        bounds = {name: getattr(self.bounds, name) for name in _BOUNDS}
        bounds |= {name: list(getattr(self.bounds, name)) for name in ("drag", "lead")}
        document = {
            "flatsat_plan": FORMAT,
            "name": self.name,
            "certificate": self.certificate,
            "limits": {name: getattr(self.limits, name) for name in _LIMITS},
            "bounds": bounds | {"lower": self.bounds.lower.tolist(), "upper": self.bounds.upper.tolist()},
            "downwash": self.downwash,
            "clearance": self.clearance,
            "laps": None if self.laps is None else self.laps.to_document(),
            "drones": {drone.name: drone.to_document() for drone in self.drones},
            "pairs": pairs.written(self.pairs),
            "obstacles": obstacles.written(self.obstacles),
            "passages": pairs.written(self.passages),
            "provenance": dict(self.provenance),
        }  # fmt: skip
        return document | {"hash": _digest(document)}


def _digest(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a document but for its hash."""
    content = {key: value for key, value in document.items() if key != "hash"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

"""The certificate: the one file in which everything that makes the controller's answer trustworthy travels.

Synthesis writes it, `Certificate.verify` proves it again with numpy alone, and the controller loads nothing unverified.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from flatsat_ros.core import lyapunov
from flatsat_ros.core.errors import FlatsatError
from flatsat_ros.core.flatness import FloatArray
from flatsat_ros.core.input_set import InputSet

FORMAT = 1

# Relative rounding that a proved inequality may show when it is tight; far below anything physical.
_ROUNDING = 1e-9

_HEADER = """\
# A flatsat_ros certificate. Written by synthesis, verified on load: edit the inputs, not the figures.
# limits: thrust_max T_max and thrust_min m/s^2 (normalised by the mass), tilt_max eps_max rad, gravity g m/s^2
# lyapunov: V = xi' P xi, xi = (position error m, velocity error m/s); P = block (x) I3; V' <= -rate V, rate alpha 1/s
# invariant_set: V <= level (eps) implies |B'P xi|^2 <= ball (rho, m^2/s^4), a ball inside the input set
# sampling: command held for period h s; V does not grow for applied gains in [gain_min, gain_max]; gain_max caps gamma
"""

_SCHEMA: dict[str, tuple[str, ...]] = {
    "limits": ("thrust_max", "tilt_max", "gravity", "thrust_min"),
    "lyapunov": ("rate", "block", "matrix"),
    "invariant_set": ("ball", "level"),
    "sampling": ("period", "gain_min", "gain_max"),
}


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is proved about one closed loop.

    Attributes:
        name: what the user calls it.
        limits: the input set V_c.
        rate: alpha, 1/s; in continuous time V' <= -alpha V on the invariant set for every gain gamma >= 1.
        block: (2, 2) symmetric block of P = block (x) I3; V in (m, m/s).
        ball: rho, m^2/s^4; the ball |v|^2 <= rho lies in V_c.
        level: eps; E = { V <= eps } is invariant and the constraints hold.
        period: h, s; the command is held constant in between.
        gain_min, gain_max: applied gains for which V does not increase at or between samples (zero-order hold).
        provenance: how it came about: package version, inputs, solver, residuals. Free-form, for people.

    Raises:
        FlatsatError: a value is missing, of the wrong shape or not finite. Inequalities are checked by `verify`.
    """

    name: str
    limits: InputSet
    rate: float
    block: FloatArray
    ball: float
    level: float
    period: float
    gain_min: float
    gain_max: float
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        units = {
            "rate": "1/s", "ball": "m^2/s^4", "level": "", "period": "s", "gain_min": "", "gain_max": "",
        }  # fmt: skip
        for name, unit in units.items():
            object.__setattr__(self, name, lyapunov.require_positive(name, getattr(self, name), unit))
        block = _matrix("block", self.block, 2)
        block.setflags(write=False)
        object.__setattr__(self, "block", block)

    @property
    def matrix(self) -> FloatArray:
        """The Lyapunov matrix P, (6, 6), for xi = (x, y, z, xdot, ydot, zdot)."""
        return np.asarray(np.kron(self.block, np.eye(3)), dtype=np.float64)

    def margins(self) -> dict[str, float]:
        """Return by how much, relatively, each inequality of the certificate holds; negative ones fail."""
        holds = np.linalg.eigvalsh(self.block)
        margins = {"P is positive definite": float(holds[0] / abs(holds).max())}
        if margins["P is positive definite"] <= 0.0:
            return margins
        eta_per_level = float(self.block[1] @ np.linalg.solve(self.block, self.block[1]))
        margins |= {
            "A'P + P A - 2 P B B'P + alpha P <= 0": -lyapunov.decay_residual(self.block, self.rate),
            "the ball |v|^2 <= rho lies in the input set": 1.0 - math.sqrt(self.ball) / self.limits.inner_radius,
            "V <= eps implies |B'P xi|^2 <= rho": 1.0 - self.level * eta_per_level / self.ball,
            "gain_min <= 1": 1.0 - self.gain_min,
            "1 <= gain_max": self.gain_max - 1.0,
        }
        for gain, name in ((self.gain_min, "gain_min"), (self.gain_max, "gain_max")):
            margins[f"V does not grow during a period at {name}"] = -lyapunov.hold_growth(self.block, self.period, gain)
        return margins

    def verify(self) -> dict[str, float]:
        """Check every inequality with numpy alone.

        Returns:
            The relative margin of each inequality, at least -1e-9 (rounding of a tight one).

        Raises:
            FlatsatError: an inequality does not hold; the text names it and by how much it fails.
        """
        margins = self.margins()
        for name, margin in margins.items():
            if not margin >= -_ROUNDING or (name == "P is positive definite" and margin <= 0.0):
                raise FlatsatError(f"certificate {self.name!r}: '{name}' fails by {-margin:.6g} (relative): must hold")
        return margins

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Certificate:
        """Read a certificate and verify it.

        Raises:
            FlatsatError: the file cannot be read, a key is unknown or missing, a value has the wrong shape or sign, or
                an inequality does not hold.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
            document = yaml.safe_load(text)
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise FlatsatError(f"certificate {os.fspath(path)!r} cannot be read: {error}") from error
        try:
            certificate = cls.from_document(document)
            certificate.verify()
        except FlatsatError as error:
            raise FlatsatError(f"{os.fspath(path)}: {error}") from error
        return certificate

    @classmethod
    def from_document(cls, document: object) -> Certificate:
        """Build a certificate from the parsed YAML document, refusing whatever is not exactly its form."""
        root = _section("the certificate", document, ("flatsat_certificate", "name", *_SCHEMA, "provenance"))
        if root["flatsat_certificate"] != FORMAT or isinstance(root["flatsat_certificate"], bool):
            raise FlatsatError(f"flatsat_certificate = {root['flatsat_certificate']!r}: this version reads {FORMAT}")
        if not isinstance(root["name"], str) or not root["name"]:
            raise FlatsatError(f"name = {root['name']!r}: must be a non-empty string")
        if not isinstance(root["provenance"], dict):
            raise FlatsatError("provenance: must be a mapping")
        limits, decay, invariant, sampling = (_section(key, root[key], keys) for key, keys in _SCHEMA.items())
        certificate = cls(
            name=root["name"],
            limits=InputSet(**limits),
            rate=decay["rate"],
            block=_matrix("lyapunov.block", decay["block"], 2),
            **invariant,
            **sampling,
            provenance=root["provenance"],
        )
        matrix = _matrix("lyapunov.matrix", decay["matrix"], 6)
        difference = float(np.abs(matrix - certificate.matrix).max())
        if difference > _ROUNDING * float(np.abs(matrix).max()):
            raise FlatsatError(f"lyapunov.matrix differs from block (x) I3 by {difference:.6g}: they must be equal")
        return certificate

    def to_document(self) -> dict[str, Any]:
        """Return the certificate as plain lists, numbers and strings, the form of the YAML file."""
        values = {
            "limits": {key: getattr(self.limits, key) for key in _SCHEMA["limits"]},
            "lyapunov": {"rate": self.rate, "block": self.block.tolist(), "matrix": self.matrix.tolist()},
            "invariant_set": {key: getattr(self, key) for key in _SCHEMA["invariant_set"]},
            "sampling": {key: getattr(self, key) for key in _SCHEMA["sampling"]},
        }
        return {"flatsat_certificate": FORMAT, "name": self.name, **values, "provenance": dict(self.provenance)}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Verify and write the certificate; the file is replaced in one step, never left half written.

        Raises:
            FlatsatError: an inequality does not hold, or the file cannot be written.
        """
        self.verify()
        target = Path(path)
        temporary = None
        try:
            text = _HEADER + yaml.safe_dump(self.to_document(), sort_keys=False, default_flow_style=None, width=120)
            with tempfile.NamedTemporaryFile(
                "w", encoding="utf-8", dir=target.parent, prefix=target.name, suffix=".part", delete=False
            ) as stream:
                temporary = stream.name
                stream.write(text)
            Path(temporary).chmod(0o644)
            Path(temporary).replace(target)
        except (OSError, yaml.YAMLError) as error:
            if temporary is not None:
                Path(temporary).unlink(missing_ok=True)
            raise FlatsatError(f"certificate {os.fspath(path)!r} cannot be written: {error}") from error


def _section(name: str, value: object, keys: tuple[str, ...]) -> dict[str, Any]:
    """Return a mapping that has exactly the given keys."""
    if not isinstance(value, dict):
        raise FlatsatError(f"{name}: must be a mapping with the keys {', '.join(keys)}, not {type(value).__name__}")
    unknown = [key for key in value if key not in keys]
    if unknown:
        raise FlatsatError(f"{name}: unknown key {unknown[0]!r}; valid keys are {', '.join(keys)}")
    missing = [key for key in keys if key not in value]
    if missing:
        raise FlatsatError(f"{name}: key {missing[0]!r} is missing; needed are {', '.join(keys)}")
    return value


def _matrix(name: str, value: object, size: int) -> FloatArray:
    """Return a finite symmetric (size, size) float array."""
    try:
        matrix = np.array(value)
    except ValueError:  # rows of different lengths
        matrix = np.array(None)
    if matrix.dtype.kind not in "fi":
        raise FlatsatError(f"{name}: must be a {size}x{size} matrix of numbers, not {value!r}")
    matrix = matrix.astype(np.float64)
    if matrix.shape != (size, size):
        raise FlatsatError(f"{name} has shape {matrix.shape}: must be ({size}, {size})")
    if not np.isfinite(matrix).all():
        raise FlatsatError(f"{name} contains {matrix[~np.isfinite(matrix)][0]}: every entry must be a finite number")
    asymmetry = float(np.abs(matrix - matrix.T).max())
    if asymmetry > _ROUNDING * float(np.abs(matrix).max()):
        raise FlatsatError(f"{name} is not symmetric: entries differ by {asymmetry:.6g}")
    return matrix

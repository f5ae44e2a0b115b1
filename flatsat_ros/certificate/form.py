"""The file of a certificate: its sections and keys, and what they say as the arguments of a `Certificate`."""

from __future__ import annotations

from typing import Any

import numpy as np

from flatsat_ros.base.arrays import FloatArray, finite_array
from flatsat_ros.base.errors import LARGEST, refusal, require
from flatsat_ros.base.strict_yaml import section
from flatsat_ros.certificate.flight import FlightSection
from flatsat_ros.certificate.robust import Robust
from flatsat_ros.law.input_set import InputSet

# Versions of the file: the second has a flight section.
FORMATS = (1, 2)

HEADER = """\
# A flatsat_ros certificate. Written by synthesis, verified on load: edit the inputs, not the figures.
# limits: thrust_max T_max and thrust_min m/s^2 (normalised by the mass), tilt_max eps_max rad, gravity g m/s^2
# lyapunov: V(xi) = xi' P xi, xi = (position error m, velocity error m/s); block is that of P for x and for y,
#   block_vertical for z (null: the same); V' <= -rate V in continuous time, rate alpha 1/s
# invariant_set: V <= level (eps) implies |B'P xi|^2 <= ball (rho, m^2/s^4), a ball inside the input set
# sampling: command held for period h s, lag tau s, delay d s; V does not grow for applied gains in
#   [gain_min, gain_max]: gain_max caps gamma, gain_min is the smallest kappa whose kappa-sets are certified
# loop: W per axis for z = (p, v[, a], past commands) takes the place of V (null: neither lag nor delay)
# robust: against drift m/s and push m/s^2, each (x and y, z); rate beta 1/s, box vbar m/s^2; the sampled loop never
#   leaves V <= floor; share p of a period's growth is the disturbance's (null: nothing is certified)
"""

SCHEMA: dict[str, tuple[str, ...]] = {
    "limits": ("thrust_max", "tilt_max", "gravity", "thrust_min"),
    "lyapunov": ("rate", "block", "block_vertical", "matrix"),
    "invariant_set": ("ball", "level"),
    "sampling": ("period", "lag", "delay", "gain_min", "gain_max"),
}
_LOOP = ("horizontal", "vertical")
_ROBUST = ("rate", "drift", "push", "box", "floor", "share")


def read(document: object) -> tuple[dict[str, Any], FloatArray]:
    """Return the arguments of a `Certificate`, and P, (6, 6), which its blocks give too.

    Args:
        document: as parsed from YAML.

    Raises:
        FlatsatError: a key is unknown or missing, or a value has the wrong shape or sign.
    """
    version = document.get("flatsat_certificate") if isinstance(document, dict) else None
    flies = version == FORMATS[1] and not isinstance(version, bool)
    added = ("flight",) if flies else ()
    keys = ("flatsat_certificate", "name", *SCHEMA, "loop", "robust", *added, "provenance")
    root = section("the certificate", document, keys)
    if not flies and (version != FORMATS[0] or isinstance(version, bool)):
        raise refusal("flatsat_certificate", version, "", f"{FORMATS[0]} or {FORMATS[1]}, what this version reads")
    if not isinstance(root["name"], str) or not root["name"]:
        raise refusal("name", root["name"], "", "a non-empty string")
    if not isinstance(root["provenance"], dict):
        raise refusal("provenance", root["provenance"], "", "a mapping")
    limits, decay, invariant, sampling = (section(key, root[key], keys) for key, keys in SCHEMA.items())
    loop = dict.fromkeys(_LOOP) if root["loop"] is None else section("loop", root["loop"], _LOOP)
    robust = None if root["robust"] is None else Robust(**section("robust", root["robust"], _ROBUST))
    figures = {
        "name": root["name"],
        "limits": InputSet(**limits),
        "rate": decay["rate"],
        "block": symmetric_matrix("lyapunov.block", decay["block"], 2),
        "block_vertical": decay["block_vertical"],
        **invariant,
        **sampling,
        "loop": loop["horizontal"],
        "loop_vertical": loop["vertical"],
        "robust": robust,
        "flight": FlightSection.from_document(root["flight"], sampling["period"]) if flies else None,
        "provenance": root["provenance"],
    }
    return figures, symmetric_matrix("lyapunov.matrix", decay["matrix"], 6)


def symmetric_matrix(name: str, value: object, size: int) -> FloatArray:
    """Return a symmetric (size, size) array of floats of at most LARGEST."""
    matrix = np.array(finite_array(name, value))
    if matrix.shape != (size, size):
        raise refusal(f"shape of {name}", matrix.shape, "", f"({size}, {size})")
    largest = float(np.abs(matrix).max())
    require(largest <= LARGEST, f"an entry of {name}", largest, "", f"at most {LARGEST:g} in size")
    asymmetry = float(np.abs(matrix - matrix.T).max())
    require(asymmetry == 0.0, f"asymmetry of {name}", asymmetry, "", "0: the matrix is symmetric")
    return matrix

"""The paper on one page: the saturated law with adaptive gain, one pure step for N drones."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import FloatArray, finite_array, float_array
from flatsat_ros.base.errors import refusal
from flatsat_ros.law import gain as gain_law
from flatsat_ros.law.flatness import input_from_finite
from flatsat_ros.law.gain import Tuning
from flatsat_ros.law.input_set import InputSet

_SUM = np.ones(6)  # sums the entries of rows, faster than sum() on few of them


class Certified(Protocol):
    """What the law reads of a certificate; a `flatsat_ros.certificate.certificate.Certificate` has all of it."""

    @property
    def limits(self) -> InputSet:
        """The input set V_c: the accelerations within the limits of thrust and tilt."""

    @property
    def matrix(self) -> FloatArray:
        """The Lyapunov matrix P, (6, 6), for xi = (position error m, velocity error m/s), world frame."""

    @property
    def period(self) -> float:
        """The time h, s, for which a command is held."""

    @property
    def gain_max(self) -> float:
        """The largest gain that is certified, dimensionless, at least 1."""


@dataclass(frozen=True, eq=False)
class Memory:
    """What the controller carries from step to step.

    Attributes:
        gain: gamma, (N,), dimensionless.
    """

    gain: FloatArray


class Output(NamedTuple):
    """The answer of one step for N drones.

    Attributes:
        acceleration: v (N, 3), m/s^2, world frame.
        input: u = (T, phi, theta) (N, 3): thrust normalised by the mass, m/s^2, roll, rad, and pitch, rad.
        error: xi (N, 6), m and m/s, world frame: state minus reference.
        lyapunov: V (N,), the Lyapunov function of the error.
        gain: gamma (N,), with which this step was computed, before its adaptation.
        applied_gain: k (N,): v = v_ref - k B'P xi.
        saturated: (N,) whether the limits shortened the command: k < gamma.
    """

    acceleration: FloatArray
    input: FloatArray
    error: FloatArray
    lyapunov: FloatArray
    gain: FloatArray
    applied_gain: FloatArray
    saturated: np.ndarray


class Controller:
    """The saturated law with the matrix and the limits of one certificate and the gains of one tuning."""

    def __init__(self, certificate: Certified, tuning: Tuning) -> None:
        """Bind a verified certificate and a tuning.

        Raises:
            FlatsatError: the tuning lets gamma grow beyond what the certificate covers, or its leak would take more
                than the whole gain within one period.
        """
        if (tuning.leak * certificate.period > 1.0).any():
            most = 1.0 / certificate.period
            raise refusal("leak (nu)", tuning.leak.max(), "1/s", f"at most 1/period = {most:.6g} 1/s")
        if (tuning.gain_max > certificate.gain_max).any():
            raise refusal(
                "gain_max", tuning.gain_max.max(), "", f"at most the certificate's {certificate.gain_max:.6g}"
            )
        self.certificate = certificate
        self.tuning = tuning
        self._matrix = certificate.matrix

    def start(self) -> Memory:
        """Return the memory before the first step: gamma = gamma_0."""
        return Memory(gain=self.tuning.gain_initial.copy())

    def step(self, memory: Memory, state: ArrayLike, yaw: ArrayLike, reference: ArrayLike) -> tuple[Memory, Output]:
        """Compute the command of every drone and adapt its gain, once per period h.

        Args:
            memory: from `start` or the previous step.
            state: (N, 6) position (m) and velocity (m/s), world frame.
            yaw: (N,) measured psi, rad, counter-clockwise.
            reference: (N, 9) position (m), velocity (m/s) and acceleration (m/s^2, inside the input set), world frame.

        Returns:
            The next memory and the output.

        Raises:
            FlatsatError: a shape is wrong, an entry is not finite, or a reference acceleration leaves the input set.
        """
        limits, gamma = self.certificate.limits, memory.gain
        state, reference = float_array("state", state, 6), float_array("reference", reference, 9)
        yaw = float_array("yaw", yaw)
        # xi = (p, pdot) - (p_ref, pdot_ref),  V = xi' P xi,  v0 = -B' P xi
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            # copies of columns: with few rows numpy computes much faster with them than with views
            xi, v_ref = state.copy() - reference[..., :6].copy(), reference[..., 6:].copy()
            gradient = xi @ self._matrix
            lyapunov = (gradient * xi) @ _SUM
            v0 = -gradient[..., 3:].copy()

            # v = v_ref + k v0: as far toward v_ref + gamma v0 as V_c reaches
            k = limits.reach_of_finite(v_ref, v0, gamma)
            v = v_ref + k[..., np.newaxis] * v0
            u = input_from_finite(v, yaw, limits.gravity)
            whole = float(np.vdot(u, u))  # one look at the end instead of one at each array
        if not math.isfinite(whole):
            found = {"state": state, "reference": reference, "yaw": yaw, "gain": gamma, "P xi": gradient}
            for name, value in found.items():
                finite_array(name, value)

        following = Memory(gain=gain_law.adapt(gamma, lyapunov, self.tuning, self.certificate.period))
        return following, Output(v, u, xi, lyapunov, gamma, k, k < gamma)

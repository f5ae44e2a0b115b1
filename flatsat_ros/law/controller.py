"""The paper on one page: the saturated law with adaptive gain, one pure step for N drones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import FloatArray, finite_array
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.law import gain as gain_law
from flatsat_ros.law.flatness import input_from_acceleration
from flatsat_ros.law.gain import Tuning
from flatsat_ros.law.input_set import InputSet


class Certified(Protocol):
    """What the law takes from a certificate, which stands above it."""

    @property
    def limits(self) -> InputSet:
        """The input set V_c."""

    @property
    def matrix(self) -> FloatArray:
        """P, (6, 6), for xi = (position error m, velocity error m/s)."""

    @property
    def period(self) -> float:
        """h, s."""

    @property
    def gain_max(self) -> float:
        """Largest gain that is certified."""


@dataclass(frozen=True, eq=False)
class Memory:
    """What the controller carries from step to step: the gains gamma, (N,)."""

    gain: FloatArray


@dataclass(frozen=True, eq=False)
class Output:
    """The answer of one step for N drones.

    Attributes:
        acceleration: v (N, 3), m/s^2, world frame.
        input: u = (T, phi, theta) (N, 3): m/s^2, rad, rad.
        error: xi (N, 6), m and m/s: state minus reference.
        lyapunov: V (N,).
        gain: gamma (N,), before this step's adaptation.
        applied_gain: k (N,): v = v_ref - k B'P xi.
        saturated: (N,), k < gamma.
    """

    acceleration: FloatArray
    input: FloatArray
    error: FloatArray
    lyapunov: FloatArray
    gain: FloatArray
    applied_gain: FloatArray
    saturated: np.ndarray


class Controller:
    """The law of one certificate with one tuning."""

    def __init__(self, certificate: Certified, tuning: Tuning) -> None:
        """Bind a verified certificate and a tuning.

        Raises:
            FlatsatError: the tuning lets gamma grow beyond what the certificate covers, or leaks more than all of it
                in one period.
        """
        if (tuning.leak * certificate.period > 1.0).any():
            most = 1.0 / certificate.period
            raise FlatsatError(f"leak (nu) = {tuning.leak.max():.6g} 1/s: must be at most 1/period = {most:.6g} 1/s")
        if (tuning.gain_max > certificate.gain_max).any():
            raise FlatsatError(
                f"gain_max = {tuning.gain_max.max():.6g}: must be at most the certificate's {certificate.gain_max:.6g}"
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
            yaw: (N,) measured psi, rad.
            reference: (N, 9) position, velocity, acceleration (m/s^2, inside the input set).

        Returns:
            The next memory and the output.

        Raises:
            FlatsatError: a shape is wrong, an entry is not finite, or a reference acceleration leaves the input set.
        """
        limits = self.certificate.limits
        reference = finite_array("reference", reference, 9)
        # xi = (p, pdot) - (p_ref, pdot_ref),  V = xi' P xi,  v0 = -B' P xi
        xi = finite_array("state", state, 6) - reference[..., :6]
        gradient = xi @ self._matrix
        lyapunov = np.einsum("...i,...i->...", gradient, xi)
        v0, v_ref = -gradient[..., 3:], reference[..., 6:]

        # v = sat(gamma v0) about v_ref; gamma v0 itself is never formed
        gamma = memory.gain
        k = np.minimum(gamma, limits.exit_factor(v_ref, v0))
        v = v_ref + k[..., np.newaxis] * v0
        u = input_from_acceleration(v, yaw, limits.gravity)

        following = Memory(gain=gain_law.adapt(gamma, lyapunov, self.tuning, self.certificate.period))
        return following, Output(v, u, xi, lyapunov, gamma, k, k < gamma)

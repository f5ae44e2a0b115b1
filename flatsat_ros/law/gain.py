"""The adaptive gain gamma: how it grows and falls, and its tuning, drone by drone."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import BoolArray, FloatArray, finite_array, require_each
from flatsat_ros.base.errors import LARGEST, SMALLEST, FlatsatError


@dataclass(frozen=True, eq=False, init=False)
class Tuning:
    """The adaptation of N drones: arrays (N,), one entry a drone; a scalar stands for all drones.

    Attributes:
        adaptation_rate: mu >= 0, 1/s per unit of V; 0 keeps the gain constant.
        threshold: V_inf > 0; the gain rests while V is at most this.
        gain_initial: gamma_0, in [1, gain_max].
        gain_max: cap of gamma, at least 1; from the certificate.
        leak: nu >= 0, 1/s; the gain falls back toward 1 at this rate. 0 is the paper's law, whose gain never falls.
        restart: whether a new reference that puts V above V_inf starts the adaptation anew from gamma_0; otherwise the
            gain grows a little with each set-point, until the drone oscillates.

    Raises:
        FlatsatError: a value is out of its range, not finite, or the lengths differ.
    """

    adaptation_rate: FloatArray
    threshold: FloatArray
    gain_initial: FloatArray
    gain_max: FloatArray
    leak: FloatArray
    restart: BoolArray

    def __init__(
        self,
        adaptation_rate: ArrayLike,
        threshold: ArrayLike,
        gain_initial: ArrayLike,
        gain_max: ArrayLike,
        leak: ArrayLike = 0.0,
        restart: ArrayLike = True,
    ) -> None:
        names = [entry.name for entry in fields(self)]
        values = (adaptation_rate, threshold, gain_initial, gain_max, leak, restart)
        arrays = [np.atleast_1d(finite_array(name, value)) for name, value in zip(names, values, strict=True)]
        try:
            arrays = [np.array(array) for array in np.broadcast_arrays(*arrays)]
        except ValueError as error:
            raise FlatsatError(f"tuning: {error}; give one value for all drones or one for each") from error
        arrays[-1] = arrays[-1] != 0.0
        for name, array in zip(names, arrays, strict=True):
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        mu, v_inf, initial, cap, nu, _ = arrays
        positive = (v_inf >= SMALLEST) & (v_inf <= LARGEST)
        require_each((nu >= 0.0) & (nu <= LARGEST), "leak (nu)", nu, "1/s", f"from 0 to {LARGEST:g}")
        require_each((mu >= 0.0) & (mu <= LARGEST), "adaptation_rate (mu)", mu, "1/s", f"from 0 to {LARGEST:g}")
        require_each(positive, "threshold (V_inf)", v_inf, "", f"above 0, from {SMALLEST:g} to {LARGEST:g}")
        require_each((cap >= 1.0) & (cap <= LARGEST), "gain_max", cap, "", f"from 1 to {LARGEST:g}")
        valid = f"from 1 to gain_max = {cap.min():.6g}"
        require_each((initial >= 1.0) & (initial <= cap), "gain_initial (gamma_0)", initial, "", valid)


def adapt(gain: FloatArray, lyapunov: FloatArray, tuning: Tuning, period: float) -> FloatArray:
    """Return the gains one period later, (N,).

    gamma+ = clip(gamma + h [mu sigma(V) - nu (gamma - 1)], 1, gain_max) with sigma(V) = max(V - V_inf, 0): forward
    Euler of the paper's eq. 23b, with the certificate's cap and a leak. Everything proved about the sets needs only a
    gain within [1, gain_max], so it holds for any of these.

    Args:
        gain: gamma, (N,).
        lyapunov: V, (N,).
        tuning: of the N drones.
        period: h, s.
    """
    excess = np.maximum(lyapunov - tuning.threshold, 0.0)
    slope = tuning.adaptation_rate * excess
    if np.count_nonzero(tuning.leak):
        slope = slope - tuning.leak * (gain - 1.0)
    return np.minimum(np.maximum(gain + period * slope, 1.0), tuning.gain_max)

"""From what a user wants to the rate that gives it: the fastest certificate that covers given start errors.

The least s with a fixed start in s D grows at least like alpha: alpha V has terms in alpha^2 to alpha^4. So kappa falls
at least as fast as alpha rises, and the certified rate alpha (2 kappa - 1) of a kappa-set is largest where kappa is
just 1: the answer is the largest alpha whose D holds the start.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from flatsat_ros.base.arrays import FloatArray, finite_array
from flatsat_ros.base.errors import FlatsatError, refusal
from flatsat_ros.certificate.lyapunov import closed_form_block, hold_gain_interval
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.certificate.sets import Sets
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.synthesis.common_function import BreakdownError
from flatsat_ros.synthesis.gain_cap import gain_cap
from flatsat_ros.synthesis.robust_design import closed_form_blocks, largest_box, rate_interval, robust_sets

_RATE_RANGE = (1e-2, 1e2)  # 1/s; what `cover` looks through

# The rate is found to this, relatively, and rounded down by it, so that rounding does not put the start outside.
_RESOLUTION = 1e-5


def start_corners(errors: ArrayLike) -> FloatArray:
    """Return the start errors with those signs that matter, (4, 6): velocity along or against position.

    Args:
        errors: three or six magnitudes: |x|, |y|, |z| in m and |xdot|, |ydot|, |zdot| in m/s, the last three 0 if not
            given. All starts up to these are covered if the corners are.

    Raises:
        FlatsatError: another number of them, a negative or infinite one, or all are 0.
    """
    errors = finite_array("cover", errors)
    if errors.shape not in ((3,), (6,)) or (errors < 0.0).any() or not errors.any():
        valid = "3 or 6 magnitudes of at least 0 and not all 0, DX,DY,DZ[,VX,VY,VZ]"
        raise refusal("cover", errors.tolist(), "m and m/s", valid)
    full = np.zeros(6)
    full[: len(errors)] = errors
    signs = [(1, 1, 1, side, side, up) for side, up in product((1, -1), repeat=2)]
    return np.asarray(full * np.array(signs))


def rate_covering(
    limits: InputSet, errors: ArrayLike, timing: Timing, lowest: float = 1.0, highest: float = math.inf
) -> float:
    """Return the largest alpha, 1/s, for which the set D of the nominal certificate holds all starts up to `errors`.

    Args:
        limits: V_c.
        errors: magnitudes, see `start_corners`.
        timing: of the loop.
        lowest: see `synthesis.gain_cap.gain_cap`.
        highest: see `synthesis.gain_cap.gain_cap`.

    Raises:
        FlatsatError: no rate covers them; BreakdownError if the arithmetic came to no answer for a rate that it tried.
    """

    def sets(rate: float) -> Sets:
        block = closed_form_block(rate)
        if timing.immediate:
            gain_min, matrix = hold_gain_interval(rate, timing.period)[0], block
        else:
            cap = gain_cap(timing, block, lowest, highest)
            gain_min, matrix = cap.gain_min, block if cap.matrix is None else cap.matrix
        return Sets(limits, matrix, matrix, rate, rate, limits.inner_radius**2 / rate, gain_min)

    return _largest_covering(sets, start_corners(errors), _RATE_RANGE)


def robust_rate_covering(
    limits: InputSet, errors: ArrayLike, period: float, drift: FloatArray, push: FloatArray
) -> float:
    """Return the largest beta, 1/s, whose robust certificate guarantees all starts up to `errors`.

    Args:
        limits: V_c.
        errors: magnitudes, see `start_corners`.
        period: h, s.
        drift: (2,), m/s, see `synthesis.robust_design`.
        push: (2,), m/s^2.

    Raises:
        FlatsatError: no rate covers them.
    """
    smallest, largest = rate_interval(largest_box(limits), drift, push)

    def sets(rate: float) -> Sets:
        return robust_sets(limits, Timing(period), closed_form_blocks(rate, drift, push), drift, push)

    return _largest_covering(sets, start_corners(errors), (max(smallest, _RATE_RANGE[0]), largest))


def _largest_covering(sets: Callable[[float], Sets], starts: FloatArray, interval: tuple[float, float]) -> float:
    def covers(rate: float) -> bool:
        try:
            found = sets(rate)
        except BreakdownError:
            raise  # not an answer: it may not decide which rate is the largest
        except FlatsatError:
            return False  # this rate has no certificate; a smaller one may
        return bool(found.classify(starts).guaranteed.all() and (found.scale_larger(starts) <= 1.0).all())

    slow, fast = interval
    if covers(fast):
        return fast
    # from above: a rate that is too large has small sets or no certificate at all
    rate = fast
    with tqdm(desc="rates tried", unit="", delay=2.0, leave=False) as progress:
        while not covers(rate):
            progress.update()
            fast, rate = rate, rate / 1.3
            if rate < slow:
                raise FlatsatError(
                    f"no rate from {slow:.4g} to {interval[1]:.4g} 1/s covers these start errors: they must be "
                    "smaller; wider limits, a shorter lag or delay or a smaller disturbance help"
                )
        while fast - rate > _RESOLUTION * rate:
            progress.update()
            middle = (rate + fast) / 2.0
            rate, fast = (middle, fast) if covers(middle) else (rate, middle)
    return rate

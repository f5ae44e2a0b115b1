"""L-BFGS: minimise a smooth function of many unknowns from its values and gradients."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from flatsat_ros.base.arrays import FloatArray

_MEMORY = 12  # pairs of steps and changes of the gradient
_DECREASE = 1e-4  # of what the slope promises
_TRIALS = 12  # of a step, each a half to a tenth of the one before


def descend(
    function: Callable[[FloatArray], tuple[float, FloatArray]],
    start: FloatArray,
    steps: int,
    tolerance: float,
    enough: Callable[[], bool] = lambda: False,
) -> FloatArray:
    """Return where the descent ends.

    Args:
        function: value and gradient (n,) at a point (n,).
        start: (n,) where it begins.
        steps: at most.
        tolerance: it ends when ten steps together lower the value by less than this share of it.
        enough: says after each step, at the point that was looked at last, whether it may end there.
    """
    point, (value, gradient) = start, function(start)
    memory: deque[tuple[FloatArray, FloatArray, float]] = deque(maxlen=_MEMORY)
    values = deque([value], maxlen=11)
    for _ in range(steps):
        if enough():
            break
        direction = _direction(gradient, memory)
        slope = float(direction @ gradient)
        if slope >= 0.0:
            memory.clear()
            direction, slope = -gradient, -float(gradient @ gradient)
            if slope == 0.0:
                break
        step = 1.0 if memory else min(1.0, 1.0 / np.sqrt(-slope))
        for _ in range(_TRIALS):
            there = point + step * direction
            new, turned = function(there)
            if new <= value + _DECREASE * step * slope:
                break
            # the minimum of the parabola through both values and the slope
            step *= float(np.clip(-slope * step / (2.0 * (new - value - slope * step)), 0.1, 0.5))
        else:
            if not memory:
                break
            memory.clear()
            continue
        change, bend = there - point, turned - gradient
        curvature = float(change @ bend)
        if curvature > 1e-10 * float(bend @ bend):
            memory.append((change, bend, 1.0 / curvature))
        point, value, gradient = there, new, turned
        values.append(value)
        if len(values) == values.maxlen and values[0] - value <= tolerance * abs(value):
            break
    return point


def _direction(gradient: FloatArray, memory: deque[tuple[FloatArray, FloatArray, float]]) -> FloatArray:
    """Return minus the approximate inverse Hessian times the gradient: the recursion of two loops."""
    direction = -gradient
    shares = []
    for change, bend, inverse in reversed(memory):
        share = inverse * float(change @ direction)
        shares.append(share)
        direction = direction - share * bend
    if memory:
        change, bend, inverse = memory[-1]
        direction = direction / (inverse * float(bend @ bend))
    for (change, bend, inverse), share in zip(memory, reversed(shares), strict=True):
        direction = direction + (share - inverse * float(bend @ direction)) * change
    return direction

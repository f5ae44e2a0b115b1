"""How semidefinite programs are solved here, and what a certificate says of a solver that did or did not agree.

The figures of certificates are in closed form and proved without a solver, which computes them once more. So only what
it finds can contradict them: where it breaks down or stops short of an optimum, nothing was checked, and that is all.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import Any

import cvxpy as cp
import numpy as np

from flatsat_ros.base.errors import FlatsatError

# Clarabel's settings, one after the other until it reaches an optimum: its own, then with shorter steps.
_SETTINGS: tuple[dict[str, float], ...] = ({}, {"max_step_fraction": 0.9})


class UnsolvedError(FlatsatError):
    """The solver came to no answer; that says nothing about the program, of which it is known that it has one."""


def solve(name: str, problem: cp.Problem) -> None:
    """Solve a program that has a solution to optimality.

    Raises:
        UnsolvedError: the solver broke down, stopped short of an optimum or found none.
    """
    for settings in _SETTINGS:
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "Solution may be inaccurate")  # the status below says so
                problem.solve(solver=cp.CLARABEL, **settings)
        except cp.error.SolverError as error:
            said = f"the solver failed on the {name} program: {error}"
            continue
        if problem.status == cp.OPTIMAL and all(np.isfinite(each.value).all() for each in problem.variables()):
            return
        said = f"the solver reports {problem.status!r} for the {name} program: must be 'optimal', and finite"
    raise UnsolvedError(said)


def solver_name() -> str:
    """Return the solver and its version, for the provenance."""
    return f"Clarabel {version('clarabel')} with cvxpy {version('cvxpy')}"


def cross_checked(method: str, differences: Callable[[], Mapping[str, float]], tolerance: float) -> dict[str, Any]:
    """Return what a certificate's provenance says of the method and of the solver that the closed form agrees with.

    Args:
        method: how the solver checks, for the text.
        differences: returns those between the two, relative, by the name of the quantity.
        tolerance: the largest that may be.

    Raises:
        FlatsatError: one is larger, or not a number.
    """
    try:
        found = differences()
    except UnsolvedError as error:
        reason = " ".join(str(error).split())  # in one line
        return {"method": "closed form", "cross_check": {"status": "did not run", "reason": reason}}
    for quantity, difference in found.items():
        if not difference <= tolerance:
            raise FlatsatError(
                f"closed form and semidefinite program differ in {quantity} by {difference:.3g} (relative): "
                f"must agree to {tolerance}"
            )
    return {
        "method": f"closed form, cross-checked by {method}",
        "cross_check": {"status": "optimal", "relative_tolerance": tolerance},
    }

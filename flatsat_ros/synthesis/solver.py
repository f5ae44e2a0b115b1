"""How semidefinite programs are solved here: to optimality, or with an error that says so."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import cvxpy as cp

from flatsat_ros.base.errors import FlatsatError


def solve(name: str, problem: cp.Problem) -> None:
    """Solve to optimality; anything less is an error and, infeasibility apart, not a statement about the program.

    Raises:
        FlatsatError: the solver broke down or stopped short of an optimum, or the program has no solution.
    """
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Solution may be inaccurate")  # the status below says so
            problem.solve(solver=cp.CLARABEL)
    except cp.error.SolverError as error:
        raise FlatsatError(
            f"the solver failed on the {name} program (which does not make it infeasible): {error}"
        ) from error
    if problem.status == cp.INFEASIBLE:
        raise FlatsatError(f"the {name} program is infeasible")
    if problem.status != cp.OPTIMAL:
        raise FlatsatError(f"the solver reports {problem.status!r} for the {name} program: must be 'optimal'")


def solver_name() -> str:
    """Return the solver and its version, for the provenance."""
    return f"Clarabel {version('clarabel')} with cvxpy {version('cvxpy')}"


def agreement(differences: Mapping[str, float], tolerance: float) -> dict[str, Any]:
    """Return what a certificate's provenance says of the solver, which found what the closed form says.

    Args:
        differences: relative, between the two, by the name of the quantity.
        tolerance: the largest that may be.

    Raises:
        FlatsatError: one is larger, or not a number.
    """
    for quantity, difference in differences.items():
        if not difference <= tolerance:
            raise FlatsatError(
                f"closed form and semidefinite program differ in {quantity} by {difference:.3g} (relative): "
                f"must agree to {tolerance}"
            )
    return {"status": "optimal", "relative_tolerance": tolerance}

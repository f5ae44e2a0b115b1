"""How semidefinite programs are solved here: to optimality, or with an error that says so."""

from __future__ import annotations

import warnings
from importlib.metadata import version

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

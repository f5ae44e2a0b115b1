"""What a solver's failure decides: nothing but whether a certificate says that the solver agrees."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.synthesis.nominal import synthesize
from flatsat_ros.synthesis.report import table
from flatsat_ros.synthesis.robust_design import synthesize_robust

LIMITS = InputSet(1.45 * GRAVITY, math.radians(10.0))
KINDS: dict[str, Callable[[], Certificate]] = {
    "nominal": lambda: synthesize(LIMITS, 1.25, 0.1, "x"),
    "lagged": lambda: synthesize(LIMITS, 1.25, 0.1, "x", lag=0.1, delay=0.05),
    "robust": lambda: synthesize_robust(LIMITS, (0.1, 0.2), (0.2, 0.3), 0.02, "x"),
    "robust, slower": lambda: synthesize_robust(LIMITS, (0.1, 0.2), (0.2, 0.3), 0.02, "x", rate=0.5),
}
SOLVED = {kind: make() for kind, make in KINDS.items()}
_SOLVE = cp.Problem.solve


class FailingSolver:
    """Fails in one way at some of its calls, which are counted from 0."""

    def __init__(self, how: str, fails: Callable[[int], bool] = lambda call: True) -> None:
        self._how, self._fails = how, fails
        self.calls = 0

    def solve(self, problem: cp.Problem, **options: Any) -> None:
        call, self.calls = self.calls, self.calls + 1
        if not self._fails(call):
            _SOLVE(problem, **options)
        elif self._how == "breakdown":
            raise cp.error.SolverError("out of\nluck")
        else:
            _SOLVE(problem, **options)
            if self._how == "nan":
                for variable in problem.variables():
                    variable.save_value(np.full(variable.shape, np.nan))
            else:
                problem._status = self._how

    def use(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(cp.Problem, "solve", lambda problem, **options: self.solve(problem, **options))


HOW = ["breakdown", "nan", cp.OPTIMAL_INACCURATE, cp.INFEASIBLE, cp.INFEASIBLE_INACCURATE, cp.UNBOUNDED, cp.USER_LIMIT]


def without_check(certificate: Certificate) -> dict[str, Any]:
    provenance = {key: value for key, value in certificate.provenance.items() if key not in ("method", "cross_check")}
    return dataclasses.replace(certificate, provenance=provenance).to_document()


@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize("kind", KINDS)
def test_no_failure_of_the_solver_decides_a_figure(kind: str, how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    FailingSolver(how).use(monkeypatch)
    unchecked = KINDS[kind]()
    assert without_check(unchecked) == without_check(SOLVED[kind])
    assert unchecked.provenance["cross_check"]["status"] == "did not run"
    assert "cross-checked" not in unchecked.provenance["method"]


@pytest.mark.parametrize("kind", KINDS)
def test_wherever_the_solver_begins_to_fail_the_figures_are_the_same(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted = FailingSolver("breakdown", lambda call: False)
    counted.use(monkeypatch)
    assert KINDS[kind]().provenance["cross_check"]["status"] == "optimal"
    for first in {1, counted.calls // 2, counted.calls - 2, counted.calls - 1}:
        FailingSolver("breakdown", lambda call, first=first: call >= first).use(monkeypatch)
        unchecked = KINDS[kind]()
        assert without_check(unchecked) == without_check(SOLVED[kind])
        assert unchecked.provenance["cross_check"]["status"] == "did not run"


def test_a_failure_of_once_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    FailingSolver("breakdown", lambda call: call == 1).use(monkeypatch)
    assert KINDS["nominal"]().provenance["cross_check"] == SOLVED["nominal"].provenance["cross_check"]


def test_the_certificate_and_its_table_say_why_the_check_did_not_run(monkeypatch: pytest.MonkeyPatch) -> None:
    FailingSolver("breakdown").use(monkeypatch)
    certificate = KINDS["nominal"]()
    reason = "the solver failed on the decay program: out of luck"
    assert certificate.provenance["cross_check"] == {"status": "did not run", "reason": reason}
    lines = table(certificate).splitlines()
    assert any(line.startswith("  solver") and line.endswith(", did not run") for line in lines)
    assert f"  {'why not':<26}{reason}" in lines


@pytest.mark.parametrize("how", [cp.OPTIMAL_INACCURATE, cp.INFEASIBLE])
def test_a_status_that_is_no_optimum_is_named(how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    FailingSolver(how).use(monkeypatch)
    assert f"{how!r} for the box program" in KINDS["robust"]().provenance["cross_check"]["reason"]

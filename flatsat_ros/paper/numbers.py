"""The paper's parameter tables beside ours: what follows from the limits, the rates and the disturbance alone."""

from __future__ import annotations

import math

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.gain_bounds import settling_time_bound
from flatsat_ros.certificate.lyapunov import decay_residual
from flatsat_ros.certificate.robust import robust_residual
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.paper.runs import (
    ADAPTATION_RATES,
    GAMMA_0,
    STUDY_1_START,
    TEST_1_ERROR,
    TEST_1_SET_POINT,
    TEST_1_START,
    V_INF,
    printed_disturbance,
)
from flatsat_ros.paper.table import Table
from flatsat_ros.synthesis.robust_design import largest_box, rate_interval

INPUT = "an input, taken as printed"

# per axis, as printed
_PRINTED_Q = np.array([[2.3148, -1.3889], [-1.3889, 1.6667]])
_PRINTED_P = np.array([[0.98, 0.78], [0.78, 1.25]])
_PRINTED_QW = np.array([[2.29, -2.14], [-2.14, 2.07]]), np.array([[4.42, -2.14], [-2.14, 2.07]])


def controller_parameters(table: Table, certificate: Certificate) -> None:
    """Table I."""
    table.at("Table I, controller's parameters")
    limits, rate, inverse = certificate.limits, certificate.rate, np.linalg.inv(certificate.block)
    literal = InputSet(limits.thrust_max, 0.1745).inner_radius ** 2
    certified = certified_rate(np.linalg.inv(_PRINTED_Q))
    settling = {
        "V(0) = eps": settling_time_bound(certificate.level, V_INF, rate),
        "V(0) of the study": settling_time_bound(value_of(certificate, STUDY_1_START), V_INF, rate),
    }
    table.number("T_max = 1.45 g, m/s^2", "14.22", limits.thrust_max, "g = 9.81 m/s^2 is not printed; vbar_3 = g/3 is")
    table.number("eps_max = 10 deg, rad", "0.1745", limits.tilt_max, f"taken as 0.1745, rho would be {literal:.4f}")
    table.number("gamma_0", "1", GAMMA_0, INPUT)
    table.number(
        "V_inf", "0.05", certificate.level * math.exp(-rate * 3.2323), "implied by the printed bound of t_inf and eps"
    )
    table.number(
        "Q, entries of one axis",
        "2.3148, -1.3889, 1.6667",
        inverse[np.triu_indices(2)].tolist(),
        "4/alpha^3, -2/alpha^2, 2/alpha; the semidefinite program agrees",
    )
    table.number("alpha, 1/s", "1.2", rate, "the rate at which the condition on Q is tight")
    table.claim(
        "Q as printed certifies alpha",
        "1.2 1/s",
        certified >= rate,
        f"{certified:.6g} 1/s",
        "rounding a tight matrix breaks its inequality",
    )
    table.number("rho, m^2/s^4", "2.9019", certificate.ball, "(g sin eps_max)^2, the largest ball around 0 in V_c")
    table.number("eps", "2.4182", certificate.level, "rho / alpha; the semidefinite program agrees")
    table.number(
        "bound of t_inf, s", "3.2323", settling, "ln(V(0)/V_inf)/alpha of the farthest start in E, not of the study's"
    )


def robustness(table: Table, certificate: Certificate) -> None:
    """Table II."""
    table.at("Table II, robustness")
    limits, box = certificate.limits, certificate.limits.inner_box
    assert certificate.robust is not None
    drift = certificate.robust.drift
    inverse, vertical = (np.linalg.inv(block) for block in certificate.blocks)
    literal = InputSet(limits.thrust_max, 0.698).inner_box[0]
    certified = [_certified_beta(np.linalg.inv(q), e) for q, e in zip(_PRINTED_QW, drift, strict=True)]
    table.number("T_max / g", "2", limits.thrust_max / limits.gravity, INPUT)
    table.number("eps_max = 40 deg, rad", "0.698", limits.tilt_max, f"taken as 0.698, vbar_1 would be {literal:.4f}")
    table.number(
        "vbar, m/s^2",
        "3.8804, 3.8804, 3.2700",
        box.tolist(),
        "2/3 g tan(eps_max)/sqrt 2 and g/3: the largest-volume box in V_c",
    )
    table.number(
        "beta, 1/s",
        "0.9668",
        {
            "E E' = 2 diag(1,1,0,0,0,0)": certificate.rate,
            "E E' = diag(1,1,0,0,0,0)": _beta(limits, (1.0, 0.0), (0.0, 0.0)),
            "E = I6": _beta(limits, (1.0, 1.0), (1.0, 1.0)),
        },
        "E is not printed; only this one gives the number, and with E = I6 (nan) there is no Q_w",
    )
    table.number(
        "Q_w, entries of x and y",
        "2.29, -2.14, 2.07",
        inverse[np.triu_indices(2)].tolist(),
        "equality in the robust condition at the largest beta; the semidefinite program agrees",
    )
    table.number(
        "Q_w, entries of z",
        "4.42, -2.14, 2.07",
        vertical[np.triu_indices(2)].tolist(),
        "4/beta^3 rounds to 4.43: cut off, not rounded",
    )
    table.claim(
        "Q_w as printed certifies beta, x and y",
        "0.9668 1/s",
        certified[0] >= 0.9668,
        f"{certified[0]:.4f} 1/s",
        "rounded, it satisfies the condition for no beta at all (0)",
    )
    table.claim(
        "Q_w as printed certifies beta, z",
        "0.9668 1/s",
        certified[1] >= 0.9668,
        f"{certified[1]:.4f} 1/s",
        "rounding a tight matrix breaks its inequality",
    )
    times = np.linspace(0.0, 200.0, 20_001)
    meant = max(w_x**2 + w_y**2 for w_x, w_y in map(printed_disturbance, times))
    table.number(
        "largest w'w of the printed disturbance",
        "1",
        {"w_y = cos(0.15), as printed": 1.0 + math.cos(0.15) ** 2, "w_y = cos(0.15 t)": meant},
        "w'w <= 1 is assumed; E E' = 2 diag(1,1,0,0,0,0) makes it admissible",
    )


def experiment_parameters(table: Table, certificate: Certificate) -> None:
    """Section IV-A."""
    table.at("Section IV-A, experiment setups")
    certified, start = certified_rate(_PRINTED_P), value_of(certificate, TEST_1_ERROR)
    kappa = float(certificate.sets.kappa(TEST_1_ERROR))
    table.number("sampling time, s", "0.1", certificate.period, INPUT)
    table.number("set-point of Test 1, m", "0.6, 0.6, 0.8", TEST_1_SET_POINT.tolist(), INPUT)
    table.number("start of Test 1, m", "-0.6, -0.6, 0", TEST_1_START.tolist(), INPUT)
    table.number("mu of Test 1, from and to", "1, 5", ADAPTATION_RATES[[1, -1]].tolist(), INPUT)
    table.number(
        "P, entries of one axis",
        "0.98, 0.78, 1.25",
        certificate.block[np.triu_indices(2)].tolist(),
        "alpha^3/2, alpha^2/2, alpha with alpha = 1.25, which is not printed",
    )
    table.number("eps", "2.3215", certificate.level, "rho / 1.25")
    table.claim(
        "P as printed certifies its rate",
        "1.25 1/s",
        certified >= certificate.rate,
        f"{certified:.4f} 1/s",
        "rounding a tight matrix breaks its inequality",
    )
    table.claim(
        "Test 1 starts in E, V(0)",
        f"at most {certificate.level:.4f}",
        start <= certificate.level,
        f"{start:.4f}",
        f"outside; but the applied gain is at least kappa = {kappa:.4f} > 1/2, so that V decreases all the same",
    )


def value_of(certificate: Certificate, state: FloatArray) -> float:
    """Return V of one state (6,)."""
    return float(state @ certificate.matrix @ state)


def certified_rate(block: FloatArray) -> float:
    """Return the largest alpha, 1/s, with A'P + P A - 2 P B B'P + alpha P <= 0."""
    return 1.0 - decay_residual(block, 1.0)


def _certified_beta(block: FloatArray, drift: float) -> float:
    """Return the largest beta of a grid for which P = Q_w^-1 satisfies the robust condition, 0 if none does."""
    grid = np.linspace(1e-4, 2.0, 20_000)
    return max((float(beta) for beta in grid if robust_residual(block, float(beta), drift, 0.0) <= 0.0), default=0.0)


def _beta(limits: InputSet, drift: tuple[float, float], push: tuple[float, float]) -> float:
    """Return the largest beta for a disturbance, 1/s, nan if the condition has no solution."""
    try:
        return rate_interval(largest_box(limits), np.array(drift), np.array(push))[1]
    except FlatsatError:
        return math.nan

"""What the paper says of its simulations and tests, beside our runs of them."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.certificate.gain_bounds import continuous_gain_bound, settling_time_bound
from flatsat_ros.demo import scenario as demo_scenario
from flatsat_ros.demo.record import PAPER_RMS, RMS_LIMIT
from flatsat_ros.flight import defaults
from flatsat_ros.paper.numbers import INPUT
from flatsat_ros.paper.runs import (
    ADAPTATION_RATES,
    CAMPAIGN_RUNS,
    GAMMA_0,
    STUDY_1_START,
    TEST_1_TIMING,
    V_INF,
    Runs,
)
from flatsat_ros.paper.studies import History
from flatsat_ros.paper.table import Table
from flatsat_ros.paper.tracking import hull_factor, inner_polytope

# how far above 1 the rounding of an integration may leave V
_ROUNDING = 1e-9

_REFERENCE_SAMPLES, _DIRECTIONS, _POLYTOPE_SIDES = 100, 500, 24


def study_1(table: Table, runs: Runs) -> None:
    """The simulation study of the adaptive gain."""
    table.at("Section III-A, simulation study, mu = 0..5")
    certificate, history = runs.simulation, runs.study_1
    first, final, rate = float(history.lyapunov[0, 0]), history.gain[-1], certificate.rate
    settling = history.settling(V_INF)
    after_1, after_3 = history.lyapunov[history.index(1.0)], history.lyapunov[history.index(3.0)]
    bounds = np.array([continuous_gain_bound(GAMMA_0, mu, first, V_INF, rate) for mu in ADAPTATION_RATES])
    surplus = 2.0 * V_INF * settling_time_bound(first, V_INF, rate)
    table.number("xi(0), m and m/s", "1.05, 1.04, 0.85, -0.02, -1.39, -0.42", STUDY_1_START.tolist(), INPUT)
    table.number("mu, from and to", "0, 5", ADAPTATION_RATES[[0, -1]].tolist(), INPUT)
    table.claim(
        "xi(0) lies in E, V(0)", f"at most {certificate.level:.4f}", first <= certificate.level, f"{first:.7f}", "just"
    )
    table.claim(
        "V reaches V_inf sooner with mu than without, s",
        "sooner",
        bool((settling[1:] < settling[0]).all()),
        _list(settling),
        "for mu = 0..5",
    )
    table.claim(
        "the transition improves with mu, V(1 s)", "falls", bool((np.diff(after_1) < 0.0).all()), _list(after_1),
        "for mu = 0..5, by less and less",
    )  # fmt: skip
    table.claim(
        "near the end a larger mu is slower, V(3 s)",
        "rises from mu = 1 on",
        bool((np.diff(after_3[1:]) > 0.0).all()),
        _list(after_3),
        "for mu = 0..5",
    )
    table.claim(
        "eq. 25 is the integral that it stands for, surplus",
        "0",
        surplus <= _ROUNDING,
        f"{surplus:.4f} mu",
        "V_inf t_inf has the wrong sign: 2 mu V_inf t_inf too much",
    )
    table.claim(
        "gamma stays below its bound (corrected)",
        _list(bounds),
        bool((final <= bounds * (1.0 + _ROUNDING)).all()),
        _list(final),
        "for mu = 0..5",
    )
    table.claim(
        "the gap to the bound grows with mu",
        "grows",
        bool((np.diff(bounds - final) > 0.0).all()),
        _list(bounds - final),
        "for mu = 0..5",
    )
    _limits(table, runs, history)


def study_2(table: Table, runs: Runs) -> None:
    """The robustness study."""
    table.at("Section III-B, robustness study")
    for gain, largest in runs.campaign.items():
        table.claim(
            f"E_w is invariant, gamma = {gain:g}: largest V",
            "at most 1",
            largest <= 1.0 + _ROUNDING,
            f"{largest:.9f}",
            f"{CAMPAIGN_RUNS:,} starts on the boundary, the disturbance at every moment the one that raises V most",
        )
    table.number("gamma", "1, 10", list(runs.study_2), INPUT)
    low, high = (_spread_of_v0(runs, gain) for gain in runs.study_2)
    table.claim(
        "with gamma = 10 the state keeps closer to B'P xi = 0",
        "closer",
        high < low,
        f"{high:.3f} < {low:.3f} m/s^2",
        "root mean square of B'P xi along x over the second half",
    )


def tracking(table: Table, runs: Runs) -> None:
    """The remark on tracking: how much the constant set costs along the references of Test 2."""
    table.at("Section III-B, remark on tracking")
    limits, (begin, end) = runs.experiment.limits, runs.flight.swap
    v_ref = np.array(
        [
            robot.reference.sample(t)[6:]
            for robot in runs.flight.robots.values()
            for t in np.linspace(begin, end, _REFERENCE_SAMPLES)
        ]
    )
    directions = np.random.default_rng(0).normal(size=(_DIRECTIONS, 3))
    corners = np.array(list(itertools.product(*zip(v_ref.min(axis=0), v_ref.max(axis=0), strict=True))))
    polytope = inner_polytope(limits, _POLYTOPE_SIDES).minus(corners).factor(directions)
    hull = hull_factor(limits, corners, directions)
    exact = limits.exit_factor(v_ref[:, np.newaxis], directions)
    ratios = [float((factor / polytope).mean()) for factor in (hull, exact)]
    table.claim(
        "room beyond the polytope of eq. 44, mean factor (ours)",
        "-",
        bool((hull >= polytope * (1.0 - _ROUNDING)).all() and (exact >= hull * (1.0 - _ROUNDING)).all()),
        f"{ratios[0]:.3f}, {ratios[1]:.3f}",
        f"V_c minus the box of v_ref exactly, not with {_POLYTOPE_SIDES} sides; and about v_ref(t) itself, as we do",
    )


def test_1(table: Table, runs: Runs) -> None:
    """Test 1 on a simulated loop with the lag and the delay of a Crazyflie over the radio."""
    table.at("Section IV-B, Test 1")
    history, capped, timing = runs.test_1, runs.test_1_capped, TEST_1_TIMING
    where = f"simulated at h = {timing.period} s with a lag of {timing.lag} s and a delay of {timing.delay} s"
    late = history.time >= 0.5 * history.time[-1]
    rest = np.linalg.norm(history.error[late][..., :3], axis=-1).max(axis=0)
    highest, growth = history.lyapunov[late].max(axis=0), np.ptp(history.gain[late], axis=0)
    table.claim(
        "mu = 1, 2: the steady-state error is removed, m", "0", bool((rest[:2] < 1e-3).all()), _list(rest[:2]), where
    )
    table.claim(
        "mu = 1, 2: gamma converges, late growth", "0", bool((growth[:2] == 0.0).all()), _list(growth[:2]), where
    )
    table.claim(
        "mu = 5: V does not stay below V_inf, late maximum", "above 0.05", bool(highest[-1] > V_INF),
        f"{highest[-1]:.4f}", where,
    )  # fmt: skip
    table.claim(
        "mu = 5: gamma does not converge, late growth", "above 0", bool(growth[-1] > 0.0), f"{growth[-1]:.3f}", where
    )
    below = bool((capped.lyapunov[late] <= V_INF).all())
    table.claim(
        f"with gamma capped at {runs.cap:.2f} every mu converges (ours)",
        "-",
        below,
        f"{capped.lyapunov[late].max():.1e}",
        "late maximum of V; the cap is proved for this loop",
    )
    _limits(table, runs, history)
    slowest = float(np.quantile(runs.steps[1], 0.99)) * 1e3
    table.claim(
        "the computation time remains below 3 ms",
        "below 3 ms",
        slowest < 3.0,
        f"{slowest:.3f} ms",
        "one step of one drone, 99 % of all are faster, processor time of this computer",
    )


def test_2(table: Table, runs: Runs) -> None:
    """Test 2 with simulated Crazyflies."""
    table.at("Table III, Test 2")
    robots = runs.flight.summary()["robots"]
    table.number("gamma_0, mu, V_inf", "1.0, 2.0, 0.05", [defaults.GAMMA_0, defaults.MU, defaults.V_INF], INPUT)
    begin = runs.flight.swap[0]
    places = np.array([robot.reference.sample(begin)[:2] for robot in runs.flight.robots.values()])
    table.number("way-points, x and y, 10 cm", "0, -6, 6, 6, -6, 6", (10.0 * places).ravel().tolist(), INPUT)
    height = float(runs.flight.robots["cf1"].reference.end[2])
    table.number(
        "height of the way-points, m", "1", {"z in m": height, "z in 10 cm": height / 10.0},
        "all three coordinates are printed as multiples of 10 cm; drones do not fly 10 cm above the floor",
    )  # fmt: skip
    for (name, robot), printed in zip(robots.items(), PAPER_RMS, strict=True):
        table.number(
            f"RMS tracking error of {name}, m",
            f"{printed}",
            robot["rms_m"],
            f"the time of the swap is not printed; ours takes {demo_scenario.LEG_TIME:g} s for a leg",
            undetermined=True,
        )
    largest = max(robot["rms_m"] for robot in robots.values())
    table.claim(
        "RMS tracking errors below 10 cm", "0.1 m", largest < RMS_LIMIT, f"{largest:.4f} m", "simulated Crazyflies"
    )
    average = float(runs.steps[3].mean()) * 1e3
    table.number(
        "average computation time, ms", "1.4809", average, "of this computer, three drones in one step",
        undetermined=True,
    )  # fmt: skip
    table.claim("average computation time below 2 ms", "2 ms", average < 2.0, f"{average:.3f} ms", "on this computer")


def _limits(table: Table, runs: Runs, history: History) -> None:
    limits = runs.simulation.limits
    tilt = math.degrees(float(np.abs(history.input[..., 1:]).max()))
    table.claim(
        "T_max, eps_max are kept: largest thrust and tilt",
        f"{limits.thrust_max:.2f} m/s^2, {math.degrees(limits.tilt_max):.0f} deg",
        bool(limits.contains(history.acceleration).all()),
        f"{history.input[..., 0].max():.2f} m/s^2, {tilt:.2f} deg",
        "of all runs",
    )


def _spread_of_v0(runs: Runs, gain: float) -> float:
    """Return the root mean square of B'P xi along x over the second half of study 2."""
    history = runs.study_2[gain]
    gradient = history.error[len(history.time) // 2 :] @ runs.robust.matrix
    return float(np.sqrt((gradient[..., 3] ** 2).mean()))


def _list(values: ArrayLike) -> str:
    return ", ".join(f"{value:.4g}" for value in np.asarray(values, dtype=np.float64))

"""Everything that `reproduce` computes: the certificates of the paper, its two simulation studies and its two tests."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.demo import headless as demo_headless
from flatsat_ros.demo import scenario as demo_scenario
from flatsat_ros.demo.record import FlightRecord
from flatsat_ros.falsification.loops import disturbance_matrix, worst_disturbance
from flatsat_ros.law.controller import Controller
from flatsat_ros.law.gain import Tuning
from flatsat_ros.paper.gain_laws import GainRuns, run_gain_laws
from flatsat_ros.paper.studies import (
    History,
    advance,
    measure_steps,
    on_boundary,
    run_continuous,
    run_sampled,
    start_of,
)
from flatsat_ros.synthesis.gain_cap import gain_cap
from flatsat_ros.synthesis.nominal import synthesize_paper
from flatsat_ros.synthesis.robust_design import synthesize_paper_robust

# Table I, and the simulation study of the adaptive gain
GAMMA_0, V_INF = 1.0, 0.05
ADAPTATION_RATES = np.arange(6.0)
STUDY_1_START = np.array([1.05, 1.04, 0.85, -0.02, -1.39, -0.42])
STUDY_1_SECONDS, STUDY_1_STEP = 5.0, 2e-3

# the robustness study: gains that the paper simulates, and one beyond
ROBUST_GAINS = (1.0, 10.0, 100.0)
_STUDY_2_SECONDS = 10.0
_STUDY_2_STARTS = 12
# integration step and length of the adversarial runs for each gain, s: the loop is as fast as k P_vv, about 15 k 1/s
_CAMPAIGN = {1.0: (0.05, 6.0), 10.0: (0.01, 3.0), 100.0: (0.001, 0.5)}
CAMPAIGN_RUNS = 10_000
_BATCH = 2_500  # runs at once: more do not fit the cache

# Test 1, on a loop as the experiment may have been: sampled, with the lag of the attitude and a delay
TEST_1_START, TEST_1_SET_POINT = np.array([-0.6, -0.6, 0.0]), np.array([0.6, 0.6, 0.8])
TEST_1_ERROR = np.concatenate([TEST_1_START - TEST_1_SET_POINT, np.zeros(3)])
TEST_1_TIMING = Timing(period=0.1, lag=0.1, delay=0.05)
TEST_1_SECONDS = 30.0

# beyond every gain that a run reaches: the paper's law has no cap
_NO_CAP = 1e6
_TIMED_STEPS = 4_000


@dataclass(frozen=True, eq=False)
class Runs:
    """What came out.

    Attributes:
        simulation, experiment, robust: certificates of Table I, of the experiments and of Table II.
        study_1: continuous, mu = 0..5.
        study_2: continuous under the printed disturbance, from the boundary of E_w, by gain.
        campaign: largest V of all adversarial runs from the boundary of E_w, by gain; E_w is V <= 1.
        cap: largest gain that is proved for the loop of Test 1.
        test_1: sampled with lag and delay, mu = 1..5, the paper's law.
        test_1_capped: the same with the gain capped.
        flight: Test 2 with simulated Crazyflies.
        gain_laws: repeated set-points and a lasting disturbance, by gain law.
        steps: processor time of `Controller.step` in s, by number of drones.
    """

    simulation: Certificate
    experiment: Certificate
    robust: Certificate
    study_1: History
    study_2: dict[float, History]
    campaign: dict[float, float]
    cap: float
    test_1: History
    test_1_capped: History
    flight: FlightRecord
    gain_laws: GainRuns
    steps: dict[int, FloatArray]


def run_all(folder: Path) -> Runs:
    """Compute everything, with progress on stderr; folder is for what the flight of Test 2 needs."""
    stages = tqdm(total=6, desc="certificates", bar_format="{desc:<44} {bar} {n}/{total}")
    with stages:

        def done(following: str) -> None:
            stages.update()
            stages.set_description_str(following)

        simulation, experiment = synthesize_paper("paper_simulation"), synthesize_paper("paper_experiment")
        robust = synthesize_paper_robust()
        cap = gain_cap(TEST_1_TIMING, experiment.block).gain_max
        done("study 1, adaptive gain")
        study_1 = run_study_1(simulation)
        done("study 2, robustness")
        study_2 = {gain: run_study_2(robust, gain) for gain in ROBUST_GAINS[:2]}
        done("test 1, adaptation rates")
        test_1 = run_test_1(experiment, _NO_CAP)
        test_1_capped = run_test_1(experiment, cap)
        done("gain laws")
        gain_laws = run_gain_laws(experiment)
        done("computation time")
        steps = {count: measure_steps(law(experiment, count), _spread(test_1.error[:, 0], count)) for count in (1, 3)}
        done("")
    campaign = {gain: run_campaign(robust, gain, CAMPAIGN_RUNS) for gain in ROBUST_GAINS}
    flight = demo_headless.fly(demo_scenario.plan(folder, paper=True))
    return Runs(
        simulation, experiment, robust, study_1, study_2, campaign, cap, test_1, test_1_capped, flight, gain_laws, steps
    )


def law(
    certificate: Certificate, count: int, mu: ArrayLike = 0.0, gain: float = GAMMA_0, cap: float = _NO_CAP
) -> Controller:
    """Return the paper's law for N drones: no leak, and no cap unless one is given."""
    uncapped = dataclasses.replace(certificate, gain_max=_NO_CAP)
    return Controller(uncapped, Tuning(np.broadcast_to(mu, (count,)), V_INF, gain, cap))


def run_study_1(certificate: Certificate) -> History:
    """The simulation study of the adaptive gain, for mu = 0..5."""
    count = len(ADAPTATION_RATES)
    start = np.tile(STUDY_1_START, (count, 1))
    return run_continuous(law(certificate, count, ADAPTATION_RATES), start, STUDY_1_SECONDS, STUDY_1_STEP)


def printed_disturbance(t: float) -> tuple[float, float]:
    """Return w_x and w_y of Table II at time t, m/s, with the t that its cosine lacks."""
    return math.sin(1.5 * t + math.pi / 8.0), math.cos(0.15 * t)


def run_study_2(certificate: Certificate, gain: float) -> History:
    """The robustness study: a constant gain, starts all around the boundary of E_w in its (x, xdot) plane."""
    angles = 2.0 * np.pi * np.arange(_STUDY_2_STARTS) / _STUDY_2_STARTS
    directions = np.zeros((_STUDY_2_STARTS, 6))
    directions[:, 0], directions[:, 3] = np.cos(angles), np.sin(angles)

    def drift(t: float, gradient: FloatArray) -> FloatArray:
        added = np.zeros_like(gradient)
        added[:, :2] = printed_disturbance(t)
        return added

    start = on_boundary(certificate.matrix, 1.0, directions)
    return run_continuous(
        law(certificate, len(start), gain=gain), start, _STUDY_2_SECONDS, _CAMPAIGN[gain][0] / 2.0, drift
    )


def run_campaign(certificate: Certificate, gain: float, runs: int, seed: int = 0) -> float:
    """Return the largest V of runs from the boundary of E_w under the disturbance that raises V most at every moment.

    If that one cannot push the state over the boundary, no admissible disturbance can.
    """
    assert certificate.robust is not None
    matrix = disturbance_matrix(certificate.robust)
    step, seconds = _CAMPAIGN[gain]
    directions = np.random.default_rng(seed).normal(size=(runs, 6))
    start = on_boundary(certificate.matrix, 1.0, directions)

    def adversary(t: float, gradient: FloatArray) -> FloatArray:
        return worst_disturbance(gradient, matrix) @ matrix

    largest, steps = 0.0, round(seconds / step)
    with tqdm(
        total=steps * runs,
        desc=f"E_w under attack, gamma = {gain:g}",
        bar_format="{desc:<44} {bar} {percentage:3.0f} %",
    ) as bar:
        for first in range(0, runs, _BATCH):
            y = start_of(law(certificate, 1, gain=gain), start[first : first + _BATCH])
            controller = law(certificate, len(y), gain=gain)
            for i in range(steps):
                y, output = advance(controller, y, i * step, step, adversary)
                largest = max(largest, float(output.lyapunov.max()))
                bar.update(len(y))
    return largest


def run_test_1(certificate: Certificate, cap: float) -> History:
    """Test 1 for mu = 1..5."""
    rates = ADAPTATION_RATES[1:]
    start = np.tile(TEST_1_ERROR, (len(rates), 1))
    return run_sampled(law(certificate, len(rates), rates, cap=cap), start, TEST_1_SECONDS, TEST_1_TIMING)


def _spread(errors: FloatArray, count: int) -> FloatArray:
    """Return states (M, N, 6) for timing from those of one flight (m, 6), repeated."""
    return np.resize(errors, (_TIMED_STEPS, count, 6))

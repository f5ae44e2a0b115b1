"""The paper's simulations and tests, run again through `Controller.step`: continuous, sampled, disturbed, timed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import thread_time_ns

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.falsification.loops import runge_kutta
from flatsat_ros.law.controller import Controller, Memory, Output
from flatsat_ros.law.gain import adapt

# E w (N, 6) at time t, s, for N drones, given xi'P (N, 6)
Disturbance = Callable[[float, FloatArray], FloatArray]

POSE_NOISE = 5e-4  # m, standard deviation of the motion capture in studies that fly the simulated Crazyflie


@dataclass(frozen=True, eq=False)
class History:
    """What N loops did at M times.

    Attributes:
        time: (M,) s.
        error: (M, N, 6) xi, m and m/s.
        lyapunov: (M, N) V.
        gain: (M, N) gamma.
        applied_gain: (M, N) k.
        acceleration: (M, N, 3) v, m/s^2.
        input: (M, N, 3) u = (T, phi, theta), m/s^2 and rad.
    """

    time: FloatArray
    error: FloatArray
    lyapunov: FloatArray
    gain: FloatArray
    applied_gain: FloatArray
    acceleration: FloatArray
    input: FloatArray

    @classmethod
    def of(cls, time: FloatArray, outputs: list[Output]) -> History:
        """Stack the outputs of M steps."""
        names = ("error", "lyapunov", "gain", "applied_gain", "acceleration", "input")
        return cls(time, *(np.array([getattr(output, name) for output in outputs]) for name in names))

    def index(self, time: float) -> int:
        """Return the number of the sample nearest to a time, s."""
        return int(np.abs(self.time - time).argmin())

    def settling(self, threshold: float) -> FloatArray:
        """Return when V first reaches the threshold, (N,) s, linear between samples; infinite if never."""
        times = np.full(self.lyapunov.shape[1], np.inf)
        for i, column in enumerate(self.lyapunov.T):
            below = np.flatnonzero(column <= threshold)
            if below.size and below[0] > 0:
                j = below[0]
                share = (column[j - 1] - threshold) / (column[j - 1] - column[j])
                times[i] = self.time[j - 1] + share * (self.time[j] - self.time[j - 1])
        return times


def run_continuous(
    law: Controller, start: FloatArray, seconds: float, step: float, disturbance: Disturbance | None = None
) -> History:
    """Integrate the continuous closed loop with its gain, for N drones at hover references.

    Args:
        law: of N drones.
        start: (N, 6) xi(0).
        seconds: how long.
        step: of the integration, s.
        disturbance: E w, none by default.
    """
    y, outputs = start_of(law, start), []
    times = step * np.arange(round(seconds / step) + 1, dtype=np.float64)
    for t in times:
        y, output = advance(law, y, float(t), step, disturbance)
        outputs.append(output)
    return History.of(times, outputs)


def start_of(law: Controller, start: FloatArray) -> FloatArray:
    """Return the state (N, 7) of the continuous loop: xi and gamma_0."""
    return np.hstack([start, np.broadcast_to(law.start().gain, (len(start),))[:, np.newaxis]])


def advance(
    law: Controller, y: FloatArray, t: float, step: float, disturbance: Disturbance | None
) -> tuple[FloatArray, Output]:
    """Return the state (N, 7) one Runge-Kutta step later, and the output at its beginning."""
    yaw, reference = np.zeros(len(y)), np.zeros((len(y), 9))

    outputs = []

    def slope(part: int, y: FloatArray) -> FloatArray:
        _, output = law.step(Memory(y[:, 6]), y[:, :6], yaw, reference)
        # what forward Euler adds in one second is the slope of the continuous law
        growth = adapt(y[:, 6], output.lyapunov, law.tuning, 1.0) - y[:, 6]
        outputs.append(output)
        flow = np.hstack([y[:, 3:6], output.acceleration, growth[:, np.newaxis]])
        if disturbance is not None:
            flow[:, :6] += disturbance(t + part * step / 2.0, y[:, :6] @ law.certificate.matrix)
        return flow

    return runge_kutta(slope, y, step), outputs[0]


def run_sampled(
    law: Controller,
    start: FloatArray,
    seconds: float,
    timing: Timing,
    drift: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> History:
    """Fly the sampled law on a double integrator behind a lag and a delay, discretised exactly.

    Args:
        law: of N drones.
        start: (N, 6) xi(0), hovering.
        seconds: how long.
        timing: of the loop; its period is the law's.
        drift: of the position, m/s, in each period.
    """
    state = np.zeros((len(start), timing.size, 3))
    state[:, :2] = start.reshape(-1, 2, 3)
    memory, outputs = law.start(), []
    times = timing.period * np.arange(round(seconds / timing.period) + 1, dtype=np.float64)
    for _ in times:
        error = state[:, :2].reshape(-1, 6)
        memory, output = law.step(memory, error, np.zeros(len(start)), np.zeros((len(start), 9)))
        outputs.append(output)
        state = timing.advance(state, output.acceleration)
        state[:, 0] += timing.period * np.array(drift)
    return History.of(times, outputs)


def on_boundary(matrix: FloatArray, level: float, directions: FloatArray) -> FloatArray:
    """Return the states (N, 6) of V = level in the directions (N, 6), uniform on the set if those are on a sphere."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return np.asarray(np.sqrt(level) * np.linalg.solve(np.linalg.cholesky(matrix).T, unit.T).T)


def measure_steps(law: Controller, errors: FloatArray) -> FloatArray:
    """Return the processor time of one step for each of M states (M, N, 6) of N drones, (M,) s."""
    yaw, reference = np.zeros(errors.shape[1]), np.zeros((errors.shape[1], 9))
    memory, durations = law.start(), np.empty(len(errors), dtype=np.int64)
    for i, state in enumerate(errors):
        begin = thread_time_ns()
        law.step(memory, state, yaw, reference)
        durations[i] = thread_time_ns() - begin
    return np.asarray(durations * 1e-9, dtype=np.float64)

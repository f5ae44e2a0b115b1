"""Tables about identification: prediction and intervals on real flights, truth inside the intervals on simulated ones.

Run as `make identification DATA=FOLDER`: every CSV log in the folder that can be used is used. The figures of the drone
are fitted on the flights of --fit (by default the first three) and judged on all others; with three or fewer, each
flight is judged by a fit on the others.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from scipy.signal import savgol_coeffs
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).parents[1] / "test" / "support"))

from flown import fly
from swap import swap

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.vehicle import PWM_FULL, VehicleProfile, load_vehicle
from flatsat_ros.demo.scenario import PAPER_WAYPOINTS, gentle_swap
from flatsat_ros.identification.disturbances import shared
from flatsat_ros.identification.fit import excited, fit
from flatsat_ros.identification.identified import NAMES, Identified, estimate, identify, profile_figures, telling
from flatsat_ros.identification.log import read_log
from flatsat_ros.identification.prediction import ahead
from flatsat_ros.identification.recording import read_csv
from flatsat_ros.identification.residuals import ComparedFlight
from flatsat_ros.identification.response import Figures
from flatsat_ros.identification.screening import STEP, Samples, position_noise, screen
from flatsat_ros.identification.surroundings import surroundings
from flatsat_ros.identification.validation import older, oldest
from flatsat_ros.sim.dynamics import Wind

AHEAD = 50  # samples, 0.5 s
PAST = 11  # samples from which the state at the start is taken, 0.1 s, by a quadratic
CALIBRATION = 6.0  # s of flight from which each model gets thrust and frame


# drone-models 0.1.0 (MIT), so_rpy_rotor and so_rpy_rotor_drag of cf2x_L250: without a delay, with a first-order thrust
# and rpy'' = -245.67 rpy - 17.32 rpy' + 196.18 command. Its own quaternion rate is for w, x, y, z and its quaternions
# are x, y, z, w: here the angles are integrated.
ROTOR = Figures(
    attitude_gain=196.18 / 245.67,
    natural_frequency=math.sqrt(245.67),
    damping=17.32 / 2.0 / math.sqrt(245.67),
    velocity_tilt=0.0,
    thrust_slope=1.0,
    thrust_lag=0.0858607,
    drag_xy=0.0,
    drag_z=0.0,
    delay=0.0,
)
# of which the packaged profile was made
PACKAGED = (
    "B10_lissajous_fast_rep1", "B2_circle_fast_rep1", "B2_circle_medium_rep1", "B2_circle_slow_rep2",
    "B3_figure8_fast_rep2", "B3_figure8_medium_rep1", "B3_figure8_slow_rep2", "B5_helix_fast_rep1",
    "B5_helix_slow_rep1", "B7_oval_fast_rep1", "B8_star_fast_rep1", "B9_trefoil_fast_rep1",
)  # fmt: skip
ROTOR_DRAG = dataclasses.replace(ROTOR, thrust_lag=0.12116392, drag_xy=0.01471782 / 0.0319, drag_z=0.01277641 / 0.0319)


def usable(folder: Path) -> Iterator[Samples]:
    """Yield the flights of a folder that can be used, each once; say why others cannot."""
    seen = set()
    for path in sorted(folder.glob("*.csv")):
        try:
            samples = screen(read_log(path))
        except FlatsatError as error:
            print(f"  left out: {error}", flush=True)
            continue
        key = samples.position[samples.usable][:500].tobytes()
        if key in seen:
            print(f"  left out: {samples.name} is there twice", flush=True)
            continue
        seen.add(key)
        yield samples


def state(samples: Samples) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return position, velocity and acceleration (M, 3) from the PAST samples, no later ones."""
    found = []
    for order in range(3):
        weights = savgol_coeffs(PAST, 2, deriv=order, delta=STEP, pos=PAST - 1, use="dot")
        columns = [np.correlate(axis, weights, mode="valid") for axis in samples.position.T]
        found.append(np.pad(np.stack(columns, axis=-1), ((PAST - 1, 0), (0, 0))))
    return found[0], found[1], found[2]


def starts(samples: Samples) -> np.ndarray:
    """Return the samples from which the next AHEAD and the PAST ones can be used, after the calibration."""
    whole = np.convolve(samples.usable, np.ones(PAST + AHEAD), mode="valid") > PAST + AHEAD - 0.5
    begin = np.flatnonzero(samples.usable)[0] + round(CALIBRATION / STEP)
    at = np.flatnonzero(whole)[::5] + PAST - 1
    return at[at > begin]


def calibrated(samples: Samples) -> ComparedFlight | None:
    """Return the first CALIBRATION seconds of a flight, None if too little of them can be used."""
    end = np.flatnonzero(samples.usable)[0] + round(CALIBRATION / STEP)
    good = samples.poses_good.copy()
    good[end:] = False
    flight = ComparedFlight.of(dataclasses.replace(samples, poses_good=good))
    return flight if len(flight.position_at) >= 20 else None


def predicted(samples: Samples, figures: Figures, at: np.ndarray) -> FloatArray | None:
    """Return positions (len(at), 3) AHEAD of samples, from the state there and the commands before and after.

    Thrust, frame and trim are those of the first CALIBRATION seconds.
    """
    first = calibrated(samples)
    if first is None:
        return None
    known = fit([first], figures, (), starts=1).misfits[0]
    place, velocity, _ = state(samples)
    wn, zeta, whole = figures.natural_frequency, figures.damping, int(figures.delay / STEP)
    share = figures.delay / STEP - whole
    index = np.arange(len(place) + AHEAD)
    sent = samples.command
    earlier, later = (sent[np.clip(index - whole - back, 0, len(sent) - 1)] for back in (1, 0))
    command = later * (1.0 - share) + earlier * share
    charge = 1.0
    if len(samples.voltage):  # means over 1 s, that of each sample from before the prediction in which it is
        past = samples.voltage[np.clip(index - AHEAD - 50, 0, len(sent) - 1)]
        charge = (past / first.motion.samples.mean_voltage) ** figures.thrust_voltage
    goal = known.thrust_full * charge * (np.clip(command[:, 2], 0.0, None) / PWM_FULL) ** figures.thrust_slope
    yaw = np.nan_to_num(samples.angles[:, 2])
    lag = math.exp(-STEP / figures.thrust_lag)

    def turn(
        tilt: FloatArray, rate: FloatArray, k: np.ndarray, v: FloatArray, cos: FloatArray, sin: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        lean = np.stack([sin * v[..., 0] - cos * v[..., 1], cos * v[..., 0] + sin * v[..., 1]], axis=-1)
        wanted = figures.attitude_gain * command[k, :2] + figures.velocity_tilt * lean
        for _ in range(4):  # semi-implicit Euler at 400 Hz
            rate = rate + (wn * wn * (wanted - tilt) - 2.0 * zeta * wn * rate) * STEP / 4.0
            tilt = tilt + rate * STEP / 4.0
        return tilt, rate

    tilts, rates, thrusts = np.zeros((len(place), 2)), np.zeros((len(place), 2)), np.zeros(len(place))
    thrusts[0] = goal[0]
    for k in range(len(place) - 1):
        tilts[k + 1], rates[k + 1] = turn(tilts[k], rates[k], np.array(k), velocity[k], np.cos(yaw[k]), np.sin(yaw[k]))
        thrusts[k + 1] = goal[k] + (thrusts[k] - goal[k]) * lag
    trim = known.trim
    p, v, tilt, rate, thrust = place[at], velocity[at], tilts[at], rates[at], thrusts[at]
    cos, sin = np.cos(yaw[at]), np.sin(yaw[at])
    drag = np.array([figures.drag_xy, figures.drag_xy, figures.drag_z])
    for step in range(AHEAD):
        (sr, sp), (cr, cp) = np.sin(tilt).T, np.cos(tilt).T
        along, across = cr * sp * thrust + trim[0], -sr * thrust + trim[1]
        force = np.stack([cos * along - sin * across, sin * along + cos * across, cr * cp * thrust - GRAVITY], axis=-1)
        a = force - drag * v
        p, v = p + v * STEP + 0.5 * a * STEP * STEP, v + a * STEP
        tilt, rate = turn(tilt, rate, at + step, v, cos, sin)
        thrust = goal[at + step] + (thrust - goal[at + step]) * lag
    return p


def prediction(flights: Sequence[tuple[Samples, Figures]], base: VehicleProfile) -> None:
    """Print how far predictions are off after 0.5 s."""
    judged = [(samples, figures, starts(samples)) for samples, figures in flights]
    for samples, _, at in judged:
        if len(at) == 0 or calibrated(samples) is None:
            print(f"  {samples.name}: too short after the calibration")
    judged = [each for each in judged if len(each[2]) and calibrated(each[0]) is not None]
    shipped = dataclasses.replace(profile_figures(base), delay=0.03)
    guesses: dict[str, list[FloatArray]] = {"constant velocity": [], "constant acceleration": []}
    for samples, _, at in judged:
        (place, velocity, acceleration), time = state(samples), AHEAD * STEP
        steady = place[at] + velocity[at] * time
        guesses["constant velocity"].append(steady)
        guesses["constant acceleration"].append(steady + 0.5 * acceleration[at] * time**2)
    for name, fixed in (
        ("drone-models' rotor", ROTOR),
        ("drone-models' rotor with drag", ROTOR_DRAG),
        (base.name, shipped),
        ("identified", None),
    ):
        kinds: dict[str, list[FloatArray]] = {"calibrated": [], "filtered": [], "filtered, adapting": []}
        groups: dict[Figures, list[tuple[Samples, np.ndarray]]] = {}
        for samples, figures, at in judged:
            guess = predicted(samples, fixed or figures, at)
            assert guess is not None
            kinds["calibrated"].append(guess)
            groups.setdefault(fixed or figures, []).append((samples, at))
        for figures, members in groups.items():
            several, begins = [each for each, _ in members], [at for _, at in members]
            for kind, adapt in (("filtered", False), ("filtered, adapting", True)):
                kinds[kind].extend(ahead(several, figures, begins, AHEAD, adapt=adapt))
        guesses |= {f"{name}, {kind}": found for kind, found in kinds.items()}
    print(f"\nposition 0.5 s ahead, RMS, {len(judged)} flights")
    truth = np.concatenate([samples.position[at + AHEAD] for samples, _, at in judged])
    rms = {
        name: float(np.sqrt(np.mean(((np.concatenate(found) - truth) ** 2).sum(axis=1))))
        for name, found in guesses.items()
    }
    best = rms["identified, filtered, adapting"]
    for name, value in rms.items():
        print(f"  {name:52s} {100.0 * value:6.2f} cm   identified, adapting, over it: {best / value:.3f}")


def coverage(known: Identified, others: Sequence[Samples], base: VehicleProfile) -> None:
    """Print how many of the other flights' own estimates lie in the intervals."""
    around = surroundings(known.flights, known.common)
    beside: dict[str, list[float]] = {each.name: [] for each in around}
    values: dict[str, list[float]] = {name: [] for name in NAMES}
    for samples in others:
        flight = ComparedFlight.of(samples)
        try:
            alone = fit([flight], known.common.figures, excited([flight]), starts=1)
        except FlatsatError as error:
            print(f"  left out: {error}")
            continue
        for each in surroundings([flight], alone):
            if each.flights:
                beside[each.name].append(each.value)
        for name in NAMES:
            if known.figures[name].interval is not None and telling(name, alone, base.pwm_max):
                values[name].append(estimate(name, alone, base.pwm_max))
    print("\nother flights' own estimates inside the stated interval")
    intervals = {name: known.figures[name].interval for name in NAMES} | {each.name: each.interval for each in around}
    for name, found in (values | beside).items():
        if intervals[name] is None or not found:
            continue
        low, high = intervals[name]
        share = np.mean([low <= value <= high for value in found])
        quantiles = np.percentile(found, (5, 50, 95))
        print(
            f"  {name:22s} [{low:8.4g}, {high:8.4g}]  {share:5.0%} of {len(found):3d}   "
            f"5 / 50 / 95 %: {quantiles[0]:.4g} / {quantiles[1]:.4g} / {quantiles[2]:.4g}"
        )


def hits(run: int) -> dict[str, bool]:
    """Tell for each figure that three flights of a simulated drone tell whether the truth is in its interval."""
    names = ("cf21", "cf21_plus", "cf2x_2025", "thrust_kit", "brushless")
    draw = np.random.default_rng((run, 14))
    base = load_vehicle(names[run % len(names)])
    gain, weight, slope = draw.uniform(0.7, 1.0), draw.uniform(0.8, 1.2), draw.uniform(0.75, 1.0)
    charge, full = draw.uniform(0.0, 0.8), draw.uniform(3.6, 4.1)
    delay = round(draw.uniform(0.0, 0.06) / 0.002) * 0.002
    dynamics = dataclasses.replace(base.dynamics, attitude_gain=gain, thrust_gain=1.0)
    drone = dataclasses.replace(base, dynamics=dynamics, thrust_slope=slope, thrust_voltage=charge)
    voltages = full, full - 0.25
    seeds = range(3 * run, 3 * run + 3)
    logs = fly(drone, seeds, seconds=20.0, delay=delay, noise=1e-3, weight=weight, voltages=voltages)
    wandering = [  # of the clock of the commands, 10 ms from flight to flight
        dataclasses.replace(log, command_time=log.command_time + draw.uniform(-0.005, 0.005)) for log in logs
    ]
    found = identify([screen(log) for log in wandering], base)
    truth = {
        "attitude_gain": gain,
        "lag_and_delay": base.dynamics.attitude.mean_delay + delay,
        "thrust_slope": slope,
        "drag_xy": base.dynamics.drag_xy,
        "drag_z": base.dynamics.drag_z,
        "velocity_tilt": 0.0,
        "thrust_voltage": charge,
        "thrust_available": weight * drone.thrust_max * float(drone.voltage_factor(sum(voltages) / 2.0)),
    }
    if base.dynamics.attitude.actuator_lag == 0.0:  # else the attitude is of third order
        attitude = base.dynamics.attitude
        truth |= {"natural_frequency": attitude.natural_frequency, "damping": attitude.damping}
    if base.dynamics.thrust_lag_up == base.dynamics.thrust_lag_down:
        truth["thrust_lag"] = base.dynamics.thrust_lag_up
    intervals = {name: found.figures[name].interval for name in truth}
    return {name: ends[0] <= truth[name] <= ends[1] for name, ends in intervals.items() if ends is not None}


def simulated(runs: int) -> None:
    """Print how often the truth is inside the interval, for simulated drones of all packaged profiles."""
    found = [hits(run) for run in tqdm(range(runs), desc="simulated drones", leave=False)]
    print(f"\ntruth inside the interval, {runs} simulated drones with 3 flights each")
    for name in NAMES:
        told = [each[name] for each in found if name in each]
        if told:
            print(f"  {name:20s} {np.mean(told):5.0%} of {len(told)}")


def packaged(flights: Sequence[Samples]) -> bool:
    """Print what the flights of `cf21_markers` tell today; return whether the profile's intervals hold all of it."""
    profile, made = load_vehicle("cf21_markers"), {samples.name: samples for samples in flights}
    print(f"\nthe {len(PACKAGED)} flights of which {profile.name} was made")
    lacking = [name for name in PACKAGED if name not in made]
    if lacking:
        print(f"  not checked: the folder lacks {', '.join(lacking)}")
        return True
    now = identify([made[name] for name in PACKAGED], dataclasses.replace(load_vehicle("cf21"), mass=profile.mass))
    good, then = True, {name: getattr(profile_figures(profile), name, None) for name in NAMES}
    then |= {"thrust_available": profile.thrust_max, "lag_and_delay": math.nan}  # that with link and clocks
    for name in NAMES:
        interval, figure = getattr(profile.intervals, name), now.figures[name]
        told = (
            "not told"
            if figure.interval is None
            else f"{figure.value:.4g} [{{:.4g}}, {{:.4g}}]".format(*figure.interval)
        )
        verdict = "no interval in the profile"
        if interval is not None:
            inside = interval[0] <= figure.value <= interval[1]
            good = good and inside
            verdict = f"{'inside' if inside else 'OUTSIDE'} [{interval[0]:.4g}, {interval[1]:.4g}]"
        print(f"  {name:20s} profile {then[name]:8.4g}   now {told:28s} {verdict}")
    return good


def recordings(folder: Path) -> None:
    """Print what recordings of motion capture say about noise and age of poses."""
    print("\nrecordings of motion capture: noise in mm (50 % / 99.9 % / worst), age of the newest pose")
    for path in sorted(folder.glob("*.csv")):
        recording = read_csv(path)
        later = np.flatnonzero(np.diff(recording.time, prepend=-np.inf) > 0.0)
        time, position = recording.time[later], recording.position[later]
        use = np.isfinite(position).all(axis=1)
        sizes = 1e3 * shared(position_noise(time, position, use))
        between = np.diff(time[use])
        noise = (
            "not told" if len(sizes) == 0 else "{:.2g} / {:.2g} / {:.2g}".format(*np.percentile(sizes, (50, 99.9, 100)))
        )
        ages = np.column_stack([np.zeros_like(between), between])
        kept = 1.0 - older(ages, 0.021)
        print(
            f"  {path.stem:24s} {between.sum():5.0f} s, {len(between) / between.sum():5.1f} Hz   {noise:22s} mm   "
            f"99.9 % {1e3 * oldest(ages, 0.999):6.0f} ms, longest {between.max():5.2f} s, up to 20 ms {kept:7.2%}"
        )


def light() -> None:
    """Print how the swap goes that is certified for the drone of the flights, once it is light enough to be lifted."""
    vehicle, certificate = load_vehicle("cf21_markers_light"), load_certificate("cf21_markers_light_soft_50hz")
    box, places = certificate.flight.horizontal.box, PAPER_WAYPOINTS
    paths = [gentle_swap(certificate, places, index, len(places)) for index in range(len(places))]
    print(f"\nswap of {vehicle.name} by {certificate.name}, {vehicle.thrust_max / GRAVITY:.3f} g, {vehicle.mass:g} kg")
    for gain in (vehicle.dynamics.attitude_gain, box.low.gain, box.high.gain):
        drone = dataclasses.replace(vehicle, dynamics=dataclasses.replace(vehicle.dynamics, attitude_gain=gain))
        print(f"  attitude gain {gain:.3f}: {swap(certificate, vehicle, drone, paths, Wind())}")


def main() -> int:
    """Print the tables; 1 if the packaged profile contradicts the flights of which it was made."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="?", type=Path, help="folder with CSV logs of one drone")
    parser.add_argument("--fit", nargs="+", metavar="NAME", help="flights to fit on, without .csv")
    parser.add_argument("--base", default="cf21")
    parser.add_argument("--recordings", type=Path, help="folder with CSV recordings of motion capture")
    parser.add_argument("--runs", type=int, default=25, help="simulated drones (default: 25, a minute)")
    arguments = parser.parse_args()
    base, good = load_vehicle(arguments.base), True
    if arguments.data is not None:
        flights = list(usable(arguments.data))
        chosen = arguments.fit or [samples.name for samples in flights[:3]]
        fitted = [samples for samples in flights if samples.name in chosen]
        others = [samples for samples in flights if samples.name not in chosen]
        known = identify(fitted, base)
        print(f"\nfitted on {', '.join(samples.name for samples in fitted)}; {len(others)} others")
        if others:
            prediction([(samples, known.common.figures) for samples in others], base)
            coverage(known, others, base)
        else:
            pairs = []
            for samples in fitted:
                rest = [each for each in fitted if each is not samples]
                pairs.append((samples, identify(rest, base).common.figures))
            prediction(pairs, base)
        good = packaged(flights)
    if arguments.recordings is not None:
        recordings(arguments.recordings)
    light()
    if arguments.runs:
        simulated(arguments.runs)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())

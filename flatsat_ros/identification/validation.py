"""Whether what a certificate assumes about drone and motion capture is so in flights: supported, contradicted, silent.

A certificate holds for the drone it was made for: a thrust that is there, a lag and a delay, an attitude that goes
where it is sent, poses in time, bounds of noise and disturbance. Flights can contradict that, and support it in what
they show; nothing is proved.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight import Axis
from flatsat_ros.crazyflie.intervals import Interval, Intervals
from flatsat_ros.crazyflie.vehicle import PWM_FULL, VehicleProfile
from flatsat_ros.identification.disturbances import BANDWIDTH, blur, disturbances, shared
from flatsat_ros.identification.identified import NAMES, Identified
from flatsat_ros.identification.log import ClaimedFlight, FlightLog, ages

SUPPORTS, CONTRADICTS, SILENT = "supports", "contradicts", "silent"
COVERED = 0.999  # share of the samples that must keep a bound
_GAIN = 0.05  # from a gain of 1, up to which flights support it where a certificate knows no other
_ROUNDING = 1e-3  # s, of stamps
_THIRD = 8.0 / math.sqrt(20.0)  # third differences of noise up to 1, over sqrt(20), are up to that


@dataclass(frozen=True)
class Verdict:
    """One assumption.

    Attributes:
        assumption: in words.
        bound: what the certificate assumes, in words.
        shown: what the flights show, in words.
        verdict: SUPPORTS, CONTRADICTS or SILENT.
    """

    assumption: str
    bound: str
    shown: str
    verdict: str


def validate(
    certificate: Certificate, identified: Identified, logs: Sequence[FlightLog], vehicle: VehicleProfile | None = None
) -> list[Verdict]:
    """Return a verdict on each assumption of a certificate.

    Args:
        certificate: of any kind.
        identified: what the flights tell of the drone.
        logs: of the flights, for the times between poses and the errors of our controller.
        vehicle: the drone's profile, with which the controller flies: its thrust map counts as known, and its intervals
            are judged, too.
    """
    if certificate.flight is None:
        return [*_ideal(certificate, identified, logs), *_profile(vehicle, identified)]
    return [*_flying(certificate, identified, logs, vehicle), *_profile(vehicle, identified)]


def _ideal(certificate: Certificate, identified: Identified, logs: Sequence[FlightLog]) -> Iterator[Verdict]:
    """Judge a certificate without a flight section."""
    yield _thrust(certificate, identified)
    total, lag = certificate.lag + certificate.delay, certificate.lag
    bound = f"at most {lag:.4g} + {certificate.delay:.4g} s"
    yield _interval("lag plus delay", identified, "lag_and_delay", (-math.inf, total), "s", bound)
    yield _interval("thrust lag", identified, "thrust_lag", (-math.inf, lag), "s")
    yield _interval("attitude gain", identified, "attitude_gain", (1.0 - _GAIN, 1.0 + _GAIN), "")
    if certificate.robust is not None:
        pushed, _ = disturbances(identified.flights, identified.common, np.zeros(3))
        unsure, _ = _blurred(identified)
        for name, sizes, most in zip(
            ("push of x and y", "push of z"),
            (np.hypot(pushed[:, 0], pushed[:, 1]), np.abs(pushed[:, 2])),
            certificate.robust.push,
            strict=True,
        ):
            yield _share(f"{name} up to {BANDWIDTH:.2g} Hz", sizes, float(most), "m/s^2", unsure)
    yield _poses(certificate.period, certificate.period, logs)


def _flying(
    certificate: Certificate, identified: Identified, logs: Sequence[FlightLog], vehicle: VehicleProfile | None
) -> Iterator[Verdict]:
    """Judge a certificate with a flight section."""
    flight = certificate.flight
    assert flight is not None
    sides, upright = flight.horizontal.box, flight.vertical.box
    yield _thrust(certificate, identified)
    total = sides.low.lead + sides.low.delay, sides.high.lead + sides.high.delay
    yield _interval("lag plus delay", identified, "lag_and_delay", total, "s")
    yield _interval("attitude gain", identified, "attitude_gain", (sides.low.gain, sides.high.gain), "")
    if sides.low.frequency > 0.0:
        wn, zeta = (sides.low.frequency, sides.high.frequency), (sides.low.damping, sides.high.damping)
        yield _interval("natural frequency", identified, "natural_frequency", wn, "rad/s")
        yield _interval("damping", identified, "damping", zeta, "")
    yield _interval("thrust lag", identified, "thrust_lag", (upright.low.lag, upright.high.lag), "s")
    known = None
    if vehicle is not None:
        known = vehicle.force_max / vehicle.mass
        ratio = (vehicle.pwm_max / PWM_FULL) ** identified.common.figures.thrust_slope * known
        gain = upright.low.gain * ratio, upright.high.gain * ratio
        yield _interval("thrust scale", identified, "thrust_available", gain, "m/s^2")
    pushed, change = disturbances(identified.flights, identified.common, _slowing(flight.axes, identified), known)
    pushed = pushed / (identified.common.figures.attitude_gain, identified.common.figures.attitude_gain, 1.0)
    more, faster = _blurred(identified)
    sizes, rate, noise = np.linalg.norm(pushed, axis=1), flight.assumptions.disturbance_rate, flight.assumptions.noise
    yield _share(f"disturbance up to {BANDWIDTH:.2g} Hz", sizes, flight.disturbance, "m/s^2", more)
    yield _share(f"its rate up to {BANDWIDTH:.2g} Hz", shared(change), rate, "m/s^3", faster)
    yield _share("pose noise", 1e3 * shared(identified.noise), 1e3 * noise, "mm", 1e3 * noise * (_THIRD - 1.0))
    yield _poses(flight.assumptions.pose_age, certificate.period, logs)
    flown = [log.flown for log in logs if log.flown is not None]
    if flown:
        yield from _tube(flown, (flight.horizontal.tube.position, flight.vertical.tube.position))


def _blurred(identified: Identified) -> tuple[float, float]:
    """Return up to which sizes noise of the poses, where it is told, looks like a disturbance and like its change."""
    return blur(0.0 if math.isnan(identified.pose_noise) else identified.pose_noise, COVERED)


def _tube(flown: Sequence[ClaimedFlight], tube: tuple[float, float]) -> Iterator[Verdict]:
    """Judge the tube by the ticks in which our controller claimed it, with a certificate that has the same one."""
    error, certified, claimed = (
        np.concatenate([getattr(each, name) for each in flown]) for name in ("error", "tube", "claimed")
    )
    same = np.isclose(certified, tube, rtol=1e-6).all(axis=1)
    shown = f"claimed in {np.mean(claimed[same]):.1%} of the flight" if same.any() else "flown with another certificate"
    use = same & claimed
    for name, sizes, most in (
        ("tube of x and y", np.hypot(error[:, 0], error[:, 1]), tube[0]),
        ("tube of z", np.abs(error[:, 2]), tube[1]),
    ):
        found = _share(name, sizes[use], most, "m")
        yield dataclasses.replace(found, shown=f"{found.shown}; {shown}")


def _profile(vehicle: VehicleProfile | None, identified: Identified) -> Iterator[Verdict]:
    """Judge the intervals of a profile, by the value that these flights have in common."""
    known = Intervals() if vehicle is None or vehicle.intervals is None else vehicle.intervals
    for name in NAMES:
        interval, found = getattr(known, name), identified.figures[name]
        if interval is None:
            continue
        verdict, shown = SILENT, "not told"
        if found.interval is not None:
            verdict = SUPPORTS if interval[0] <= found.value <= interval[1] else CONTRADICTS
            shown = f"{found.value:.4g}"
        yield Verdict(f"profile: {name}", f"[{interval[0]:.4g}, {interval[1]:.4g}]", shown, verdict)


def _slowing(axes: tuple[Axis, Axis], identified: Identified) -> FloatArray:
    """Return what of the slowing by the velocity (3,), 1/s, plants of the boxes have: the nearest to the drone's."""
    figures = identified.common.figures
    own = figures.drag_xy - GRAVITY * figures.velocity_tilt, figures.drag_z
    nearest = [
        float(np.clip(value, axis.box.low.drag + axis.box.low.tilt, axis.box.high.drag + axis.box.high.tilt))
        for value, axis in zip(own, axes, strict=True)
    ]
    return np.array([nearest[0], nearest[0], nearest[1]])


def _thrust(certificate: Certificate, identified: Identified) -> Verdict:
    """Judge whether the largest thrust is there."""
    least = certificate.limits.thrust_max
    return _interval("thrust available", identified, "thrust_available", (least, math.inf), "m/s^2")


def _interval(
    name: str, identified: Identified, figure: str, assumed: Interval, unit: str, bound: str | None = None
) -> Verdict:
    """Judge a figure that must lie in an interval."""
    if bound is None:
        ends = [f"{end:.4g}" for end in assumed]
        bound = f"[{ends[0]}, {ends[1]}]"
        if not math.isfinite(assumed[0]):
            bound = f"at most {ends[1]}"
        elif not math.isfinite(assumed[1]):
            bound = f"at least {ends[0]}"
        bound = f"{bound} {unit}".strip()
    found = identified.figures[figure]
    if found.interval is None:
        return Verdict(name, bound, "not told", SILENT)
    low, high = found.interval
    verdict = SILENT
    if assumed[0] <= low and high <= assumed[1]:
        verdict = SUPPORTS
    elif high < assumed[0] or low > assumed[1]:
        verdict = CONTRADICTS
    return Verdict(name, bound, f"{found.value:.4g} [{low:.4g}, {high:.4g}] {unit}".strip(), verdict)


def _share(name: str, sizes: FloatArray, most: float, unit: str, unsure: float = 0.0) -> Verdict:
    """Judge sizes (n,) that must not be above a bound, up to a share of COVERED.

    What is less above it than `unsure`, in the same unit, the flights do not tell from what is within.
    """
    bound = f"at most {most:.4g} {unit}"
    if len(sizes) == 0:
        return Verdict(name, bound, "not told", SILENT)
    half, nearly, worst = np.percentile(sizes, (50.0, 100.0 * COVERED, 100.0))
    share = float(np.mean(sizes <= most))
    shown = f"{half:.3g} / {nearly:.3g} / {worst:.3g} {unit} (50 % / {COVERED:.1%} / worst), {share:.2%} within"
    if share >= COVERED:
        return Verdict(name, bound, shown, SUPPORTS)
    surely = float(np.mean(sizes <= most + unsure))
    if unsure > 0.0:
        shown = f"{shown}, {surely:.2%} but for noise"
    return Verdict(name, bound, shown, SILENT if surely >= COVERED else CONTRADICTS)


def _poses(age: float, period: float, logs: Sequence[FlightLog]) -> Verdict:
    """Judge whether at nearly all times there is a pose that is no older than an age."""
    found = np.concatenate([ages(log) for log in logs])
    share = 1.0 - older(found, age + _ROUNDING)
    before = found[:, 1]
    shown = (
        f"{np.median(before):.3g} s old before the next (median), at most {before.max():.3g} s; no older than that "
        f"{share:.2%} of the time, than {oldest(found, COVERED):.3g} s {COVERED:.1%}"
    )
    bound = f"a pose each {age:.4g} s" if age == period else f"at most {age:.4g} s old"
    return Verdict("pose gaps", bound, shown, SUPPORTS if share >= COVERED else CONTRADICTS)


def older(found: FloatArray, age: float) -> float:
    """Return the share of the time in which the newest pose is older than an age, s, of `ages` (n, 2), s."""
    begin, end = found.T
    # a gap counts by the time it takes
    return float(np.maximum(end - np.maximum(begin, age), 0.0).sum() / (end - begin).sum())


def oldest(found: FloatArray, coverage: float) -> float:
    """Return an age, s, above which the newest pose is at no more than 1 - coverage of all moments.

    Args:
        found: (n, 2) `ages`, s.
        coverage: below 1.
    """
    return float(brentq(lambda age: older(found, age) - (1.0 - coverage), 0.0, found.max(), xtol=1e-9))

"""Whether what a certificate assumes about drone and motion capture is so in flights: supported, contradicted, silent.

A certificate holds for the drone it was made for: a thrust that is there, a lag and a delay, an attitude that goes
where it is sent, a pose for each period. Flights can contradict that, and support it in what they show; nothing is
proved.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.identification.identified import Identified
from flatsat_ros.identification.log import FlightLog

SUPPORTS, CONTRADICTS, SILENT = "supports", "contradicts", "silent"
COVERED = 0.999  # share of the samples that must keep a bound
_GAIN = 0.05  # from a gain of 1, up to which flights support it
_ROUNDING = 1e-3  # s, of stamps


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


def validate(certificate: Certificate, identified: Identified, logs: Sequence[FlightLog]) -> list[Verdict]:
    """Return a verdict on each assumption of a certificate.

    Args:
        certificate: any.
        identified: what the flights tell of the drone.
        logs: of the flights, for the times between poses.
    """
    return list(_verdicts(certificate, identified, logs))


def _verdicts(certificate: Certificate, identified: Identified, logs: Sequence[FlightLog]) -> Iterator[Verdict]:
    most = certificate.limits.thrust_max
    yield _at_most(
        most, f"T_max = {most:.4g} m/s^2 is there", "thrust available", "m/s^2", identified, "thrust_available"
    )
    total = certificate.lag + certificate.delay
    bound = f"lag + delay = {certificate.lag:.4g} + {certificate.delay:.4g} s"
    yield _at_least(total, bound, "lag plus delay", "s", identified, "lag_and_delay")
    yield _at_least(certificate.lag, f"lag = {certificate.lag:.4g} s", "thrust lag", "s", identified, "thrust_lag")
    gain = identified.figures["attitude_gain"]
    shown, verdict = "not told", SILENT
    if gain.interval is not None:
        low, high = gain.interval
        shown = f"{gain.value:.3g} [{low:.3g}, {high:.3g}]"
        if not low <= 1.0 <= high:
            verdict = CONTRADICTS
        elif max(high - 1.0, 1.0 - low) <= _GAIN:
            verdict = SUPPORTS
    yield Verdict("attitude gain", "1", shown, verdict)
    yield _gaps(certificate.period, logs)


def _at_most(value: float, bound: str, name: str, unit: str, identified: Identified, figure: str) -> Verdict:
    """Judge a value that must be there."""
    found = identified.figures[figure]
    if found.interval is None:
        return Verdict(name, bound, "not told", SILENT)
    low, high = found.interval
    verdict = SUPPORTS if value <= low else CONTRADICTS if value > high else SILENT
    return Verdict(name, bound, f"{found.value:.4g} [{low:.4g}, {high:.4g}] {unit}", verdict)


def _at_least(value: float, bound: str, name: str, unit: str, identified: Identified, figure: str) -> Verdict:
    """Judge a value that must not be exceeded."""
    found = identified.figures[figure]
    if found.interval is None:
        return Verdict(name, bound, "not told", SILENT)
    low, high = found.interval
    verdict = SUPPORTS if high <= value else CONTRADICTS if low > value else SILENT
    return Verdict(name, bound, f"{found.value:.4g} [{low:.4g}, {high:.4g}] {unit}", verdict)


def _gaps(period: float, logs: Sequence[FlightLog]) -> Verdict:
    """Judge whether there is a pose for each period."""
    between = np.concatenate([np.diff(np.unique(log.pose_time[np.isfinite(log.position).all(axis=1)])) for log in logs])
    # a gap counts by the time it takes: in it, its share of all moments has no new pose
    late = np.maximum(between - period - _ROUNDING, 0.0)
    share = 1.0 - float(late.sum() / between.sum())
    shown = f"median {np.median(between):.3g} s, longest {between.max():.3g} s, new enough {share:.3%} of the time"
    return Verdict("pose gaps", f"a pose each {period:.4g} s", shown, SUPPORTS if share >= COVERED else CONTRADICTS)

"""Verdicts on the assumptions of certificates."""

import dataclasses
from typing import Any, cast

import numpy as np
import pytest

from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.identification.identified import NAMES, Figure, Identified
from flatsat_ros.identification.log import FlightLog
from flatsat_ros.identification.validation import validate

LOOP = load_certificate("cf21_50hz")
IMMEDIATE = load_certificate("paper_experiment")


def found(**intervals: tuple[float, float] | None) -> Identified:
    """What flights tell, with these intervals; nothing of the rest."""
    figures = {
        name: Figure(np.mean(ends) if (ends := intervals.get(name)) else 0.0, ends, 3 if ends else 0, ())
        for name in NAMES
    }
    nothing = cast(Any, None)
    return Identified((), nothing, figures, nothing, nothing, 0.0)


def log(*between: float) -> FlightLog:
    time = np.cumsum(np.concatenate([[0.0], np.tile(between, 500)]))
    return FlightLog(
        "log",
        time,
        np.zeros((len(time), 3)),
        np.zeros((len(time), 3)),
        time,
        np.zeros((len(time), 3)),
        time[:0],
        time[:0],
    )


@pytest.mark.parametrize(
    ("name", "figure", "scale", "offset"),
    [
        ("thrust available", "thrust_available", -1.0, LOOP.limits.thrust_max),
        ("lag plus delay", "lag_and_delay", 1.0, LOOP.lag + LOOP.delay),
        ("thrust lag", "thrust_lag", 1.0, LOOP.lag),
    ],
)
def test_a_bound_is_supported_contradicted_or_neither_by_where_the_interval_lies(
    name: str, figure: str, scale: float, offset: float
) -> None:
    for ends, verdict in (((-0.04, -0.01), "supports"), ((0.01, 0.04), "contradicts"), ((-0.01, 0.01), "silent")):
        low, high = sorted(offset + scale * end for end in ends)
        verdicts = {each.assumption: each for each in validate(LOOP, found(**{figure: (low, high)}), [log(0.02)])}
        assert verdicts.pop(name).verdict == verdict
        assert verdicts.pop("pose gaps").verdict == "supports"
        assert {each.verdict for each in verdicts.values()} == {"silent"}
        assert {each.shown for each in verdicts.values()} == {"not told"}


@pytest.mark.parametrize(
    ("interval", "verdict"),
    [((0.97, 1.03), "supports"), ((0.9, 1.1), "silent"), ((0.74, 0.79), "contradicts"), (None, "silent")],
)
def test_a_certificate_assumes_that_the_attitude_goes_where_it_is_sent(
    interval: tuple[float, float] | None, verdict: str
) -> None:
    judged = validate(LOOP, found(attitude_gain=interval), [log(0.02)])
    assert {each.assumption: each.verdict for each in judged}["attitude gain"] == verdict


def test_a_certificate_without_lag_is_contradicted_by_any() -> None:
    judged = validate(IMMEDIATE, found(lag_and_delay=(0.07, 0.09)), [log(0.02)])
    assert {each.assumption: each.verdict for each in judged}["lag plus delay"] == "contradicts"


@pytest.mark.parametrize(
    ("between", "verdict"),
    [((0.02,), "supports"), ((0.01,), "supports"), ((0.0202,), "supports"), ((0.04,), "contradicts")],
)
def test_poses_must_come_each_period(between: tuple[float, ...], verdict: str) -> None:
    judged = validate(LOOP, found(), [log(*between)])
    assert {each.assumption: each.verdict for each in judged}["pose gaps"] == verdict


def test_a_hole_counts_by_the_time_that_it_takes() -> None:
    def share(hole: float) -> str:
        holed = log(0.01)
        time = holed.pose_time.copy()
        time[250:] += hole
        moved = dataclasses.replace(holed, pose_time=time)
        return {each.assumption: each.verdict for each in validate(LOOP, found(), [moved])}["pose gaps"]

    assert share(0.012) == "supports"  # 1 ms too long, of 5 s
    assert share(0.1) == "contradicts"

"""Polynomials of crazyswarm's CSV form: kept as given where limits allow it, else slowed down, proved in any case."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.planning import Wishes, plan, read_mission
from flatsat_ros.planning.polynomials import read_polynomials
from flatsat_ros.plans import Plan

CERTIFICATE = load_certificate("paper_experiment")
HEADER = ",".join(["duration", *(f"{axis}^{power}" for axis in ("x", "y", "z", "yaw") for power in range(8))])


def polynomials(start: FloatArray, steps: list[FloatArray], durations: list[float], yaw: float = 0.0) -> FloatArray:
    """Rows of pieces that rest at both ends of each: position, velocity, acceleration and jerk meet there."""
    rows, place = [], np.array(start)
    for step, duration in zip(steps, durations, strict=True):
        shape = np.array([0, 0, 0, 0, 35, -84, 70, -20]) / duration ** np.arange(8)
        axes = np.outer(step, shape)
        axes[:, 0] += place
        rows.append([duration, *axes.ravel(), yaw, *[0.0] * 7])
        place = place + step
    return np.array(rows)


def written(path: Path, rows: FloatArray, digits: int = 12) -> Path:
    lines = [",".join(f"{value:.{digits}f}" for value in row) + "," for row in rows]  # crazyswarm ends lines so
    path.write_text("\n".join([HEADER + ",", *lines]) + "\n")
    return path


steps = st.lists(
    st.tuples(*[st.floats(-0.5, 0.5)] * 3).map(np.array).filter(lambda step: np.abs(step).max() > 0.05),
    min_size=1, max_size=3,
)  # fmt: skip


# with fewer digits, or longer, what is rounded off grows to more than is asked below: by t^7 in the last coefficient
@given(steps, st.floats(0.8, 1.2), st.integers(7, 9))
@settings(max_examples=6)
def test_the_reference_is_what_the_pieces_say(
    tmp_path_factory: pytest.TempPathFactory, ways: list[FloatArray], duration: float, digits: int
) -> None:
    durations = [round(duration * (1.0 + 0.3 * i), 3) for i in range(len(ways))]
    rows = polynomials(np.array([0.0, 0.0, 1.0]), ways, durations)
    curve, yaw = read_polynomials(written(tmp_path_factory.mktemp("p") / "a.csv", rows, digits))
    pieces = Trajectory(np.cumsum([0.0, *durations]), rows[:, 1:25].reshape(-1, 3, 8).transpose(0, 2, 1))
    assert yaw == 0.0
    reference = curve.trajectory()
    for t in np.linspace(0.0, sum(durations), 40):
        assert reference.sample(float(t)) == pytest.approx(pieces.sample(float(t)), abs=2e-4)
    assert len(curve.points) == 4 * len(ways) + 4


def test_slow_polynomials_are_kept_and_fast_ones_slowed_down_until_they_hold(tmp_path: Path) -> None:
    way = [np.array([1.0, 0.5, 0.2])]
    slow = written(tmp_path / "slow.csv", polynomials(np.array([0.0, 0.0, 1.0]), way, [9.0], 0.3))
    fast = written(tmp_path / "fast.csv", polynomials(np.array([0.0, 0.0, 1.0]), way, [2.0], 0.3))
    kept, retimed = (plan(read_mission(path, CERTIFICATE, Wishes(), "p")) for path in (slow, fast))
    assert kept.duration == 9.0
    assert kept.provenance["polynomials"] == "as given"
    assert kept.drones[0].yaw == 0.3
    assert retimed.provenance["polynomials"].startswith("slowed down ")
    factor = retimed.duration / 2.0
    assert 1.1 < factor < 5.0
    slacks = retimed.verify()
    assert min(slacks.values()) >= 0.0
    original = read_polynomials(fast)[0].trajectory()
    for t in (0.3, 0.9, 1.7):
        path = original.sample(t)[:3]
        assert retimed.trajectory("cf1").sample(t * factor)[:3] == pytest.approx(path, abs=1e-6)
    again = tmp_path / "plan.yaml"
    retimed.save(again)
    assert Plan.load(again).to_document() == retimed.to_document()


def test_drones_with_polynomials_are_proved_to_keep_apart_or_named(tmp_path: Path) -> None:
    for name, y in (("a", 0.0), ("b", 0.6), ("c", 0.5)):
        bend = [np.array([0.5, 0.1 if name == "b" else 0.0, 0.0]), np.array([0.5, 0.0, 0.0])]
        written(tmp_path / f"{name}.csv", polynomials(np.array([0.0, y, 1.0]), bend, [4.0, 4.0]))
    two = tmp_path / "two.yaml"
    two.write_text("drones: {cf1: a.csv, cf2: b.csv}\n")
    found = plan(read_mission(two, CERTIFICATE, Wishes(), "two"))
    assert found.pairs[0].distance == pytest.approx(6000, abs=1)
    one, other = (drone.curve.trajectory() for drone in found.drones)
    sampled = min(float(np.linalg.norm(one.sample(t)[:3] - other.sample(t)[:3])) for t in np.linspace(0.0, 8.0, 101))
    assert found.pairs[0].distance / 1e4 <= sampled + 1e-9
    two.write_text("drones: {cf1: b.csv, cf2: c.csv}\n")
    with pytest.raises(FlatsatError, match=r"distance of cf1 and cf2 at way-point 1 = 0.1 m: must be at least 0.4"):
        read_mission(two, CERTIFICATE, Wishes(), "two")
    two.write_text("drones: {cf1: a.csv, cf2: [[0, 2, 1], [1, 2, 1]]}\n")
    with pytest.raises(FlatsatError, match="polynomials: must be given for all drones or for none"):
        read_mission(two, CERTIFICATE, Wishes(), "two")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ((0, 1, 5e-3), "distance of the pieces from a reference .* = 0.00.* m at t = "),
        (
            (1, 2, 0.5),
            "distance of the pieces from a reference that rests at both ends and is continuous up to the jerk",
        ),
        ((0, 26, 0.1), "yaw of the polynomials changes: must be constant"),
        ((0, 0, -2.0), "duration of piece 1 = -.*s: must be from 0.001 to 3600"),
    ],
)
def test_what_is_no_smooth_reference_is_refused(tmp_path: Path, change: tuple[int, int, float], text: str) -> None:
    rows = polynomials(np.array([0.0, 0.0, 1.0]), [np.array([0.5, 0.0, 0.0])] * 2, [1.5, 1.5])
    rows[change[0], change[1]] += change[2]
    with pytest.raises(FlatsatError, match=text):
        read_mission(written(tmp_path / "a.csv", rows), CERTIFICATE, Wishes(), "a")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "first line = '': must be duration,"),
        ("\n\n", "first line = '': must be duration,"),
        ("x,y", "first line = 'x,y'"),
    ],
)
def test_a_file_that_a_mission_names_is_named_in_its_refusal(tmp_path: Path, text: str, reason: str) -> None:
    (named := tmp_path / "poly.csv").write_text(text)
    (mission := tmp_path / "two.yaml").write_text("drones: {cf1: poly.csv}\n")
    with pytest.raises(FlatsatError, match=f"{named}: {reason}"):
        read_polynomials(named)
    with pytest.raises(FlatsatError, match=f"{mission}: {named}: {reason}"):
        read_mission(mission, CERTIFICATE, Wishes(), "two")

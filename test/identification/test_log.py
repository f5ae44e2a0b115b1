"""Flight logs come out of CSV files as they went in."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from flown import write
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.identification.columns import load_columns
from flatsat_ros.identification.log import FlightLog, angles_of, read_log
from flatsat_ros.identification.screening import screen
from flatsat_ros.sim.dynamics import Bodies, Ideal


def test_a_log_is_read_in_si_units_with_our_signs(logs: list[FlightLog], tmp_path: Path) -> None:
    read = read_log(write(logs[0], tmp_path / "flight.csv"))
    assert read.name == "flight"
    assert read.damaged == 0
    assert len(read.voltage) == 0
    for name in ("pose_time", "position", "angles", "command_time", "command"):
        assert_allclose(getattr(read, name), getattr(logs[0], name), rtol=1e-7, atol=1e-7, err_msg=name)


def test_lines_that_are_no_rows_are_counted_and_become_nan(logs: list[FlightLog], tmp_path: Path) -> None:
    path = write(logs[0], tmp_path / "flight.csv")
    lines = path.read_text().splitlines()
    lines[100] = lines[100].replace(",", ",x", 1)  # a field that is no number
    lines[200] = lines[200].rpartition(",")[0]  # a line that breaks off: its stamp is not sure either
    lines[300] = lines[300].partition(",")[0] + "," * 9  # a row that only has a stamp: no damage, but no pose
    path.write_text("\n".join(lines))
    read = read_log(path)
    assert read.damaged == 2
    assert len(read.pose_time) == len(lines) - 2
    assert np.flatnonzero(np.isnan(read.position[:, 0])).tolist() == [99, 298]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "are none of a known form"),
        ("t,x,y\n1,2,3\n", "are none of a known form"),
        ("{header}\n", "has no row of numbers: must have 5 s of flight below its header"),
        ("{header}\n{row}\n", "it has 1 poses: must have at least 2"),
        ("{header}\nx\n", "has no row of numbers: must have 5 s of flight below its header"),
    ],
)
def test_files_that_are_no_logs_are_refused(text: str, complaint: str, tmp_path: Path) -> None:
    header = ",".join(column.name for column in load_columns("cflib").columns.values())
    path = tmp_path / "flight.csv"
    path.write_text(text.format(header=header, row=",".join("1" for _ in header.split(","))))
    with pytest.raises(FlatsatError, match=complaint) as refusal:
        read_log(path)
    assert str(path) in str(refusal.value)


def test_a_given_map_must_fit_the_file(logs: list[FlightLog], tmp_path: Path) -> None:
    with pytest.raises(FlatsatError, match="must be also t, px, py"):
        read_log(write(logs[0], tmp_path / "flight.csv"), load_columns("vicon_100hz"))


def test_angles_are_those_of_the_simulated_body_and_no_quaternion_has_none() -> None:
    body = Bodies(Ideal(), np.zeros((50, 3)) + (0.0, 0.0, 9.0), np.zeros(50), thrust=9.81, floor=0.0)
    body.attitude[..., 0] = np.random.default_rng(0).uniform(-1.5, 1.5, (3, 50))
    quaternion = body.quaternion.T.copy()
    assert_allclose(angles_of(quaternion), body.angles, atol=1e-12)
    quaternion[:, 3] = 0.0
    quaternion[:, 4] = np.nan
    assert np.isnan(angles_of(quaternion)).all(axis=1).nonzero()[0].tolist() == [3, 4]


def test_a_mark_of_the_byte_order_before_the_header_is_none_of_its_columns(short: list[str], tmp_path: Path) -> None:
    (marked := tmp_path / "flight.csv").write_text("\ufeff" + "\n".join(short), encoding="utf-8")
    assert len(read_log(marked).pose_time) == len(short) - 1


@settings(max_examples=40, deadline=None)
@given(
    damage=st.lists(
        st.tuples(
            st.integers(0, 500),
            st.integers(0, 9),
            st.sampled_from(["", "nan", "inf", "-inf", "1e300", "-1e300", "1e9", "0", "-0.0", "1e-320", "x", "1,1"]),
        ),
        max_size=8,
    ),
    twice=st.booleans(),
)
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_damaged_logs_are_screened_or_refused_and_what_is_usable_is_finite(
    damage: list[tuple[int, int, str]], twice: bool, short: list[str]
) -> None:
    lines = list(short)
    for row, column, text in damage:
        fields = lines[1 + row].split(",")
        fields[column % len(fields)] = text
        lines[1 + row] = ",".join(fields)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.csv"
        path.write_text("\n".join(lines * (1 + twice)))
        try:
            samples = screen(read_log(path))
        except FlatsatError:
            return
    assert samples.seconds >= 5.0
    for values in (samples.position, samples.angles, samples.command):
        assert np.isfinite(values[samples.usable]).all()


@pytest.fixture(scope="module")
def short(logs: list[FlightLog], tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The lines of a log."""
    path = write(logs[0], tmp_path_factory.mktemp("short") / "flight.csv")
    return path.read_text(encoding="utf-8").splitlines()[:651]

"""CSV recordings: the faults of motion capture are kept, a torn line is left out, anything else is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.identification.recording import COLUMNS, POSES, Recording, read_csv

HEADER = ",".join(COLUMNS)
EPOCH = 1_700_000_000.0


def line(t: float, x: float = 0.0, qw: float = 1.0) -> str:
    return ",".join(repr(value) for value in (t, x, 0.0, 1.0, 0.0, 0.0, 0.0, qw))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "recording.csv"


def write(file: Path, *lines: str, end: str = "\n") -> Path:
    file.write_text("\n".join([HEADER, *lines]) + end, encoding="utf-8")
    return file


def test_the_faults_of_motion_capture_are_data(file: Path) -> None:
    times = [0.0, 0.01, 0.01013, 0.01013, 0.63, 0.62, 15.63]
    rows = [line(EPOCH + t) for t in times]
    rows[2] = line(EPOCH + times[2], qw=np.nan)
    rows[4] = line(EPOCH + times[4], x=0.5)
    recording = read_csv(write(file, *rows))
    # a Unix time leaves a quarter of a microsecond
    assert recording.time == pytest.approx(times, abs=3e-7)
    assert recording.position[:, 0].tolist() == [0.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0]
    assert np.isnan(recording.quaternion[:, 3]).tolist() == [False, False, True, False, False, False, False]
    assert recording.torn == ()
    assert recording.duration == pytest.approx(15.63, abs=3e-7)


def test_lost_frames_are_empty_cells_and_no_torn_lines(file: Path) -> None:
    recording = read_csv(write(file, line(0.0), "0.01,,,,,,,", "0.02,0.5,0.0,1.0, ,,,", "0.03,0.1,,", line(0.04)))
    assert recording.torn == (5,)
    assert recording.time.tolist() == [0.0, 0.01, 0.02, 0.04]
    assert np.isnan(recording.position).all(axis=1).tolist() == [False, True, False, False]
    assert np.isnan(recording.quaternion).all(axis=1).tolist() == [False, True, True, False]


def test_a_byte_order_mark_and_stamps_in_nanoseconds_are_read(file: Path) -> None:
    rows = [line(t).replace(repr(t), repr(1_700_000_000_000_000_000 + int(t * 1e9))) for t in (0.25, 0.5, 99.0)]
    file.write_text("\n".join([HEADER, *rows]), encoding="utf-8-sig")
    assert read_csv(file).time == pytest.approx([0.0, 0.25, 98.75], abs=3e-7)
    with pytest.raises(FlatsatError, match=r"s of any epoch or ns since 1970, within 100000 s of the first"):
        read_csv(write(file, line(1_700_000_000_000.0), line(1_700_000_200_000.0)))


def test_a_late_pose_is_due_right_after_the_one_ahead_of_it() -> None:
    recording = Recording(np.array([0.0, 0.3, 0.1, 0.2, 0.4]), np.zeros((5, 3)), np.zeros((5, 4)))
    assert recording.due().tolist() == [0.0, 0.3, 0.3, 0.3, 0.4]


BROKEN = line(EPOCH + 0.0225, x=-0.0123456, qw=-0.5)


# up to the sign of the last column: from its first digit on nobody can tell that the line breaks off
@given(st.integers(1, BROKEN.rindex(",") + 2), st.booleans())
def test_a_file_that_breaks_off_anywhere_gives_the_poses_before(
    tmp_path_factory: pytest.TempPathFactory, length: int, resumed: bool
) -> None:
    rows = [line(EPOCH), line(EPOCH + 0.0125), BROKEN[:length], *([line(EPOCH + 7.5)] if resumed else [])]
    file = write(tmp_path_factory.mktemp("torn") / "recording.csv", *rows, end="\n" if resumed else "")
    recording = read_csv(file)
    assert recording.torn == (4,)
    assert recording.time == pytest.approx([0.0, 0.0125, 7.5][: 2 + resumed], abs=3e-7)


def test_carriage_returns_and_empty_lines_do_not_count(file: Path) -> None:
    file.write_bytes(f"{HEADER}\r\n{line(1.0)}\r\n\r\n{line(1.5)}\r\n".encode())
    assert read_csv(file).time.tolist() == [0.0, 0.5]


@pytest.mark.parametrize(
    "garbage",
    [
        "1.0,0,0,1,0,0,0,one",
        "1.0,zero,0,1,0,0,0,1",
        "1.0,0,zero",
        "1.0,0,0,1,0,0,0,1,9",
        "1.0,0,0,1,0,0,0,1,-",
        "1_0.0,0,0,1,0,0,0,1",
        "1.0,0,0,1,0,0,0,\uff11",
        "nan,0,0,1,0,0,0,1",
        "inf,0,0,1,0,0,0,1",
        "1.0;0;0;1;0;0;0;1",
        "\0\0\0\0",
        HEADER,
    ],
)
def test_garbage_is_refused_with_its_line_number(file: Path, garbage: str) -> None:
    with pytest.raises(FlatsatError, match=r"recording\.csv: line 3: .*must be 8 numbers"):
        read_csv(write(file, line(0.0), garbage, line(2.0)))


@pytest.mark.parametrize("content", ["", "t,x,y,z\n", line(0.0) + "\n", HEADER + ",extra\n"])
def test_a_file_without_the_column_names_is_refused(file: Path, content: str) -> None:
    file.write_text(content, encoding="utf-8")
    with pytest.raises(FlatsatError, match=r"line 1: .*must be 't,x,y,z,qx,qy,qz,qw'"):
        read_csv(file)


@pytest.mark.parametrize("lines", [[], ["1.0,2.0"]])
def test_a_recording_without_a_pose_is_refused(file: Path, lines: list[str]) -> None:
    with pytest.raises(FlatsatError, match=r"recording\.csv: .*no poses"):
        read_csv(write(file, *lines))


def test_more_lines_than_are_read_are_refused(file: Path) -> None:
    file.write_text(HEADER + "\n" + "\n" * POSES, encoding="utf-8")
    with pytest.raises(FlatsatError, match=r"cannot be read: it has more than 200000 lines"):
        read_csv(file)


def test_what_cannot_be_read_is_refused_in_one_line(tmp_path: Path) -> None:
    binary = tmp_path / "binary.csv"
    binary.write_bytes(bytes(range(256)))
    for path in (tmp_path, tmp_path / "missing.csv", binary):
        with pytest.raises(FlatsatError, match=r"cannot be read: .+") as caught:
            read_csv(path)
        assert "\n" not in str(caught.value)


def test_a_recording_refuses_shapes_that_differ_and_stamps_that_are_not_finite() -> None:
    with pytest.raises(FlatsatError, match="shapes"):
        Recording(np.zeros(2), np.zeros((3, 3)), np.zeros((2, 4)))
    with pytest.raises(FlatsatError, match="stamp = nan s: must be finite"):
        Recording(np.array([0.0, np.nan]), np.zeros((2, 3)), np.zeros((2, 4)))
    with pytest.raises(FlatsatError, match=r"stamp = 2000000.0 s: must be .* within 100000 s of the first"):
        Recording(np.array([0.0, 2e6]), np.zeros((2, 3)), np.zeros((2, 4)))

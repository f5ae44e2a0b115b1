"""Numbers that are read from text: plain decimal ones, wherever they stand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.numerals import integer_of, number_of
from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.cli import shell
from flatsat_ros.identification.log import _number
from flatsat_ros.planning import Wishes, read_mission

FOREIGN = ["1_0", "\u0664", "1\u0660", "\uff11"]  # 10, 4, 10, 1 for Python


@pytest.mark.parametrize("text", [*FOREIGN, "", "x", "0x1", "1 0"])
@pytest.mark.parametrize("read", [number_of, integer_of, shell.number, shell.integer])
def test_what_is_no_plain_number_is_none(read: Callable[[str], float], text: str) -> None:
    with pytest.raises(ValueError, match=r"number|convert|invalid literal"):
        read(text)


@pytest.mark.parametrize(("text", "value"), [("1.5", 1.5), (" -2e-3 ", -0.002), ("007", 7.0), ("12", 12.0)])
def test_plain_numbers_are_read(text: str, value: float) -> None:
    assert number_of(text) == value


@pytest.mark.parametrize("text", FOREIGN)
def test_tables_of_numbers_take_no_others(text: str, tmp_path: Path) -> None:
    (file := tmp_path / "way.csv").write_text(f"x,y,z\n0,0,1\n{text},0,1\n", encoding="utf-8")
    with pytest.raises(FlatsatError, match="must be numbers"):
        read_mission(file, load_certificate("cf21_50hz"), Wishes(), "way")
    names = ",".join(["duration", *(f"{axis}^{power}" for axis in ("x", "y", "z", "yaw") for power in range(8))])
    file.write_text(f"{names}\n{text}{',0' * 32}\n", encoding="utf-8")
    with pytest.raises(FlatsatError, match="must be numbers"):
        read_mission(file, load_certificate("cf21_50hz"), Wishes(), "way")
    assert _number(text) is None

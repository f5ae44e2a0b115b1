"""Laws of column maps."""

from pathlib import Path

import pytest
import yaml

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.identification.columns import load_columns, packaged_columns, recognise


@pytest.mark.parametrize("path", packaged_columns(), ids=lambda path: path.stem)
def test_every_packaged_map_is_recognised_by_its_own_header_in_any_order(path: Path) -> None:
    known = load_columns(path)
    header = ["something_else", *(column.name for column in reversed(list(known.columns.values())))]
    assert recognise(header) == known


def test_optional_columns_may_be_missing_and_others_not() -> None:
    known = load_columns("cflib")
    header = [column.name for column in known.columns.values() if not column.optional]
    assert "pm.vbat" not in header
    assert recognise(header) == known
    with pytest.raises(FlatsatError, match=r"cflib also has .'controller.roll'.; give a column map with --columns"):
        recognise([name for name in header if name != "controller.roll"])


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"x": {"column": "x", "unit": "deg"}}, "x.unit = 'deg': must be one of m, mm"),
        ({"x": {"column": 7, "unit": "m"}}, "x.column = 7: must be the name of a column"),
        ({"x": {"column": "x", "unit": "m", "sign": 2}}, "x.sign = 2: must be 1 or -1"),
        ({"x": {"column": "x", "unit": "m", "optional": 1}}, "x.optional = 1: must be true or false"),
        ({"x": {"column": "x", "units": "m"}}, "x: unknown key 'units'"),
        ({"x": {"column": "x"}}, "x: key 'unit' is missing"),
        ({"x": None}, "x = None: must be a mapping"),
        ({"colour": {"column": "x", "unit": "m"}}, "quantity = 'colour': must be one of time"),
        ({"qx": {"column": "x", "unit": "1"}}, None),
        ({"thrust_setpoint": None}, "thrust_setpoint = None"),
    ],
)
def test_a_wrong_map_is_refused_by_name(change: dict[str, object], complaint: str | None, tmp_path: Path) -> None:
    source = next(path for path in packaged_columns() if path.stem == "cflib")
    document = yaml.safe_load(source.read_text())
    document["columns"] |= change
    (path := tmp_path / "wrong.yaml").write_text(yaml.safe_dump(document))
    if complaint is None:  # one of a quaternion is none
        assert load_columns(path).columns["qx"].name == "x"
        return
    with pytest.raises(FlatsatError, match=complaint) as refusal:
        load_columns(path)
    assert str(path) in str(refusal.value)


@pytest.mark.parametrize(
    ("without", "complaint"),
    [("time", "'time' is missing"), ("roll_setpoint", "'roll_setpoint' is missing"), ("yaw", "either qx")],
)
def test_a_map_without_what_is_needed_is_refused(without: str, complaint: str, tmp_path: Path) -> None:
    source = next(path for path in packaged_columns() if path.stem == "cflib")
    document = yaml.safe_load(source.read_text())
    del document["columns"][without]
    (path := tmp_path / "wrong.yaml").write_text(yaml.safe_dump(document))
    with pytest.raises(FlatsatError, match=complaint):
        load_columns(path)

"""YAML is read as it was meant or refused in one line: its traps, its explosions, and any damage to a file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.strict_yaml import YAML_BYTES, YAML_DEPTH, YAML_VALUES, read_yaml, write_yaml

TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=20) | st.from_regex(
    r"[-+]?[0-9.][0-9._:eExXobfn+-]{0,8}|~|null|[yY]es|=|<<", fullmatch=True
)
SCALAR = (
    st.none()
    | st.booleans()
    | st.integers(1 - 2**63, 2**63 - 1)
    | st.floats(allow_nan=False, allow_subnormal=False)
    | TEXT
)
DOCUMENT = st.dictionaries(
    TEXT,
    st.recursive(SCALAR, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXT, inner, max_size=4)),
    max_size=6,
)


def parse(folder: Path, text: str | bytes) -> Any:
    path = folder / "file.yaml"
    path.write_bytes(text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text)
    return read_yaml(path)


@given(DOCUMENT)
def test_what_is_written_comes_back(tmp_path_factory: pytest.TempPathFactory, document: dict[str, Any]) -> None:
    path = tmp_path_factory.mktemp("yaml") / "file.yaml"
    write_yaml(path, document, "# a comment\n")
    again = read_yaml(path)
    assert repr(again) == repr(document)  # 1, 1.0, True and -0.0, 0.0 differ


def test_plain_values_are_what_they_seem(tmp_path: Path) -> None:
    text = "{a: 10, b: -1.5, c: +0.5e-3, d: .5, e: yes, f: ~, g: 1e-3, h: '017', i: 2020-13-45, j: =, k: 1.2.3, l: -}"
    assert parse(tmp_path, text) == {
        "a": 10, "b": -1.5, "c": 5e-4, "d": 0.5, "e": True, "f": None, "g": "1e-3", "h": "017", "i": "2020-13-45",
        "j": "=", "k": "1.2.3", "l": "-",
    }  # fmt: skip
    assert parse(tmp_path, "[.inf, -.INF]") == [math.inf, -math.inf]
    assert math.isnan(parse(tmp_path, ".nan"))
    assert parse(tmp_path, "") is None


@pytest.mark.parametrize(
    "number",
    [
        "017", "08", "-010", "00", "01.5", "0_1", "0o17", "0x1F", "0b101", "1_000", "1_0.5", "1._5", ".5_0", "1_0e3",
        "1:30", "-1:30:00", "1:30.5", "190:20:30",
    ],
)  # fmt: skip
def test_a_number_that_is_not_plainly_decimal_is_refused(number: str, tmp_path: Path) -> None:
    with pytest.raises(FlatsatError, match=r"file.yaml: cannot be read: line 2: number '.*': must be a plain decimal"):
        parse(tmp_path, f"a: 1\nb: {number}\n")
    assert parse(tmp_path, f"b: '{number}'") == {"b": number}


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a: 1\nb: 2\na: 1", "line 3: key 'a' stands there twice"),
        ("{a: {b: 1, 'b': 2}}", "line 1: key 'b' stands there twice"),
        ("<<: {a: 1}\n<<: {b: 1}", "line 2: key '<<' stands there twice"),
        ("1: a", "line 1: key '1': must be text"),
        ("yes: a", "line 1: key 'yes': must be text"),
        ("? [a]\n: b", r"line 1: key \[ScalarNode.*: must be text"),
        ("a: " + "9" * 5000, r"line 1: integer '99.*\.\.\..*99': must fit 64 bits"),
        ("a: 9223372036854775808", "line 1: integer '9223372036854775808': must fit 64 bits"),
        ("a: 1.0e+400", r"line 1: number '1.0e\+400': must be 0, or from 2.3e-308 to 1.7e\+308"),
        ("a: -1.0e-400", r"number '-1.0e-400': must be 0, or from"),
        ("a: 1.2345678e-320", r"number '1.2345678e-320': must be 0, or from"),
        ("a: !!float 1:30", "line 1: tag 'tag:yaml.org,2002:float': must not be there"),
        ("a: !!python/object:os.x {}", "line 1: tag .*: must not be there"),
        ("a: ! 1", "line 1: tag '!': must not be there"),
        ("[" * 5000, f"line 1: more than {YAML_DEPTH} lists and mappings inside each other"),
        ("{a: " * 5000, f"line 1: more than {YAML_DEPTH} lists and mappings inside each other"),
        ("- " * 5000, f"line 1: more than {YAML_DEPTH} lists and mappings inside each other"),
        ("[" + "1," * YAML_VALUES + "]", f"line 1: more than {YAML_VALUES} values, aliases expanded"),
        ("&a [*a]", "line 1: alias 'a' stands inside what it names"),
        ("a: &a {<<: *a}", "line 1: alias 'a' stands inside what it names"),
        ("[*a]", "line 1: found undefined alias 'a'"),
        ("a: <<", "could not determine a constructor for the tag"),
        ("<<: 1", "line 1: while constructing a mapping expected a mapping or list of mappings"),
        ("--- a\n--- b", "line 2: expected a single document in the stream but found another document"),
        ("a: 'b", "line 1: while scanning a quoted scalar found unexpected end of stream"),
        ("a: b: c", "line 1: mapping values are not allowed here"),
        ("a\0b", "special characters are not allowed"),
        (b"\xff\xfe", "codec can't decode byte 0xff in position 0"),
        ("#" * (YAML_BYTES + 1), f"it has more than {YAML_BYTES} bytes"),
    ],
)  # fmt: skip
def test_what_would_be_misread_or_explode_is_refused_in_one_line(
    text: str | bytes, reason: str, tmp_path: Path
) -> None:
    with pytest.raises(FlatsatError, match=reason) as refused:
        parse(tmp_path, text)
    assert str(refused.value).startswith(f"{tmp_path}/file.yaml: cannot be read: ")
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 500


@pytest.mark.parametrize("entry", ["[{}]", "{{<<: [{}]}}"])
def test_aliases_may_be_used_but_not_explode(entry: str, tmp_path: Path) -> None:
    assert parse(tmp_path, "a: &a {b: 1}\nc: *a\nd: {<<: *a, b: 2}") == {"a": {"b": 1}, "c": {"b": 1}, "d": {"b": 2}}
    lines = ["a0: &a0 {b: 1}"]
    lines += [f"a{i + 1}: &a{i + 1} " + entry.format(",".join([f"*a{i}"] * 10)) for i in range(20)]
    with pytest.raises(FlatsatError, match=rf"line 5: more than {YAML_VALUES} values, aliases expanded"):
        parse(tmp_path, "\n".join(lines))


def test_a_value_that_yaml_cannot_say_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    with pytest.raises(FlatsatError, match=r"file.yaml: cannot be written: .*object object"):
        write_yaml(path, {"a": object()})
    assert not path.exists()

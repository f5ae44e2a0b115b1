"""One grammar of refusal, in one short line whatever the value is, and checks that take exactly what they say."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.arrays import finite_array, require_each
from flatsat_ros.base.errors import (
    LARGEST,
    SMALLEST,
    FlatsatError,
    quoted,
    refusal,
    require,
    require_not_negative,
    require_number,
    require_positive,
    require_zero_or_positive,
)

ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary() | st.complex_numbers(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner) | st.tuples(inner, inner),
)
CHECKS: dict[Callable[[str, object, str], float], Callable[[float], bool]] = {
    require_number: lambda x: -LARGEST <= x <= LARGEST,
    require_positive: lambda x: SMALLEST <= x <= LARGEST,
    require_not_negative: lambda x: 0.0 <= x <= LARGEST,
    require_zero_or_positive: lambda x: x == 0.0 or SMALLEST <= x <= LARGEST,
}
NUMBERS = st.floats() | st.integers() | st.sampled_from([0.0, SMALLEST, LARGEST, 5e-324, 10**400, -(10**5000)])


@given(ANYTHING, st.text())
def test_a_refusal_is_one_short_line_whatever_the_value(value: object, written: str) -> None:
    text = str(refusal("thrust", value, "N", "above 0"))
    assert text == f"thrust = {quoted(value)} N: must be above 0"
    named = str(refusal("thrust of " + 40 * written, value, "N", "above 0"))
    assert named.isprintable()
    assert len(named) <= len(text) + 150
    assert text.isprintable()
    assert len(quoted(value)) <= 100


def test_a_value_of_any_size_is_quoted_at_once() -> None:
    explosion: list[Any] = ["x"]
    for _ in range(60):
        explosion = [explosion] * 10
    loop: list[Any] = []
    loop.append(loop)
    for value in (explosion, loop, 10**5000, [10**5000], "x" * 10**6, np.zeros((300, 300)), {"a": explosion}):
        assert len(quoted(value)) <= 100
        assert quoted(value).isprintable()
    assert quoted(10**5000) == "an integer of 16610 bits"
    assert (quoted(np.float64(0.1)), quoted(np.int64(3)), quoted("a\nb"), quoted(2**63)) == (
        "0.1", "3", r"'a\nb'", "9223372036854775808",
    )  # fmt: skip
    assert str(refusal("gain", 0.5, "", "at least 1")) == "gain = 0.5: must be at least 1"


@pytest.mark.parametrize("check", CHECKS)
@given(value=NUMBERS)
def test_a_check_takes_exactly_the_numbers_within_its_bounds(
    check: Callable[[str, object, str], float], value: float
) -> None:
    if CHECKS[check](value):
        assert check("mass", value, "kg") == value
        assert type(check("mass", value, "kg")) is float
    else:
        with pytest.raises(FlatsatError, match=r"mass = .* kg: must be .* to 1e\+12"):
            check("mass", value, "kg")


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize("value", [True, False, np.True_, None, "1.0", [1.0], np.ones(1), 1j, math.nan, np.nan])
def test_what_is_no_number_is_refused(check: Callable[[str, object, str], float], value: object) -> None:
    with pytest.raises(FlatsatError, match=r"mass = .* kg: must be "):
        check("mass", value, "kg")


def test_a_bound_of_ones_own_is_named_with_the_value() -> None:
    assert require_number("share", np.float32(0.5), "", 0.0, 1.0) == 0.5
    require(True, "share", 0.5, "", "at most 1")
    with pytest.raises(FlatsatError, match=r"^share = 1\.5: must be a number from 0 to 1$"):
        require_number("share", 1.5, "", 0.0, 1.0)
    with pytest.raises(FlatsatError, match=r"^share = 1\.5 %: must be at most 1$"):
        require(False, "share", 1.5, "%", "at most 1")
    values = np.array([0.5, 2.0, 3.0])
    with pytest.raises(FlatsatError, match=r"^share = 2\.0: must be at most 1$"):
        require_each(values <= 1.0, "share", values, "", "at most 1")


@pytest.mark.parametrize(
    "value", ["1.0", ["1.0", "2.0"], [[1.0], [1.0, 2.0]], None, [None], [10**400], {"a": 1.0}, [1j], np.array("x")]
)
def test_what_is_no_array_of_numbers_is_refused(value: object) -> None:
    with pytest.raises(FlatsatError, match=r"v = .*: must be an array of numbers"):
        finite_array("v", value)


def test_integers_and_booleans_serve_as_floats_in_arrays() -> None:
    assert finite_array("v", [1, 2]).tolist() == [1.0, 2.0]
    assert finite_array("v", np.array([1.5], dtype=np.float32)).dtype == np.float64
    assert finite_array("v", [True, False]).tolist() == [1.0, 0.0]
    with pytest.raises(FlatsatError, match=r"^shape of v = \(2,\): must be \(\.\.\., 3\)$"):
        finite_array("v", [1.0, 2.0], 3)
    with pytest.raises(FlatsatError, match=r"^an entry of v = inf: must be a finite number$"):
        finite_array("v", [1.0, np.inf])

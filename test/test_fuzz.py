"""Whatever is read from others is taken or refused in one line: two hundred bad inputs of each kind."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from fuzzing import MODULES, is_available, kind_of
from hypothesis import HealthCheck, given, settings


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.skipif(not is_available(n), reason="not installed")) for n in MODULES]
)
def test_bad_input_is_taken_or_refused_and_breaks_nothing(name: str, tmp_path: Path) -> None:
    kind, taken = kind_of(name), Counter[bool]()

    with kind.open(tmp_path) as attempt:

        @settings(max_examples=200, suppress_health_check=[HealthCheck.too_slow])
        @given(kind.inputs)
        def attempt_one(data: bytes) -> None:
            taken[attempt(data)] += 1

        attempt_one()
    assert min(taken[True], taken[False]) >= 10, "some are taken and some are refused, or the inputs say nothing"

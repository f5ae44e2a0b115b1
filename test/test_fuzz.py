"""Whatever is read from others is taken or refused in one line: two hundred bad inputs of each kind."""

from __future__ import annotations

import struct
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from fuzzing import MODULES, is_available, kind_of
from fuzzing.sequence import encoded
from hypothesis import HealthCheck, given, settings

from flatsat_ros.base.errors import FlatsatError


def require(name: str) -> None:
    if not is_available(name):
        pytest.skip(f"needs {MODULES[name][1]}")


@pytest.mark.parametrize("name", MODULES)
def test_bad_input_is_taken_or_refused_and_breaks_nothing(name: str, tmp_path: Path) -> None:
    require(name)
    kind, taken = kind_of(name), Counter[bool]()

    with kind.open(tmp_path) as attempt:

        @settings(max_examples=200, suppress_health_check=[HealthCheck.too_slow])
        @given(kind.inputs)
        def attempt_one(data: bytes) -> None:
            taken[attempt(data)] += 1

        attempt_one()
    assert min(taken[True], taken[False]) >= 5, "some are taken and some are refused, or the inputs say nothing"


# what broke something once, by what broke
FOUND = {
    "way-points whose differences overflow": ("waypoints", np.array([1.0, 0.0, 1.7e308, 0.0] * 4).tobytes()[:80]),
    "an external pose that no packet holds": (
        "bridge",
        encoded([(1, b"\0\1\0\0" + bytes(8) + b"\1\0\0\0" + bytes(4) + struct.pack("<7d", 1e300, 0, 1, 0, 0, 0, 1))]),
    ),
    "a console line without an end": ("crtp", encoded([(0, b"x" * 30)] * 16)),
    "a carriage return in a field": ("mission", b"cx,y,z\n0.0,0.0,1.0\r1.0,1.0,1.0\n"),
    "a setup that is no object": ("console", encoded([(1, b"\0\1\0\0\3\0\0\0[]\0")])),
    "robots that are none": ("console", encoded([(1, b"\0\1\0\0\x16\0\0\0" + b'{"robot_names": [""]}\0')])),
    "flags that are infinite": ("crtp", encoded([(0x52, bytes([1, 0, 0, 0]) + struct.pack("<2f", 4.0, np.inf))])),
}


@pytest.mark.parametrize("what", FOUND)
def test_what_broke_once_stays_mended(what: str, tmp_path: Path) -> None:
    name, data = FOUND[what]
    require(name)
    with kind_of(name).open(tmp_path) as attempt:
        attempt(data)


def test_of_what_breaks_a_small_input_is_kept_and_breaks_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")  # workers take one of their own
    from fuzzing import campaign

    def attempt(data: bytes) -> bool:
        if len(data) >= 24:
            raise ZeroDivisionError("division by zero")
        return True

    monkeypatch.setattr(campaign, "_opened", lambda _: attempt)
    outcome = campaign.run_batch(campaign.Batch("waypoints", 1, 400, tmp_path))
    assert "ZeroDivisionError: division by zero" in outcome.finding
    assert outcome.counts["broken"] > 0
    assert outcome.kept is not None
    assert 24 <= len(outcome.kept.read_bytes()) < 40, "of those that hypothesis makes the smallest, changed by chance"
    assert list(tmp_path.iterdir()) == [outcome.kept]
    assert campaign.replay(outcome.kept).endswith("ZeroDivisionError: division by zero")
    outcome.kept.write_bytes(b"sound")
    assert campaign.replay(outcome.kept) == ""


def test_a_batch_in_which_nothing_breaks_says_so_and_is_the_same_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")
    from fuzzing import campaign

    tried: list[bytes] = []
    monkeypatch.setattr(campaign, "_opened", lambda _: lambda data: bool(tried.append(data)))
    outcomes = [campaign.run_batch(campaign.Batch("recording", 7, 80, tmp_path)) for _ in range(2)]
    assert [(outcome.finding, outcome.counts) for outcome in outcomes] == [("", {"refused": 80})] * 2
    assert tried[:80] == tried[80:]
    assert len(set(tried)) > 60
    with pytest.raises(FlatsatError, match="name of the file = 'other-1': must be KIND"):
        campaign.replay(tmp_path / "other-1")

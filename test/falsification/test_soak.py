"""The figures of a soak and its verdict: what grows is seen, what does not is not; this process measures itself."""

from __future__ import annotations

import gc
import mmap
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.falsification.soak.usage import ProcessUsage, left, sample
from flatsat_ros.falsification.soak.verdict import GROWTH_MAX, MISSED_MAX, Soak, lines, memory_growth, summary, verdict

HOUR = 3600


def soak(memory: Callable[[float], float] = lambda _: 80.0, **changes: Any) -> Soak:
    """An hour of flight with one process, whose memory, MiB, is a function of time, s."""
    samples = [ProcessUsage(float(t), memory(float(t)), 20, 17, {"/dev/shm/x": 1000}) for t in range(0, HOUR, 10)]
    figures: dict[str, Any] = {
        "samples": {"controller": samples},
        "ticks": 50 * HOUR + 1,
        "watched": float(HOUR),
        "flights": 12,
    }
    return Soak(drones=10, period=0.02, **{**figures, **changes})


def test_a_flight_in_which_nothing_grows_passes() -> None:
    assert verdict(soak()) == []
    figures = summary(soak())
    assert figures["passed"] is True
    assert figures["ticks_missed"] == 0
    assert (
        lines(figures)[0]
        == "10 drones, 60.0 min, 12 flights; 180001 ticks, 0 missed; 0 s in which a drone had no poses"
    )


def test_memory_that_settles_in_the_first_half_passes() -> None:
    assert verdict(soak(lambda t: 80.0 + min(t, 1000.0) / 20.0)) == []


@given(rate=st.floats(-20.0, 20.0), start=st.floats(10.0, 500.0))
def test_growth_is_the_slope(rate: float, start: float) -> None:
    grown, hourly = memory_growth(soak(lambda t: start + rate * t / HOUR).samples["controller"])
    assert hourly == pytest.approx(rate, abs=1e-6)
    assert grown == pytest.approx(rate / 2.0, rel=0.01, abs=1e-6)
    found = verdict(soak(lambda t: start + rate * t / HOUR))
    assert bool(found) is (grown > GROWTH_MAX)


def test_one_outlier_is_no_growth() -> None:
    assert verdict(soak(lambda t: 80.0 + 3.0 * (t == 3000.0))) == []


@pytest.mark.parametrize(("field", "value"), [("descriptors", 21), ("threads", 18), ("shared", {"/dev/shm/x": 1001})])
def test_what_must_not_grow_at_all_is_seen(field: str, value: object) -> None:
    flown = soak()
    flown.samples["controller"][-1] = flown.samples["controller"][-1]._replace(**{field: value})
    (problem,) = verdict(flown)
    assert "in the first half" in problem
    flown = soak()
    flown.samples["controller"][0] = flown.samples["controller"][0]._replace(**{field: value})
    assert verdict(flown) == []


def test_missed_ticks_are_counted_and_bounded() -> None:
    assert soak(ticks=50 * HOUR + 1 - 7).missed == 7
    bound = int(MISSED_MAX * (50 * HOUR + 1))
    assert verdict(soak(ticks=50 * HOUR + 1 - bound)) == []
    assert "missed" in verdict(soak(ticks=50 * HOUR - bound))[0]


def test_what_is_left_behind_or_went_wrong_fails() -> None:
    assert verdict(soak(left=["/dev/shm/x"])) == ["left behind: /dev/shm/x"]
    assert verdict(soak(problems=["no longer in the air: cf1"])) == ["no longer in the air: cf1"]
    assert "too short" in verdict(soak(samples={"controller": []}))[0]


def test_a_process_is_measured() -> None:
    gc.collect()
    before = sample(os.getpid(), 0.0)
    ballast = b"x" * 50_000_000
    wait = threading.Event()
    thread = threading.Thread(target=wait.wait)
    thread.start()
    read, write = os.pipe()
    name = Path("/dev/shm", f"flatsat_test_{os.getpid()}")
    try:
        with name.open("wb+") as file:
            file.truncate(4096)
            with mmap.mmap(file.fileno(), 4096):
                after = sample(os.getpid(), 1.0)
                assert left({str(name)}) == []  # it is in use
        assert left({str(name)}) == [str(name)]
    finally:
        name.unlink()
        os.close(read)
        os.close(write)
        wait.set()
        thread.join()
    assert left({str(name)}) == []
    assert len(ballast) / 2**20 == pytest.approx(after.memory - before.memory, abs=5.0)
    assert after.descriptors - before.descriptors == 4  # the pipe's two, the file's and the mapping's
    assert after.threads == before.threads + 1
    assert after.shared.items() - before.shared.items() == {(str(name), 4096)}


def test_a_process_that_is_not_there_is_refused() -> None:
    with pytest.raises(FlatsatError, match="process 999999999"):
        sample(999_999_999, 0.0)

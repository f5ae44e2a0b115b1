"""The tick of this tree beside the tick of an earlier commit, in turns: `make bench ARGS="--against COMMIT"`.

Run as a program with the folder of a tree it times that tree's tick and prints the result; the names that it uses stood
elsewhere before the package was sorted into rooms.
"""

from __future__ import annotations

import importlib
import io
import json
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
SIZES = (1, 10, 100)
PLACES = {"at its set-point": 0.0, "0.5 m away": 0.5}  # m
_ROUNDS = 7
_STOOD = 60  # ticks before the flight: who has stood so long may do so on something, where poses repeat
_SETTLED, _TICKS = 60, 200  # ticks before and while it is timed
_PERIOD = 0.02  # s, of the certificate cf21_50hz
_ROUNDING = 1e-6  # relative, of commands of both trees


class Comparison(NamedTuple):
    """Tick times of one number of drones in one place, us, round by round."""

    ours: list[float]
    theirs: list[float]


@contextmanager
def checked_out(commit: str) -> Iterator[Path]:
    """Lend a folder with the files of a commit of this tree's history; any name that git knows.

    Raises:
        RuntimeError: git does not know it.
    """
    archive = subprocess.run(["git", "-C", str(ROOT), "archive", commit], capture_output=True, check=False)
    if archive.returncode != 0:
        raise RuntimeError(archive.stderr.decode(errors="replace").strip())
    with tempfile.TemporaryDirectory(prefix="flatsat_ros-bench-") as folder:
        with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as tar:
            tar.extractall(folder, filter="data")
        yield Path(folder)


def compare(commit: str) -> dict[str, Comparison]:
    """Time the ticks of this tree and of a commit of its history in turns.

    Args:
        commit: any name that git knows.

    Returns:
        The times by the number of drones and their place.

    Raises:
        RuntimeError: git does not know the commit, or the two trees command the drones differently.
    """
    with checked_out(commit) as folder:
        rounds = [{name: _run(tree) for name, tree in (("ours", ROOT), ("theirs", folder))} for _ in range(_ROUNDS)]
    for case, first in rounds[0]["ours"].items():
        ours, theirs = np.array(first["command"]), np.array(rounds[0]["theirs"][case]["command"])
        if not np.allclose(ours, theirs, rtol=_ROUNDING, atol=_ROUNDING):
            raise RuntimeError(f"{case}: commanded is {ours.tolist()} now and {theirs.tolist()} at {commit}")
    return {
        case: Comparison(*([one[name][case]["us"] for one in rounds] for name in ("ours", "theirs")))
        for case in rounds[0]["ours"]
    }


def _run(tree: Path) -> dict[str, Any]:
    command = [sys.executable, __file__, str(tree)]
    answer: dict[str, Any] = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    return answer


def _name(*places: str) -> Any:
    """Return the first of some dotted names that is there."""
    for place in places:
        module, _, name = place.rpartition(".")
        try:
            return getattr(importlib.import_module(f"flatsat_ros.{module}"), name)
        except (ImportError, AttributeError):
            continue
    raise ImportError(f"none of {', '.join(places)} is there")


def _time(tree: Path, size: int, away: float) -> dict[str, Any]:
    """Return the mean time of a tick, us, and a command of the first drone, of drones so far, m, from their set-point.

    The mean of the faster nine tenths: not every tick does the same, and what is slower was interrupted.
    """
    certificate = _name("certificate.certificate.Certificate", "core.certificate.Certificate").load(
        tree / "config" / "cf21_50hz.yaml"
    )
    policy = _name("flight.policy.Policy", "flight.supervisor.Policy", "core.supervisor.Policy")
    tuning = _name("law.gain.Tuning", "core.gain.Tuning")(2.0, 0.05, 1.0, certificate.gain_max)
    hold = _name("flight.trajectory.Trajectory", "flight.reference.Trajectory", "core.reference.Trajectory").hold
    step = {}
    if "goal_mode" in policy.__dataclass_fields__:
        step = {"goal_mode": _name("flight.policy.GoalMode", "flight.supervisor.GoalMode").STEP}
    pilot = _name("flight.pilot.Pilot", "core.pilot.Pilot")(
        certificate, tuning, policy(disturbance_max=0.8, **step), size
    )
    places = [(i % 10 * 1.0, i // 10 * 1.0, 1.0) for i in range(size)]
    times = []
    for number in range(-_STOOD, _SETTLED + _TICKS):
        now = (_STOOD + number) * _PERIOD
        if number == 0:
            for index, (x, y, z) in enumerate(places):
                getattr(pilot, "set_reference", getattr(pilot, "refer", None))(index, hold([x + away, y, z]))
        for index, place in enumerate(places):
            pilot.measure(index, now, place, (0.0, 0.0, 0.0, 1.0), now)
        begin = perf_counter()
        tick = pilot.tick(now)
        times.append(perf_counter() - begin)
        if number == _SETTLED:
            command = tick.input[0].tolist()
    fastest = np.sort(times[_STOOD + _SETTLED :])[: int(0.9 * _TICKS)]
    return {"us": 1e6 * float(fastest.mean()), "command": command}


if __name__ == "__main__":
    sys.path.insert(0, sys.argv[1])
    cases = {f"{size} {place}": (size, away) for place, away in PLACES.items() for size in SIZES}
    print(json.dumps({case: _time(Path(sys.argv[1]), *parameters) for case, parameters in cases.items()}))

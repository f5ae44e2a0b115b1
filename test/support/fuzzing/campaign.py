"""Batches of inputs of one kind, tried in worker processes, and what breaks kept in files."""

from __future__ import annotations

import atexit
import functools
import hashlib
import os
import resource
import signal
import tempfile
import time
import traceback
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings
from ros_domain import claim_ros_domain

from flatsat_ros.base.errors import refusal
from flatsat_ros.base.files import make_folder
from fuzzing import MODULES, kind_of
from fuzzing.damage import variants
from fuzzing.kind import Attempt, rewrite

# nobody else's nodes take part, nor those of other workers; rclpy reads this when it starts
_domain, _domain_claim = claim_ros_domain()
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(_domain)

BATCH = 400
# of each input that hypothesis makes, so many more are made by chance
_VARIANTS = 7
# what one input may cost, s of CPU, and all inputs of a kind, bytes of addresses: each half-made node has ten stacks
_SECONDS, _BYTES = 5.0, 4 << 30


@dataclass(frozen=True)
class Batch:
    """Inputs of one kind, made from one seed; what breaks is kept in a folder."""

    kind: str
    seed: int
    inputs: int
    folder: Path


@dataclass(frozen=True)
class Outcome:
    """What came of a batch.

    Attributes:
        kind: of its inputs.
        counts: how many were taken, refused, broken.
        seconds: how long it took, s.
        finding: what broke; empty if nothing did.
        kept: the file with an input that breaks it, made of the smallest one that hypothesis found.
    """

    kind: str
    counts: Counter[str]
    seconds: float
    finding: str = ""
    kept: Path | None = None


class _TooSlowError(Exception):
    """An input takes longer than it may."""


def run_batch(batch: Batch) -> Outcome:
    """Try a batch. The newest input is in a file until it is through: a worker may die of it."""
    attempt, inputs = _opened(batch.kind), kind_of(batch.kind).inputs
    running = make_folder(batch.folder) / f"{batch.kind}-{batch.seed}.running"
    counts, began, broken = Counter[str](), time.monotonic(), b""

    @seed(batch.seed)
    @settings(
        max_examples=max(batch.inputs // (_VARIANTS + 1), 1),
        database=None,
        deadline=None,
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
        verbosity=Verbosity.quiet,
    )
    @given(inputs)
    def attempt_several(first: bytes) -> None:
        nonlocal broken
        for data in variants(first, _VARIANTS):
            rewrite(running, data)
            try:
                taken = _bounded(attempt, data)
            except Exception:
                broken = data
                counts["broken"] += 1
                raise
            counts["taken" if taken else "refused"] += 1

    try:
        attempt_several()
    except Exception as error:
        name = f"{batch.kind}-{hashlib.sha256(broken).hexdigest()[:12]}"
        kept = batch.folder / name
        kept.write_bytes(broken)
        return Outcome(batch.kind, counts, time.monotonic() - began, _finding(error), kept)
    finally:
        running.unlink(missing_ok=True)
    return Outcome(batch.kind, counts, time.monotonic() - began)


def replay(file: Path) -> str:
    """Try the input in a file that was kept, whose name begins with its kind; return what breaks, empty if nothing.

    Raises:
        FlatsatError: its name is another one.
    """
    kind = file.name.partition("-")[0]
    if kind not in MODULES:
        raise refusal("name of the file", file.name, "", f"KIND-..., with a kind of {', '.join(MODULES)}")
    data = file.read_bytes()
    attempt = _opened(kind)
    try:
        _bounded(attempt, data)
    except Exception as error:
        return _finding(error)
    return ""


def unfinished(folder: Path) -> list[Path]:
    """Return the inputs at which worker processes were when they ended."""
    return sorted(folder.glob("*.running"))


@functools.cache
def _opened(name: str) -> Attempt:
    """Open a kind, once in each process; it is closed at the end of the process."""
    stack = ExitStack()
    folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="flatsat_ros-fuzz-"))
    attempt = stack.enter_context(kind_of(name).open(Path(folder)))
    atexit.register(stack.close)
    _bound_memory()
    return attempt


def _bounded(attempt: Attempt, data: bytes) -> bool:
    """Try an input within bounds of CPU and memory."""

    def stop(_number: int, _frame: FrameType | None) -> None:
        raise _TooSlowError(f"more than {_SECONDS:g} s of CPU for one input")

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, _SECONDS)
    try:
        return attempt(data)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def _bound_memory() -> None:
    """Let this process take so much more memory and no more; what fails then is the input's fault."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = pages * os.sysconf("SC_PAGE_SIZE") + _BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _finding(error: Exception) -> str:
    """Return what broke and where: the last calls of the traceback."""
    return "".join(traceback.format_exception(error, limit=-4)).strip()[-4000:]

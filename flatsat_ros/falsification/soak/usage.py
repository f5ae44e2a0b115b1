"""What a process of this machine uses, from /proc."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from flatsat_ros.base.errors import FlatsatError

MIB = 1024.0 * 1024.0
SHARED = "/dev/shm/"


class ProcessUsage(NamedTuple):
    """What a process uses at one moment.

    Attributes:
        time: s since the beginning.
        memory: resident, MiB.
        descriptors: open files, pipes and sockets.
        threads: their number.
        shared: the files of shared memory that it maps, by name, with their sizes in bytes.
    """

    time: float
    memory: float
    descriptors: int
    threads: int
    shared: dict[str, int]


def sample(pid: int, time: float) -> ProcessUsage:
    """Return what a process uses now.

    Args:
        pid: of the process.
        time: s since the beginning.

    Raises:
        FlatsatError: there is no such process.
    """
    process = Path("/proc", str(pid))
    try:
        status = dict(
            line.split(":", 1) for line in (process / "status").read_text(encoding="utf-8").splitlines() if ":" in line
        )
        descriptors = sum(1 for _ in (process / "fd").iterdir())
    except OSError as error:
        raise FlatsatError(f"process {pid}: {error.strerror}") from error
    if "VmRSS" not in status:  # it has ended, and nobody has asked for its exit code
        raise FlatsatError(f"process {pid} has ended")
    return ProcessUsage(
        time,
        1024.0 * float(status["VmRSS"].split()[0]) / MIB,  # kB in the file are KiB
        descriptors,
        int(status["Threads"]),
        {name: size for name in sorted(_mapped(process / "maps")) if (size := _size(name)) is not None},
    )


def present() -> set[str]:
    """Return the files of shared memory that there are, by name."""
    return {str(path) for path in Path(SHARED).iterdir()}


def left(names: set[str]) -> list[str]:
    """Return which files of shared memory, by name, are still there though no process maps them any more."""
    there = {name for name in names if Path(name).exists()}
    if there:
        for maps in Path("/proc").glob("[0-9]*/maps"):
            there -= _mapped(maps)
    return sorted(there)


def _mapped(maps: Path) -> set[str]:
    """Return the files of shared memory in a process's maps; none if it has ended."""
    try:
        text = maps.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return set()
    return {line[line.index(SHARED) :] for line in text.splitlines() if SHARED in line}


def _size(name: str) -> int | None:
    """Return the size of a file, bytes; None if it is gone, as of one that is mapped and was deleted."""
    try:
        return Path(name).stat().st_size
    except OSError:
        return None

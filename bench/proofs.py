"""The processor time of the first proof of every packaged flight certificate against that of the controller's start."""

from __future__ import annotations

import os
import selectors
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from typing import NamedTuple

import psutil

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.resources import config_path
from flatsat_ros.synthesis.flight_design import read_designs

_READY = b"with certificate"  # what the controller says once it flies
_START = 120.0  # s
_GOODBYE = 10.0  # s


class Proof(NamedTuple):
    """Processor time, s: of the controller's start with what is proved already, and what the first start takes more."""

    certificate: str
    start: float
    proof: float


def proofs() -> Iterator[Proof]:
    """Start the controller twice with every packaged certificate that has a flight section.

    Raises:
        FlatsatError: the controller does not start.
    """
    for certificate, (vehicle, _) in read_designs(config_path("flight", "designs")).items():
        with tempfile.TemporaryDirectory() as cache:
            first, second = (_started(certificate, vehicle, cache) for _ in range(2))
        yield Proof(certificate, second, first - second)


def _started(certificate: str, vehicle: str, cache: str) -> float:
    """Return the processor time until a controller flies, s; proofs are remembered in a folder of their own."""
    command = [sys.executable, "-m", "flatsat_ros.nodes.controller_node", "--ros-args"]
    command += ["-p", "robot_names:=[cf1]", "-p", f"certificate:={certificate}", "-p", f"vehicle:={vehicle}"]
    environment = os.environ | {"XDG_CACHE_HOME": cache, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    deadline, said = time.monotonic() + _START, b""
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process:
        assert process.stdout is not None
        try:
            with selectors.DefaultSelector() as selector:
                selector.register(process.stdout, selectors.EVENT_READ)
                while _READY not in said:
                    if not selector.select(max(deadline - time.monotonic(), 0.0)):
                        raise FlatsatError(f"the controller does not fly {certificate} within {_START:g} s")
                    new = os.read(process.stdout.fileno(), 65536)
                    if not new:
                        raise FlatsatError(f"the controller ended: {said.decode(errors='replace').strip()}")
                    said += new
            times = psutil.Process(process.pid).cpu_times()
            return float(times.user + times.system)
        finally:
            process.terminate()
            try:
                process.wait(_GOODBYE)
            except subprocess.TimeoutExpired:
                process.kill()

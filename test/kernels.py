"""`make test-kernels`: law, flight, certificates and synthesis as other processors and other Pythons compute them.

OpenBLAS chooses its kernel by the processor; OPENBLAS_CORETYPE makes it choose another, as far as this processor can
execute it. Under each, the tests are run and certificates in config/ computed again, those of DESIGNS of the whole
loops: every kernel must write the same files, but for the line that names the solver.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[1]
TESTS = ("test/law", "test/flight", "test/certificate", "test/synthesis")

DESIGNS = ("cf21_flight_50hz", "cf21_adaptive_50hz")  # seconds each; all take minutes on each kernel

# What OpenBLAS is asked for, from the oldest to the newest; several may stand for one kernel.
CORE_TYPES = (
    "Prescott", "Nehalem", "Sandybridge", "Haswell", "Zen", "SkylakeX", "Cooperlake", "Sapphirerapids",
    "ARMV8", "NeoverseN1", "NeoverseV1", "VORTEX",
)  # fmt: skip

_TRIAL = "import numpy as np; a = np.eye(99) + np.ones((99, 99)) @ np.ones((99, 99)); np.linalg.cholesky(a)"


def kernels(python: str) -> dict[str, dict[str, str]]:
    """Return the environment of each kernel that OpenBLAS reports and this processor executes, by the kernel's name."""
    found: dict[str, dict[str, str]] = {}
    for core_type in CORE_TYPES:
        environment = {"OPENBLAS_CORETYPE": core_type}
        trial = run([python, "-c", _TRIAL], {**environment, "OPENBLAS_VERBOSE": "2"})
        reported = re.search(r"^Core: (\w+)$", trial.stdout, re.MULTILINE)
        if trial.returncode == 0 and reported and "Core not found" not in trial.stdout:
            found.setdefault(reported[1], environment)
    return found


def run(command: Sequence[str], environment: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    """Run a command in the source tree, with its messages among its output."""
    return subprocess.run(
        command,
        cwd=ROOT,
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )


def certificates(python: str, environment: Mapping[str, str], own: Sequence[str]) -> dict[str, str]:
    """Return what `make certificates` writes, of whole loops DESIGNS, by file name, without the line of the solver.

    Args:
        python: the interpreter.
        environment: what to add to the environment.
        own: the inputs of the certificate for the Crazyflie 2.1.
    """
    with tempfile.TemporaryDirectory(prefix="flatsat_ros-kernels-") as folder:
        program = [python, "-m", "flatsat_ros.cli.synthesize"]
        stored = yaml.safe_load((ROOT / "config" / "designs" / "flight.yaml").read_text(encoding="utf-8"))
        (chosen := Path(folder) / "designs").write_text(yaml.safe_dump({name: stored[name] for name in DESIGNS}))
        for arguments in (
            ["--paper", "all", "--output-dir", folder],
            [*own, "--output", f"{folder}/cf21_50hz.yaml"],
            ["--designs", str(chosen), "--output-dir", folder],
        ):
            done = run([*program, *arguments], environment)
            if done.returncode != 0:
                return {"synthesize": done.stdout}
        return without_solver(Path(folder))


def without_solver(folder: Path) -> dict[str, str]:
    """Return the texts of a folder's certificates, by file name, without the line that names the solver."""
    return {
        path.name: re.sub(r"^  solver: .*\n", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
        for path in sorted(folder.glob("*.yaml"))
    }


def main() -> int:
    """Run everything; return 1 if anything failed, else 0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--certificate", default="", metavar="OPTIONS", help="inputs of cf21_50hz")
    parser.add_argument("--pytest", default="", metavar="OPTIONS", help="for pytest")
    parser.add_argument("python", nargs="+", help="the interpreter for all kernels, then others for their default one")
    arguments = parser.parse_args()
    first, *others = arguments.python
    runs = [(first, name, environment) for name, environment in kernels(first).items()]
    runs += [(python, "its own kernel", {}) for python in others]
    shipped, failed = without_solver(ROOT / "config"), False
    for python, name, environment in runs:
        version = run([python, "-c", "import sys; print(sys.version.split()[0])"], {}).stdout.strip()
        tests = run([python, "-m", "pytest", "--quiet", *arguments.pytest.split(), *TESTS], environment)
        written = certificates(python, environment, arguments.certificate.split())
        different = [file for file, text in written.items() if shipped.get(file) != text]
        summary = tests.stdout.strip().rpartition("\n")[2]
        print(f"Python {version}, {name}: {summary}; ", end="")
        print(f"other than in config: {', '.join(different)}" if different else "certificates as in config", flush=True)
        if tests.returncode != 0:
            print(tests.stdout)
        for file in different:
            print(f"--- {file}\n{written[file]}")
        failed |= tests.returncode != 0 or bool(different)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())

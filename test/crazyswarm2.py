"""Tests with crazyswarm2 itself: its interfaces are built, then its scripts and ours run (`make test-crazyswarm2`).

Nothing of crazyswarm2 comes with this package: the checkout is given. What is built lies in out/crazyswarm2/ and is
built again when an interface has changed.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import subprocess
import sys
import sysconfig
from pathlib import Path

ROOT = Path(__file__).parents[1]
BUILT = ROOT / "out" / "crazyswarm2"
TESTS = ("crazyswarm2_scripts.py", "crazyswarm2_server.py", "crazyswarm2_poses.py", "test_crazyswarm.py")
# what the wheels' CMake files were made with
_FOREIGN = re.compile(r"/opt/python/[\w.-]+/(include/python[\d.]+|lib/python[\d.]+/site-packages/numpy/_core/include)")


def main() -> int:
    """Return the exit code of the tests, or 2 if they could not begin."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--source", type=Path, required=True, help="checkout of crazyswarm2")
    parser.add_argument("--package", type=Path, action="append", default=[], help="more packages of interfaces")
    parser.add_argument(
        "--python", type=Path, required=True, help="of the environment with generators and crazyflie_py's needs"
    )
    options, rest = parser.parse_known_args()
    packages = [options.source / "crazyflie_interfaces", *options.package]
    for package in packages:
        if not (package / "CMakeLists.txt").is_file():
            print(f"error: {package}: must be a package of interfaces, SOURCE=CHECKOUT_OF_CRAZYSWARM2", file=sys.stderr)
            return 2
    python = ROOT / options.python  # the link, not what it leads to: it is the environment
    mend(python.parents[1])
    for package in packages:
        build(package, python)
    libraries = BUILT / "lib"
    modules = libraries / f"python{sysconfig.get_python_version()}" / "site-packages"
    source = options.source.resolve()
    sources = [str(source / name) for name in ("crazyflie_py", "crazyflie_examples", "crazyflie_server_py")]
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([os.environ.get("PYTHONPATH", ""), str(modules), *sources]).strip(os.pathsep),
        "AMENT_PREFIX_PATH": os.pathsep.join([os.environ.get("AMENT_PREFIX_PATH", ""), str(BUILT)]).strip(os.pathsep),
        "LD_LIBRARY_PATH": str(libraries),
        "CRAZYSWARM2": str(source),
        "CRAZYSWARM2_LIBRARIES": str(libraries),
        "CRAZYSWARM2_PYTHON": str(python),
    }
    environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)
    for missing in sorted({"motion_capture_tracking_interfaces", "tf2_msgs"} - {package.name for package in packages}):
        print(f"without {missing} in PACKAGES not all is flown: see docs/crazyswarm2.md", file=sys.stderr)
    tests = [str(file) for name in TESTS if (file := ROOT / "test" / "nodes" / name).is_file()]
    return subprocess.run([sys.executable, "-m", "pytest", *rest, *tests], env=environment, check=False).returncode


def mend(environment: Path) -> None:
    """Let the CMake files of an environment's wheels name its own Python."""
    python = environment / "bin" / "python"
    script = "import numpy, sysconfig; print(sysconfig.get_paths()['include']); print(numpy.get_include())"
    include, numpy = subprocess.run([python, "-c", script], capture_output=True, text=True, check=True).stdout.split()
    for file in environment.glob("share/*/cmake/*Export.cmake"):
        text = file.read_text(encoding="utf-8")
        own = _FOREIGN.sub(lambda found: include if found[1].startswith("include") else numpy, text)
        if own != text:
            file.write_text(own, encoding="utf-8")


def build(package: Path, python: Path) -> None:
    """Build and install a package of interfaces, unless it is installed as it is."""
    files = sorted([*package.glob("msg/*"), *package.glob("srv/*"), package / "CMakeLists.txt"])
    digest = hashlib.sha256(b"".join(file.read_bytes() for file in files) + str(python).encode()).hexdigest()
    stamp = BUILT / f"{package.resolve().name}.sha256"
    if stamp.is_file() and stamp.read_text(encoding="utf-8") == digest:
        return
    prefix, folder = python.parents[1], BUILT / "build" / package.resolve().name
    inherited = {
        name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "AMENT", "COLCON", "_ROS"))
    }
    inherited.pop("LD_LIBRARY_PATH", None)
    environment = {
        **inherited,
        "PATH": os.pathsep.join([str(prefix / "bin"), os.environ["PATH"]]),
        "AMENT_PREFIX_PATH": str(prefix),
        "CMAKE_PREFIX_PATH": os.pathsep.join([str(prefix), str(BUILT)]),
    }
    own = [f"-DCMAKE_INSTALL_PREFIX={BUILT}", f"-DPython3_EXECUTABLE={python}", "-DBUILD_TESTING=OFF"]
    jobs = str(os.cpu_count() or 1)
    for command in (
        ["cmake", "-S", str(package), "-B", str(folder), *own],
        ["cmake", "--build", str(folder), "--parallel", jobs],
        ["cmake", "--install", str(folder)],
    ):
        subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, check=True)
    stamp.write_text(digest, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())

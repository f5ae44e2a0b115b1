"""What every test process gets before anything imports numpy or rclpy: one thread, its own ROS domain and logs."""

from __future__ import annotations

import functools
import os
import re
import tempfile
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from ros_domain import claim_ros_domain
from xdist.scheduler import LoadScopeScheduling

TEST = Path(__file__).resolve().parent

# files whose tests share what takes long to compute
SHARING = ("test/paper/test_reproduction.py",)

# niceness of workers whose tests have time
BEHIND = 10

_domain, _domain_claim = claim_ros_domain()
_logs = tempfile.TemporaryDirectory(prefix="flatsat_ros-log-", ignore_cleanup_errors=True)
os.environ["ROS_DOMAIN_ID"] = str(_domain)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_LOG_DIR"] = _logs.name

# The workers share the cores: threads of linear algebra that wait for each other's core take ten times as long.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# The same examples in every run; `--hypothesis-profile explore` searches for new ones.
settings.register_profile("ci", derandomize=True, deadline=None)
settings.register_profile("explore", max_examples=2000, deadline=None)
settings.load_profile("ci")


class _Groups(LoadScopeScheduling):  # type: ignore[misc]
    """Keeps the tests whose processes fly in real time on one worker, one at a time, and those that share computations.

    xdist's own groups do not work with pytest 9.2: they are written into names of tests that it no longer reads.
    """

    def _split_scope(self, nodeid: str) -> str:
        return _group(nodeid)


def _group(nodeid: str) -> str:
    """Return the name of a test's group; its own where any worker may run it at any time."""
    file = nodeid.partition("::")[0]
    if file in SHARING:
        return file
    if not file.startswith(("test/nodes/", "test/cli/")):
        return nodeid
    marks = _marks(file)
    return nodeid if "in_process" in marks else file if "beside_flights" in marks else "flights"


@functools.cache
def _marks(file: str) -> set[str]:
    """Which marks all tests of a file have."""
    return set(re.findall(r"^pytestmark = pytest\.mark\.(\w+)", (TEST.parent / file).read_text(encoding="utf-8"), re.M))


@pytest.hookimpl(wrapper=True)
def pytest_xdist_auto_num_workers() -> Generator[None, int, int]:
    """Take one worker more than there are cores: one waits for flights, whose processes take a third of a core."""
    return (yield) + 1


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Let a worker step back behind flights once it has come to tests that stand alone: they are given out last."""
    if hasattr(item.config, "workerinput") and _group(item.nodeid) == item.nodeid and os.nice(0) < BEHIND:
        os.nice(BEHIND)


def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> _Groups:
    """Distribute the tests to workers by group."""
    return _Groups(config, log)


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A ROS domain of the test's own, for it and the processes it starts."""
    domain, claim = claim_ros_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    with claim:
        yield domain


@pytest.fixture(scope="session")
def root() -> Path:
    """The source tree that the installed package was built from."""
    return TEST.parent


@pytest.fixture(scope="session")
def prefix() -> Path:
    """Where colcon installed the package; `make test` builds and sources it."""
    from ament_index_python import PackageNotFoundError, get_package_prefix

    try:
        return Path(get_package_prefix("flatsat_ros"))
    except PackageNotFoundError:
        pytest.fail("flatsat_ros is not installed: run `make test`, or colcon build and source install/setup.bash")


@pytest.fixture(scope="session")
def executables(prefix: Path) -> Path:
    """The folder with the executables, as `ros2 run` finds them."""
    return prefix / "lib" / "flatsat_ros"

"""The choreography: arm, stand, take off, gather, swap, land. Simulated and live flights follow this one text."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NoReturn

from tqdm import tqdm

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.demo.scenario import Scenario
from flatsat_ros.flight.trajectory import Trajectory

STANDING_TIME = 1.0  # s on the floor, in which the controller gets to know all poses
GATHER_TIME = 3.0  # s from the take-off to the goals that gather the drones at their first way-points
CLIMB_TIME = 6.0  # s from the take-off to the start of the swap
LANDING_TIME = 8.0  # s that a landing takes, until the controller is silent again
LANDING_LATEST = 40.0  # s after which a drone that still flies did not land
# m, from its first way-point, that a drone may be when the trajectories are sent, and s after that: in the paper's
# flight, and where references are followed in a tube and must not jump
GATHERED = 0.15, 0.0
GATHERED_GENTLY = 0.02, 1.5
LATE = 20.0  # s, that drones may be late at their first way-points

# time flown, time left
_BAR = "{desc} {bar} {n:.1f}/{total:.1f} {unit}"
_ROUNDING = 1e-6  # s


class Stage(ABC):
    """Drones and their controller as the choreography sees them, and its way to wait."""

    def __init__(self) -> None:
        self._bar: tqdm[NoReturn] = tqdm(disable=True)

    @abstractmethod
    def now(self) -> float:
        """Return the time, s, on a clock that begins anywhere."""

    @abstractmethod
    def step(self) -> None:
        """Let a little time pass."""

    @abstractmethod
    def arm(self) -> None:
        """Arm all drones."""

    @abstractmethod
    def take_off(self) -> None:
        """Let all drones take off, as high as their first way-points are."""

    @abstractmethod
    def send_goals(self, places: FloatArray) -> None:
        """Send all drones to places (N, 3), m."""

    @abstractmethod
    def send_trajectories(self, trajectories: Sequence[Trajectory], lead: float) -> float:
        """Send each drone a trajectory that begins in `lead` seconds; return when that is on the record's clock, s."""

    @abstractmethod
    def land(self) -> None:
        """Let all drones land."""

    @abstractmethod
    def away(self, places: FloatArray, distance: float) -> list[str]:
        """Return the names of the drones that are farther than a distance, m, from their places (N, 3), m."""

    @abstractmethod
    def in_use(self) -> list[str]:
        """Return the names of the drones that the controller still commands."""

    def wait_until(self, holds: Callable[[], bool], seconds: float) -> bool:
        """Wait until a condition holds, for at most a time, s; return whether it holds."""
        end = self.now() + seconds
        while not holds():
            before = self.now()
            if before > end - _ROUNDING:
                return False
            self.step()
            self._advance(self.now() - before)
        return True

    def let_pass(self, seconds: float) -> None:
        """Wait for a time, s."""
        self.wait_until(lambda: False, seconds)

    @contextmanager
    def progress(self, seconds: float, description: str, *, leave: bool = True) -> Iterator[None]:
        """Show on stderr, as a bar, how much of a time has passed.

        Args:
            seconds: the whole time.
            description: what happens meanwhile.
            leave: whether the bar stays, filled, at the end.
        """
        with tqdm(total=seconds, unit="s", desc=description, bar_format=_BAR, leave=leave) as self._bar:
            yield
            self._advance(seconds)

    def describe(self, what: str) -> None:
        """Show beside the progress what happens now."""
        self._bar.set_description_str(what)

    def _advance(self, seconds: float) -> None:
        if self._bar.total is not None:
            self._bar.update(min(seconds, self._bar.total - self._bar.n))


def perform(scenario: Scenario, stage: Stage) -> float:
    """Fly a scenario from the floor to the floor; return when its swap began on the record's clock, s.

    A drone that has not landed by `LANDING_LATEST` is left as it is: the record shows it.

    Raises:
        FlatsatError: drones did not arrive at their first way-points, or the stage could not do as it was asked.
    """
    with stage.progress(STANDING_TIME + CLIMB_TIME + scenario.duration + LANDING_TIME, "taking off"):
        stage.arm()
        stage.let_pass(STANDING_TIME)
        stage.take_off()
        stage.let_pass(GATHER_TIME)
        if scenario.plan is None:  # which gathers its drones by itself
            _gather(scenario, stage)
        start = stage.send_trajectories(scenario.swaps, scenario.lead)
        stage.describe("swapping")
        stage.let_pass(scenario.lead + scenario.duration)
        stage.step()  # the end itself belongs to the swap
        stage.describe("landing")
        stage.land()
        stage.wait_until(lambda: not stage.in_use(), LANDING_LATEST)
    return start


def _gather(scenario: Scenario, stage: Stage) -> None:
    """Let all drones go to their first way-points.

    Raises:
        FlatsatError: they did not arrive there in time.
    """
    stage.send_goals(scenario.gathering)
    stage.let_pass(CLIMB_TIME - GATHER_TIME - scenario.lead)
    near, rest = GATHERED if scenario.paper else GATHERED_GENTLY
    if not stage.wait_until(lambda: not stage.away(scenario.gathering, near), LATE):
        late = ", ".join(stage.away(scenario.gathering, near))
        raise FlatsatError(f"not within {near:g} m of the first way-point, {LATE:g} s late: {late}")
    stage.let_pass(rest)

"""Batches of runs, and what many of them come to."""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from functools import partial
from typing import NamedTuple

from flatsat_ros.falsification.campaigns import RUNS, CampaignOutcome, Pool, run
from flatsat_ros.falsification.sabotage import sabotaged
from flatsat_ros.falsification.workers import results_of


class Batch(NamedTuple):
    """A thousand runs with one certificate: everything about them follows from these two.

    Attributes:
        campaign: one of `campaigns.CAMPAIGNS`.
        seed: of the random numbers.
    """

    campaign: str
    seed: int


def batches_of(campaigns: Sequence[str], runs: int, seed: int) -> list[Batch]:
    """Return the batches of at least so many runs, the campaigns in turn, seeds counting up from the first one."""
    count = math.ceil(runs / RUNS)
    return [Batch(campaigns[i % len(campaigns)], seed + i // len(campaigns)) for i in range(count)]


def run_batch(batch: Batch, pool: Pool, sabotage: str | None, watched: int | None = None) -> CampaignOutcome:
    """Run one batch, see `campaigns.run`; sabotage is None or one of `sabotage.SABOTAGES`."""
    return run(*batch, pool, None if sabotage is None else partial(sabotaged, sabotage), watched)


def run_batches(batches: Sequence[Batch], pool: Pool, sabotage: str | None, workers: int) -> Generator[CampaignOutcome]:
    """Yield what the batches come to, in their order; what has not begun is dropped with the generator.

    Args:
        batches: to run.
        pool: see `campaigns.run`.
        sabotage: None, or one of `sabotage.SABOTAGES`.
        workers: processes; 1 for this one alone.

    Raises:
        FlatsatError: a worker process died.
    """
    yield from results_of(partial(run_batch, pool=pool, sabotage=sabotage), batches, workers)

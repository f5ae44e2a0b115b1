"""Many batches, one after the other or in worker processes; they come to the same, in the same order."""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from itertools import islice
from typing import NamedTuple

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.interrupts import signals_held
from flatsat_ros.falsification.campaigns import RUNS, Outcome, Pool, run
from flatsat_ros.falsification.sabotage import sabotaged


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


def run_batch(batch: Batch, pool: Pool, sabotage: str | None, watched: int | None = None) -> Outcome:
    """Run one batch, see `campaigns.run`; sabotage is None or one of `sabotage.SABOTAGES`."""
    return run(*batch, pool, None if sabotage is None else partial(sabotaged, sabotage), watched)


def run_batches(batches: Sequence[Batch], pool: Pool, sabotage: str | None, workers: int) -> Generator[Outcome]:
    """Yield what the batches come to, in their order; what has not begun is dropped with the generator.

    Args:
        batches: to run.
        pool: see `campaigns.run`.
        sabotage: None, or one of `sabotage.SABOTAGES`.
        workers: processes; 1 for this one alone.

    Raises:
        FlatsatError: a worker process died.
    """
    work = partial(run_batch, pool=pool, sabotage=sabotage)
    if workers == 1:
        yield from map(work, batches)
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one core for each worker, not for each matrix product
    context = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(workers, mp_context=context, initializer=_end_with_the_parent)
    remaining, submitted = iter(batches), deque[Future[Outcome]]()
    try:
        while True:
            for batch in islice(remaining, 2 * workers - len(submitted)):
                with _deaf():
                    submitted.append(executor.submit(work, batch))
            if not submitted:
                return
            yield submitted.popleft().result()
    except BrokenProcessPool as error:
        raise FlatsatError("a worker process died: was there enough memory for all --workers?") from error
    finally:
        with signals_held():
            executor.shutdown(cancel_futures=True)


@contextmanager
def _deaf() -> Iterator[None]:
    """Let processes that start here be deaf to SIGINT and SIGHUP, which reach all of a terminal: this one ends them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_the_parent() -> None:
    """Let this worker end when its parent was killed, which ends no worker by itself."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()

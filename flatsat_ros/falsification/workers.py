"""The same work on many items, here or in worker processes: the results are the same, in the same order."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from typing import TypeVar

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.interrupts import signals_held

WORKERS_MAX = 512  # more processes than any machine of ours has cores

Item = TypeVar("Item")
Result = TypeVar("Result")


def results_of(work: Callable[[Item], Result], items: Iterable[Item], workers: int) -> Generator[Result]:
    """Yield the results of the work, in the order of the items. Work that is not done ends with the generator.

    Args:
        work: a function of a module, or a partial of one: worker processes import it.
        items: what is worked on; the next one is taken when a worker is free.
        workers: processes; 1 for this one alone.

    Raises:
        FlatsatError: a worker process died.
    """
    if workers == 1:
        yield from map(work, items)
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one core for each worker, not for each matrix product
    context = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(workers, mp_context=context, initializer=_end_with_the_parent)
    remaining, submitted, complete = iter(items), deque[Future[Result]](), False
    others = multiprocessing.active_children()
    try:
        while True:
            for item in islice(remaining, 2 * workers - len(submitted)):
                with _deaf():
                    submitted.append(executor.submit(work, item))
            if not submitted:
                complete = True
                return
            yield submitted.popleft().result()
    except BrokenProcessPool as error:
        raise FlatsatError("a worker process died: was there enough memory for all --workers?") from error
    finally:
        with signals_held():
            if not complete:  # nobody wants to wait for a piece that may take a minute
                for process in multiprocessing.active_children():
                    if process not in others:
                        process.terminate()
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

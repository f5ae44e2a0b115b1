"""SIGINT, SIGTERM and SIGHUP where an exception must not be raised at any moment: held back, and delivered in time."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def signals_held() -> Iterator[Callable[[], None]]:
    """Hold back those of the three signals that have a handler; what has come by the end is delivered there.

    An exception that a handler raises wherever it comes can get lost, as in a finalizer or in an import that takes it
    for an import that failed; and it must not come while things are tidied up.

    Yields:
        A function that calls the handlers of the signals that have come so far.
    """
    handlers: dict[int, Callable[[int, Any], Any]] = {}
    pending: list[int] = []

    def deliver() -> None:
        while pending:
            number = pending.pop(0)
            handlers[number](number, None)

    for stopping in STOPPING:
        handler = signal.getsignal(stopping)
        if callable(handler):
            handlers[stopping] = handler
            signal.signal(stopping, lambda number, _frame: pending.append(number))
    try:
        yield deliver
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        deliver()

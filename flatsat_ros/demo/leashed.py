"""Run a module that ends when its parent does: `python -m flatsat_ros.demo.leashed MODULE ARGUMENTS`.

The parent holds the other end of stdin, a pipe through which nothing comes. The kernel closes it however the parent
ends, also when it is killed, and the module is told to end like by anybody else: with SIGTERM.
"""

from __future__ import annotations

import os
import runpy
import signal
import sys
import threading


def _wait() -> None:
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    threading.Thread(target=_wait, daemon=True).start()
    sys.argv = sys.argv[1:]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)

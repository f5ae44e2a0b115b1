"""Ctrl-C that comes while a program still imports what it needs."""

from __future__ import annotations


def ctrl_c_at(module: str) -> str:
    """Return what a program is to execute first, so that Ctrl-C comes while it looks for a module."""
    return f"""
import signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            sys.meta_path.remove(self)
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Finder())
"""

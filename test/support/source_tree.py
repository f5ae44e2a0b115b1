"""Source texts as trees."""

from __future__ import annotations

import ast
import gc


def parsed(text: str) -> ast.Module:
    """Return the tree of a source text.

    CPython before 3.11.9 and 3.12.3 counts the depth of all trees that are being made in one place (its issue 106905):
    a collection in between, of something that lets another thread run, may end in a SystemError.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        return ast.parse(text)
    finally:
        if enabled:
            gc.enable()

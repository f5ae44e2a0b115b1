"""Several messages in one input: each with a code, which tells what it is, and its bytes."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from hypothesis import strategies as st

Item = tuple[int, bytes]

_MOST = 16


def sequences(items: st.SearchStrategy[Item], most: int = 6) -> st.SearchStrategy[bytes]:
    """Return inputs of up to so many messages."""
    return st.lists(items, min_size=1, max_size=most).map(encoded)


def encoded(items: Sequence[Item]) -> bytes:
    """Return the messages as one input."""
    return b"".join(struct.pack("<BH", code, len(data)) + data for code, data in items)


def decoded(data: bytes) -> list[Item]:
    """Return the messages of an input, as many as it has; any bytes are an input."""
    items, at = [], 0
    while at + 3 <= len(data) and len(items) < _MOST:
        code, length = struct.unpack_from("<BH", data, at)
        items.append((code, data[at + 3 : at + 3 + length]))
        at += 3 + length
    return items

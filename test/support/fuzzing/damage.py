"""Damage to files: what a hand, a disk or a bad tool does to them; and the numbers that nobody expects."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from random import Random

from hypothesis import strategies as st

# values that mean something else than they seem to, or break mathematics
NUMBERS = (
    "0", "-1", "-0.0", "1", "1.0", "2", "0.5", "1.0e-320", "5.0e-324", "1.0e-300", "-1.0e+300", "1.7e+308", "1.0e+999",
    "1.0e-999", ".nan", "-.inf", ".inf", "nan", "inf", "1e3", "017", "0o17", "0x1F", "0b11", "1_000", "1_0.5", "1:30",
    "1:30.5", "1" + "0" * 400, "9" * 5000, "9223372036854775808", "1.0e+12", "1.0e-12", "\uff11",
)  # fmt: skip
TOKENS = (
    *NUMBERS, "", " ", "\t", "\n", "\r", "\0", "\x1b", "\x85", "\u2028", "\ufeff", "\udcff", ",", ":", "- ", "? ", "#",
    "'", '"', "|", ">", "[", "]", "{", "}", "[" * 50, "{a: " * 50, "[]", "{}", "[1.0, 2.0, 3.0]", "{a: 1.0}", "null",
    "true", "yes", "~", "text", "2020-13-45", "&a ", "*a", "<<: ", "!!float ", "!!python/object:os.x ", "!!binary ",
    "%YAML 1.2\n---\n", "--- ", "...\n", "x" * 3000,
)  # fmt: skip

_EXTREMES = (
    math.nan, math.inf, 0.0, 5e-324, 1e-310, 1e-160, 1e-12, 1.0, 2.0**31, 2.0**53, 1e12, 1e39, 1e155, 1.7e308,
)  # fmt: skip
# any number that fits into 64 bits, those at the edges more often
FLOATS = st.sampled_from([sign * value for value in _EXTREMES for sign in (1.0, -1.0)]) | st.floats()


@st.composite
def damaged(draw: st.DrawFn, text: str) -> bytes:
    """One to three of: a token put over up to a dozen characters or a whole value, lines lost, doubled or moved.

    Now and then the end is torn off, or bytes are hit as well.
    """
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(st.integers(0, 5))
        if kind <= 2:
            text = _overwritten(draw, text, whole=kind > 0)
        elif kind == 5:
            text = text[: draw(st.integers(0, len(text)))]
        else:
            lines = text.splitlines(keepends=True) or [""]
            first, second = (draw(st.integers(0, len(lines) - 1)) for _ in range(2))
            lines[first] = (lines[first] + lines[second]) if kind == 3 else ""
            text = "".join(lines)
    data = text.encode("utf-8", "surrogateescape")
    return draw(corrupted(data)) if draw(st.integers(0, 9)) == 9 else data


@st.composite
def corrupted(draw: st.DrawFn, data: bytes) -> bytes:
    """One to three of: bytes overwritten, with bits turned, lost, added; the end torn off."""
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, max(len(data) - 1, 0)))
        kind = draw(st.integers(0, 3))
        if kind == 0:
            added = draw(_ADDED)
            data = data[:start] + added + data[start + len(added) :]
        elif kind == 1:
            data = data[:start] + bytes(255 - byte for byte in data[start : start + 1]) + data[start + 1 :]
        elif kind == 2:
            data = data[:start] + draw(_ADDED) + data[start + draw(st.integers(0, 40)) :]
        else:
            data = data[:start]
    return data


_LENGTHS = [n.to_bytes(size, "little") for size in (2, 4, 8) for n in (0, 2 ** (8 * size) - 1, 2 ** (7 * size))]
_ADDED = st.binary(max_size=20) | st.sampled_from(_LENGTHS)


def _overwritten(draw: st.DrawFn, text: str, whole: bool) -> str:
    start = draw(st.integers(0, max(len(text) - 1, 0)))
    if whole:  # the value or key around it
        stops = ",[]{}: \n"
        while start > 0 and text[start - 1] not in stops:
            start -= 1
        end = next((i for i in range(start, len(text)) if text[i] in stops), len(text))
    else:
        end = start + draw(st.integers(0, 12))
    return text[:start] + draw(st.sampled_from(TOKENS)) + text[end:]


_PIECES = [
    *(token.encode("utf-8", "surrogateescape") for token in TOKENS if len(token) < 100),
    *(struct.pack(order + "d", sign * value) for value in _EXTREMES for sign in (1.0, -1.0) for order in "<>"),
    *(struct.pack("<f", value) for value in (math.nan, math.inf, -3e38)),
    *_LENGTHS,
]


def variants(data: bytes, count: int) -> Iterator[bytes]:
    """Yield an input and others made of it by chance, always the same ones: hypothesis alone would take all the time.

    Each differs in one to four places: a piece put over or between, bits turned, bytes lost, doubled or moved.
    """
    yield data
    random = Random(data)
    for _ in range(count):
        changed = bytearray(data)
        for _ in range(random.randint(1, 4)):
            at, length = random.randint(0, len(changed)), random.choice((1, 2, 4, 8, 8, 8, 20))
            match random.randint(0, 5):
                case 0:
                    piece = random.choice(_PIECES)
                    changed[at : at + len(piece)] = piece
                case 1:
                    changed[at:at] = random.choice(_PIECES)
                case 2 if at < len(changed):
                    changed[at] ^= 1 << random.randint(0, 7)
                case 3:
                    del changed[at : at + length]
                case 4:
                    changed[at:at] = changed[at : at + length]
                case _:
                    start = random.randint(0, len(changed))
                    changed[at : at + length] = changed[start : start + length]
        yield bytes(changed)

"""Damage to files: what a hand, a disk or a bad tool does to them, for tests of whatever reads them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError

# values that mean something else than they seem to, or break mathematics
NUMBERS = (
    "0", "-1", "-0.0", "1", "1.0", "2", "0.5", "1.0e-320", "5.0e-324", "1.0e-300", "-1.0e+300", "1.7e+308", "1.0e+999",
    "1.0e-999", ".nan", "-.inf", ".inf", "nan", "inf", "1e3", "017", "0o17", "0x1F", "0b11", "1_000", "1_0.5", "1:30",
    "1:30.5", "1" + "0" * 400, "9" * 5000, "9223372036854775808", "1.0e+12", "1.0e-12", "\uff11",
)  # fmt: skip
TOKENS = (
    *NUMBERS, "", " ", "\t", "\n", "\r", "\0", "\x1b", "\x85", "\u2028", "\ufeff", "\udcff", ",", ":", "- ", "? ", "#",
    "'", '"', "|", ">", "[", "]", "{", "}", "[" * 50, "{a: " * 50, "null", "true", "yes", "~", "2020-13-45",
    "&a ", "*a", "<<: ", "!!float ", "!!python/object:os.x ", "!!binary ", "%YAML 1.2\n---\n", "--- ", "...\n",
    "x" * 3000,
)  # fmt: skip


def refusal(load: Callable[[], object], path: Path) -> str | None:
    """Load a file; return the text of a refusal, which must be short, in one line, and name the path."""
    try:
        load()
    except FlatsatError as refused:
        text = str(refused)
    else:
        return None
    assert text.startswith(str(path))
    assert text.isprintable()
    assert len(text) < len(str(path)) + 500
    return text


@st.composite
def damaged(draw: st.DrawFn, text: str) -> bytes:
    """One to three of: a token put over up to a dozen characters or a whole value, a line doubled, lost or swapped."""
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(st.integers(0, 4))
        if kind <= 2:
            text = _overwritten(draw, text, whole=kind > 0)
        else:
            lines = text.splitlines(keepends=True) or [""]
            first, second = (draw(st.integers(0, len(lines) - 1)) for _ in range(2))
            lines[first] = (lines[first] + lines[second]) if kind == 3 else ""
            text = "".join(lines)
    return text.encode("utf-8", "surrogateescape")


@st.composite
def corrupted(draw: st.DrawFn, data: bytes) -> bytes:
    """One to three of: bytes overwritten, with bits turned, lost, added; the end torn off."""
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, max(len(data) - 1, 0)))
        lost, added = draw(st.integers(0, 40)), draw(st.binary(max_size=20) | st.sampled_from(_LENGTHS))
        kind = draw(st.integers(0, 3))
        if kind == 0:
            data = data[:start] + added + data[start + len(added) :]
        elif kind == 1:
            data = data[:start] + bytes(255 - byte for byte in data[start : start + 1]) + data[start + 1 :]
        elif kind == 2:
            data = data[:start] + added + data[start + lost :]
        else:
            data = data[:start]
    return data


_LENGTHS = [n.to_bytes(size, "little") for size in (2, 4, 8) for n in (0, 2 ** (8 * size) - 1, 2 ** (7 * size))]


def _overwritten(draw: st.DrawFn, text: str, whole: bool) -> str:
    start = draw(st.integers(0, max(len(text) - 1, 0)))
    end = start + draw(st.integers(0, 12))
    if whole:  # the value or key around it
        stops = ",[]{}: \n"
        while start > 0 and text[start - 1] not in stops:
            start -= 1
        end = next((i for i in range(start, len(text)) if text[i] in stops), len(text))
    return text[:start] + draw(st.sampled_from(TOKENS)) + text[end:]

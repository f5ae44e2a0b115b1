"""Tables of decimals as text: what a plan file holds in place of lists, read to integers without rounding."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from flatsat_ros.base.errors import FlatsatError, quoted, refusal

_DECIMAL = re.compile(r"-?(?:0|[1-9][0-9]{0,5})\.[0-9]{1,9}")


def written(rows: Iterable[Sequence[int | str]], digits: Sequence[int | None]) -> str:
    """Return lines of words, and of integers as decimals.

    Args:
        rows: of words and integers.
        digits: of each column after the point: 9 for nanometres as metres; None for words.
    """
    lines = []
    for row in rows:
        columns = zip(row, digits, strict=True)
        lines.append(" ".join(str(value) if count is None else _decimal(int(value), count) for value, count in columns))
    return "".join(f"{line}\n" for line in lines)


def _decimal(value: int, digits: int) -> str:
    whole, part = divmod(abs(value), 10**digits)
    return f"{'-' if value < 0 else ''}{whole}.{part:0{digits}d}"


def read(name: str, text: object, digits: Sequence[int | None], rows_max: int) -> list[tuple[int | str, ...]]:
    """Return the rows of a table, decimals as the integers that `written` was given.

    Args:
        name: of the table, for the error.
        text: what must be one.
        digits: as for `written`; decimals may have fewer, never more.
        rows_max: more are refused.

    Raises:
        FlatsatError: it is no text, a row has another number of columns, a decimal is none or has more digits, or there
            are too many rows.
    """
    if not isinstance(text, str):
        raise refusal(name, text, "", "lines of text")
    lines = text.splitlines()
    if len(lines) > rows_max:
        raise refusal(f"number of lines of {name}", len(lines), "", f"at most {rows_max}")
    rows = []
    for number, line in enumerate(lines, 1):
        words = line.split()
        if len(words) != len(digits):
            raise refusal(f"line {number} of {name}", line, "", f"{len(digits)} columns")
        rows.append(tuple(
            word if count is None else _integer(f"line {number} of {name}", word, count)
            for word, count in zip(words, digits, strict=True)
        ))  # fmt: skip
    return rows


def integer_rows(name: str, text: object, digits: Sequence[int], rows_max: int) -> list[tuple[int, ...]]:
    """Return the rows of a table of decimals alone; see `read`."""
    return [tuple(map(int, row)) for row in read(name, text, digits, rows_max)]


def _integer(place: str, word: str, digits: int) -> int:
    if not _DECIMAL.fullmatch(word) or len(word.partition(".")[2]) > digits:
        raise FlatsatError(f"{place}: {quoted(word)}: must be a decimal with 1 to {digits} digits after the point")
    whole, _, part = word.lstrip("-").partition(".")
    value = int(whole + part.ljust(digits, "0"))
    return -value if word.startswith("-") else value

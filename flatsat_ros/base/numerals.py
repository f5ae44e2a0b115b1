"""Numbers as people write them: 1_000 and the digits of other scripts are numbers for Python alone."""

from __future__ import annotations


def number_of(text: str) -> float:
    """Return the number that a text stands for.

    Raises:
        ValueError: it is none.
    """
    return float(_plain(text))


def integer_of(text: str) -> int:
    """Return the integer that a text stands for.

    Raises:
        ValueError: it is none.
    """
    return int(_plain(text))


def _plain(text: str) -> str:
    if "_" in text or not text.isascii():
        raise ValueError("not a plain decimal number")
    return text

"""What a kind of input is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError

Content = TypeVar("Content")

# takes one input; returns whether it was taken, or False if it was refused; raises where neither was done properly
Attempt = Callable[[bytes], bool]


@dataclass(frozen=True)
class Kind:
    """One kind of input.

    Attributes:
        inputs: how they are made; an input is bytes, so that it can be kept in a file.
        open: given an empty folder, the context in which they are tried.
    """

    inputs: st.SearchStrategy[bytes]
    open: Callable[[Path], AbstractContextManager[Attempt]]


def of_file(
    inputs: st.SearchStrategy[bytes], load: Callable[[Path], Content], law: Callable[[Content], None], name: str
) -> Kind:
    """Return the kind of a file.

    Args:
        inputs: what stands in it.
        load: reads it, and refuses it in one short line that begins with its path.
        law: what must hold of what was read.
        name: of the file.
    """

    @contextmanager
    def opened(folder: Path) -> Iterator[Attempt]:
        path = folder / name

        def attempt(data: bytes) -> bool:
            rewrite(path, data)
            try:
                content = load(path)
            except FlatsatError as refused:
                require_one_line(refused, path)
                return False
            law(content)
            return True

        yield attempt

    return Kind(inputs, opened)


def rewrite(path: Path, data: bytes) -> None:
    """Write a file anew. Written over, it would be flushed to the disk when it is closed, on some file systems."""
    path.unlink(missing_ok=True)
    path.write_bytes(data)


def require_one_line(refused: FlatsatError, path: Path | None = None) -> None:
    """Require that a refusal is one short line, which begins with the path if it is about a file."""
    text = str(refused)
    assert text.isprintable(), text
    if path is not None:
        assert text.startswith(str(path)), text
    assert 0 < len(text) < len(str(path or "")) + 500, text

"""Files: one bounded way to read them, one way to write them in a single step; what fails is one line with the path."""

from __future__ import annotations

import os
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from flatsat_ros.base.errors import FlatsatError, one_line, quoted, refusal

_SPECIAL = "a device, pipe or socket"


def user_path(text: str | os.PathLike[str]) -> Path:
    """Return what a user gave as a path; `~` is the home folder.

    Raises:
        FlatsatError: it is empty, contains a NUL, or nobody has that home folder.
    """
    name = os.fspath(text)
    if not name or "\0" in name:
        raise refusal("path", name, "", "the path of a file or folder")
    try:
        return Path(name).expanduser()
    except RuntimeError as error:
        raise refusal("path", name, "", "a path whose home folder exists") from error


def resolved(path: str | os.PathLike[str]) -> Path:
    """Return the whole path to which links lead.

    Raises:
        FlatsatError: they lead round and round.
    """
    try:
        return Path(path).resolve()
    except (OSError, RuntimeError) as error:
        raise unreadable(path, "its links lead round and round") from error


def read_text(path: str | os.PathLike[str], bytes_max: int) -> str:
    """Return the text of a regular file.

    Args:
        path: of the file; `~` is not expanded, see `user_path`.
        bytes_max: largest size that is read, bytes.

    Raises:
        FlatsatError: the file is missing, not readable, no regular file (a folder, device, pipe or socket), larger, or
            not UTF-8.
    """
    try:
        check_regular(path, bytes_max)
        with Path(path).open("rb") as stream:
            data = stream.read(bytes_max + 1)
        check_size(path, len(data), bytes_max)
        return data.decode("utf-8")
    except FlatsatError:
        raise
    except (OSError, ValueError) as error:
        raise unreadable(path, error) from error


def check_regular(path: str | os.PathLike[str], bytes_max: int = sys.maxsize) -> None:
    """Refuse what is not a regular file of at most bytes_max bytes, without opening it: a pipe would block.

    Raises:
        FlatsatError: it is missing, no regular file, or larger.
    """
    try:
        status = Path(path).stat()
    except (OSError, ValueError) as error:
        raise unreadable(path, error) from error
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else _SPECIAL
        raise unreadable(path, f"it is {kind}, must be a regular file")
    check_size(path, status.st_size, bytes_max)


def check_folder(path: str | os.PathLike[str]) -> None:
    """Refuse a folder with a device, pipe or socket in it, or one that cannot be listed.

    Raises:
        FlatsatError: names the path.
    """
    try:
        files = [file for file in Path(path).iterdir() if not file.is_dir()]
    except OSError as error:
        raise unreadable(path, error) from error
    for file in files:
        check_regular(file)


def check_size(path: str | os.PathLike[str], size: int, bytes_max: int) -> None:
    """Refuse a file of more than bytes_max bytes.

    Raises:
        FlatsatError: it is larger.
    """
    if size > bytes_max:
        raise unreadable(path, f"it has more than {bytes_max} bytes, the most that is read")


def shown(path: str | os.PathLike[str]) -> str:
    """Return a path for an error message, in one line."""
    name = os.fspath(path)
    return name if name.isprintable() and 0 < len(name) <= 300 else quoted(name)


def located(path: str | os.PathLike[str], reason: object) -> FlatsatError:
    """Return the refusal of what a file says: the path, then the reason, in one line."""
    return FlatsatError(f"{shown(path)}: {reason}")


def unreadable(path: str | os.PathLike[str], reason: object) -> FlatsatError:
    """Return the refusal of a file that cannot be read, in one line."""
    return located(path, f"cannot be read: {_words(reason)}")


def make_folder(path: str | os.PathLike[str]) -> Path:
    """Make a folder, its parents too; one that is there already is taken.

    Raises:
        FlatsatError: it cannot be made.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        there = "a link to nothing" if not folder.exists() else "a file" if folder.is_file() else _SPECIAL
        raise unwritable(folder, f"it is {there}, must be a folder") from error
    except (OSError, ValueError) as error:
        raise unwritable(folder, error) from error
    return folder


def check_writable(path: str | os.PathLike[str]) -> None:
    """Refuse a file that cannot be written; nothing is written yet. To be asked before long work begins.

    Raises:
        FlatsatError: its folder is missing or read-only, it is a folder itself, or a device, pipe or socket, whose
            place the file would take, or it must not be written.
    """
    file = Path(path)
    if not file.parent.is_dir():
        raise unwritable(file, f"the folder {shown(file.parent)} does not exist")
    if file.is_dir():
        raise unwritable(file, "it is a folder, must be a file")
    _refuse_special(file)
    if not os.access(file.parent, os.W_OK | os.X_OK) or (file.exists() and not os.access(file, os.W_OK)):
        raise unwritable(file, "it is protected, must be a file that may be written, in such a folder")


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file in one step, as `replacing` does.

    Raises:
        FlatsatError: the file cannot be written.
    """
    with replacing(path) as file:
        file.write_text(text, encoding="utf-8")


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a file to write to, of the same ending, which then takes the place of another in one step.

    Whoever reads the file meanwhile, or finds it after a failure, has the old one.

    Raises:
        FlatsatError: the file cannot be written.
    """
    target, temporary = Path(path), None
    try:
        _refuse_special(target)
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=".part-", suffix=target.suffix)
        temporary = Path(name)
        try:
            yield temporary
            os.fsync(handle)  # or a power cut could leave the new name without the new content
        finally:
            os.close(handle)
        temporary.chmod(0o644)
        temporary.replace(target)
    except BaseException as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        if isinstance(error, (OSError, ValueError)) and not isinstance(error, FlatsatError):
            raise unwritable(path, error) from error
        raise


def _refuse_special(target: Path) -> None:
    """Refuse to put a file in the place of a device, pipe or socket: root would take /dev/null from everybody."""
    if target.exists() and not (target.is_file() or target.is_dir()):
        raise unwritable(target, f"it is {_SPECIAL}, must be a regular file")


def unwritable(path: str | os.PathLike[str], reason: object) -> FlatsatError:
    """Return the refusal of a file or folder that cannot be written, in one line."""
    return located(path, f"cannot be written: {_words(reason)}")


def _words(reason: object) -> str:
    """Return why it failed; an OSError without the path, which stands in the message already."""
    return one_line(getattr(reason, "strerror", None) or str(reason) or type(reason).__name__)

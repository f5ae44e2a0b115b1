"""The manners of every command line here: how it reads its arguments, refuses, reports failure and is stopped.

Exit codes: what the program itself returns, 0 or 1; 2 after one line on stderr, `error: ...`, for input that is
refused and for files, folders and libraries that are not to be had; 130 when stopped by Ctrl-C, 143 by SIGTERM and 129
by SIGHUP, without a traceback.

Nothing heavy is imported here: Ctrl-C is heard before numpy has come in.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

REFUSED = 2

# What command lines take without a name, by attribute of the arguments.
_WITHOUT_NAME = {"attacked": "CERTIFICATE", "file": "FILE"}


class _CommandLineError(Exception):
    """A command line that cannot be used; the text says why."""


class _Stopped(KeyboardInterrupt):
    """A signal asked the program to end. Python ends itself with SIGINT for a bare KeyboardInterrupt out of exec."""


class Parser(argparse.ArgumentParser):
    """Arguments whose options cannot be abbreviated and whose refusals are one line."""

    def __init__(self, program: str, description: str | None, epilog: str | None = None) -> None:
        super().__init__(prog=program, description=description, epilog=epilog, allow_abbrev=False)
        # what begins so is a value, as -1,0,1 or -1e-3, which argparse itself takes for options
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def error(self, message: str) -> NoReturn:
        """Refuse the command line."""
        unknown = message.partition("unrecognized arguments: ")[2].split()
        if unknown and unknown[0].startswith("-"):
            from flatsat_ros.base.errors import nearest_name

            message += nearest_name(unknown[0].partition("=")[0], self._option_string_actions)
        raise _CommandLineError(f"{message}; see --help")

    def print_help(self, file: Any = None) -> None:
        """Print the help; argparse itself would not tell that it could not be written."""
        print(self.format_help(), end="", file=file)


def run(parser: Callable[[], Parser], work: Callable[[argparse.Namespace], int], argv: Sequence[str] | None) -> int:
    """Read the command line, do the work and return the exit code of the process.

    Args:
        parser: makes the parser of the arguments.
        work: does what was asked for, given the arguments, and returns 0 or 1.
        argv: arguments without the program's name; those of the process if None.
    """
    os.environ["MPLBACKEND"] = (
        "Agg"  # figures go to files; matplotlib fails to import with a name that it does not know
    )
    stopped: list[int] = []
    try:
        with _stoppable(stopped):
            try:
                code = work(parser().parse_args(argv))
            except SystemExit as leaving:  # --help
                code = int(leaving.code or 0)
            if sys.stdout is not None:
                sys.stdout.flush()
            return code
    except (Exception, KeyboardInterrupt) as error:
        # an import that a signal ends may fail with an error of its own
        if stopped or isinstance(error, KeyboardInterrupt):
            _say("stopped")
            return 128 + (stopped or [signal.SIGINT])[0]
        if not _is_refusal(error):
            raise
        from flatsat_ros.base.errors import reason_of

        _say(f"error: {reason_of(error)}")
        return REFUSED


def _is_refusal(error: Exception) -> bool:
    """Tell what the user can do something about from what is a defect of ours."""
    from flatsat_ros.base.errors import FlatsatError

    return isinstance(error, (FlatsatError, OSError, ImportError, _CommandLineError))


def _say(text: str) -> None:
    """Print a line on stderr; give up what stdout did not take, which Python would complain about at the end."""
    with suppress(OSError):
        print(text, file=sys.stderr)
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError:
        with Path(os.devnull).open("w", encoding="utf-8") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())


@contextmanager
def _stoppable(stopped: list[int]) -> Iterator[None]:
    """Let SIGINT, SIGTERM and SIGHUP, but for those that are ignored, as by nohup, raise _Stopped.

    Args:
        stopped: gets the numbers of the signals that come.
    """
    from flatsat_ros.base.interrupts import STOPPING

    def stop(number: int, _frame: FrameType | None) -> None:
        stopped.append(number)
        raise _Stopped

    before = {number: signal.getsignal(number) for number in STOPPING}
    heard = {number: handler for number, handler in before.items() if handler is not signal.SIG_IGN}
    for number in heard:
        signal.signal(number, stop)
    try:
        yield
    finally:
        for number, handler in heard.items():
            signal.signal(number, handler)


def path(text: str) -> Path:
    """Return the path that an argument names; `~` is the home folder, `~name` that of a user.

    Raises:
        argparse.ArgumentTypeError: it is no path, or there is no such user.
    """
    from flatsat_ros.base.errors import FlatsatError
    from flatsat_ros.base.files import user_path

    try:
        return user_path(text)
    except FlatsatError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def number(text: str) -> float:
    """Return the number that an argument says."""
    from flatsat_ros.base.numerals import number_of

    return number_of(text)


def integer(text: str) -> int:
    """Return the integer that an argument says."""
    from flatsat_ros.base.numerals import integer_of

    return integer_of(text)


def require_alone(arguments: argparse.Namespace, option: str, *beside: str) -> None:
    """Refuse, beside an option, all others that it would ignore.

    Args:
        arguments: what the command line gave; None or False for what it did not.
        option: its name without dashes, as an attribute of the arguments.
        beside: names of the options that may stand beside it.

    Raises:
        FlatsatError: there are others; the text names them.
    """
    from flatsat_ros.base.errors import FlatsatError

    ignored = [
        _typed(name)
        for name, value in sorted(vars(arguments).items())
        if name not in (option, *beside) and value is not None and value is not False
    ]
    if ignored:
        raise FlatsatError(f"{', '.join(ignored)}: not used with {_typed(option)}; drop one or the other")


def _typed(name: str) -> str:
    """Return what a command line calls an attribute of the arguments."""
    return _WITHOUT_NAME.get(name, f"--{name.replace('_', '-')}")


def require_new(target: Path, force: bool) -> None:
    """Refuse, before anything is computed, a file to write that exists or cannot be written.

    Args:
        target: the file.
        force: whether it may exist.

    Raises:
        FlatsatError: it cannot be written, or exists without `force`.
    """
    from flatsat_ros.base.files import check_writable, unwritable

    check_writable(target)
    if target.exists() and not force:
        raise unwritable(target, "it exists: give --force to overwrite it")


def require_apart(option: str, target: Path | None, others: Mapping[str, str | Path | None]) -> None:
    """Refuse to write over a file that is read, or written, besides.

    Args:
        option: that names the target, as it is typed.
        target: the file to write, if any.
        others: the other files, by what the command line calls them.

    Raises:
        FlatsatError: one is the same file.
    """
    from flatsat_ros.base.errors import refusal
    from flatsat_ros.base.files import resolved

    for name, other in others.items():
        if target is not None and other is not None and resolved(target) == resolved(other):
            raise refusal(option, str(target), "", f"another file than {name}, which it would replace")


def require_folder(folder: Path, names: Iterable[str]) -> None:
    """Make a folder, with those of the files' names, and refuse it if one of the files cannot be written.

    Raises:
        FlatsatError: the folder cannot be made, or a file cannot be written.
    """
    from flatsat_ros.base.files import check_writable, make_folder

    make_folder(folder)
    for name in names:
        make_folder((folder / name).parent)
        check_writable(folder / name)

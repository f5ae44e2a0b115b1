"""The manners that all command lines share: arguments, refusals in one line, exit codes, and how they are stopped."""

from __future__ import annotations

import argparse
import re
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.interrupts import STOPPING, signals_held
from flatsat_ros.cli import (
    demo,
    excitation,
    falsify,
    faults,
    identify,
    plan,
    report,
    reproduce,
    shell,
    soak,
    synthesize,
    validate,
)

pytestmark = pytest.mark.beside_flights


PROGRAMS = {
    "demo": demo.main,
    "falsify": falsify.main,
    "faults": faults.main,
    "excitation": excitation.main,
    "identify": identify.main,
    "plan": plan.main,
    "report": report.main,
    "reproduce": reproduce.main,
    "soak": soak.main,
    "synthesize": synthesize.main,
    "validate": validate.main,
}


def run(work: Callable[[argparse.Namespace], int], *argv: str) -> int:
    """Run a program of the tests' own, whose options are --here and --there."""

    def parser() -> shell.Parser:
        made = shell.Parser("own", "A program of the tests' own.")
        made.add_argument("--here", type=shell.path)
        made.add_argument("--there", action="store_true")
        return made

    return shell.run(parser, work, argv)


def raising(error: BaseException) -> Callable[[argparse.Namespace], int]:
    """Work that fails."""

    def work(_: argparse.Namespace) -> int:
        raise error

    return work


def refusal(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line on stderr, without its beginning; nothing is on stdout."""
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert err.endswith("\n")
    assert err.count("\n") == 1
    return err[len("error: ") :]


def test_no_command_line_is_left_out() -> None:
    setup = (Path(__file__).parents[2] / "setup.py").read_text(encoding="utf-8")
    assert sorted(PROGRAMS) == sorted(re.findall(r"= flatsat_ros[.]cli[.](\w+):main", setup))


@pytest.mark.parametrize("program", PROGRAMS)
def test_help_is_no_failure(program: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert PROGRAMS[program](["--help"]) == 0
    assert f"usage: {program}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("program", "abbreviated"),
    [
        ("demo", "--outp=x"),
        ("falsify", "--work=1"),
        ("faults", "--work=1"),
        ("reproduce", "--out=x"),
        ("synthesize", "--thrust-max-=1.4"),
    ],
)
def test_no_option_can_be_abbreviated(program: str, abbreviated: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert PROGRAMS[program]([abbreviated]) == 2
    (option,) = re.findall(
        rf"unrecognized arguments: {abbreviated}; the nearest is (.*); see --help\n", refusal(capsys)
    )
    assert option.startswith("--")


def test_an_option_that_no_name_is_near_to_is_refused_without_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert PROGRAMS["demo"](["--xyzzy"]) == 2
    assert refusal(capsys) == "unrecognized arguments: --xyzzy; see --help\n"


@pytest.mark.parametrize("program", ["demo", "faults", "reproduce", "synthesize"])
def test_the_home_folder_of_nobody_is_refused(
    program: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert PROGRAMS[program](["--output", "~no such user/x"]) == 2
    assert "path = '~no such user/x': must be a path whose home folder exists" in refusal(capsys)
    assert list(tmp_path.iterdir()) == []


def test_a_home_folder_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert shell.path("~/x") == tmp_path / "x"


@pytest.mark.parametrize("program", ["demo", "faults", "reproduce"])
@pytest.mark.parametrize("taken", ["file", "file/below", "/dev/null/below", "/proc/below"])
def test_a_folder_that_cannot_be_made_is_refused_before_anything_is_computed(
    program: str, taken: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    extra = ["--headless"] if program == "demo" else []
    assert PROGRAMS[program](["--output", taken, *extra]) == 2
    assert refusal(capsys).startswith(taken)
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("program", "file"), [("demo", "summary.json"), ("faults", "table.json"), ("reproduce", "table.json")]
)
def test_a_file_that_cannot_be_written_is_refused_before_anything_is_computed(
    program: str, file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / file).mkdir()
    extra = ["--headless"] if program == "demo" else []
    assert PROGRAMS[program](["--output", str(tmp_path), *extra]) == 2
    assert refusal(capsys) == f"{tmp_path / file}: cannot be written: it is a folder, must be a file\n"
    assert list((tmp_path / file).iterdir()) == []


@pytest.mark.parametrize(
    ("program", "arguments", "ignored"),
    [
        ("falsify", ["--replay", "hold:1:1", "--runs", "1000000"], "--runs"),
        ("falsify", ["--replay", "hold:1:1", "--seed", "0", "--campaign", "hold"], "--campaign, --seed"),
        ("falsify", ["--replay", "hold:1:1", "--workers", "2", "--seconds", "9"], "--seconds, --workers"),
        ("faults", ["--replay", "y_up:hover", "--workers", "2", "--output", "x"], "--output, --workers"),
        ("faults", ["--live", "--phase", "hover", "--workers", "2"], "--phase, --workers"),
        ("synthesize", ["--verify", "x.yaml", "--paper", "all"], "--paper"),
        ("synthesize", ["--verify", "x.yaml", "--force", "--plot", "x.png"], "--force, --plot"),
        ("synthesize", ["--paper", "all", "--cover", "1,1,1", "--output", "x.yaml"], "--cover, --output"),
    ],
)
def test_an_option_that_another_would_ignore_is_refused_by_name(
    program: str, arguments: list[str], ignored: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert PROGRAMS[program](arguments) == 2
    assert refusal(capsys) == f"{ignored}: not used with {arguments[0]}; drop one or the other\n"


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (FlatsatError("this is\n  too large"), "this is too large"),
        (FileNotFoundError(2, "No such file or directory", "x/y"), "x/y: No such file or directory"),
        (OSError(28, "No space left on device"), "[Errno 28] No space left on device"),
        (ModuleNotFoundError("No module named 'rosbags'"), "No module named 'rosbags'"),
    ],
)
def test_what_the_user_can_mend_is_one_line_and_exit_code_2(
    error: Exception, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(raising(error)) == 2
    assert refusal(capsys) == f"{line}\n"


def test_a_defect_of_ours_is_not_hidden() -> None:
    with pytest.raises(ValueError, match="shape"):
        run(raising(ValueError("shape")))


@pytest.mark.parametrize("number", STOPPING)
def test_a_signal_stops_the_work_and_the_handlers_are_what_they_were(
    number: signal.Signals, capsys: pytest.CaptureFixture[str]
) -> None:
    before = [signal.getsignal(stopping) for stopping in STOPPING]

    def work(_: argparse.Namespace) -> int:
        signal.raise_signal(number)
        pytest.fail("the work went on")

    assert run(work) == 128 + number
    assert capsys.readouterr().err == "stopped\n"
    assert [signal.getsignal(stopping) for stopping in STOPPING] == before


def test_a_signal_that_an_import_turns_into_an_error_stops_all_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    def work(_: argparse.Namespace) -> int:
        try:
            signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt as error:
            raise ImportError("initialization failed") from error
        return 0

    assert run(work) == 128 + signal.SIGTERM
    assert capsys.readouterr().err == "stopped\n"


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert run(lambda _: signal.raise_signal(signal.SIGHUP) or 0) == 0
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_signals_that_are_held_come_where_they_are_delivered_and_at_the_end() -> None:
    came: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: came.append(number))
    try:
        with signals_held() as deliver:
            signal.raise_signal(signal.SIGTERM)
            assert came == []
            deliver()
            deliver()
            assert came == [signal.SIGTERM]
            signal.raise_signal(signal.SIGTERM)
        assert came == [signal.SIGTERM] * 2
        signal.raise_signal(signal.SIGTERM)
        assert came == [signal.SIGTERM] * 3
    finally:
        signal.signal(signal.SIGTERM, before)


def test_a_signal_without_a_handler_is_not_held() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    try:
        with signals_held():
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("plan way.csv --verify p.yaml", "FILE: not used with --verify; drop one or the other"),
        ("falsify cf21_50hz --campaign hold", "--campaign: not used with CERTIFICATE; drop one or the other"),
    ],
)
def test_what_has_no_name_on_the_command_line_is_called_as_in_its_help(
    line: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    program, *arguments = line.split()
    assert PROGRAMS[program](arguments) == 2
    assert refusal(capsys) == f"{text}\n"


@pytest.mark.parametrize("program", ["falsify", "falsify --mutants 1", "synthesize --verify"])
def test_what_is_wrong_in_a_file_is_said_with_its_path(
    program: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, (name, *options) = tmp_path / "empty.yaml", program.split()
    file.write_text("", encoding="utf-8")
    assert PROGRAMS[name]([*options, str(file)]) == 2
    assert refusal(capsys).startswith(f"{file}: the certificate = None: must be a mapping")


@pytest.mark.parametrize("bag", ["loop.mcap", "/"])
def test_a_bag_that_is_no_place_for_a_report_is_refused(
    bag: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loop.mcap").symlink_to("loop.mcap")
    assert PROGRAMS["report"]([bag]) == 2
    assert f"{bag}: cannot be read: " in refusal(capsys)


@pytest.mark.parametrize(
    ("line", "text"),
    [
        (
            "plan way.csv --output way.csv --force",
            "--output = 'way.csv': must be another file than FILE, which it would replace",
        ),
        ("plan way.csv --output ./way.csv --force", "must be another file than FILE"),
        ("plan way.csv --output link.csv --force", "must be another file than FILE"),
        (
            "synthesize --thrust-max 14 --output a.png --plot a.png",
            "--plot = 'a.png': must be another file than --output",
        ),
        (
            "synthesize --flight --vehicle cf21 --assume way.csv --output way.csv --force",
            "must be another file than --assume",
        ),
        (
            "validate way.csv --certificate a --vehicle b.yaml --write b.yaml --force",
            "must be another file than --vehicle",
        ),
    ],
)
def test_nothing_is_written_over_what_is_read_or_written_besides(
    line: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("way.csv", "way.yaml"):
        Path(name).write_text("x,y,z\n0,0,1\n1,0,1\n", encoding="utf-8")
    Path("link.csv").symlink_to("way.csv")
    program, *arguments = line.split()
    assert PROGRAMS[program](arguments) == 2
    assert text in refusal(capsys)
    assert Path("way.csv").read_text(encoding="utf-8").startswith("x,y,z")


@pytest.mark.parametrize(
    "line",
    [
        "plan way.csv --certificate=",
        "falsify --plans p.yaml --certificate=",
        "faults --fault y_up --certificate=",
        "synthesize --flight --vehicle cf21 --assume=",
        "synthesize --thrust-max 14 --name=",
    ],
)
def test_an_empty_name_does_not_stand_for_the_usual_one(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    """As where a variable of the shell that should hold it is not set."""
    program, *arguments = line.split()
    assert PROGRAMS[program](arguments) == 2
    assert "''" in refusal(capsys)


@pytest.mark.parametrize("place", ["-1,0,1", "-.5,0,1", "-1e-1,-0.5,1"])
def test_lists_of_numbers_may_begin_with_a_negative_one(
    place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert PROGRAMS["excitation"](["--output", str(tmp_path / "e.yaml"), "--at", place]) == 0
    assert "written to" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("excitation --output e.yaml --at 0,0", "argument --at: '0,0': must be X,Y,Z, three numbers within 500 m"),
        ("excitation --output e.yaml --at nan,0,1", "argument --at: 'nan,0,1': must be X,Y,Z"),
        ("excitation --output e.yaml --at 1e9,0,1", "argument --at: '1e9,0,1': must be X,Y,Z"),
        ("synthesize --flight --vehicle cf21 --seconds nan", "--seconds = nan s: must be a number above 0"),
        ("synthesize --flight --vehicle cf21 --seconds 0", "--seconds = 0.0 s: must be a number above 0"),
        ("falsify --workers 100000", "--workers = 100000: must be from 1 to 512"),
        ("faults --workers 100000", "--workers = 100000: must be from 1 to 512"),
        ("reproduce --output taken", "taken: cannot be written: it is a file, must be a folder"),
        ("reproduce --output dangling", "dangling: cannot be written: it is a link to nothing, must be a folder"),
    ],
)
def test_a_value_that_cannot_be_used_is_refused_before_work_begins(
    line: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("taken").touch()
    Path("dangling").symlink_to("nothing")
    program, *arguments = line.split()
    assert PROGRAMS[program](arguments) == 2
    assert text in refusal(capsys)


@pytest.mark.parametrize("wind", ["nan", "100", "-1"])
def test_a_wind_that_is_too_much_is_refused_before_a_plan_is_made(
    wind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert PROGRAMS["demo"](["--headless", "--robots", "2", "--wind", wind, "--output", str(tmp_path)]) == 2
    assert refusal(capsys).startswith(f"--wind = {float(wind)} m/s: must be from 0 to 1.096 m/s")

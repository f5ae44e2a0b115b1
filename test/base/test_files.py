"""Files are read whole, bounded and in one encoding, or refused in one line; they are written in one step, or not."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.files import check_writable, make_folder, read_text, replacing, user_path, write_text
from flatsat_ros.base.resources import config_path


def refusal(path: Path | str, bytes_max: int = 100) -> str:
    with pytest.raises(FlatsatError) as refused:
        read_text(path, bytes_max)
    assert "\n" not in str(refused.value)
    return str(refused.value)


def test_a_text_comes_back_as_it_was_written(tmp_path: Path) -> None:
    write_text(tmp_path / "text", "gr\xfc\xdfe \U0001f681\n")
    assert read_text(tmp_path / "text", 100) == "gr\xfc\xdfe \U0001f681\n"
    assert (tmp_path / "text").stat().st_mode & 0o777 == 0o644


def test_what_is_no_regular_file_is_refused_without_being_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")  # to open it would wait for a writer for ever
    (tmp_path / "link").symlink_to("pipe")
    (tmp_path / "loop").symlink_to("loop")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "socket"))
        for name in ("pipe", "link", "socket", "/dev/zero", "/dev/full"):
            assert "cannot be read: it is a device, pipe or socket, must be a regular file" in refusal(tmp_path / name)
    assert "it is a folder, must be a regular file" in refusal(tmp_path)
    assert "cannot be read: Too many levels of symbolic links" in refusal(tmp_path / "loop")
    assert refusal(tmp_path / "none") == f"{tmp_path}/none: cannot be read: No such file or directory"


def test_one_byte_more_than_the_bound_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "text"
    path.write_bytes(b"x" * 100)
    assert len(read_text(path, 100)) == 100
    path.write_bytes(b"x" * 101)
    assert "it has more than 100 bytes, the most that is read" in refusal(path)
    with path.open("wb") as stream:
        stream.truncate(100_000_000)
    assert "it has more than 100 bytes, the most that is read" in refusal(path)
    # what claims to be empty and never ends
    assert "it has more than 100 bytes" in refusal("/proc/self/smaps")


def test_what_is_not_utf_8_and_what_is_closed_to_us_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "latin"
    path.write_bytes("gr\xfc\xdfe".encode("latin-1"))
    assert "cannot be read: 'utf-8' codec can't decode byte 0xfc in position 2" in refusal(path)

    def closed(*arguments: object) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "open", closed)  # root may read everything
    assert refusal(path) == f"{path}: cannot be read: Permission denied"


@pytest.mark.parametrize("name", ["a\nb", "\x1b[31m", "x" * 5000, "nul\0", "\udcff\0", ""])
def test_a_path_that_is_none_is_refused_in_one_line_too(name: str, tmp_path: Path) -> None:
    assert len(refusal(tmp_path / name if name else "")) < 700
    with pytest.raises(FlatsatError, match="cannot be written: "):
        write_text(tmp_path / name / "missing" / "file", "")


def test_the_home_folder_of_nobody_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert user_path("~/x.yaml") == tmp_path / "x.yaml"
    assert user_path("./x~") == Path("x~")
    for text in ("~who_is_that/x.yaml", "", "a\0b"):
        with pytest.raises(FlatsatError, match=r"path = .*: must be "):
            user_path(text)


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "text"
    write_text(path, "old")

    def fail(*arguments: object, **options: object) -> None:
        raise OSError(28, "No space left on device", "/tmp/other")

    for owner, name in ((Path, "replace"), (Path, "chmod"), (os, "fsync")):
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, fail)
            with pytest.raises(FlatsatError) as refused:
                write_text(path, "new")
        assert str(refused.value) == f"{path}: cannot be written: No space left on device"
    with pytest.raises(FlatsatError, match="cannot be written: 'utf-8' codec can't encode"):
        write_text(path, "\udcff")
    assert path.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_is_made_once_and_refused_where_it_cannot_be(tmp_path: Path) -> None:
    assert make_folder(make_folder(tmp_path / "a" / "b")) == tmp_path / "a" / "b"
    write_text(tmp_path / "file", "")
    for path in (tmp_path / "file", tmp_path / "file" / "below", "/proc/nothing", "nul\0"):
        with pytest.raises(FlatsatError, match=r".*: cannot be written: ."):
            make_folder(path)


def test_what_cannot_be_written_is_known_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check_writable(tmp_path / "file")
    assert list(tmp_path.iterdir()) == []
    write_text(tmp_path / "file", "")
    check_writable(tmp_path / "file")
    with pytest.raises(FlatsatError, match=r"missing/x: cannot be written: the folder .*missing does not exist"):
        check_writable(tmp_path / "missing" / "x")
    with pytest.raises(FlatsatError, match=r"cannot be written: it is a folder, must be a file"):
        check_writable(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    for special in (tmp_path / "pipe", Path("/dev/null")):
        with pytest.raises(FlatsatError, match=r"cannot be written: it is a device, pipe or socket, must be a regular"):
            check_writable(special)
    with pytest.raises(FlatsatError, match=r"pipe: cannot be written: it is a device"):
        write_text(tmp_path / "pipe", "")
    assert (tmp_path / "pipe").is_fifo()
    for forbidden in (tmp_path, tmp_path / "file"):  # root may write everywhere
        monkeypatch.setattr(os, "access", lambda path, mode, forbidden=forbidden: Path(path) != forbidden)
        with pytest.raises(FlatsatError, match="file: cannot be written: it is protected"):
            check_writable(tmp_path / "file")


def test_what_is_written_keeps_its_ending_and_an_error_of_the_writer(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    with replacing(path) as file:
        assert (file.parent, file.suffix) == (tmp_path, ".png")
        file.write_bytes(b"new")
    assert path.read_bytes() == b"new"
    for error in (KeyboardInterrupt, FlatsatError):
        with pytest.raises(error), replacing(path) as file:
            raise error
    with pytest.raises(FlatsatError, match=r"picture.png: cannot be written: no such format"), replacing(path):
        raise ValueError("no such format")
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_configuration_is_found_by_its_name_or_path_and_else_the_refusal_says_what_is_there(tmp_path: Path) -> None:
    (own := tmp_path / "mine.yaml").write_text("a: 1\n")
    assert config_path(own) == own
    assert config_path("cf21", "vehicles").name == "cf21.yaml"
    with pytest.raises(
        FlatsatError, match=r"no packaged configuration 'cf21_plsu'; the nearest is cf21_plus; .*: brush"
    ):
        config_path("cf21_plsu", "vehicles")
    with pytest.raises(
        FlatsatError, match=rf"{tmp_path}/none.yaml: cannot be read: No such file or directory; .*: brush"
    ):
        config_path(tmp_path / "none.yaml")
    os.mkfifo(pipe := tmp_path / "pipe.yaml")
    for path, reason in ((pipe, "it is a device, pipe or socket"), (tmp_path, "it is a folder")):
        with pytest.raises(FlatsatError, match=rf"^{path}: cannot be read: {reason}, must be a regular file$"):
            config_path(path)
    with pytest.raises(FlatsatError, match=r"^path = '~no_such_user/x.yaml': must be a path whose home folder exists$"):
        config_path("~no_such_user/x.yaml")

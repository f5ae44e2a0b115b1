"""Contents that were verified: proved once, and again when content or proof is another."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.strict_yaml import read_yaml, write_yaml
from flatsat_ros.certificate import verified
from flatsat_ros.certificate.certificate import Certificate

FLYING = Path(__file__).parents[2] / "config" / "cf21_flight_50hz.yaml"


@pytest.fixture
def proofs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the certificates that were proved, with a cache of their own and a proof that takes no time."""
    proved: list[str] = []
    verify = Certificate.verify

    def count(certificate: Certificate) -> dict[str, float]:
        proved.append(certificate.name)
        if certificate.gain_max > 4.0:
            raise FlatsatError("gain_max")
        return {} if certificate.flight is not None else verify(certificate)

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(Certificate, "verify", count)
    return proved


def changed(tmp_path: Path, **sampling: Any) -> Path:
    document = read_yaml(FLYING)
    document["sampling"].update(sampling)
    write_yaml(tmp_path / "other.yaml", document)
    return tmp_path / "other.yaml"


def test_a_content_is_proved_once(proofs: list[str], tmp_path: Path) -> None:
    for _ in range(3):
        assert Certificate.load(FLYING).flight is not None
    assert len(proofs) == 1
    Certificate.load(changed(tmp_path))  # the same content without its comments
    assert len(proofs) == 1
    Certificate.load(changed(tmp_path, gain_max=3.9))
    assert len(proofs) == 2


def test_what_is_refused_is_not_remembered(proofs: list[str], tmp_path: Path) -> None:
    for _ in range(2):
        with pytest.raises(FlatsatError):
            Certificate.load(changed(tmp_path, gain_max=4.1))
    assert len(proofs) == 2


def test_another_proof_proves_again(proofs: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    Certificate.load(FLYING)
    monkeypatch.setattr(verified, "_checker", lambda: b"another")
    Certificate.load(FLYING)
    assert len(proofs) == 2


@pytest.mark.parametrize("folder", ["/proc/no/such", "relative"])
def test_without_a_folder_to_write_to_it_is_proved_at_every_start(
    proofs: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", folder)
    monkeypatch.setenv("HOME", "/proc/no/such")
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        Certificate.load(FLYING)
    assert len(proofs) == 2
    assert list(tmp_path.iterdir()) == []

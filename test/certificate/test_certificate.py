"""The certificate: round trip, and everything that must not get past load."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.closed_form import closed_form_certificate
from flatsat_ros.law.input_set import InputSet


def make(thrust: float = 1.45, tilt: float = math.pi / 18, rate: float = 1.25, period: float = 0.1) -> Certificate:
    """The closed form, as synthesis fills it in."""
    limits = InputSet(thrust * GRAVITY, tilt)
    provenance = {"source": "a test: with a colon", "residuals": {"Q": 1.0e-8}}
    return replace(closed_form_certificate(limits, rate, period, "test"), provenance=provenance)


VALID = make()

Change = Callable[[dict[str, Any]], object]


def broken(change: Change) -> dict[str, Any]:
    """The valid document after a change."""
    document = copy.deepcopy(VALID.to_document())
    change(document)
    return document


@settings(max_examples=25)
@given(
    thrust=st.floats(1.01, 3.0),
    tilt=st.floats(0.02, 1.5),
    rate=st.floats(0.1, 10.0),
    hold=st.floats(0.01, 1.5),
)
def test_what_is_saved_comes_back_to_the_last_bit(
    tmp_path_factory: pytest.TempPathFactory, thrust: float, tilt: float, rate: float, hold: float
) -> None:
    path = tmp_path_factory.mktemp("round") / "trip.yaml"
    certificate = make(thrust, tilt, rate, hold / rate)
    certificate.save(path)
    assert Certificate.load(path).to_document() == certificate.to_document()
    assert Certificate.load(path).limits == certificate.limits


def test_the_file_is_for_people(tmp_path: Path) -> None:
    path = tmp_path / "certificate.yaml"
    VALID.save(path)
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# A flatsat_ros certificate.")
    assert "limits: {thrust_max: 14.2245, tilt_max: 0.17453292519943295, gravity: 9.81, thrust_min: 0.0}" in text
    assert path.stat().st_mode & 0o777 == 0o644


def test_all_margins_hold_and_the_tight_ones_are_tight() -> None:
    margins = VALID.verify()
    assert set(margins) == set(VALID.margins())
    tight = [name for name, margin in margins.items() if abs(margin) < 1e-9]
    assert len(tight) == 5
    assert min(margins.values()) >= 0.0


def test_p_acts_on_the_stacked_state() -> None:
    xi = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    by_axis = sum(xi[[i, i + 3]] @ VALID.block @ xi[[i, i + 3]] for i in range(3))
    assert xi @ VALID.matrix @ xi == pytest.approx(by_axis)


@pytest.mark.parametrize(
    ("changes", "inequality"),
    [
        ({"block": [[1.0, 2.0], [2.0, 1.0]]}, "P is positive definite"),
        ({"block": [[0.0, 0.0], [0.0, 1.0]]}, "P is positive definite"),
        ({"rate": 1.2501}, "A'P + P A - 2 P B B'P + alpha P <= 0"),
        ({"ball": VALID.ball * 1.0001}, "the ball |v|^2 <= rho lies in the input set"),
        ({"limits": InputSet(1.45 * GRAVITY, 0.1745)}, "the ball |v|^2 <= rho lies in the input set"),
        ({"limits": InputSet(1.1 * GRAVITY, 0.2)}, "the ball |v|^2 <= rho lies in the input set"),
        ({"level": VALID.level * 1.0001}, "V <= eps implies |B'P xi|^2 <= rho"),
        ({"gain_min": 1.01}, "gain_min <= 1"),
        ({"gain_max": 0.99}, "1 <= gain_max"),
        ({"gain_min": VALID.gain_min * 0.999}, "V does not grow during a period at gain_min"),
        ({"gain_max": VALID.gain_max * 1.001}, "V does not grow during a period at gain_max"),
        ({"period": 0.101}, "V does not grow during a period at gain_min"),
    ],
)
def test_an_inequality_that_fails_is_named_with_its_amount(
    changes: dict[str, Any], inequality: str, tmp_path: Path
) -> None:
    certificate = dataclasses.replace(VALID, **changes)
    with pytest.raises(FlatsatError) as refused:
        certificate.verify()
    assert f"'{inequality}' fails by " in str(refused.value)
    with pytest.raises(FlatsatError):
        certificate.save(tmp_path / "never.yaml")
    assert list(tmp_path.iterdir()) == []


def test_the_amount_is_by_how_much_it_fails() -> None:
    with pytest.raises(FlatsatError, match=r"fails by 0\.25 \(relative\)"):
        dataclasses.replace(VALID, level=VALID.level * 1.25).verify()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda d: d.update(flatsat_certificate=3), "flatsat_certificate = 3: must be 1 or 2, what this version reads"),
        (lambda d: d.update(flatsat_certificate=True), "flatsat_certificate = True"),
        (lambda d: d.update(name=""), "name = ''"),
        (lambda d: d.update(name=7), "name = 7"),
        (lambda d: d.update(provenance=None), "provenance = None: must be a mapping"),
        (lambda d: d.update(extra=1), "the certificate: unknown key 'extra'"),
        (lambda d: d.pop("sampling"), "the certificate: key 'sampling' is missing"),
        (lambda d: d.update(limits=[1, 2]), "limits = [1, 2]: must be a mapping with the keys thrust_max"),
        (lambda d: d["limits"].update(tilt=1), "limits: unknown key 'tilt'; valid keys are thrust_max, tilt_max"),
        (lambda d: d["lyapunov"].pop("rate"), "lyapunov: key 'rate' is missing"),
        (lambda d: d["invariant_set"].update(radius=1), "invariant_set: unknown key 'radius'"),
        (lambda d: d["sampling"].pop("gain_max"), "sampling: key 'gain_max' is missing"),
        (lambda d: d["limits"].update(thrust_max=9.0), "cannot hover"),
        (lambda d: d["limits"].update(tilt_max="1e-1"), "tilt_max = '1e-1'"),
        (lambda d: d["lyapunov"].update(rate="1e-5"), "rate = '1e-5'"),
        (lambda d: d["lyapunov"].update(rate=-1.25), "rate = -1.25 1/s: must be a number above 0, from 1e-12 to 1e+12"),
        (lambda d: d["lyapunov"].update(rate=True), "rate = True"),
        (lambda d: d["invariant_set"].update(ball=-1.0), "ball = -1.0"),
        (lambda d: d["invariant_set"].update(level=None), "level = None"),
        (lambda d: d["invariant_set"].update(level=math.nan), "level = nan"),
        (lambda d: d["sampling"].update(period=0.0), "period = 0.0 s"),
        (lambda d: d["sampling"].update(gain_max=math.inf), "gain_max = inf"),
        (lambda d: d["sampling"].update(gain_min=[0.5]), "gain_min = [0.5]"),
        (
            lambda d: d["lyapunov"].update(block=[[1.0, 0.5, 0.5, 1.0]]),
            "shape of lyapunov.block = (1, 4): must be (2, 2)",
        ),
        (lambda d: d["lyapunov"].update(block=[[1.0], [0.5, 1.0]]), "must be an array of numbers"),
        (lambda d: d["lyapunov"].update(block=[["1e-5", "2"], ["2", "1e-5"]]), "must be an array of numbers"),
        (lambda d: d["lyapunov"].update(block=None), "must be an array of numbers"),
        (lambda d: d["lyapunov"].update(block=[[1.0, 0.5], [0.4, 1.0]]), "asymmetry of lyapunov.block = "),
        (lambda d: d["lyapunov"]["block"][0].__setitem__(0, math.nan), "an entry of lyapunov.block = nan"),
        (
            lambda d: d["lyapunov"]["block"][0].__setitem__(0, -1.0),
            "difference of lyapunov.matrix from that of its blocks = ",
        ),
        (lambda d: d["lyapunov"]["matrix"].pop(), "shape of lyapunov.matrix = (5, 6)"),
        (lambda d: d["lyapunov"]["matrix"][2].__setitem__(5, 0.1), "asymmetry of lyapunov.matrix = "),
        (lambda d: d["lyapunov"]["matrix"][1].__setitem__(1, 1.0), "that of its blocks = 0.0234375: must be 0"),
    ],
)
def test_a_document_that_is_not_exactly_a_certificate_is_refused(change: Change, text: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(yaml.safe_dump(broken(change)), encoding="utf-8")
    with pytest.raises(FlatsatError) as refused:
        Certificate.load(path)
    assert text in str(refused.value)
    assert str(path) in str(refused.value)


def test_an_unverified_document_can_be_built_but_not_loaded(tmp_path: Path) -> None:
    document = broken(lambda d: d["invariant_set"].update(level=9.0))
    Certificate.from_document(document)
    path = tmp_path / "bold.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    with pytest.raises(FlatsatError, match=r"V <= eps implies .* fails by"):
        Certificate.load(path)


FIGURES = [
    *(("limits", key) for key in ("thrust_max", "tilt_max", "gravity", "thrust_min")),
    *(("invariant_set", key) for key in ("ball", "level")),
    *(("sampling", key) for key in ("period", "gain_min", "gain_max", "lag", "delay")),
    ("lyapunov", "rate"),
]
MAGNITUDES = st.builds(
    lambda sign, power, digits: sign * digits * 10.0**power,
    st.sampled_from((1.0, -1.0)), st.integers(-323, 307), st.floats(1.0, 9.9),
)  # fmt: skip


@settings(max_examples=200)
@given(figures=st.dictionaries(st.sampled_from(FIGURES), MAGNITUDES, max_size=3), block=st.tuples(*[MAGNITUDES] * 3))
def test_no_figures_however_absurd_break_the_verification(
    figures: dict[tuple[str, str], float], block: tuple[float, float, float]
) -> None:
    document = copy.deepcopy(VALID.to_document())
    for (section, key), value in figures.items():
        document[section][key] = value
    if max(map(abs, block)) < 1e12:
        a, b, c = block
        document["lyapunov"]["block"] = [[a, b], [b, c]]
        document["lyapunov"]["matrix"] = np.kron([[a, b], [b, c]], np.eye(3)).tolist()
    with contextlib.suppress(FlatsatError):
        assert min(Certificate.from_document(document).verify().values()) >= 0.0


@pytest.mark.parametrize(
    "block",
    [
        [[0.0, 0.0], [0.0, 0.0]],
        [[1.0, 1.0], [1.0, 1.0]],
        [[1.0, 0.0], [0.0, 1e-13]],
        [[1e12, 1e6], [1e6, 1.0]],
    ],
)
def test_a_matrix_of_which_rounding_would_decide_is_not_positive_definite(block: list[list[float]]) -> None:
    with pytest.raises(FlatsatError, match="'P is positive definite' fails by"):
        dataclasses.replace(VALID, block=block).verify()


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("saved") / "saved.yaml"
    VALID.save(path)
    return path.read_bytes()


@given(share=st.floats(0.0, 1.0))
def test_of_a_torn_file_everything_proved_is_intact_or_it_is_refused(
    tmp_path_factory: pytest.TempPathFactory, saved: bytes, share: float
) -> None:
    path, content = tmp_path_factory.mktemp("torn") / "torn.yaml", saved
    path.write_bytes(content[: int(share * len(content))])
    try:
        document = Certificate.load(path).to_document()
    except FlatsatError:
        return
    assert document | {"provenance": None} == VALID.to_document() | {"provenance": None}


@pytest.mark.parametrize(
    "content", [b"", b"[]", b"\xff\xfe", b"{", b"\x00", b"just text", b"a: !!python/object:os.x {}"]
)
def test_other_files_are_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "other.yaml"
    path.write_bytes(content)
    with pytest.raises(FlatsatError):
        Certificate.load(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "missing.yaml", tmp_path):
        with pytest.raises(FlatsatError, match="cannot be read"):
            Certificate.load(path)
    with pytest.raises(FlatsatError, match="cannot be written"):
        VALID.save(tmp_path / "missing" / "certificate.yaml")


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "certificate.yaml"
    VALID.save(path)
    before = path.read_bytes()

    def fail(*arguments: object, **options: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(FlatsatError, match="cannot be written: disk full"):
        make(rate=1.2).save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(FlatsatError, match="cannot be written"):
        dataclasses.replace(VALID, provenance={"solver": object()}).save(path)
    assert path.read_bytes() == before


def test_a_certificate_does_not_change() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        VALID.level = 9.0  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        VALID.block[0, 0] = 9.0


def test_however_short_a_period_is_growth_does_not_pass_for_rounding() -> None:
    """With a gain of nearly 0 V grows by less than any rounding in so short a period, and without end."""
    with pytest.raises(FlatsatError, match="'V does not grow during a period at gain_min' fails by"):
        replace(VALID, period=1e-10, gain_min=1e-9).verify()

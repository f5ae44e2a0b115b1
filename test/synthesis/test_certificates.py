"""Certificates as synthesis makes them: proved again in rational arithmetic, and refused once they are wrong."""

from __future__ import annotations

import dataclasses
import importlib.util
import math
import re
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.cli.synthesize import main
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.synthesis.flight_design import read_designs
from flatsat_ros.synthesis.gain_cap import worst_case
from flatsat_ros.synthesis.nominal import synthesize
from flatsat_ros.synthesis.robust_design import synthesize_paper_robust, synthesize_robust
from flatsat_ros.synthesis.rounding import DIGITS

_SPEC = importlib.util.spec_from_file_location("exact", Path(__file__).parent / "exact.py")
assert _SPEC is not None
assert _SPEC.loader is not None
exact = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(exact)

ROOT = Path(__file__).parents[2]
LIMITS = InputSet(1.45 * GRAVITY, math.radians(10.0))
FLYING = read_designs(ROOT / "config" / "designs" / "flight.yaml")
SHIPPED = sorted({path.stem for path in (ROOT / "config").glob("*.yaml")} - set(FLYING))

# Within this a certificate comes out again, relatively; an entry of W relative to the root of the diagonal's product.
AGREEMENT = 1e-7
# The share p of a robust certificate is free to choose, and has four digits.
SHARE_AGREEMENT = 1e-3
LAGGING = synthesize(LIMITS, 1.25, 0.1, "lagging", lag=0.1, delay=0.05)
FAST = synthesize(LIMITS, 1.25, 0.02, "fast", lag=0.14, delay=0.03, lowest=0.8)
ROBUST = synthesize_paper_robust()
PUSHED = synthesize_robust(LIMITS, (0.1, 0.2), (0.2, 0.3), 0.02, "pushed")


@pytest.fixture(scope="module")
def regenerated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that `make certificates` would fill."""
    folder = tmp_path_factory.mktemp("config")
    (options,) = re.findall(r"^CF21 := (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert main(["--paper", "all", "--output-dir", str(folder)]) == 0
    assert main([*options.split(), "--output", str(folder / "cf21_50hz.yaml")]) == 0
    return folder


def leaves(document: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every number, string and matrix of a document with its place."""
    if isinstance(document, dict):
        for key, value in document.items():
            yield from leaves(value, f"{path}.{key}")
    else:
        yield path, document


@pytest.mark.parametrize("name", SHIPPED)
def test_what_is_shipped_comes_out_again(name: str, regenerated: Path) -> None:
    assert sorted(path.stem for path in regenerated.glob("*.yaml")) == SHIPPED
    shipped = dict(leaves(Certificate.load(ROOT / "config" / f"{name}.yaml").to_document()))
    again = dict(leaves(Certificate.load(regenerated / f"{name}.yaml").to_document()))
    assert shipped.keys() == again.keys()
    for place, value in again.items():
        if place in (".provenance.solver", ".provenance.package"):
            continue  # other versions may have computed it
        if np.ndim(value) == 2:
            scale = np.sqrt(np.outer(np.diag(value), np.diag(value)))
            assert (np.abs(np.subtract(shipped[place], value)) <= AGREEMENT * scale).all(), place
        elif np.size(value) and isinstance(np.ravel(value)[0], float):
            agreement = SHARE_AGREEMENT if place == ".robust.share" else AGREEMENT
            np.testing.assert_allclose(shipped[place], value, rtol=agreement, err_msg=place)
        else:
            assert shipped[place] == value, place


def test_the_agreement_is_the_documented_one() -> None:
    text = (ROOT / "docs" / "mathematics.md").read_text(encoding="utf-8")
    assert f"agree to {AGREEMENT:.0e}".replace("e-0", "e-") in text
    assert f"p to {SHARE_AGREEMENT:.0e}".replace("e-0", "e-") in text


@pytest.mark.parametrize("name", SHIPPED)
def test_figures_have_the_digits_that_every_processor_agrees_on(name: str) -> None:
    """A figure is a decimal number on the safe side; what is written keeps at least nine digits of it."""
    certificate = Certificate.load(ROOT / "config" / f"{name}.yaml")
    exact_ball = certificate.limits.inner_radius**2
    assert exact_ball * (1.0 - 1e-9) <= certificate.ball <= exact_ball
    exact_level = certificate.ball / max(float(block[1, 1]) for block in certificate.blocks)
    assert exact_level * (1.0 - 1e-9) <= certificate.level <= exact_level
    figures = [certificate.ball, certificate.level, certificate.gain_min, certificate.gain_max]
    if certificate.robust is not None:
        figures += [certificate.robust.rate, certificate.robust.floor, *certificate.robust.box]
    for figure in figures:
        assert figure == float(f"{figure:.{DIGITS - 1}e}")


@pytest.mark.parametrize("name", SHIPPED)
def test_what_is_shipped_holds_in_rational_arithmetic(name: str) -> None:
    results = exact.proved(Certificate.load(ROOT / "config" / f"{name}.yaml"))
    assert len(results) >= 14
    assert [claim for claim, holds in results.items() if not holds] == []


def test_three_certificates_of_the_paper_are_shipped() -> None:
    assert {"paper_experiment", "paper_simulation", "paper_robust"} <= set(SHIPPED)


@pytest.mark.parametrize("certificate", [LAGGING, FAST, PUSHED], ids=lambda certificate: certificate.name)
def test_what_synthesis_makes_holds_in_rational_arithmetic(certificate: Certificate) -> None:
    assert [claim for claim, holds in exact.proved(certificate).items() if not holds] == []


WRONG = [
    (ROBUST, {"level": ROBUST.level * 1.05}),
    (ROBUST, {"gain_max": ROBUST.gain_max * 1.01}),
    (ROBUST, {"gain_min": 0.95}),
    (ROBUST, {"rate": ROBUST.rate * 1.001}),
    (ROBUST, {"block": ROBUST.block * 1.001}),
    (ROBUST, {"block_vertical": ROBUST.block_vertical * 20.0}),
    (ROBUST, {"robust": dataclasses.replace(ROBUST.robust, drift=[1.42, 0.0])}),
    (ROBUST, {"robust": dataclasses.replace(ROBUST.robust, drift=[math.sqrt(2.0), 2.0])}),
    (ROBUST, {"robust": dataclasses.replace(ROBUST.robust, push=[0.1, 0.0])}),
    (ROBUST, {"robust": dataclasses.replace(ROBUST.robust, rate=0.967)}),
    (ROBUST, {"robust": dataclasses.replace(ROBUST.robust, box=[3.9, 3.27])}),
    (ROBUST, {"robust": dataclasses.replace(ROBUST.robust, box=[3.87, 3.27])}),
    (ROBUST, {"robust": dataclasses.replace(ROBUST.robust, floor=1.0)}),
    (ROBUST, {"robust": dataclasses.replace(ROBUST.robust, floor=2.7)}),
    (ROBUST, {"robust": dataclasses.replace(ROBUST.robust, share=0.5)}),
    (LAGGING, {"level": LAGGING.level * 1.05}),
    (LAGGING, {"gain_max": 1.3 * worst_case(LAGGING.timing, LAGGING.block, LAGGING.gain_max).constant}),
    (LAGGING, {"gain_max": LAGGING.gain_max * 1.01}),
    (LAGGING, {"gain_min": 0.99}),
    (LAGGING, {"loop": 0.95 * LAGGING.loop}),
    (LAGGING, {"lag": 0.11}),
    (LAGGING, {"delay": 0.06}),
    (LAGGING, {"period": 0.09, "delay": 0.05}),
    (FAST, {"loop_vertical": np.eye(5)}),
]


@pytest.mark.parametrize(("certificate", "changes"), WRONG)
def test_a_wrong_certificate_is_refused_by_both_checks(certificate: Certificate, changes: dict[str, Any]) -> None:
    wrong = dataclasses.replace(certificate, **changes)
    with pytest.raises(FlatsatError, match="fails by"):
        wrong.verify()
    assert not all(exact.proved(wrong).values())


def test_five_percent_more_eps_and_gains_beyond_the_linear_limit_are_refused_without_lag() -> None:
    certificate = synthesize(LIMITS, 1.25, 0.1, "plain")
    limit = worst_case(certificate.timing, certificate.block, certificate.gain_max).constant
    for changes in ({"level": certificate.level * 1.05}, {"gain_max": 1.3 * limit}):
        with pytest.raises(FlatsatError, match="fails by"):
            dataclasses.replace(certificate, **changes).verify()


@pytest.mark.parametrize("certificate", [LAGGING, FAST, ROBUST, PUSHED], ids=lambda certificate: certificate.name)
def test_what_is_saved_comes_back_to_the_last_bit(certificate: Certificate, tmp_path: Path) -> None:
    path = tmp_path / "trip.yaml"
    certificate.save(path)
    assert Certificate.load(path).to_document() == certificate.to_document()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda d: d.update(loop=None), "loop is missing: must be given for lag = 0.1 s and delay = 0.05 s"),
        (lambda d: d["sampling"].update(lag=0.0, delay=0.0), "loop is given, but neither lag nor delay"),
        (lambda d: d["sampling"].update(delay=0.25), "shape of loop = (4, 4): must be (6, 6)"),
        (lambda d: d["sampling"].update(lag=-0.1), "lag (tau) = -0.1 s"),
        (lambda d: d["loop"].update(diagonal=1), "loop: unknown key 'diagonal'"),
        (lambda d: d["loop"].pop("vertical"), "loop: key 'vertical' is missing"),
        (lambda d: d["loop"]["horizontal"].pop(), "shape of loop = (3, 4)"),
        (lambda d: d["loop"].update(vertical=[[1.0]]), "shape of loop_vertical = (1, 1)"),
        (lambda d: d["lyapunov"].update(block_vertical=[[1.0]]), "shape of block_vertical = (1, 1)"),
        (
            lambda d: d["lyapunov"].update(block_vertical=[[1.0, 0.0], [0.0, 1.0]]),
            "that of its blocks = 0.78125: must be 0",
        ),
        (lambda d: d.update(robust={"rate": 1.0}), "robust: key 'drift' is missing"),
        (lambda d: d.pop("robust"), "key 'robust' is missing"),
    ],
)
def test_a_document_that_contradicts_itself_is_refused(
    change: Callable[[dict[str, Any]], object], text: str, tmp_path: Path
) -> None:
    document = yaml.safe_load(yaml.safe_dump(LAGGING.to_document()))
    change(document)
    with pytest.raises(FlatsatError) as refused:
        Certificate.from_document(document)
    assert text in str(refused.value)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"floor": 0.0}, "robust.floor = 0.0"),
        ({"share": 1.0}, "robust.share = 1.0: must be below 1"),
        ({"rate": math.nan}, "robust.rate = nan"),
        ({"drift": [1.0]}, "robust.drift"),
        ({"push": [-1.0, 0.0]}, "an entry of robust.push = -1.0 m/s^2: must be from 0 to 1e+12"),
        ({"box": [math.inf, 1.0]}, "robust.box"),
    ],
)
def test_impossible_robust_values_are_refused(values: dict[str, Any], text: str) -> None:
    with pytest.raises(FlatsatError) as refused:
        dataclasses.replace(ROBUST.robust, **values)
    assert text in str(refused.value)


def test_the_sets_of_a_lagging_loop_start_about_as_far_out_as_those_of_the_ideal_one() -> None:
    ideal = synthesize(LIMITS, 1.25, 0.1, "ideal")
    assert 0.9 < LAGGING.sets.rest_radius / ideal.sets.rest_radius < 1.0
    assert LAGGING.sets.volume_ellipsoid > ideal.sets.volume_ellipsoid
    assert LAGGING.sets.volume_larger / LAGGING.sets.volume_ellipsoid == pytest.approx(5.878997, abs=1e-6)


@pytest.mark.parametrize("certificate", [LAGGING, FAST], ids=lambda certificate: certificate.name)
def test_the_saturated_loop_with_lag_and_delay_never_leaves_its_sets(certificate: Certificate) -> None:
    random, count, timing, sets = np.random.default_rng(3), 500, certificate.timing, certificate.sets
    spread = np.linalg.cholesky(np.linalg.inv(sets.horizontal))
    state = (spread @ random.standard_normal((timing.size, count * 3))).reshape(timing.size, count, 3)
    state = np.moveaxis(state, 0, 1).reshape(count, -1)
    state *= (0.999 / certificate.gain_min / sets.scale_larger(state))[:, np.newaxis]
    for _ in range(200):
        assert sets.classify(state).guaranteed.all()
        before = sets.levels(state)
        v0 = -state[:, :6] @ certificate.matrix[:, 3:]
        gamma = np.minimum(certificate.gain_max, random.uniform(1.0, 2.0 * certificate.gain_max, count))
        k = np.minimum(gamma, 1.0 / certificate.limits.gauge(v0))
        assert (k >= certificate.gain_min).all()
        v = k[:, np.newaxis] * v0
        following = timing.advance(state.reshape(count, timing.size, 3), v).reshape(count, -1)
        np.testing.assert_allclose(following[:, 6:], timing.follow(state[:, 6:], v), rtol=1e-12, atol=1e-12)
        state = following
        for now, then in zip(sets.levels(state), before, strict=True):
            assert (now <= then * (1.0 + 1e-12)).all()


def test_the_exact_check_is_exact() -> None:
    third = Fraction(1, 3)
    assert abs(float(exact.sine(third)) - math.sin(1 / 3)) < 1e-15
    assert abs(float(exact.cosine(Fraction(3, 2))) - math.cos(1.5)) < 1e-15
    assert abs(float(exact.exponential(Fraction(7, 2))) - math.exp(-3.5)) < 1e-15
    for timing in (Timing(0.1, 0.1, 0.05), Timing(0.1, 0.0, 0.23), Timing(0.02, 0.14, 0.04), Timing(0.1)):
        for own, other in zip(exact.transition(timing), timing.transition, strict=True):
            np.testing.assert_allclose(np.array(own, dtype=float), other, rtol=1e-12, atol=1e-15)
    matrix = [[Fraction(2), third], [third, Fraction(1, 18)]]
    assert exact.positive(matrix)
    assert not exact.positive(matrix, strictly=True)  # singular
    matrix[1][1] += Fraction(1, 10**30)
    assert exact.positive(matrix)
    assert exact.product(matrix, exact.inverse(matrix)) == exact.identity(2)

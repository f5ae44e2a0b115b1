"""Certificates that claim a little less or more than one that holds: the checker must accept or refuse each rightly.

A claim has a slack, the amount by which its inequality holds; `synthesize --verify` prints it. So the verdict on three
kinds of mutants is known beforehand. Those that claim less hold, those that claim more by less than the slack hold as
well, and those that claim more by more than the slack must be refused. A tube may also be claimed for other inputs: its
bounds are proportional to all inputs together.
"""

from __future__ import annotations

import copy
import math
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.lyapunov import hold_contraction

KINDS = ("weaker", "within the slack", "beyond the slack")

# A figure of a document: its place, and what is written there.
Figures = dict[tuple[str, ...], Any]
# Returns the changed figures of a claim for a share from 0 to 1.
Change = Callable[[float], Figures]

# Share of the mutants for which a tube is proved again, because their inputs are others.
_PROVED_AGAIN = 0.02

# Claims are changed by relative amounts over so many decades. Smaller changes are within the rounding of a slack.
_DECADES = 11.0
# The relative accuracy of slacks, and of contractions.
_DIGITS, _KNOWN = 1e-13, 1e-9
# Nearly 1: no figure becomes 0.
_INSIDE = 1.0 - 1e-9

_SHOWN = 5


class ClaimChanges(NamedTuple):
    """How a claim is made weaker, stronger within its slack, and stronger by more than that; None: it cannot be."""

    name: str
    weaker: Change | None
    within: Change | None
    beyond: Change | None

    def change(self, kind: int) -> Change | None:
        """Return the change of a kind, an index in `KINDS`."""
        return (self.weaker, self.within, self.beyond)[kind]


@dataclass(frozen=True)
class Mutant:
    """A certificate on which the right verdict is known.

    Attributes:
        claim: the claim that is changed.
        kind: index in `KINDS`.
        figures: the changed figures.
        document: of the mutant.
    """

    claim: str
    kind: int
    figures: Figures
    document: dict[str, Any]

    def misjudged(self) -> str:
        """Verify the mutant; return what is wrong with the verdict, empty if it is right."""
        try:
            Certificate.from_document(self.document).verify()
        except FlatsatError as error:
            return "" if self.kind == 2 else f"refused: {error}"
        return "accepted" if self.kind == 2 else ""


@dataclass
class MutantTally:
    """Verdicts so far: how many mutants of each claim and kind there were, and those that were misjudged."""

    judged: Counter[tuple[str, int]] = field(default_factory=Counter)
    wrong: list[tuple[Mutant, str]] = field(default_factory=list)

    def add(self, mutant: Mutant, misjudged: str) -> None:
        """Count one."""
        self.judged[mutant.claim, mutant.kind] += 1
        if misjudged:
            self.wrong.append((mutant, misjudged))

    def text(self, name: str, seconds: float) -> str:
        """Return the report about the certificate of a name."""
        count = self.judged.total()
        lines = [f"certificate {name!r}: {count} mutants in {seconds:.1f} s, {len(self.wrong)} misjudged"]
        lines.append(f"  {'claim':<34}" + "".join(f"{kind:>18}" for kind in KINDS))
        for claim in sorted({claim for claim, _ in self.judged}):
            lines.append(f"  {claim:<34}" + "".join(f"{self.judged[claim, kind]:>18}" for kind in range(len(KINDS))))
        for mutant, misjudged in self.wrong[:_SHOWN]:
            lines.append(f"MISJUDGED, {KINDS[mutant.kind]}: {mutant.figures}: {misjudged}")
        return "\n".join(lines)


def mutants(certificate: Certificate, seed: int, count: int) -> Iterator[Mutant]:
    """Yield mutants of a certificate that holds, so many of each kind.

    Args:
        certificate: that holds.
        seed: of the random numbers.
        count: of each kind.
    """
    random, document, slacks = np.random.default_rng(seed), certificate.to_document(), certificate.verify()
    claims = _ideal(certificate, slacks)
    others: list[ClaimChanges] = []
    if certificate.flight is not None:
        claims += _flight(document["flight"], slacks)
        others = _assumed(document["flight"]["assumptions"], slacks)
    for number in range(len(KINDS) * count):
        kind = number % len(KINDS)
        pool = others if others and random.random() < _PROVED_AGAIN else claims
        able = [(claim.name, change) for claim in pool if (change := claim.change(kind)) is not None]
        name, change = able[int(random.integers(len(able)))]
        share = 10.0 ** random.uniform(-_DECADES, 0.0)
        figures = change(1.0 - share if kind == 1 and random.random() < 0.5 else share)
        yield Mutant(name, kind, figures, _changed(document, figures))


def judged(certificate: Certificate, seed: int, count: int) -> Generator[tuple[Mutant, str]]:
    """Yield mutants, with what is wrong with their verdicts; the arguments are those of `mutants`."""
    for mutant in mutants(certificate, seed, count):
        yield mutant, mutant.misjudged()


def _changed(document: Mapping[str, Any], figures: Figures) -> dict[str, Any]:
    """Return a document with other figures."""
    other = copy.deepcopy(dict(document))
    for place, value in figures.items():
        part: Any = other
        for key in place[:-1]:
            part = part[key]
        part[place[-1]] = value
    return other


def _slack(slacks: Mapping[str, float], *texts: str) -> float:
    """Return the smallest slack of the inequalities with one of these texts in their names."""
    return min(slack for name, slack in slacks.items() if any(text in name for text in texts))


def _scaled(figures: Figures, factor: float) -> Figures:
    """Return figures times a factor."""
    return {place: (np.asarray(value) * factor).tolist() for place, value in figures.items()}


def _part(slack: float, share: float) -> float:
    """Return a share of a slack, none of what its last digits may be wrong by."""
    return max(slack * share - _DIGITS, 0.0)


def _falling(name: str, figures: Figures, slack: float, room: float = 1.0) -> ClaimChanges:
    """Return a claim that is stronger the smaller its figures are.

    Args:
        name: of the claim.
        figures: that are claimed.
        slack: by how much, relatively, they are above what holds.
        room: by how much, relatively, they may be larger.
    """
    return ClaimChanges(
        name,
        lambda share: _scaled(figures, 1.0 + _part(room, share)),
        lambda share: _scaled(figures, 1.0 - _part(slack, share)),
        lambda share: _scaled(figures, (1.0 - slack) * (1.0 - share * _INSIDE)),
    )


def _rising(name: str, figures: Figures, slack: float, room: float = 1.0) -> ClaimChanges:
    """Return a claim that is stronger the larger its figures are.

    Args:
        name: of the claim.
        figures: that are claimed.
        slack: by how much, relatively, they are below what holds, of which it is a share.
        room: by how much, relatively, they may be smaller.
    """
    return ClaimChanges(
        name,
        lambda share: _scaled(figures, 1.0 - _part(room, share) * _INSIDE),
        lambda share: _scaled(figures, 1.0 / (1.0 - _part(slack, share))),
        lambda share: _scaled(figures, (1.0 + share) / (1.0 - slack)),
    )


def _ideal(certificate: Certificate, slacks: Mapping[str, float]) -> list[ClaimChanges]:
    """Return the claims about the ideal loop."""
    sets: Figures = {("invariant_set", name): getattr(certificate, name) for name in ("ball", "level")}
    ball, level = ({place: value} for place, value in sets.items())
    # scaled alike, their last digits may come out otherwise
    sets = {**ball, **_scaled(level, 1.0 - _DIGITS)}
    decay, robust = _slack(slacks, "A'P + P A"), certificate.robust
    above_floor = 1.0 if robust is None else _slack(slacks, "s <= eps")
    within = 1.0 - (1.0 - _slack(slacks, "the ball")) ** 2  # the slack is that of the radius
    claims = [
        _rising("level", level, _slack(slacks, "<= eps implies"), above_floor),
        _rising("ball", ball, within)._replace(weaker=None),
        _rising("ball and level", sets, within, above_floor),
        # the slack is a share of the rate that is claimed
        _rising("rate", {("lyapunov", "rate"): certificate.rate}, decay / (1.0 + decay)),
        _gain(certificate, "gain_max", 1.0),
        _gain(certificate, "gain_min", -1.0),
    ]
    if robust is not None:
        box: Figures = {("robust", "box"): robust.box}
        holds_v0 = 1.0 - math.sqrt(1.0 - _slack(slacks, "v0 in the box"))
        disturbance: Figures = {("robust", name): getattr(robust, name) for name in ("drift", "push")}
        claims += [
            _rising("box in the input set", box, _slack(slacks, "the box"))._replace(weaker=None),
            _falling("box around v0", box, holds_v0)._replace(weaker=None),
            ClaimChanges("robust disturbance", lambda share: _scaled(disturbance, 1.0 - share), None, None),
        ]
    return claims


def _gain(certificate: Certificate, name: str, away: float) -> ClaimChanges:
    """Return the claim about an end of the gain interval; beyond it the growth, convex, is above its secant from 1."""
    timing, gain = certificate.timing, float(getattr(certificate, name))
    place = ("sampling", name)
    ends = []
    for block, loop in zip(certificate.blocks, certificate.loops, strict=True):
        at = (
            hold_contraction(block, timing.period, k) if timing.immediate else timing.contraction(loop, block, k)
            for k in (1.0, gain)
        )
        first, last = at
        if last > first:
            ends.append(gain + max(1.0 - last, 0.0) * (gain - 1.0) / (last - first))
    end = min(ends, key=lambda end: end * away, default=away * math.inf)
    if certificate.flight is not None and away > 0.0:
        end = min(end, certificate.flight.gain_max)
    usable = math.isfinite(end) and end > 0.0
    return ClaimChanges(
        name,
        (lambda share: {place: gain + (1.0 - gain) * share}) if gain != 1.0 else None,
        None,
        (lambda share: {place: end * (1.0 + away * (_KNOWN + 0.9 * share))}) if usable else None,
    )


def _flight(flight: Mapping[str, Any], slacks: Mapping[str, float]) -> list[ClaimChanges]:
    """Return the claims of a flight section for the same loops and inputs."""
    tilt, hovering = _slack(slacks, "every applied gain is at least 1"), _slack(slacks, "the margin is one")
    room = min(tilt, _slack(slacks, "of the thrust what a hovering drone has"))
    claims = []
    for axis in ("horizontal", "vertical"):
        for part, words in (("tube", "tube"), ("back", "way back")):
            for name, value in flight[axis][part].items():
                if name != "rate":
                    slack = slacks[f"flight: {axis} {words}, {name}"]
                    used = room if part == "tube" and name in ("nominal", "disturbance") else 1.0
                    figures: Figures = {("flight", axis, part, name): value}
                    claims.append(_falling(f"{axis} {part} {name}", figures, slack, used))
    margin, disturbance = float(flight["margin"]), float(flight["disturbance"])
    place, most = ("flight", "margin"), ("flight", "disturbance")
    return [
        *claims,
        _falling("margin", {place: margin}, tilt, hovering),
        _rising("margin of a hovering drone", {place: margin}, hovering)._replace(weaker=None),
        ClaimChanges(
            "disturbance",
            lambda share: {most: disturbance * (1.0 - share)},
            lambda share: {most: disturbance * (1.0 + _part(room, share))},
            lambda share: {most: disturbance + margin * (tilt + share)},
        ),
    ]


def _assumed(assumptions: Mapping[str, float], slacks: Mapping[str, float]) -> list[ClaimChanges]:
    """Return the claims of a flight section for other inputs."""
    inputs: Figures = {
        ("flight", "assumptions", name): value for name, value in assumptions.items() if name != "pose_age"
    }
    tubes = [slack for name, slack in slacks.items() if " tube, " in name]
    whole = _rising("all inputs", inputs, min(tubes) * (1.0 - _KNOWN))
    return [
        whole,
        *(ClaimChanges(place[-1], partial(_less, {place: value}), None, None) for place, value in inputs.items()),
    ]


def _less(figures: Figures, share: float) -> Figures:
    return _scaled(figures, 1.0 - share)

"""The table of `reproduce`: what the paper prints, what comes out here, and a verdict computed from the two."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

VERDICTS = ("exact", "rounded", "ambiguous", "wrong")

# Difference below which a printed number is the recomputed one: rounding of double precision.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Comparison:
    """One printed number, or one claim, and what became of it.

    Attributes:
        place: where the paper prints it.
        quantity: what it is, with its unit.
        printed: as printed.
        recomputed: what it was compared with; for a claim what it was decided on.
        verdict: one of `VERDICTS`.
        reason: why, in one line.
    """

    place: str
    quantity: str
    printed: str
    recomputed: str
    verdict: str
    reason: str


def compare(printed: str, value: float) -> str:
    """Return how a decimal number as printed relates to a value: exact, rounded (to its digits) or wrong."""
    number = float(printed)
    if abs(number - value) <= _ROUNDING * max(abs(value), 1.0):
        return "exact"
    decimals = len(printed.partition(".")[2])
    # a value halfway between two decimals may be rounded either way
    return "rounded" if abs(number - value) <= 0.5 * 10.0**-decimals * (1.0 + _ROUNDING) else "wrong"


class Table:
    """Collects the rows, place by place in the order of the paper.

    Attributes:
        rows: so far.
    """

    def __init__(self) -> None:
        self.rows: list[Comparison] = []
        self._place = ""

    def at(self, place: str) -> None:
        """Say at which place of the paper the following rows are printed."""
        self._place = place

    def number(
        self,
        quantity: str,
        printed: str,
        value: float | Sequence[float] | Mapping[str, float],
        reason: str,
        *,
        undetermined: bool = False,
    ) -> None:
        """Compare one or several printed numbers, separated by commas, with what was recomputed.

        Args:
            quantity: what it is, with its unit.
            printed: the number or numbers, as printed.
            value: one for each printed number; or, by name, what one printed number would be under each reading of the
                text: it is ambiguous if it agrees with some of them only.
            reason: why, in one line.
            undetermined: the paper does not print all that the number depends on, so that another value makes it
                ambiguous, not wrong.
        """
        tokens = [token.strip() for token in printed.split(",")]
        if isinstance(value, Mapping):
            verdicts = [compare(tokens[0], reading) for reading in value.values()]
            wrong = verdicts.count("wrong")
            verdict = "ambiguous" if 0 < wrong < len(verdicts) else _worst(verdicts)
            recomputed = "; ".join(f"{reading:.7g} ({name})" for name, reading in value.items())
        else:
            values = [value] if isinstance(value, (int, float)) else list(value)
            verdict = _worst(compare(token, entry) for token, entry in zip(tokens, values, strict=True))
            recomputed = ", ".join(f"{entry:.7g}" for entry in values)
        if undetermined and verdict == "wrong":
            verdict = "ambiguous"
        self.rows.append(Comparison(self._place, quantity, printed, recomputed, verdict, reason))

    def claim(self, quantity: str, printed: str, holds: bool, recomputed: str, reason: str) -> None:
        """Judge a statement: exact if it holds, wrong if not.

        Args:
            quantity: what is claimed.
            printed: the bound or property that the paper states.
            holds: whether it holds here.
            recomputed: what that was decided on.
            reason: why, in one line.
        """
        self.rows.append(Comparison(self._place, quantity, printed, recomputed, "exact" if holds else "wrong", reason))

    def document(self) -> dict[str, Any]:
        """Return the table as the content of the JSON file."""
        return {"verdicts": self._counts(), "rows": [asdict(row) for row in self.rows]}

    def markdown(self) -> str:
        """Return the table in Markdown."""
        header = ("quantity", "printed", "recomputed", "verdict", "reason")
        lines, place = (
            ["# The paper's numbers, recomputed", "", f"{self._summary()}. What is wrong: docs/errata.md."],
            "",
        )
        for row in self.rows:
            if row.place != place:
                place = row.place
                lines += ["", f"## {place}", "", _cells(header), _cells(["---"] * len(header))]
            lines.append(_cells([row.quantity, row.printed, row.recomputed, row.verdict, row.reason]))
        return "\n".join(lines) + "\n"

    def text(self) -> str:
        """Return the table for a terminal, with the reason below what is ambiguous or wrong."""
        lines, place = [], ""
        for row in self.rows:
            if row.place != place:
                place = row.place
                lines += ["", place]
            lines.append(f"  {row.verdict:<10} {row.quantity:<52} {row.printed}  |  {row.recomputed}")
            if row.verdict in ("ambiguous", "wrong"):
                lines.append(f"{'':<13}{row.reason}")
        return "\n".join([*lines[1:], "", self._summary()])

    def _counts(self) -> dict[str, int]:
        return {verdict: sum(row.verdict == verdict for row in self.rows) for verdict in VERDICTS}

    def _summary(self) -> str:
        counts = ", ".join(f"{count} {verdict}" for verdict, count in self._counts().items())
        return f"{len(self.rows)} printed numbers and claims: {counts}"


def _worst(verdicts: Iterable[str]) -> str:
    return max(verdicts, key=VERDICTS.index)


def _cells(texts: Sequence[str]) -> str:
    """Return one row of a Markdown table."""
    return "| " + " | ".join(text.replace("|", "\\|") for text in texts) + " |"

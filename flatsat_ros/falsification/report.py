"""What campaigns came to, and one run of them step by step, as text."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from itertools import islice

import numpy as np

from flatsat_ros.certificate.sets import Place
from flatsat_ros.falsification.campaigns import CAMPAIGNS, RUNS, CampaignOutcome
from flatsat_ros.falsification.claims import Violation
from flatsat_ros.falsification.sabotage import SABOTAGES

_SHOWN = 3  # violations of each claim


@dataclass
class Tally:
    """What the batches so far came to.

    Attributes:
        runs: number of closed loops, by campaign.
        tightest: by how much, relatively, each claim failed at worst; negative is to spare.
        violations: one for each run in which a claim failed.
    """

    runs: Counter[str] = field(default_factory=Counter)
    tightest: dict[str, float] = field(default_factory=dict)
    violations: list[Violation] = field(default_factory=list)

    def add(self, campaign: str, outcome: CampaignOutcome) -> None:
        """Count one batch."""
        self.runs[campaign] += RUNS
        self.violations += outcome.violations
        for claim, excess in outcome.tightest.items():
            self.tightest[claim] = max(excess, self.tightest.get(claim, -math.inf))

    def text(self, seconds: float, sabotage: str | None) -> str:
        """Return the report.

        Args:
            seconds: that the runs took.
            sabotage: None, or one of `sabotage.SABOTAGES`.
        """
        total, broken = sum(self.runs.values()), Counter(violation.campaign for violation in self.violations)
        rate = f"{total / seconds:.0f} a second"
        lines = [f"{total} runs in {seconds:.1f} s, {rate}; certificates {_truth(sabotage)}"]
        lines += ["", "campaign        runs  violations"]
        lines += [f"{name:<12}{count:>8}{broken[name]:>12}   {CAMPAIGNS[name]}" for name, count in self.runs.items()]
        lines += ["", "claim, and by how much, relatively, it failed at worst (negative: to spare; rounding is 1e-9)"]
        lines += [f"  {excess:>10.2e}  {claim}" for claim, excess in self.tightest.items()]
        for claim, count in Counter(violation.claim for violation in self.violations).most_common():
            lines += ["", f"VIOLATED in {count} runs: {claim}"]
            for violation in islice((one for one in self.violations if one.claim == claim), _SHOWN):
                where = f"{violation.campaign}:{violation.seed}:{violation.index}"
                again = f"falsify --replay {where}" + (f" --sabotage {sabotage}" if sabotage else "")
                lines.append(f"  by {violation.excess:.3g} at step {violation.step}: {again}")
        if not self.violations:
            lines += ["", "no claim failed"]
        return "\n".join(lines)


def replay_text(run: str, outcome: CampaignOutcome, violations: list[Violation], sabotage: str | None) -> str:
    """Return one run step by step.

    Args:
        run: its name, CAMPAIGN:SEED:INDEX.
        outcome: of its batch, with the history of the run.
        violations: those of the run.
        sabotage: None, or one of `sabotage.SABOTAGES`.
    """
    proven = outcome.certificate
    part = "W" if proven.loop is not None else "V"
    lines = [
        f"{run}, {CAMPAIGNS[run.partition(':')[0]]}; certificates {_truth(sabotage)}",
        f"{proven.limits}",
        f"alpha {proven.rate:.6g} 1/s, eps {proven.level:.6g}, h {proven.period:.6g} s, tau {proven.lag:.6g} s, "
        f"d {proven.delay:.6g} s, gains [{proven.gain_min:.6g}, {proven.gain_max:.6g}]",
        "",
        f"step     t s  {part + '_h':>10}  {part + '_v':>10}  set        kappa   gamma       k  T m/s^2 phi deg"
        f" theta deg  {'v m/s^2':^26}  {'position m':^26}  {'velocity m/s':^26}",
    ]
    for step, row in enumerate(outcome.history):
        thrust, *angles = row["u"]
        vectors = "".join(
            "  " + "".join(f"{x:9.4f}" for x in part)[1:] for part in (row["v"], row["xi"][:3], row["xi"][3:6])
        )
        lines.append(
            f"{step:>4}{row['t']:>8.3f}  {row['V_h']:>10.5g}  {row['V_v']:>10.5g}  {Place(int(row['place'])).name:<9}"
            f"{row['kappa']:>7.4f}{row['gamma']:>8.4g}{row['k']:>8.4g}{thrust:>9.4f}"
            f"{''.join(f'{x:>8.3f}' for x in np.degrees(angles))}  {vectors}"
        )
    for violation in violations:
        lines += ["", f"VIOLATED at step {violation.step}, by {violation.excess:.6g} (relative): {violation.claim}"]
    if not violations:
        lines += ["", "no claim failed"]
    return "\n".join(lines)


def _truth(sabotage: str | None) -> str:
    return "as proven" if sabotage is None else f"made wrong: {SABOTAGES[sabotage]}"

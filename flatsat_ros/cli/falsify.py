"""`ros2 run flatsat_ros falsify`: a million closed loops that try to break what certificates claim."""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import islice

import numpy as np
from tqdm import tqdm

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.sets import Place
from flatsat_ros.falsification.campaigns import CAMPAIGNS, RUNS, Outcome, Pool, run
from flatsat_ros.falsification.claims import Violation
from flatsat_ros.law.input_set import InputSet

# alpha 1/s, h s, tau s, d s, smallest applied gain that is asked for
_LAGS = [
    (1.25, 0.1, 0.1, 0.05, 1.0),
    (1.25, 0.05, 0.08, 0.03, 1.0),
    (1.25, 0.02, 0.08, 0.03, 1.0),
    (1.25, 0.01, 0.08, 0.03, 0.7),
    (0.8, 0.1, 0.05, 0.0, 0.6),
    (2.0, 0.05, 0.0, 0.05, 0.7),
    (1.25, 0.05, 0.05, 0.12, 0.6),
    (0.5, 0.1, 0.15, 0.33, 0.8),
]

# T_max in g, eps_max deg, drift m/s and push m/s^2 of x and y, and of z, h s
_DISTURBED = [
    (2.0, 40.0, (math.sqrt(2.0), 0.0), (0.0, 0.0), 0.01),  # the paper's
    (1.45, 10.0, (0.0, 0.0), (0.4, 0.3), 0.05),
    (1.8, 25.0, (0.4, 0.2), (0.3, 0.5), 0.02),
]

_SABOTAGE = {
    "eps": "the level eps 5 %% larger",
    "gain": "gain_max 30 %% above the largest constant gain at which the loop is stable",
    "kappa": "gain_min, the smallest kappa of the kappa-sets, 30 %% smaller",
    "disturbance": "drift and push 5 %% larger than what was allowed for",
}

_SHOWN = 3  # violations of each claim


def main(argv: Sequence[str] | None = None) -> int:
    """Run the campaigns, or one run again; 0 if every claim held, 1 if one failed, 2 if the input cannot be used."""
    arguments = _parser().parse_args(argv)
    try:
        return _replay(arguments) if arguments.replay is not None else _fly(arguments)
    except FlatsatError as error:
        print(f"falsify: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="falsify",
        description="Drive closed loops against their certificates and report every claim that fails.",
        epilog="campaigns: " + "; ".join(f"{name}: {text}" for name, text in CAMPAIGNS.items()),
        allow_abbrev=False,
    )
    parser.add_argument("--runs", type=int, default=1_000_000, help="closed loops in all (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=540.0, help="stop after so long (default: %(default)s)")
    parser.add_argument("--campaign", choices=CAMPAIGNS, help="this one only")
    parser.add_argument("--seed", type=int, default=0, help="of the first batch (default: %(default)s)")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes (default: one for each core)")
    parser.add_argument(
        "--sabotage", choices=_SABOTAGE, help="; ".join(f"{key}: {_SABOTAGE[key]}" for key in _SABOTAGE)
    )
    parser.add_argument("--replay", metavar="CAMPAIGN:SEED:INDEX", help="one run again, step by step")
    return parser


def _fly(arguments: argparse.Namespace) -> int:
    if min(arguments.runs, arguments.workers) < 1 or arguments.seed < 0 or not arguments.seconds > 0.0:
        raise FlatsatError("--runs, --workers and --seconds must be above 0, --seed at least 0")
    campaigns = list(CAMPAIGNS) if arguments.campaign is None else [arguments.campaign]
    pool = _pool(campaigns)
    count = math.ceil(arguments.runs / RUNS)
    batches = [(campaigns[i % len(campaigns)], arguments.seed + i // len(campaigns)) for i in range(count)]
    runs: Counter[str] = Counter()
    tightest: dict[str, float] = {}
    violations: list[Violation] = []
    began = time.monotonic()
    with tqdm(total=count * RUNS, unit=" runs", desc="falsify", mininterval=0.5) as bar:
        for (campaign, _), outcome in zip(batches, _outcomes(batches, pool, arguments), strict=False):
            runs[campaign] += RUNS
            violations += outcome.violations
            for claim, excess in outcome.tightest.items():
                tightest[claim] = max(excess, tightest.get(claim, -math.inf))
            bar.update(RUNS)
            bar.set_postfix(violations=len(violations))
            if time.monotonic() - began > arguments.seconds:
                break
    _report(runs, tightest, violations, time.monotonic() - began, arguments.sabotage)
    return 1 if violations else 0


def _outcomes(batches: list[tuple[str, int]], pool: Pool, arguments: argparse.Namespace) -> Iterator[Outcome]:
    """Yield what the batches come to, in their order; what has not begun is dropped with the generator."""
    work = partial(_work, pool=pool, sabotage=arguments.sabotage)
    if arguments.workers == 1:
        yield from map(work, batches)
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one core for each worker, not for each matrix product
    executor = ProcessPoolExecutor(arguments.workers, mp_context=multiprocessing.get_context("spawn"))
    try:
        yield from executor.map(work, batches)
    finally:
        executor.shutdown(cancel_futures=True)


def _work(batch: tuple[str, int], pool: Pool, sabotage: str | None, watched: int | None = None) -> Outcome:
    return run(*batch, pool, None if sabotage is None else partial(_tamper, sabotage), watched)


def _tamper(sabotage: str, proven: Certificate) -> Certificate:
    """Return a certificate that is wrong; `verify` would refuse it."""
    match sabotage:
        case "eps":
            return replace(proven, level=1.05 * proven.level)
        case "gain":
            from flatsat_ros.synthesis.gain_cap import worst_case

            limit = min(worst_case(proven.timing, block, proven.gain_max).constant for block in proven.blocks)
            return replace(proven, gain_max=1.3 * limit)
        case "kappa":
            return replace(proven, gain_min=0.7 * proven.gain_min)
        case _:
            robust = proven.robust
            if robust is None:
                return proven
            return replace(proven, robust=replace(robust, drift=1.05 * robust.drift, push=1.05 * robust.push))


def _pool(campaigns: Sequence[str]) -> Pool:
    """Compute the certificates that need a solver, as far as the campaigns do."""
    lags = _LAGS if "lag" in campaigns else []
    disturbed = _DISTURBED if {"robust", "storm"} & set(campaigns) else []
    pool: dict[str, list[Certificate]] = {"lag": [], "robust": []}
    if not lags and not disturbed:
        return pool

    from flatsat_ros.synthesis.nominal import synthesize  # cvxpy takes seconds to import
    from flatsat_ros.synthesis.robust_design import synthesize_robust

    limits = InputSet(1.45 * GRAVITY, math.radians(10.0), GRAVITY)
    with tqdm(total=len(lags) + len(disturbed), desc="certificates", leave=False) as bar:
        for rate, period, lag, delay, lowest in lags:
            pool["lag"].append(synthesize(limits, rate, period, "lag", lag=lag, delay=delay, lowest=lowest))
            bar.update()
        for thrust, tilt, drift, push, period in disturbed:
            limits = InputSet(thrust * GRAVITY, math.radians(tilt), GRAVITY)
            pool["robust"].append(synthesize_robust(limits, drift, push, period, "robust"))
            bar.update()
    return pool


def _report(
    runs: Counter[str], tightest: dict[str, float], violations: list[Violation], seconds: float, sabotage: str | None
) -> None:
    total = sum(runs.values())
    print(f"{total} runs in {seconds:.1f} s, {total / seconds:.0f} a second; certificates {_truth(sabotage)}")
    broken = Counter(violation.campaign for violation in violations)
    print("\ncampaign        runs  violations")
    for campaign, count in runs.items():
        print(f"{campaign:<12}{count:>8}{broken[campaign]:>12}   {CAMPAIGNS[campaign]}")
    print("\nclaim, and by how much, relatively, it failed at worst (negative: to spare; rounding is 1e-9)")
    for claim, excess in tightest.items():
        print(f"  {excess:>10.2e}  {claim}")
    for claim, count in Counter(violation.claim for violation in violations).most_common():
        print(f"\nVIOLATED in {count} runs: {claim}")
        for violation in islice((one for one in violations if one.claim == claim), _SHOWN):
            where = f"{violation.campaign}:{violation.seed}:{violation.index}"
            again = f"falsify --replay {where}" + (f" --sabotage {sabotage}" if sabotage else "")
            print(f"  by {violation.excess:.3g} at step {violation.step}: {again}")
    if not violations:
        print("\nno claim failed")


def _truth(sabotage: str | None) -> str:
    return "as proven" if sabotage is None else f"made wrong: {_SABOTAGE[sabotage]}".replace("%%", "%")


def _replay(arguments: argparse.Namespace) -> int:
    campaign, _, numbers = arguments.replay.partition(":")
    seed, _, index = numbers.partition(":")
    if campaign not in CAMPAIGNS or not (seed.isdecimal() and index.isdecimal()) or int(index) >= RUNS:
        raise FlatsatError(
            f"--replay {arguments.replay}: must be CAMPAIGN:SEED:INDEX with a campaign of {', '.join(CAMPAIGNS)} and "
            f"an index below {RUNS}"
        )
    outcome = _work((campaign, int(seed)), _pool([campaign]), arguments.sabotage, int(index))
    proven = outcome.certificate
    print(f"{arguments.replay}, {CAMPAIGNS[campaign]}; certificates {_truth(arguments.sabotage)}")
    print(
        f"{proven.limits}\nalpha {proven.rate:.6g} 1/s, eps {proven.level:.6g}, h {proven.period:.6g} s, tau "
        f"{proven.lag:.6g} s, d {proven.delay:.6g} s, gains [{proven.gain_min:.6g}, {proven.gain_max:.6g}]\n"
    )
    part = "W" if proven.loop is not None else "V"
    print(
        f"step     t s  {part + '_h':>10}  {part + '_v':>10}  set        kappa   gamma       k  T m/s^2 phi deg"
        f" theta deg  {'v m/s^2':^26}  {'position m':^26}  {'velocity m/s':^26}"
    )
    for step, row in enumerate(outcome.history):
        thrust, *angles = row["u"]
        vectors = "".join(
            "  " + "".join(f"{x:9.4f}" for x in part)[1:] for part in (row["v"], row["xi"][:3], row["xi"][3:6])
        )
        print(
            f"{step:>4}{row['t']:>8.3f}  {row['V_h']:>10.5g}  {row['V_v']:>10.5g}  {Place(int(row['place'])).name:<9}"
            f"{row['kappa']:>7.4f}{row['gamma']:>8.4g}{row['k']:>8.4g}{thrust:>9.4f}"
            f"{''.join(f'{x:>8.3f}' for x in np.degrees(angles))}  {vectors}"
        )
    found = [violation for violation in outcome.violations if violation.index == int(index)]
    for violation in found:
        print(f"\nVIOLATED at step {violation.step}, by {violation.excess:.6g} (relative): {violation.claim}")
    if not found:
        print("\nno claim failed")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())

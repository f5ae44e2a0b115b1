"""`ros2 run flatsat_ros falsify`: a million closed loops that try to break what certificates claim."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from contextlib import closing

from flatsat_ros.cli import shell

_RUNS, _SECONDS = 1_000_000, 540.0  # by default
_FLIGHTS = 1000  # of plans


def main(argv: Sequence[str] | None = None) -> int:
    """Run the campaigns, or one run again; 0 if every claim held, 1 if one failed, see `shell` for the others."""
    return shell.run(_parser, _run, argv)


def _parser() -> shell.Parser:
    from flatsat_ros.falsification.campaigns import CAMPAIGNS
    from flatsat_ros.falsification.sabotage import SABOTAGES

    parser = shell.Parser(
        "falsify",
        "Drive closed loops against their certificates and report every claim that fails.",
        "campaigns: " + "; ".join(f"{name}: {text}" for name, text in CAMPAIGNS.items()),
    )
    wrong = "; ".join(f"{name}: {text}" for name, text in SABOTAGES.items()).replace("%", "%%")
    parser.add_argument("--runs", type=int, help=f"closed loops in all (default: {_RUNS})")
    parser.add_argument("--seconds", type=float, help=f"stop after so long (default: {_SECONDS:g})")
    parser.add_argument("--campaign", choices=CAMPAIGNS, help="this one only")
    parser.add_argument("--seed", type=int, help="of the first batch (default: 0)")
    parser.add_argument("--workers", type=int, help="processes (default: one for each core)")
    parser.add_argument("--sabotage", choices=SABOTAGES, help=wrong)
    parser.add_argument(
        "--plans", nargs="+", type=shell.path, metavar="FILE",
        help="fly these plans instead, with the certificate that proves their tubes, in simulated wind; --runs are "
        f"flights of single drones (default: {_FLIGHTS})",
    )  # fmt: skip
    parser.add_argument("--certificate", metavar="NAME_OR_PATH", help="of --plans (default: the controller's)")
    parser.add_argument("--replay", metavar="CAMPAIGN:SEED:INDEX", help="one run again, step by step")
    return parser


def _run(arguments: argparse.Namespace) -> int:
    from flatsat_ros.base.errors import FlatsatError

    if arguments.plans is not None:
        return _fly_plans(arguments)
    if arguments.certificate is not None:
        raise FlatsatError("--certificate: used with --plans only; campaigns draw theirs")
    return _fly(arguments) if arguments.replay is None else _replay(arguments)


def _fly_plans(arguments: argparse.Namespace) -> int:
    from functools import partial

    from tqdm import tqdm

    from flatsat_ros.base.errors import FlatsatError
    from flatsat_ros.certificate.certificate import FLIGHT_CERTIFICATE, load_certificate
    from flatsat_ros.falsification.plans import Attack, made, report, tasks
    from flatsat_ros.falsification.workers import results_of
    from flatsat_ros.plans import Plan

    shell.require_alone(arguments, "plans", "certificate", "runs", "seconds", "seed", "workers")
    runs = _FLIGHTS if arguments.runs is None else arguments.runs
    seconds = _SECONDS if arguments.seconds is None else arguments.seconds
    seed, workers = arguments.seed or 0, arguments.workers or os.cpu_count() or 1
    if min(runs, workers) < 1 or seed < 0 or not seconds > 0.0:
        raise FlatsatError("--runs, --workers and --seconds must be above 0, --seed at least 0")
    certificate = load_certificate(arguments.certificate or FLIGHT_CERTIFICATE)
    plans = [Plan.load(path) for path in arguments.plans]
    work = partial(made, plans=plans, certificate=certificate)
    attacks: list[tuple[str, Attack]] = []
    began = time.monotonic()
    given = tasks(len(plans), seed)
    with (
        closing(results_of(work, tasks(len(plans), seed), workers)) as found,
        tqdm(total=runs, unit=" flights", desc="falsify", mininterval=0.5) as bar,
    ):
        for task, one in zip(given, found, strict=False):
            attacks.append((plans[task.plan].name, one))
            bar.update(one.flights)
            if bar.n >= runs or time.monotonic() - began > seconds:
                break
    print(report(attacks, time.monotonic() - began))
    return 1 if any(one.breaches for _, one in attacks) else 0


def _fly(arguments: argparse.Namespace) -> int:
    from tqdm import tqdm

    from flatsat_ros.base.errors import FlatsatError
    from flatsat_ros.falsification.campaigns import CAMPAIGNS, RUNS
    from flatsat_ros.falsification.certificates import synthesized_for
    from flatsat_ros.falsification.report import Tally
    from flatsat_ros.falsification.series import batches_of, run_batches

    runs = _RUNS if arguments.runs is None else arguments.runs
    seconds = _SECONDS if arguments.seconds is None else arguments.seconds
    seed = arguments.seed or 0
    workers = os.cpu_count() or 1 if arguments.workers is None else arguments.workers
    if min(runs, workers) < 1 or seed < 0 or not seconds > 0.0:
        raise FlatsatError("--runs, --workers and --seconds must be above 0, --seed at least 0")
    campaigns = list(CAMPAIGNS) if arguments.campaign is None else [arguments.campaign]
    _require_effect(arguments.sabotage, campaigns)
    pool, batches, tally = synthesized_for(campaigns), batches_of(campaigns, runs, seed), Tally()
    began = time.monotonic()
    with (
        closing(run_batches(batches, pool, arguments.sabotage, workers)) as outcomes,
        tqdm(total=len(batches) * RUNS, unit=" runs", desc="falsify", mininterval=0.5) as bar,
    ):
        for batch, outcome in zip(batches, outcomes, strict=False):
            tally.add(batch.campaign, outcome)
            bar.update(RUNS)
            bar.set_postfix(violations=len(tally.violations))
            if time.monotonic() - began > seconds:
                break
    print(tally.text(time.monotonic() - began, arguments.sabotage))
    return 1 if tally.violations else 0


def _replay(arguments: argparse.Namespace) -> int:
    from flatsat_ros.base.errors import refusal
    from flatsat_ros.falsification.campaigns import CAMPAIGNS, RUNS
    from flatsat_ros.falsification.certificates import synthesized_for
    from flatsat_ros.falsification.report import replay_text
    from flatsat_ros.falsification.series import Batch, run_batch

    shell.require_alone(arguments, "replay", "sabotage")
    campaign, _, numbers = arguments.replay.partition(":")
    seed, _, index = numbers.partition(":")
    if campaign not in CAMPAIGNS or not (seed.isdecimal() and index.isdecimal()) or int(index) >= RUNS:
        valid = f"CAMPAIGN:SEED:INDEX with a campaign of {', '.join(CAMPAIGNS)} and an index below {RUNS}"
        raise refusal("--replay", arguments.replay, "", valid)
    _require_effect(arguments.sabotage, [campaign])
    pool = synthesized_for([campaign])
    outcome = run_batch(Batch(campaign, int(seed)), pool, arguments.sabotage, int(index))
    violations = [violation for violation in outcome.violations if violation.index == int(index)]
    print(replay_text(arguments.replay, outcome, violations, arguments.sabotage))
    return 1 if violations else 0


def _require_effect(sabotage: str | None, campaigns: Sequence[str]) -> None:
    """Refuse a sabotage of what no campaign looks at: that nothing fails then would say nothing."""
    from flatsat_ros.base.errors import FlatsatError
    from flatsat_ros.falsification.campaigns import DISTURBED

    if sabotage == "disturbance" and not set(campaigns) & DISTURBED:
        raise FlatsatError(
            f"--sabotage disturbance: campaign {campaigns[0]} has none; must be {' or '.join(sorted(DISTURBED))}"
        )


if __name__ == "__main__":
    sys.exit(main())

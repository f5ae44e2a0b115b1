"""`ros2 run flatsat_ros falsify`: a million closed loops that try to break what certificates claim."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from typing import TypeVar

from flatsat_ros.cli import shell

_RUNS, _SECONDS = 1_000_000, 540.0  # by default
_FLIGHTS = 1000  # of plans

Result = TypeVar("Result")


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
    parser.add_argument(
        "attacked", nargs="?", metavar="CERTIFICATE",
        help="attack what this one's flight section claims, with the controller's own code; a name or a path, proved "
        "or not (default: campaigns against certificates that they draw)",
    )  # fmt: skip
    parser.add_argument("--runs", type=shell.integer, help=f"closed loops in all (default: {_RUNS})")
    parser.add_argument("--seconds", type=shell.number, help=f"stop after so long (default: {_SECONDS:g})")
    parser.add_argument("--campaign", choices=CAMPAIGNS, help="this one only")
    parser.add_argument("--seed", type=shell.integer, help="of the first batch (default: 0)")
    parser.add_argument("--workers", type=shell.integer, help="processes (default: one for each core)")
    parser.add_argument("--sabotage", choices=SABOTAGES, help=wrong)
    parser.add_argument(
        "--plans", nargs="+", type=shell.path, metavar="FILE",
        help="fly these plans instead, with the certificate that proves their tubes, in simulated wind; --runs are "
        f"flights of single drones (default: {_FLIGHTS})",
    )  # fmt: skip
    parser.add_argument("--certificate", metavar="NAME_OR_PATH", help="of --plans (default: the controller's)")
    parser.add_argument(
        "--mutants", type=shell.integer, metavar="N",
        help="instead of flights verify so many copies of CERTIFICATE that claim less, as many that claim more by less "
        "than the slack of an inequality, and as many that claim more than that, which must be refused",
    )  # fmt: skip
    parser.add_argument("--replay", metavar="CAMPAIGN:SEED:INDEX", help="one run again, step by step")
    return parser


def _run(arguments: argparse.Namespace) -> int:
    from flatsat_ros.base.errors import FlatsatError

    if arguments.plans is not None:
        return _fly_plans(arguments)
    if arguments.certificate is not None:
        raise FlatsatError("--certificate: used with --plans only; campaigns draw theirs")
    if arguments.mutants is not None:
        return _mutate(arguments)
    if arguments.attacked is not None:
        return _attack(arguments)
    return _fly(arguments) if arguments.replay is None else _replay(arguments)


def _asked(arguments: argparse.Namespace, most: int) -> tuple[int, float, int, int]:
    """Return runs, by default the most, seconds, first seed and number of workers."""
    from flatsat_ros.base.errors import require
    from flatsat_ros.falsification.workers import WORKERS_MAX

    runs = most if arguments.runs is None else arguments.runs
    seconds = _SECONDS if arguments.seconds is None else arguments.seconds
    seed = arguments.seed or 0
    workers = os.cpu_count() or 1 if arguments.workers is None else arguments.workers
    require(runs >= 1, "--runs", runs, "", "at least 1")
    require(seconds > 0.0, "--seconds", seconds, "s", "above 0")
    require(seed >= 0, "--seed", seed, "", "at least 0")
    require(1 <= workers <= WORKERS_MAX, "--workers", workers, "", f"from 1 to {WORKERS_MAX}")
    return runs, seconds, seed, workers


def _collect(
    results: Generator[Result],
    take: Callable[[Result], tuple[int, int]],
    text: Callable[[float, bool], str],
    runs: int,
    seconds: float,
    unit: str,
) -> None:
    """Take in results until there are enough runs or the time is over, and print what they came to.

    On Ctrl-C what there is so far is printed, too.

    Args:
        results: of the workers.
        take: counts one in; returns how many runs it is, and how many violations there are so far.
        text: the report, after so many seconds, and whether it was not stopped: what takes long may then be in it.
        runs: enough of them.
        seconds: s.
        unit: what is counted.
    """
    from tqdm import tqdm

    began, done = time.monotonic(), 0
    with closing(results) as found:
        try:
            with tqdm(total=runs, unit=f" {unit}", desc="falsify", mininterval=0.5) as bar:
                for result in found:
                    count, violations = take(result)
                    done += count
                    bar.update(count)
                    bar.set_postfix(violations=violations)
                    if done >= runs or time.monotonic() - began > seconds:
                        break
        except KeyboardInterrupt:
            if done:
                print(text(time.monotonic() - began, False), flush=True)
            raise
        print(text(time.monotonic() - began, True), flush=True)


def _attack(arguments: argparse.Namespace) -> int:
    from functools import partial
    from itertools import count

    from flatsat_ros.base.resources import config_path
    from flatsat_ros.certificate.certificate import Certificate
    from flatsat_ros.falsification.flight import AttackOutcome, attack, section_of
    from flatsat_ros.falsification.flight_report import FlightTally
    from flatsat_ros.falsification.workers import results_of

    shell.require_alone(arguments, "attacked", "runs", "seconds", "seed", "workers")
    runs, seconds, seed, workers = _asked(arguments, _RUNS)
    certificate = Certificate.read(config_path(arguments.attacked))  # whether it is proved or not
    section_of(certificate)
    tally = FlightTally()

    def take(outcome: AttackOutcome) -> tuple[int, int]:
        tally.add(outcome)
        return outcome.runs, len(tally.breaches)

    results = results_of(partial(attack, certificate=certificate), count(seed), workers)
    _collect(results, take, partial(tally.text, certificate, arguments.attacked), runs, seconds, "runs")
    return 1 if tally.breaches else 0


def _mutate(arguments: argparse.Namespace) -> int:
    from flatsat_ros.base.errors import FlatsatError, refusal
    from flatsat_ros.base.resources import config_path
    from flatsat_ros.certificate.certificate import Certificate
    from flatsat_ros.falsification.mutants import KINDS, Mutant, MutantTally, judged

    if arguments.attacked is None:
        raise FlatsatError("--mutants: used with a CERTIFICATE only")
    shell.require_alone(arguments, "attacked", "mutants", "seconds", "seed")
    if arguments.mutants < 1:
        raise refusal("--mutants", arguments.mutants, "", "at least 1")
    _, seconds, seed, _ = _asked(arguments, _RUNS)
    certificate, tally = Certificate.read(config_path(arguments.attacked)), MutantTally()

    def take(result: tuple[Mutant, str]) -> tuple[int, int]:
        tally.add(*result)
        return 1, len(tally.wrong)

    results, total = judged(certificate, seed, arguments.mutants), arguments.mutants * len(KINDS)
    _collect(results, take, lambda elapsed, _: tally.text(certificate.name, elapsed), total, seconds, "mutants")
    return 1 if tally.wrong else 0


def _fly_plans(arguments: argparse.Namespace) -> int:
    from functools import partial

    from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, load_certificate
    from flatsat_ros.falsification.plans import Attack, made, report, tasks
    from flatsat_ros.falsification.workers import results_of
    from flatsat_ros.plans import Plan
    from flatsat_ros.plans.tubes import require_tubes

    shell.require_alone(arguments, "plans", "certificate", "runs", "seconds", "seed", "workers")
    runs, seconds, seed, workers = _asked(arguments, _FLIGHTS)
    certificate = load_certificate(DEFAULT_CERTIFICATE if arguments.certificate is None else arguments.certificate)
    plans = [Plan.load(path) for path in arguments.plans]
    for plan in plans:
        require_tubes(plan, certificate)
    attacks: list[tuple[str, Attack]] = []
    given = tasks(len(plans), seed)

    def take(one: Attack) -> tuple[int, int]:
        attacks.append((os.fspath(arguments.plans[next(given).plan]), one))
        return one.flights, sum(each.breaches for _, each in attacks)

    results = results_of(partial(made, plans=plans, certificate=certificate), tasks(len(plans), seed), workers)
    _collect(results, take, lambda elapsed, _: report(attacks, elapsed), runs, seconds, "flights")
    return 1 if any(one.breaches for _, one in attacks) else 0


def _fly(arguments: argparse.Namespace) -> int:
    from flatsat_ros.falsification.campaigns import CAMPAIGNS, RUNS, CampaignOutcome
    from flatsat_ros.falsification.certificates import synthesized_for
    from flatsat_ros.falsification.report import Tally
    from flatsat_ros.falsification.series import batches_of, run_batches

    runs, seconds, seed, workers = _asked(arguments, _RUNS)
    campaigns = list(CAMPAIGNS) if arguments.campaign is None else [arguments.campaign]
    _require_effect(arguments.sabotage, campaigns)
    pool, batches, tally = synthesized_for(campaigns), batches_of(campaigns, runs, seed), Tally()
    flown = iter(batches)

    def take(outcome: CampaignOutcome) -> tuple[int, int]:
        tally.add(next(flown).campaign, outcome)
        return RUNS, len(tally.violations)

    results = run_batches(batches, pool, arguments.sabotage, workers)
    total = len(batches) * RUNS
    _collect(results, take, lambda elapsed, _: tally.text(elapsed, arguments.sabotage), total, seconds, "runs")
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

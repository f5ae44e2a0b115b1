"""`make bench`: law and plans against solvers, nodes against bare ones, flights, tubes, what the viewer costs.

Exit code 0 when all answers agree and every process did its work, 1 where a part failed: it is named at the end, and
the others are run all the same; bench.json is written after each part. Targets are reported, not enforced.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import tempfile
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

# nobody else's nodes take part; rclpy reads this when it starts
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 101)

import law
import numpy as np
import plans
import processes
import proofs
import swap
import tick
import viewer
from report import Quartiles, Target, quartiles, table
from tqdm import tqdm

from flatsat_ros.base.errors import FlatsatError, one_line
from flatsat_ros.base.files import make_folder, write_text
from flatsat_ros.base.resources import config_path
from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, Certificate, load_certificate
from flatsat_ros.paper import offset_free
from flatsat_ros.planning import Wishes
from flatsat_ros.synthesis.nominal import synthesize

_CERTIFICATE = "paper_experiment"
_FAST_PERIOD = 0.01  # s
_STEP_TARGETS = {1: 1 / 10, 100: 1 / 1000, 1000: 1 / 2500}
_PROCESS_TARGET = 1.25
_PROOF_TARGET = 3.0
_BOUND_TARGET, _IPOPT_TARGET = 1.05, 1.01


def main(argv: Sequence[str] | None = None) -> int:
    """Run everything, print tables and write bench.json."""
    parser = argparse.ArgumentParser(prog="bench", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out/bench"), help="folder (default: %(default)s)")
    parser.add_argument("--against", metavar="COMMIT", help="only time the tick beside this commit's")
    parser.add_argument("--missions", type=Path, metavar="FOLDER", help="only plan the missions of a folder")
    arguments = parser.parse_args(argv)
    folder: Path = arguments.output
    make_folder(folder)
    if arguments.against is not None:
        return _compare_ticks(arguments.against)
    os.environ["ROS_LOG_DIR"] = str((folder / "log").resolve())
    targets: list[Target] = []
    parts: dict[str, Callable[[], Any]] = {"plans": partial(_compare_plans, arguments.missions, targets)}
    if arguments.missions is None:
        parts |= {
            "law": lambda: _compare_law(load_certificate(_CERTIFICATE), targets),
            "processes": partial(_compare_processes, folder, targets),
            "proofs": partial(_compare_proofs, targets),
            "offset_free": partial(_compare_offsets, targets),
            "swap": partial(_compare_swaps, targets),
            "viewer": partial(_compare_viewer, folder, targets),
        }
    failed = _run(parts, targets, folder / "bench.json")
    print("\nTargets")
    print(
        table(
            ["", "at most", "measured", ""],
            [[t.what, f"{t.at_most:.4g}", str(t.measured), "met" if t.met else "NOT MET"] for t in targets],
        )
    )
    print(f"\n{folder / 'bench.json'}")
    for name, reason in failed.items():
        print(f"error: {name}: {reason}", file=sys.stderr)
    return 1 if failed else 0


def _run(parts: Mapping[str, Callable[[], Any]], targets: Sequence[Target], file: Path) -> dict[str, str]:
    """Run all parts and keep what each found as soon as it has ended; return why parts failed, by name.

    Args:
        parts: by name; what each returns goes into the file.
        targets: where the parts put theirs.
        file: to write, JSON.
    """
    results: dict[str, Any] = {"machine": _machine()}
    failed: dict[str, str] = {}
    for name, part in parts.items():
        try:
            results[name] = part()
        except (FlatsatError, OSError) as error:
            failed[name] = one_line(str(error))
        except Exception as error:  # a defect, or a library that is missing: the others are worth having all the same
            traceback.print_exc()
            failed[name] = one_line(repr(error))
        results |= {
            "targets": [{**t._asdict(), "measured": t.measured._asdict(), "met": t.met} for t in targets],
            "failed": failed,
        }
        write_text(file, json.dumps(results, indent=2) + "\n")
    return failed


def _compare_law(certificate: Certificate, targets: list[Target]) -> dict[str, Any]:
    contest = law.Contest(certificate)
    agreement = contest.check()
    print("Agreement: largest relative difference from the step for all drones, of 1000 drones")
    print(table(["", "difference"], [[name, f"{value:.1e}"] for name, value in agreement.items()]))
    print(f"the saturation acts on {contest.saturated():.0%} of them\n")

    sizes: dict[str, Any] = {}
    for size in law.SIZES:
        times = contest.time(size)
        seconds = {name: quartiles(values) for name, values in times.items()}
        ratios = {name: _ratio(values, times[law.BASELINE]) for name, values in times.items()}
        print(f"N = {size}: processor time per drone, also as a fraction of {law.BASELINE}'s, median [quartiles]")
        rows = [[name, str(_scaled(seconds[name], 1e6)), str(ratios[name])] for name in times]
        print(table(["", "us", "fraction"], rows) + "\n")
        sizes[str(size)] = {
            name: {"seconds": seconds[name]._asdict(), "fraction": ratios[name]._asdict()} for name in times
        }
        if size in _STEP_TARGETS:
            what = f"{law.STEP} per drone, N = {size}, over {law.BASELINE}"
            targets.append(Target(what, _STEP_TARGETS[size], ratios[law.STEP]))
    return {"agreement": agreement, "per_drone": sizes}


def _compare_processes(folder: Path, targets: list[Target]) -> dict[str, Any]:
    slow = config_path(_CERTIFICATE)
    nominal = Certificate.load(slow)
    fast = folder / "certificate_fast.yaml"
    synthesize(nominal.limits, nominal.rate, _FAST_PERIOD, "bench_fast").save(fast)
    results = {}
    for path, period in ((slow, nominal.period), (fast, _FAST_PERIOD)):
        rate, count = f"{1.0 / period:g} Hz", len(processes.ROBOTS)
        measured = processes.measure(path, folder)
        echoes = (processes.RAW_ECHO, processes.TYPED_ECHO)
        cpu = {name: quartiles(values) for name, values in measured.cpu.items()}
        ratios = {n: {e: _ratio(values, measured.cpu[e]) for e in echoes} for n, values in measured.cpu.items()}
        print(f"{count} drones, poses at {processes.POSE_RATE:g} Hz, tick at {rate}: processor time")
        rows = [
            [
                name,
                str(_scaled(cpu[name], 1e6 * period / count)),
                *(str(ratios[name][echo]) for echo in echoes),
                f"{np.mean(measured.work.get(name, [1.0])):.0%}",
                *(f"{size / 2**20:.0f}" for size in measured.memory[name]),
            ]
            for name in measured.cpu
        ]
        header = ["", "us per drone and tick", *(f"over {echo}" for echo in echoes), "work done", "RSS MiB", "PSS MiB"]
        print(table(header, rows) + "\n")
        results[rate] = {
            name: {
                "cpu": cpu[name]._asdict(),
                **{f"over_{echo}": ratios[name][echo]._asdict() for echo in echoes},
                **({"work_done": quartiles(measured.work[name])._asdict()} if name in measured.work else {}),
                "memory_bytes": dict(zip(("rss", "pss"), measured.memory[name], strict=True)),
            }
            for name in measured.cpu
        }
        if path is slow:
            for echo in echoes:
                what = f"controller over {echo}, {count} drones, {rate}"
                targets.append(Target(what, _PROCESS_TARGET, ratios[processes.CONTROLLER][echo]))
    return results


def _compare_proofs(targets: list[Target]) -> dict[str, Any]:
    """Start the controller with every flight certificate, proved for the first time and remembered."""
    found = list(tqdm(proofs.proofs(), desc="proofs", leave=False))
    ratios = [proof.proof / proof.start for proof in found]
    print("First proof of flight certificates on a machine, and the controller's start without it: processor time, s")
    rows = [
        [proof.certificate, f"{proof.proof:.2f}", f"{proof.start:.2f}", f"{ratio:.2f}"]
        for proof, ratio in zip(found, ratios, strict=True)
    ]
    print(table(["", "proof", "start", "ratio"], rows) + "\n")
    largest = max(ratios)
    what = "first proof of a flight certificate over the controller's start, the largest"
    targets.append(Target(what, _PROOF_TARGET, Quartiles(largest, largest, largest)))
    return {proof.certificate: proof._asdict() for proof in found}


def _compare_offsets(targets: list[Target]) -> dict[str, Any]:
    """Fly every trouble with every policy; the flights are the same in every run."""
    policies = {
        "paper": offset_free.PAPER,
        "offset-free": offset_free.OFFSET_FREE,
        "thrust too": offset_free.ESTIMATING,
    }
    rows, results = [], {}
    flights = [
        (vehicle, trouble)
        for vehicle in offset_free.VEHICLES
        for trouble in (*offset_free.TROUBLES, *offset_free.TOO_MUCH)
    ]
    for vehicle, trouble in tqdm(flights, desc="flights", leave=False):
        name = f"{vehicle}, {trouble.name}"
        flown = {key: offset_free.swap(vehicle, trouble, policy) for key, policy in policies.items()}
        if not all(outcome.within for outcome in flown.values()):
            raise FlatsatError(f"{name}: a command left the limits")
        rows.append([
            name,
            *(f"{100.0 * outcome.hover:.2f}" for outcome in flown.values()),
            *(f"{100.0 * outcome.swap:.2f}" for outcome in flown.values()),
        ])  # fmt: skip
        results[name] = {key: outcome._asdict() for key, outcome in flown.items()}
        best = flown["thrust too" if trouble in offset_free.TOO_MUCH else "offset-free"]
        for what, most, value in (
            ("hover", offset_free.HOVER_TARGET, best.hover),
            ("swap", offset_free.SWAP_TARGET, best.swap),
        ):
            targets.append(Target(f"{what}, m: {name}", most, Quartiles(value, value, value)))
    print("Three drones at 50 Hz, mu = 2: steady error of the hover and RMS error of the swap, the worst drone, cm")
    print(table(["", *(f"hover, {key}" for key in policies), *(f"swap, {key}" for key in policies)], rows))
    return results


def _compare_swaps(targets: list[Target]) -> dict[str, Any]:
    """Fly the swap with and without a flight section; the flights are the same in every run."""
    rows, results = [], {}
    for name, air in swap.AIR.items():
        before, now = swap.swaps(air)
        for certificate, flown in ((swap.PRESENT, before), (swap.DEFAULT_CERTIFICATE, now)):
            lengths = [flown.rms, *flown.furthest, *flown.tube]
            rows.append([f"{name}, {certificate}", *(f"{100.0 * length:.2f}" for length in lengths),
                         f"{flown.guaranteed:.0%}"])  # fmt: skip
        results[name] = {"before": before._asdict(), "now": now._asdict()}
        for what, most, value in (
            ("RMS of the swap over that without a flight section", swap.RATIO_TARGET, now.rms / before.rms),
            ("horizontal error over the tube", 1.0, now.furthest[0] / now.tube[0]),
            ("vertical error over the tube", 1.0, now.furthest[1] / now.tube[1]),
        ):
            targets.append(Target(f"{what}: {name}", most, Quartiles(value, value, value)))
    print("\nSwap of three drones at 50 Hz, the worst drone, cm: RMS, largest errors, tubes; share guaranteed")
    print(table(["", "RMS", "largest", "vertical", "tube", "vertical", "guaranteed"], rows))
    return results


def _compare_plans(folder: Path | None, targets: list[Target]) -> list[dict[str, Any]]:
    """Plan missions of the benchmark's own, or those of a folder."""
    certificate = load_certificate(DEFAULT_CERTIFICATE)
    missions = (plans.drawn if folder is None else partial(plans.read, folder))(certificate, Wishes())
    results = list(tqdm(plans.compared(missions, plans.SECONDS), desc="plans", leave=False))
    print(f"Plans for {certificate.name}: durations over the bound and over ours; what is violated")
    print(plans.shown(results) + "\n")
    for found in results:
        figures = []
        if found.ipopt is not None and found.drones == 1:
            duration, seconds, _ = found.ipopt
            ended = "" if duration is not None else ", which has not ended"
            figures = [(f"ours over ipopt's processor time{ended}", 1.0, found.seconds / seconds)]
            if duration is not None:
                figures.append(("ours over ipopt's duration", _IPOPT_TARGET, found.duration / duration))
        elif not found.refused and found.drones > 1:
            figures = [("duration over the bound", _BOUND_TARGET, found.duration / found.bound)]
        targets += [
            Target(f"{what}: {found.name}", most, Quartiles(value, value, value)) for what, most, value in figures
        ]
    return [found._asdict() for found in results]


def _compare_viewer(folder: Path, targets: list[Target]) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(dir=folder) as made:
        report = viewer.report_cost(Path(made))
        console = viewer.console_cost(Path(made))
    size = float(report.size)
    unseen, seen, ticks = quartiles(console.unseen), quartiles(console.seen), console.ticks()
    targets += [
        Target("report of ten drones for 60 s at 50 Hz, bytes", viewer.SIZE_TARGET, Quartiles(size, size, size)),
        Target("making the report over reading the bag", viewer.READING_TARGET, quartiles(report.over_reading)),
        Target("console without a browser over a bare subscriber", viewer.SUBSCRIBER_TARGET, unseen),
        Target("tick with console and page over that without, spread of that without", console.spread(), ticks),
    ]
    print(f"\nConsole with a page over a bare subscriber to its topics, three drones at 50 Hz: {seen}")
    return {"report": report._asdict(), "console": console._asdict()}


def _compare_ticks(commit: str) -> int:
    """Print the tick of this tree over that of a commit."""
    try:
        found = tick.compare(commit)
    except RuntimeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    rows = [
        [case, str(quartiles(times.ours)), str(quartiles(times.theirs)), str(_ratio(times.ours, times.theirs))]
        for case, times in found.items()
    ]
    print(f"The whole tick, us, in turns; the commands agree\n{table(['drones', 'now', commit, 'ratio'], rows)}")
    return 0


def _ratio(values: Sequence[float], others: Sequence[float]) -> Quartiles:
    """Return the spread of the ratios round by round: what slows down both leaves them as they are."""
    return quartiles([value / other for value, other in zip(values, others, strict=True)])


def _scaled(spread: Quartiles, factor: float) -> Quartiles:
    return Quartiles(*(factor * value for value in spread))


def _machine() -> Mapping[str, Any]:
    found: dict[str, Any] = {
        "python": platform.python_version(),
        "machine": platform.machine(),
        "cores": os.cpu_count(),
    }
    for package in ("numpy", "cvxpy", "clarabel", "osqp", "casadi"):
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


if __name__ == "__main__":
    sys.exit(main())

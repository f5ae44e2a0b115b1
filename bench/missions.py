"""How many missions of folders are planned without options, how fast, and how near to the bound.

Each folder is planned as `plan FILE` does, and summed up in one line: how many missions were planned, CPU time to the
first proved plan, and the duration of the best one over the bound, the slowest drone alone in the same spline space
under the same limits. Times are of the CPU, for other load spoils those of the clock; the search ends by them, too.

    .venv/bin/python bench/missions.py FOLDER ... [--seconds S] [--certificate NAME] [--tube M] [--match TEXT]
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, Certificate, load_certificate
from flatsat_ros.planning import Wishes, read_mission, rounds


def planned(path: Path, certificate: Certificate, wishes: Wishes, seconds: float) -> tuple[float, float, float, int]:
    """Return CPU time of the first proved plan, best duration, s, its share of the bound, and the number of drones."""
    mission = read_mission(path, certificate, wishes, path.stem)
    begin, first = time.process_time(), 0.0
    duration = share = 0.0
    for proved in rounds(mission, lambda: time.process_time() - begin > seconds):
        first = first or time.process_time() - begin
        duration, share = proved.duration, proved.duration / (proved.bound or proved.duration)
    return first, duration, share, len(mission.drones)


def main() -> None:
    """Print a line for each mission that is refused or slow, and one for each folder."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--certificate", default=DEFAULT_CERTIFICATE)
    parser.add_argument("--tube", type=float)
    parser.add_argument("--match", default="", help="text in the names of the files")
    parser.add_argument("--each", action="store_true", help="a line for each mission")
    given = parser.parse_args()
    certificate = load_certificate(given.certificate)
    for folder in given.folders:
        files = sorted(
            path for path in folder.iterdir() if path.suffix in (".json", ".yaml", ".csv") and given.match in path.name
        )
        found = []
        for path in files:
            try:
                found.append(planned(path, certificate, Wishes(tube=given.tube), given.seconds))
            except FlatsatError as error:
                print(f"  refused: {path.name}: {error}", flush=True)
                continue
            if given.each:
                first, duration, share, drones = found[-1]
                print(
                    f"  {path.stem}: {drones} drones, {first:.2f} s, {duration:.3f} s, {share:.4f} of the bound",
                    flush=True,
                )
        firsts, _, shares, _ = np.array(found or [(np.nan,) * 4]).T
        quantiles = [np.quantile(values, (0.5, 0.9, 1.0)) for values in (firsts, shares)]
        print(
            f"{folder.name}: {len(found)} of {len(files)} planned; first plan {quantiles[0][0]:.2f} s, 90 % below "
            f"{quantiles[0][1]:.2f} s, at most {quantiles[0][2]:.2f} s; over the bound {quantiles[1][0]:.4f}, 90 % "
            f"below {quantiles[1][1]:.4f}, at most {quantiles[1][2]:.4f}",
            flush=True,
        )


if __name__ == "__main__":
    main()

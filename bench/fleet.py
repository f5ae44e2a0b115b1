"""What ground effect, downwash and all that scripts need cost the simulation: `python bench/fleet.py`.

Twenty drones hover with set-points that sway; timed is the CPU per simulated second, in turns: without ground effect
and downwash, with both, and without both in an earlier commit of this tree, by default the one before the simulation
knew uploaded trajectories and set-points of position and velocity. What is compared flies alike: the two trees exactly,
and with both effects the drones are no farther away than these push them.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from tick import ROOT, checked_out

BEFORE = "47d28cd^"
_DRONES, _SECONDS, _ROUNDS = 20, 3.0, 7
_MOST = 1.3  # with both effects over before, at most
_ALIKE = 1e-9  # m
_MOVED = 1.0  # m: a hover that ground effect and downwash, uncontrolled, leave by this much is another flight


def main() -> int:
    """Return 0 if the flights agree, whatever was measured; 1 if they do not."""
    parser = argparse.ArgumentParser(prog="fleet", description=__doc__)
    parser.add_argument("--against", metavar="COMMIT", default=BEFORE, help="the earlier commit (default: %(default)s)")
    arguments = parser.parse_args()
    with checked_out(arguments.against) as folder:
        cases = {"before": (folder, False), "without both": (ROOT, False), "with both": (ROOT, True)}
        rounds = [{name: _run(*case) for name, case in cases.items()} for _ in range(_ROUNDS)]
    last = {name: np.array(flight["position"]) for name, flight in rounds[-1].items()}
    if not np.abs(last["before"] - last["without both"]).max() < _ALIKE:
        print("error: the simulations of both trees fly differently", file=sys.stderr)
        return 1
    if not 0.0 < np.abs(last["with both"] - last["without both"]).max() < _MOVED:
        print("error: ground effect and downwash change nothing, or too much", file=sys.stderr)
        return 1
    least = {name: min(one[name]["seconds"] for one in rounds) for name in cases}
    for name, seconds in least.items():
        ratio = seconds / least["before"]
        print(f"{name:>12}: {seconds:.4f} s of the CPU per simulated second of {_DRONES} drones, {ratio:.2f} of before")
    print(f"at most {_MOST}: {'met' if least['with both'] <= _MOST * least['before'] else 'missed'}")
    return 0


def _run(tree: Path, proximity: bool) -> dict[str, Any]:
    command = [sys.executable, __file__, str(tree), *(["proximity"] if proximity else [])]
    answer: dict[str, Any] = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    return answer


def _fly(tree: Path, proximity: bool) -> dict[str, Any]:
    """Return s of the CPU per simulated second, and the positions at the end, m, of a flight in a tree."""
    sys.path.insert(0, str(tree))
    from flatsat_ros.crazyflie.vehicle import VehicleProfile
    from flatsat_ros.sim.fleet import SimulatedFleet

    felt: dict[str, Any] = {}
    if proximity:
        from flatsat_ros.sim.proximity import Proximity

        felt = {"proximity": Proximity()}
    profile = VehicleProfile.load(tree / "config" / "vehicles" / "cf21.yaml")
    # two layers, so that some fly in the air that others push down
    start = [(0.4 * (n % 5), 0.5 * (n // 5 % 2), 0.7 + 0.4 * (n // 10)) for n in range(_DRONES)]
    fleet = SimulatedFleet(profile, _DRONES, start=start, flying=True, **felt)
    hover, begin = float(profile.pwm_from_thrust(9.81)), process_time()
    for step in range(round(_SECONDS / 0.02)):
        now = 0.02 * step
        fleet.advance_to(now)
        fleet.measurements(now)
        for index in range(_DRONES):
            fleet.command(index, 2.0 * float(np.sin(6.0 * now + index)), 0.0, 0.0, hover)
    return {"seconds": (process_time() - begin) / _SECONDS, "position": fleet.bodies.position.tolist()}


if __name__ == "__main__":
    if sys.argv[1:2] and Path(sys.argv[1]).is_dir():
        print(json.dumps(_fly(Path(sys.argv[1]), sys.argv[2:] == ["proximity"])))
    else:
        sys.exit(main())

"""Plan what docs/planning.md shows and draw it into docs/images: a circle of eight drones, and ten through an opening.

.venv/bin/python docs/build_plan_images.py
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle

from flatsat_ros.base.colours import PICTURES
from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, load_certificate
from flatsat_ros.planning import Wishes, plan, read_mission
from flatsat_ros.plans import Plan

IMAGES = Path(__file__).parent / "images"
EDGE, HALF, ROOM = 0.1, 0.5, (3.0, 2.0, 2.5)  # m: of the wall, its opening, and the room
ANGLES = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)


def circle() -> str:
    """Eight drones that change places across a circle of 3 m."""
    places = [(round(1.5 * float(np.cos(a)), 3), round(1.5 * float(np.sin(a)), 3)) for a in ANGLES]
    lines = [f"  cf{i}: [[{x}, {y}, 1.0], [{-x}, {-y}, 1.0]]" for i, (x, y) in enumerate(places, 1)]
    return "\n".join(["drones:", *lines]) + "\n"


def opening() -> str:
    """Ten drones that pass an opening of 1 x 1 m in a wall."""
    x, y, z = ROOM
    grid = [(-far, side) for far in (1.2, 2.4) for side in (-1.4, -0.7, 0.0, 0.7, 1.4)]
    order = [(3 * i + 1) % len(grid) for i in range(len(grid))]
    lines = [
        f"  cf{i}: [[{a}, {b}, 1.0], [{-grid[j][0]}, {grid[j][1]}, 1.0]]"
        for i, ((a, b), j) in enumerate(zip(grid, order, strict=True), 1)
    ]
    walls = {
        "left": (-y, 0.0, -HALF, z), "right": (HALF, 0.0, y, z),
        "below": (-HALF, 0.0, HALF, 0.5), "above": (-HALF, 1.5, HALF, z),
    }  # fmt: skip
    boxes = [
        f"  {name}: {{type: box, lower: [{-EDGE}, {a}, {b}], upper: [{EDGE}, {c}, {d}]}}"
        for name, (a, b, c, d) in walls.items()
    ]
    room = f"box: {{lower: [{-x}, {-y}, 0.0], upper: [{x}, {y}, {z}]}}"
    return "\n".join(["drones:", *lines, "obstacles:", *boxes, room]) + "\n"


@mpl.rc_context(PICTURES)
def drawn(found: Plan, path: Path) -> None:
    """Draw references from above and the distances of all pairs over time."""
    figure, (above, over) = plt.subplots(1, 2, figsize=(11, 5))
    times = np.linspace(0.0, found.duration, 300)
    paths = {}
    for drone in found.drones:
        trajectory = found.trajectory(drone.name)
        paths[drone.name] = np.array([trajectory.sample(float(t))[:3] for t in times])
        way = paths[drone.name]
        (line,) = above.plot(way[:, 0], way[:, 1], linewidth=1)
        middle = way[len(way) // 2]
        disc(above, middle, drone.body, color=line.get_color(), alpha=0.4)
        disc(above, middle, drone.body + drone.tube.radius, color=line.get_color(), fill=False, linestyle="--")
    for box in found.obstacles:
        (x, y, _), (right, top, _) = (corner.tolist() for corner in box.corners)
        if box.lower[2] <= 10**9 <= box.upper[2]:
            above.add_patch(Rectangle((x, y), right - x, top - y, color="0.6"))
    above.set(xlabel="x, m", ylabel="y, m", aspect="equal", title="from above; discs half-way, tubes dashed")
    for pair in found.pairs:
        apart = (paths[pair.first] - paths[pair.second]) / [1.0, 1.0, found.downwash]
        over.plot(times, np.linalg.norm(apart, axis=1), color="0.6", linewidth=0.6)
    needed = float(found.required(found.drones[0], found.drones[1]))
    over.axhline(needed, color="C1", label=f"bodies and tubes, {needed:.3f} m")
    over.set(xlabel="time, s", ylabel="distance, m", ylim=(0.0, None), title="distances of all pairs of references")
    over.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=90)
    plt.close(figure)


def disc(axes: Axes, place: np.ndarray, radius: float, **style: object) -> None:
    """Draw a circle around a place."""
    axes.add_patch(Circle((float(place[0]), float(place[1])), radius, **style))


def main() -> None:
    """Draw both."""
    certificate = load_certificate(DEFAULT_CERTIFICATE)
    for name, mission in (("plan", circle()), ("opening", opening())):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{name}.yaml"
            path.write_text(mission, encoding="utf-8")
            found = plan(read_mission(path, certificate, Wishes(), name), 60.0)
        drawn(found, IMAGES / f"{name}.png")
        print(f"{name}: {found.duration:.2f} s, tubes of {found.drones[0].tube.radius:g} m")


if __name__ == "__main__":
    main()

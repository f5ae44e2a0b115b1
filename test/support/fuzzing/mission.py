"""Way-points in files: whatever is read as a mission can be planned or refused; its numbers are finite."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.planning.inputs import Wishes, read_mission
from fuzzing.damage import damaged
from fuzzing.kind import Attempt, Kind, require_one_line, rewrite

_ENDINGS = {b"c": ".csv", b"y": ".yaml", b"j": ".json"}  # by the first byte of an input
_EXAMPLES = {
    b"c": "x,y,z,yaw,t\n0.0,0.0,1.0,0.5,0.0\n1.0,0.5,1.5,0.5,4.0\n2.0,-0.5,1.0,0.5,8.0\n",
    b"y": (
        "drones:\n  cf1: [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]]\n  cf2: [[0.0, 2.0, 1.0], [1.0, 2.0, 1.0]]\n"
        "body: 0.15\ndownwash: 2.0\ntimes: [0.0, 5.0]\nbox: {lower: [-1.0, -1.0, 0.0], upper: [3.0, 3.0, 2.0]}\n"
    ),
    b"j": (
        '{"quadrotors": {"crazyflie": {"max_vel": [1.0, 1.0, 1.0], "radius": 0.15, "downwash": 2.0}},\n'
        '"world": [{"dimension": [-3.0, -3.0, 0.0, 3.0, 3.0, 2.5]}],\n"agents": [\n'
        '{"type": "crazyflie", "cid": 1, "start": [0.0, 0.0, 1.0], "goal": [1.0, 0.0, 1.0]},\n'
        '{"type": "crazyflie", "cid": 2, "start": [0.0, 2.0, 1.0], "goal": [1.0, 2.0, 1.0]}\n],\n"obstacles": []}\n'
    ),
}


@contextmanager
def _open(folder: Path) -> Iterator[Attempt]:
    certificate, wishes = load_certificate("paper_experiment"), Wishes()

    def attempt(data: bytes) -> bool:
        path = folder / f"mission{_ENDINGS.get(data[:1], '.csv')}"
        rewrite(path, data[1:])
        try:
            mission = read_mission(path, certificate, wishes, "fuzz")
        except FlatsatError as refused:
            require_one_line(refused, path)
            return False
        assert mission.drones
        for drone in mission.drones:
            assert np.isfinite(drone.waypoints).all()
            assert np.isfinite([drone.body, drone.yaw]).all()
        assert mission.times is None or np.isfinite(mission.times).all()
        assert np.isfinite([*mission.bounds.lower, *mission.bounds.upper]).all()
        return True

    yield attempt


MISSION = Kind(
    st.one_of(damaged(example).map(lambda data, first=first: first + data) for first, example in _EXAMPLES.items()),
    _open,
)

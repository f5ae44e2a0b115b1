"""crazyswarm2's own Python server as a process, with simulated drones behind it, over UDP."""

from __future__ import annotations

import os
import signal
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from crtp_endpoint import LOG, PARAMETERS, Endpoint, setpoints

from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.nodes.ros import interfaces
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.fleet import SimulatedFleet

if TYPE_CHECKING:
    from conftest import Lab, Process

STANDINS = Path(__file__).parent / "crazyswarm2"
NEAR = 0.05  # m


class Server:
    """crazyswarm2's server, and its drones.

    Attributes:
        drones: simulated, switched on.
        robots: their names.
        poses, telemetry: of each drone, as they come.
        running: the process.
    """

    def __init__(
        self,
        lab: Lab,
        folder: Path,
        places: Mapping[str, Sequence[float]],
        *,
        marks: Mapping[str, str] | None = None,
        vehicle: str = "cf21",
        yaw: float = 0.0,
        rate: int = 100,
        wind: Wind | None = None,
    ) -> None:
        """Switch the drones on at their places, and start the server.

        Args:
            lab: runs it.
            folder: for its files.
            places: of the drones by name, (3,) m.
            marks: what the URIs of the drones end with, by name: scripts take their last two characters for a number.
            vehicle: profile of the drones.
            yaw: theirs, rad.
            rate: of the poses, Hz.
            wind: in the room.
        """
        start = list(places.values())
        fleet = SimulatedFleet(load_vehicle(vehicle), len(start), start=start, yaw=yaw, wind=wind)
        self.drones = Endpoint(fleet, log=LOG, parameters=PARAMETERS)
        self.robots = list(places)
        self.drones.switch_on()
        self._lab, self._folder = lab, folder
        (folder / "server.yaml").write_text(
            yaml.safe_dump(self._parameters(rate, places, marks or {})), encoding="utf-8"
        )
        # another environment than that of the tests, as in a launch file of crazyswarm2
        path = f"{os.environ['PYTHONPATH']}{os.pathsep}{STANDINS}"
        script = folder / "crazyflie_server"
        script.write_text(
            f"""#!/bin/sh
cd {folder}
unset _ROS_WHEELS_BOOTSTRAP_COMPLETE
export LD_LIBRARY_PATH={os.environ["CRAZYSWARM2_LIBRARIES"]} PYTHONPATH={path}
exec {os.environ["CRAZYSWARM2_PYTHON"]} -u -m crazyflie_server_py.crazyflie_server "$@"
""",
            encoding="utf-8",
        )
        script.chmod(0o755)
        self.poses = {robot: lab.watch(interfaces.POSE, robot) for robot in self.robots}
        self.telemetry = {robot: lab.watch(interfaces.TELEMETRY, robot) for robot in self.robots}
        self.running = self.start()

    def _parameters(self, rate: int, places: Mapping[str, Sequence[float]], marks: Mapping[str, str]) -> dict[str, Any]:
        """What crazyswarm2's launch file makes of crazyflies.yaml and server.yaml."""
        robots = {
            robot: {
                "enabled": True,
                "uri": drone.uri + marks.get(robot, ""),
                "initial_position": list(place),
                "type": "cf21",
            }
            for (robot, place), drone in zip(places.items(), self.drones.drones, strict=True)
        }
        topics = {"pose": {"frequency": rate}, "status": {"frequency": 10}}
        shared = {
            "firmware_logging": {"enabled": True, "default_topics": topics},
            "firmware_params": {"stabilizer": {"controller": 1}, "flightmode": {"stabModeYaw": 0}},
            "reference_frame": "world",
        }
        given = {
            "fileversion": 3,
            "robots": robots,
            "robot_types": {"cf21": {"big_quad": False}},
            "all": shared,
            "firmware_params": {"query_all_values_on_connect": True},
            "robot_description": "",
        }
        return {"/crazyflie_server": {"ros__parameters": given}}

    def start(self) -> Process:
        """Start the server, and wait until it tells of its drones."""
        given = "--ros-args", "--params-file", str(self._folder / "server.yaml")
        self.running = self._lab.run(self._folder / "crazyflie_server", *given)
        seen = {robot: len(poses) for robot, poses in self.poses.items()}
        self._lab.wait(
            lambda: all(len(poses) > seen[robot] + 5 for robot, poses in self.poses.items()), "poses from the server"
        )
        return self.running

    def stop(self) -> None:
        """Kill the server, as it ends when it breaks down."""
        self.running.stop(signal.SIGKILL)

    def power_cycle(self, index: int = 0) -> None:
        """Switch a drone off and, a second later, as by hand, on where it is."""
        self.drones.switch_off(index)
        self._lab.listen(1.0)
        self.drones.switch_on(index)

    def mode(self, robot: str = "cf1") -> Mode | None:
        """The mode that the controller tells."""
        told = self.telemetry[robot]
        return Mode(int(told[-1].data[FIELDS.index("mode")])) if told else None

    def thrusts(self, since: int = 0, index: int = 0) -> set[int]:
        """The thrusts that a drone was sent from some set-point on."""
        return {int(thrust) for *_, thrust in setpoints(self.drones, index)[since:]}

    def wait_until_near(self, goal: Sequence[float], robot: str = "cf1", near: float = NEAR) -> None:
        """Wait until a drone, itself and not its pose, stays near a place for a second."""
        index, since = self.robots.index(robot), [self.drones.fleet.time]

        def stays() -> bool:
            with self.drones.lock:
                now, where = self.drones.fleet.time, self.drones.fleet.bodies.position[index]
                if np.abs(where - goal).max() > near:
                    since[0] = now
            return now - since[0] > 1.0

        self._lab.wait(stays, f"{robot} to stay near {goal}")

"""A plan over real DDS: three simulated drones gather, set out together, pause, go on and rest at the end."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from std_srvs.srv import Trigger
from swap_plan import NAMES, swap_plan

from flatsat_ros.nodes.ros import interfaces, messages

if TYPE_CHECKING:
    from conftest import Lab


def test_three_drones_fly_a_plan_with_a_pause(lab: Lab, tmp_path: Path) -> None:
    plan = swap_plan(tube=0.15)
    plan.save(tmp_path / "swap.yaml")
    places = np.array([plan.trajectory(name).sample(0.0)[:3] for name in NAMES])
    goals = [plan.trajectory(name).end for name in NAMES]
    poses = {name: lab.watch(interfaces.POSE, name) for name in NAMES}
    ground = (places * (1.0, 1.0, 0.0)).ravel().tolist()
    lab.start("sim_drone", robot_names=list(NAMES), start_positions=ground, position_noise=0.0005)
    lab.fly(*NAMES, certificate=plan.certificate, plan=tmp_path / "swap.yaml")
    for name in NAMES:
        lab._wait_for_link(name)
    lab.wait(lambda: lab.ask(Trigger, "plan/start").success, "the plan to be started")
    lab.wait(lambda: lab.ask(Trigger, "plan/pause").success, "the drones to set out")
    begin = {name: len(poses[name]) for name in NAMES}
    lab.wait(lambda: lab.ask(Trigger, "plan/resume").success, "the drones to stand still")
    for name, goal in zip(NAMES, goals, strict=True):
        lab.wait_for_flight(name, poses[name], goal)
    tracks = {
        name: np.array([messages.pose_from_message(message)[1] for message in poses[name][begin[name] :]])
        for name in NAMES
    }
    count = min(map(len, tracks.values()))
    tubes = {drone.name: drone.tube.radius for drone in plan.drones}
    for pair, (first, second) in zip(plan.pairs, itertools.combinations(NAMES, 2), strict=True):
        # poses of one moment come together, give or take one
        apart = (tracks[first][:count] - tracks[second][:count]) / (1.0, 1.0, plan.downwash)
        assert np.linalg.norm(apart, axis=1).min() > pair.distance / 1e4 - tubes[first] - tubes[second]

"""Predictions of `make identification`: from the past and the commands alone, and right for a drone that is known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from flown import fly
from numpy.testing import assert_array_equal

from flatsat_ros import load_vehicle
from flatsat_ros.identification.identified import profile_figures
from flatsat_ros.identification.prediction import ahead
from flatsat_ros.identification.screening import Samples, screen

DRONE = load_vehicle("cf21_markers")
FIGURES = dataclasses.replace(profile_figures(DRONE), delay=0.02)
AT, STEPS = np.array([400, 600]), 50


@pytest.fixture(scope="module")
def flown() -> Samples:
    strong = dataclasses.replace(DRONE, force_max=1.3 * DRONE.force_max)
    return screen(fly(strong, range(1), seconds=8.0, delay=0.02, noise=1e-4, frame=(0.01, -0.02))[0])


def test_predictions_know_no_later_pose(flown: Samples) -> None:
    first = ahead([flown], FIGURES, [AT], STEPS, adapt=True)[0]
    position, angles = flown.position.copy(), flown.angles.copy()
    position[AT[-1] + 1 :] += 1.0
    angles[AT[-1] + 1 :, :2] += 0.5
    later = dataclasses.replace(flown, position=position, angles=angles)
    assert_array_equal(ahead([later], FIGURES, [AT], STEPS, adapt=True)[0], first)


def test_predictions_of_a_known_drone_are_right_whatever_its_frame_and_thrust(flown: Samples) -> None:
    at = np.arange(400, len(flown.position) - STEPS, 20)
    for adapt in (False, True):
        error = np.linalg.norm(
            ahead([flown], FIGURES, [at], STEPS, adapt=adapt)[0] - flown.position[at + STEPS], axis=1
        )
        assert np.sqrt(np.mean(error**2)) < 0.006
        assert np.linalg.norm(flown.position[at + STEPS] - flown.position[at], axis=1).max() > 0.2


def test_what_adapts_finds_the_tilt_of_the_flight(flown: Samples) -> None:
    at = np.arange(400, len(flown.position) - STEPS, 20)
    wrong = dataclasses.replace(FIGURES, velocity_tilt=FIGURES.velocity_tilt - 0.03)
    fixed, adapted = (
        np.linalg.norm(ahead([flown], wrong, [at], STEPS, adapt=adapt)[0] - flown.position[at + STEPS], axis=1)
        for adapt in (False, True)
    )
    assert np.mean(adapted**2) < 0.5 * np.mean(fixed**2)

"""Certificates: whatever is loaded is proved, and a controller that flies with it keeps to its limits."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from flatsat_ros.base.resources import config_path
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.law.controller import Controller
from flatsat_ros.law.gain import Tuning
from fuzzing.damage import damaged
from fuzzing.kind import of_file

# position, m, and velocity, m/s, of drones at, near and far from their goals
_STATES = np.array([[0.0] * 6, [0.1, -0.1, 0.2, 0.3, 0.0, -0.3], [1e4, -1e4, 1e4, 1e3, 1e3, -1e3]])


def _law(certificate: Certificate) -> None:
    assert min(certificate.margins().values()) > -1e-9
    controller = Controller(certificate, Tuning(*np.array([2.0, 0.05, 1.0, certificate.gain_max, 0.0])[:, np.newaxis]))
    memory, rest = controller.start(), np.zeros((3, 9))
    for _ in range(3):
        memory, output = controller.step(memory, _STATES, np.zeros(3), rest)
    limits = certificate.limits
    assert np.isfinite(output.input).all()
    assert (output.input[:, 0] <= limits.thrust_max * (1.0 + 1e-9)).all()
    assert (np.abs(output.input[:, 1:]) <= limits.tilt_max * (1.0 + 1e-9)).all()


CERTIFICATE = of_file(
    st.one_of(damaged(config_path(name).read_text(encoding="utf-8")) for name in ("paper_experiment", "cf21_50hz")),
    Certificate.load,
    _law,
    "certificate.yaml",
)

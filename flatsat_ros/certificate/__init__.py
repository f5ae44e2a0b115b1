"""Proofs about a closed loop, their checks, and the file in which they travel. Numpy and PyYAML only."""

from flatsat_ros.certificate.certificate import Certificate, load_certificate
from flatsat_ros.certificate.gain_bounds import continuous_gain_bound, sampled_gain_bound, settling_time_bound
from flatsat_ros.certificate.lyapunov import closed_form_block, hold_gain_interval
from flatsat_ros.certificate.robust import Robust
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.certificate.sets import Membership, Place, Sets

__all__ = [
    "Certificate",
    "Membership",
    "Place",
    "Robust",
    "Sets",
    "Timing",
    "closed_form_block",
    "continuous_gain_bound",
    "hold_gain_interval",
    "load_certificate",
    "sampled_gain_bound",
    "settling_time_bound",
]

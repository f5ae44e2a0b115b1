"""What the controller flies with where nobody says otherwise, as a node and where there is none."""

from __future__ import annotations

from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.policy import Policy
from flatsat_ros.law.gain import Tuning

MU, V_INF, GAMMA_0 = 2.0, 0.05, 1.0  # the paper's Table III
DISTURBANCE_MAX = 0.8  # m/s^2, that is compensated
THRUST_ERROR_MAX = 0.25  # of the thrust, that is corrected


def default_tuning(certificate: Certificate, *, restart: bool = True) -> Tuning:
    """Return the tuning of the gains, up to the certificate's cap; far references restart them, or do not."""
    return Tuning(MU, V_INF, GAMMA_0, certificate.gain_max, restart=restart)


def default_policy(drag: float) -> Policy:
    """Return the policy for drones with a vertical drag over their mass, 1/s."""
    return Policy(disturbance_max=DISTURBANCE_MAX, thrust_error_max=THRUST_ERROR_MAX, drag=drag)

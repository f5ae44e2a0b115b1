"""The parts of which a flight of N drones is put together; each keeps its own state, row by row."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.battery import Batteries
from flatsat_ros.flight.clearance import Clearance
from flatsat_ros.flight.direct_loop import DirectLoop
from flatsat_ros.flight.estimator import Estimator
from flatsat_ros.flight.guidance import Guidance
from flatsat_ros.flight.loops import Loop, PredictedLoop
from flatsat_ros.flight.orientation import Orientations
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.senses import Senses
from flatsat_ros.flight.steering import Steering
from flatsat_ros.flight.supervisor import Supervisor
from flatsat_ros.flight.traffic import Traffic
from flatsat_ros.flight.yaw import YawControl
from flatsat_ros.law.gain import Tuning


class Parts(NamedTuple):
    """What estimates, leads, steers and watches N drones.

    Attributes:
        estimator: the drones' estimates.
        orientations: whose orientation is seen.
        batteries: what is known of their batteries.
        clearance: what keeps drones on the ground.
        supervisor: the flight modes, and what is asked for.
        guidance: the references.
        traffic: who goes where, and who waits for whom.
        senses: the detectors.
        loop: the state on which the law acts, and what is proved of it.
        yaw: the headings.
        steering: the law, its gains and their tuning.
    """

    estimator: Estimator
    orientations: Orientations
    batteries: Batteries
    clearance: Clearance
    supervisor: Supervisor
    guidance: Guidance
    traffic: Traffic
    senses: Senses
    loop: Loop
    yaw: YawControl
    steering: Steering


def put_together(
    certificate: Certificate, tuning: Tuning, policy: Policy, count: int, names: Sequence[str], others: Sequence[str]
) -> Parts:
    """Return the parts of N idle drones; see `Pilot` for the arguments."""
    estimator, supervisor, flight = Estimator(count), Supervisor(policy, count), certificate.flight
    guidance = Guidance(certificate.limits, policy.speed_max, policy.box, count, flight)
    loop: Loop = (
        DirectLoop(certificate, policy, guidance.references, estimator)
        if flight is None
        else PredictedLoop(certificate, flight, policy, guidance.references, estimator)
    )
    return Parts(
        estimator=estimator,
        orientations=Orientations(estimator, policy.yaw_source, count),
        batteries=Batteries(count),
        clearance=Clearance(),
        supervisor=supervisor,
        guidance=guidance,
        traffic=Traffic(policy, guidance, supervisor, names, others),
        senses=Senses(certificate, policy, count),
        loop=loop,
        yaw=YawControl(count),
        steering=Steering(certificate, tuning, count),
    )

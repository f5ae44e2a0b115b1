"""The tuning of the gains as parameters: common to all drones or a drone's own, to be changed in flight."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.defaults import GAMMA_0, MU, V_INF
from flatsat_ros.law.controller import Controller
from flatsat_ros.law.gain import Tuning
from flatsat_ros.nodes.ros import messages
from flatsat_ros.nodes.ros.parameters import declare, declare_override, require_float_or_unset

# parameter, what it means, unit, default and range; Tuning's fields in order
_TUNING = (
    ("mu", "adaptation rate mu of the gain; 0 keeps it constant", "1/s", MU, (0.0, 100.0)),
    ("v_inf", "threshold V_inf below which the gain rests", "", V_INF, (1e-9, 1e9)),
    ("gamma_0", "gain gamma_0 at take-off", "", GAMMA_0, (1.0, 1e6)),
    ("gamma_max", "cap of the gain, at most the certificate's; 0 takes the certificate's", "", 0.0, (0.0, 1e6)),
    ("nu", "leak of the gain toward 1, at most 1/period; 0 is the paper's law", "1/s", 0.0, (0.0, 1e3)),
)


class TuningParameters:
    """The parameters of the tuning, of one node."""

    def __init__(self, node: Node, robots: Sequence[str], certificate: Certificate) -> None:
        """Declare them.

        Raises:
            FlatsatError: a value given at the start is not valid.
        """
        self._node, self._robots, self._certificate = node, robots, certificate
        for name, meaning, unit, default, valid in _TUNING:
            declare(node, name, default, meaning, unit=unit, bounds=valid, changeable=True)
            for robot in robots:
                declare_override(node, f"robots.{robot}.{name}", meaning, unit)
        declare(node, "restart_gain", True, "a far new reference restarts the gain at gamma_0", changeable=True)

    def tuning(self, changed: Mapping[str, object] | None = None) -> Tuning:
        """Return the tuning with some parameters changed; a robot's own value goes over the common one.

        Raises:
            FlatsatError: a value is not valid.
        """
        changes = changed or {}

        def value(name: str) -> float | None:
            found = changes[name] if name in changes else self._node.get_parameter(name).value
            return require_float_or_unset(name, found)

        columns = []
        for name, *_ in _TUNING:
            common = value(name)
            own = [value(f"robots.{robot}.{name}") for robot in self._robots]
            columns.append(np.array([common if entry is None else entry for entry in own], dtype=float))
        mu, v_inf, initial, cap, nu = columns
        cap = np.where(cap == 0.0, self._certificate.gain_max, cap)
        restart = bool(changes.get("restart_gain", self._node.get_parameter("restart_gain").value))
        tuning = Tuning(mu, v_inf, initial, cap, nu, restart)
        Controller(self._certificate, tuning)
        return tuning

    def follow(self, retune: Callable[[Tuning], None]) -> None:
        """From now on check every change, several at once as a whole, and give the tuning that results."""

        def check(parameters: Sequence[Parameter]) -> SetParametersResult:
            for parameter in parameters:
                if parameter.type_ is Parameter.Type.NOT_SET:  # rclpy would forget its declaration
                    kept = f"parameter {parameter.name} cannot be deleted: set it to the common value"
                    return messages.parameters_answer(kept)
            changed = {parameter.name: parameter.value for parameter in parameters}
            try:
                self.tuning(changed)
            except FlatsatError as error:  # the law has other names for some of them
                return messages.parameters_answer(f"{', '.join(changed)} refused: {error}")
            return messages.parameters_answer()

        def take(_: Sequence[Parameter]) -> None:
            retune(self.tuning())

        self._node.add_on_set_parameters_callback(check)
        self._node.add_post_set_parameters_callback(take)

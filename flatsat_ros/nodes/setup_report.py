"""What the controller is set to, as text on a topic that late listeners get, too: recordings and viewers draw by it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter

from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.policy import Policy
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.viewing.recorder import setup_of


class SetupReport:
    """Publishes certificate, limits, box and parameters of a controller, at the start and when a parameter changes."""

    def __init__(self, node: Node, certificate: Certificate, policy: Policy) -> None:
        self._node, self._figures = node, setup_of(certificate, policy)
        topic = interfaces.SETUP
        self._publisher = node.create_publisher(topic.kind, topic.suffix, topic.publish)
        node.add_post_set_parameters_callback(self._publish)
        self._publish(())

    def _publish(self, _: Sequence[Parameter]) -> None:
        parameters: Mapping[str, Any] = self._node.get_parameters_by_prefix("")
        known = {name: entry.value for name, entry in sorted(parameters.items()) if entry.value is not None}
        self._publisher.publish(messages.text_message(json.dumps(known | self._figures)))

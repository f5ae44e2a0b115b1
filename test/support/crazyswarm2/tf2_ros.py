"""As much of tf2_ros as crazyswarm2's Python server imports: it has no wheel. Nobody here listens to what it sends."""

from __future__ import annotations


class TransformBroadcaster:
    """Sends nothing."""

    def __init__(self, node: object) -> None:
        """Take the node that would send."""

    def sendTransform(self, transform: object) -> None:
        """Drop a transform."""

"""The ROS 2 nodes: the only modules that import rclpy and message packages.

Callbacks convert and store, a fixed-rate tick calls the pure step and publishes.
"""

__all__: list[str] = []

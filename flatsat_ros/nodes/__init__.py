"""The ROS 2 nodes: the only modules that import rclpy and message packages.

They know `core` and `sim`: callbacks convert and store, a fixed-rate tick calls the pure step and publishes.
"""

"""The drone that is not there: dynamics, firmware behaviour, sensors and wind.

It knows `core` and no other room; it speaks SI units and no ROS: `nodes.sim_drone` puts it behind topics.
"""

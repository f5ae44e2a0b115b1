"""Certified saturated control of quadcopters in the flat output space, over ROS 2.

Poses come in, an explicit law answers with thrust, roll and pitch, and what makes the answer trustworthy was computed
beforehand and travels in one YAML file, the certificate. The rooms, and who may know whom: `core` (the mathematics)
knows nobody; `synthesis` (offline) and `sim` (the drone that is not there) know `core`; `nodes` (the only ones that
speak ROS) know `sim` and `core`; `cli` stands on top.
"""

__version__ = "0.1.0"

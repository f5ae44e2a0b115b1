"""Certified saturated control of quadcopters in the flat output space, over ROS 2.

Poses come in, an explicit law answers with thrust, roll and pitch, and what makes the answer trustworthy was computed
beforehand and travels in one YAML file, the certificate. The rooms of the package, and which may know which, are drawn
in docs/architecture.md and stated by test/test_layering.py.
"""

__version__ = "0.1.0"

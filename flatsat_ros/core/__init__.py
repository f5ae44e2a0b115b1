"""The mathematics of the flight: numpy and PyYAML only, pure functions and small frozen dataclasses.

Nothing here imports ROS, scipy, cvxpy or another room of the package, so that the same code serves the node, the
simulator, the reproduction of the paper and the tests.
"""

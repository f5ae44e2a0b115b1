"""What every room stands on: errors, checks, arrays, constants, the packaged files. Numpy and PyYAML only."""

from flatsat_ros.base.arrays import BoolArray, FloatArray, IntArray, finite_array
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError, require, require_positive
from flatsat_ros.base.resources import config_path

__all__ = [
    "GRAVITY",
    "BoolArray",
    "FlatsatError",
    "FloatArray",
    "IntArray",
    "config_path",
    "finite_array",
    "require",
    "require_positive",
]

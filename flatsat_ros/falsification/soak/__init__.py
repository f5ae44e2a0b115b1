"""A long flight of real processes, watched for what grows: memory, descriptors, threads, shared memory; ticks missed.

processes -> samples (usage) -> what grew, and what is left behind (verdict)
"""

from flatsat_ros.falsification.soak.flight import fly
from flatsat_ros.falsification.soak.usage import ProcessUsage, sample
from flatsat_ros.falsification.soak.verdict import Soak, summary

__all__ = ["ProcessUsage", "Soak", "fly", "sample", "summary"]

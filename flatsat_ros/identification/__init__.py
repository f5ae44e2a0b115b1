"""What recordings and flights tell about a vehicle and its motion capture.

What is imported here needs numpy only; `identified`, which fits flight logs, and what it stands on need scipy, too.
"""

from flatsat_ros.identification.recording import Recording, read_csv

__all__ = ["Recording", "read_csv"]

"""Ordinary flights, drawn at random, in which nothing is broken: what detectors find there is a false alarm.

`drawn` has what a flight is made of, `flight` flies it, `sayings` judges what was said.
"""

from flatsat_ros.falsification.ordinary.drawn import Drawn
from flatsat_ros.falsification.ordinary.flight import Flown, OrdinaryFlight, Said
from flatsat_ros.falsification.ordinary.sayings import alarms

__all__ = ["Drawn", "Flown", "OrdinaryFlight", "Said", "alarms"]

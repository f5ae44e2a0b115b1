"""What was flown, made visible: flights read from any bag, their figures, and a page that needs no network.

read_flight(path)  or  Recorder(...).flight(title)  -> Flight -> report(flight)  -> one HTML file
"""

from flatsat_ros.viewing.bag import read_flight
from flatsat_ros.viewing.figures import figures_of
from flatsat_ros.viewing.flight import Channel, Flight, LoggedEvent, Track
from flatsat_ros.viewing.page import report
from flatsat_ros.viewing.recorder import Recorder, setup_of

__all__ = ["Channel", "Flight", "LoggedEvent", "Recorder", "Track", "figures_of", "read_flight", "report", "setup_of"]

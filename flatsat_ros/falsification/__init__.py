"""Campaigns of closed loops that try to break what certificates claim. Numpy only."""

from flatsat_ros.falsification.campaigns import CAMPAIGNS, CampaignOutcome, run
from flatsat_ros.falsification.claims import Violation

__all__ = ["CAMPAIGNS", "CampaignOutcome", "Violation", "run"]

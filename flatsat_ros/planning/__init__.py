"""References made offline: splines through way-points."""

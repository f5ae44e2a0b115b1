"""Campaigns of closed loops that try to break what certificates claim. Numpy only."""

"""Proofs about a closed loop, their checks, and the file in which they travel. Numpy and PyYAML only."""

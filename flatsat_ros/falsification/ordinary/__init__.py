"""Ordinary flights, drawn at random, in which nothing is broken: what detectors find there is a false alarm.

`drawn` has what a flight is made of, `flight` flies it, `sayings` judges what was said.
"""

"""The command lines: argparse shells over `synthesis`, `sim` and `core`, with progress, tables and pictures.

Nothing imports them. They import no ROS themselves; the one that needs a node imports it where it is used.
"""

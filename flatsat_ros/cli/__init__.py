"""The command lines: argparse shells with arguments, progress and exit codes; what they compute stands in other rooms.

Nothing imports them. They import no ROS themselves; the one that needs a node imports it where it is used.
"""

__all__: list[str] = []

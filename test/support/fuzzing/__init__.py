"""Inputs that nobody in their right mind would give, for everything that reads what others wrote.

Each kind of input has a file here: how such inputs are made, and what must hold whatever they are. The tests try a few
of each, the same ones every time; `make fuzz` tries as many as there is time for, new ones every time.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec

from fuzzing.kind import Kind

# by kind: the module that has it, and what that needs beside numpy and PyYAML
MODULES = {
    "certificate": ("certificate", ""),
    "vehicle": ("vehicle", ""),
    "crazyflies": ("crazyflies", ""),
    "recording": ("recording", ""),
    "plan": ("plan", ""),
    "mission": ("mission", "scipy"),
    "log": ("log", ""),
    "columns": ("columns", ""),
    "waypoints": ("waypoints", "scipy"),
    "browser": ("browser", ""),
    "mcap": ("bag", "rclpy"),
    "db3": ("bag", "rclpy"),
    "metadata": ("bag", "rclpy"),
    "flight": ("flight", "rclpy"),
    "cdr": ("cdr", "rclpy"),
    "controller": ("controller", "rclpy"),
    "console": ("console", "rclpy"),
    "simulation": ("simulation", "rclpy"),
    "relay": ("relay", "rclpy"),
    "parameters": ("parameters", "rclpy"),
    "crtp": ("bridge", "cflib"),
    "bridge": ("bridge", "cflib"),
}


def kind_of(name: str) -> Kind:
    """Return a kind by its name; what it needs must be installed."""
    module, _ = MODULES[name]
    kind: Kind = getattr(import_module(f"fuzzing.{module}"), name.upper())
    return kind


def is_available(name: str) -> bool:
    """Tell whether what a kind needs is installed."""
    _, needed = MODULES[name]
    return not needed or find_spec(needed) is not None

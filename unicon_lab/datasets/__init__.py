"""Data sets for learning, made of recordings: LeRobot's format, for `unicon bag export`."""

__all__ = ["WRITERS"]

WRITERS = ("auto", "own", "lerobot")
"""Who writes: LeRobot's package where it is installed and we may, ourselves, or the package."""

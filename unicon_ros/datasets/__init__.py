"""Data sets for learning, made of recordings: LeRobot's format, for `unicon bag export`."""

"""Faults that are put into real runs, and what the motors still got: `unicon bench faults`."""

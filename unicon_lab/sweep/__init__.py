"""Thousands of rollouts of a workflow, each with values of its own; for `unicon sweep`."""

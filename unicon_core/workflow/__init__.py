"""Workflows: YAML to a built graph, for the command line and the node."""

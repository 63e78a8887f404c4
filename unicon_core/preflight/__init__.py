"""Preflight: a look at the live robot that sends nothing, and a first small move of each joint."""

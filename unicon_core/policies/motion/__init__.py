"""Motions that a policy follows: reading their files, and comparing the robot with them."""

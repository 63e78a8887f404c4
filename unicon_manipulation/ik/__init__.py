"""Inverse kinematics, step by step: joints that bring end effectors to targets, for `reach`."""

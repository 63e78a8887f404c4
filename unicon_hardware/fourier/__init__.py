"""Fourier's FSA actuators, one address each: what is sent to them, and their answers."""

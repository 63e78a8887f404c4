"""Diagnosis: which cause explains that a recorded robot moves unlike its simulation."""

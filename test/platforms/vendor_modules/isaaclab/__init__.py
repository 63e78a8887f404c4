"""Stand-in for Isaac Lab 2.3.2; see `lab.py`."""

QUAT = "wxyz"
"""Or xyzw, as 3.0.0 tells it."""

SINGLE = True
"""One context in a process, as it is; the conformance suite holds several beside each other."""

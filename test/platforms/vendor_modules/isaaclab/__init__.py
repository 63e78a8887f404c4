"""Stand-in for Isaac Lab 2.3.2; see `lab.py`."""

# Or xyzw, as 3.0.0 tells it.
QUAT = "wxyz"

# One context in a process, as it is; the conformance suite holds several beside each other.
SINGLE = True

"""Runtime: pacing, statistics, trace and report of a running graph."""

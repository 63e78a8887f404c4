"""Benchmarks: side by side comparisons of ours with the usual way, for `unicon bench`."""

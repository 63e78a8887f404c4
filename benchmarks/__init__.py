"""Benchmarks that are not shipped: `unicon bench NAME` finds them beside a checkout."""

"""Stand-in for Isaac Gym Preview 4."""

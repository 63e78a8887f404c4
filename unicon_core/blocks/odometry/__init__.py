"""Odometry from a robot's own sensors, for policies, navigation and reports."""

"""Platforms of real robots, one package for each vendor's protocol.

A driver is a `Wire` (frames in, frames out) behind a `WiredRobot`, which is the platform. What a
robot's motors, topics, ports and modes are stands in its robot file under `transport`, not here.
"""

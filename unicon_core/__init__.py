"""The core of unicon: states, blocks, flow, robots, policies and platforms, without ROS."""

__version__ = "0.1.0"

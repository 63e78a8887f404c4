"""The ROS 2 side of unicon: command line, bridge and node."""

from unicon_base import moved

moved.install()

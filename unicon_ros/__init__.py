"""The ROS 2 side of unicon: command line, bridge and node."""

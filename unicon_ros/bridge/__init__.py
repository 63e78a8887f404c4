"""Bridge: mirrors states to ROS 2 topics and topics to states, for `unicon run` and the node.

Imports rclpy only where a session is made, so that everything else runs without ROS.
"""

from unicon_ros.bridge.session import RosSession

__all__ = ["RosSession"]

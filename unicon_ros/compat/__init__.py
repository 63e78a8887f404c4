"""What differs between ROS 2 distributions and what touches rclpy's private names, in one place.

Everything here has a public way to fall back to, so that a changed rclpy costs speed, not function.
Tried on Jazzy (rclpy 7.1); Humble's (3.3) and Kilted's (9.1) names are taken from their sources.
"""

from unicon_ros.compat.loading import (
    convert_parameters,
    fast_dds_profiles,
    import_rclpy,
    imported_first,
    message_class,
    parameter_given,
    parameters_given,
)
from unicon_ros.compat.made_types import bytes_class
from unicon_ros.compat.services import (
    Responses,
    ReusedWaitSet,
    Transitions,
    incompatible_policy,
    polled_group,
    raw_publish,
    raw_take,
    request_take,
    steady_timer,
    wait_for_readers,
    with_events,
)
from unicon_ros.compat.serving import Piece, Serving

__all__ = [
    "Piece",
    "Responses",
    "ReusedWaitSet",
    "Serving",
    "Transitions",
    "bytes_class",
    "convert_parameters",
    "fast_dds_profiles",
    "import_rclpy",
    "imported_first",
    "incompatible_policy",
    "message_class",
    "parameter_given",
    "parameters_given",
    "polled_group",
    "raw_publish",
    "raw_take",
    "request_take",
    "steady_timer",
    "wait_for_readers",
    "with_events",
]

"""Built-in blocks: postures, commands, predicates and safety, for the `flow:` of a workflow."""

import re

__all__ = ["BUILTIN"]

BUILTIN: dict[str, str] = {
    re.sub("(?<=[a-z])(?=[A-Z])", "_", factory).lower(): f"unicon_core.blocks.{module}:{factory}"
    for module, factories in {
        "postures": ("Pose", "Hold", "Damp", "Sway"),
        "excite": ("Excite",),
        "velocity_command": ("VelocityCommand", "Drive"),
        "controls.gamepad": ("gamepad",),
        "controls.device": ("keyboard",),
        "controls.modes": ("modes",),
        "safety.limits": ("effort_limits", "joint_limits", "rate_limit", "velocity_limits"),
        "safety.ranges": (
            *("action_stop", "command_stop", "hardware_stop", "range_stop"),
            *("ObservationRange", "ObservationStop"),
        ),
        "safety.sensors": ("JointSensorStop",),
        "safety.servo_stops": ("OverrunStop", "PowerStop", "TrackingStop", "TwinStop"),
        "safety.stops": (
            *("ButtonStop", "Commanded", "Elapsed", "Finite", "height_stop", "RemoteStop"),
            *("Settled", "StaleStop", "tilted", "TiltStop", "VelocityStop"),
        ),
        "safety.stuck": ("EncoderStop", "ImuStop"),
        "approach": ("BlendIn", "FadeIn"),
        "forward_command": ("External", "ForwardCommand"),
        "odometry.leg_odometry": ("LegOdometry",),
        "maps": ("copy", "linear_map", "MotorHeat", "projected_gravity"),
        "whole_body.frames": ("Frames", "Gravity", "MovingTarget"),
    }.items()
    for factory in factories
}
"""Block name to `module:factory`, a function or the tick's class; imported when a workflow asks."""

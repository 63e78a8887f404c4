"""Built-in blocks: postures, commands, predicates and safety, for the `flow:` of a workflow."""

import re

__all__ = ["BUILTIN"]

BUILTIN: dict[str, str] = {
    re.sub("(?<=[a-z])(?=[A-Z])", "_", factory).lower(): f"unicon_core.blocks.{module}:{factory}"
    for module, factories in {
        "postures": ("Pose", "Hold", "Damp", "Sway"),
        "excite": ("Excite",),
        "motor_heat": ("MotorHeat",),
        "velocity_command": ("VelocityCommand", "Drive"),
        "controls.gamepad": ("gamepad",),
        "controls.keyboard": ("keyboard",),
        "controls.modes": ("modes",),
        "predicates": ("Commanded", "Elapsed", "Settled", "tilted"),
        "safety.learned": ("action_stop", "ObservationRange", "ObservationStop"),
        "safety.limits": ("effort_limits", "joint_limits", "rate_limit"),
        "safety.overrun": ("OverrunStop",),
        "safety.ranges": ("command_stop", "hardware_stop", "range_stop"),
        "safety.sensors": ("JointSensorStop",),
        "safety.servo_stops": ("PowerStop", "TrackingStop", "TwinStop"),
        "safety.speeds": ("velocity_limits",),
        "safety.stops": (
            *("ButtonStop", "Finite", "height_stop", "RemoteStop"),
            *("StaleStop", "TiltStop", "VelocityStop"),
        ),
        "safety.stuck": ("EncoderStop", "ImuStop"),
        "blend_in": ("BlendIn", "FadeIn"),
        "forward_command": ("ForwardCommand",),
        "odometry.leg_odometry": ("LegOdometry",),
        "projected_gravity": ("projected_gravity",),
        "maps": ("copy", "linear_map"),
        "whole_body.frames": ("Frames",),
        "whole_body.gravity": ("Gravity",),
        "whole_body.moving_target": ("MovingTarget",),
    }.items()
    for factory in factories
}
"""Block name to `module:factory`, a function or the tick's class; imported when a workflow asks."""

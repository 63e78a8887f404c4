"""Built-in blocks: postures, commands, predicates and safety, for the `flow:` of a workflow."""

__all__ = ["BUILTIN"]

BUILTIN: dict[str, str] = {
    name: f"unicon_core.blocks.{module}:{name}"
    for module, names in {
        "pose": ("pose",),
        "hold": ("hold", "damp"),
        "sway": ("sway",),
        "excite": ("excite",),
        "motor_heat": ("motor_heat",),
        "velocity_command": ("velocity_command",),
        "controls.drive": ("drive",),
        "controls.gamepad": ("gamepad",),
        "controls.headset": ("headset_controls",),
        "controls.keyboard": ("keyboard",),
        "controls.modes": ("modes",),
        "teleop.teleop": ("teleop",),
        "predicates": ("commanded", "elapsed", "settled", "tilted"),
        "safety.button_stop": ("button_stop", "remote_stop"),
        "safety.hardware": ("hardware_stop",),
        "safety.learned": ("action_stop", "observation_range", "observation_stop"),
        "safety.limits": ("effort_limits", "joint_limits", "rate_limit"),
        "safety.overrun": ("overrun_stop",),
        "safety.ranges": ("command_stop", "range_stop"),
        "safety.sensors": ("joint_sensor_stop",),
        "safety.servo_stops": ("power_stop", "tracking_stop"),
        "safety.speeds": ("velocity_limits",),
        "safety.stops": ("finite", "height_stop", "stale_stop", "tilt_stop", "velocity_stop"),
        "safety.stuck": ("encoder_stop", "imu_stop"),
        "safety.twin_stop": ("twin_stop",),
        "blend_in": ("blend_in",),
        "fade_in": ("fade_in",),
        "forward_command": ("forward_command",),
        "odometry.leg_odometry": ("leg_odometry",),
        "projected_gravity": ("projected_gravity",),
        "whole_body.reach": ("reach",),
        "retarget": ("retarget",),
        "maps": ("copy", "linear_map"),
        "whole_body.frames": ("frames",),
        "whole_body.gravity": ("gravity",),
        "whole_body.moving_target": ("moving_target",),
    }.items()
    for name in names
}
"""Block name to `module:factory`; a factory is imported when a workflow names it."""

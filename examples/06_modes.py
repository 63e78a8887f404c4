"""Modes: a switch goes from one flow to another, blended, at the wish of a state."""

from unicon_core import Loop, Program, Switch, block, elapsed, policy, pose, run

if __name__ == "__main__":
    mode = block("expression", "tick > 250 and tick < 600")  # false: the first case
    program = Program(
        robot="go2",
        platform="mujoco",
        rate=50,
        policies={"walk": "go2_velocity"},
        commands=[block("velocity_command", constant=[0.4, 0.0, 0.2])],
        flow=Loop(
            Switch(mode, {"stand": pose("stand", duration=30), "walk": policy("walk")}, blend=0.3),
            until=elapsed(14),
        ),
        safety=["finite", "joint_limits", "tilt_stop"],
    )
    x, y, _ = run(program, speed="max").base_displacement_m
    print(f"walked to {x:+.2f} {y:+.2f} m and stood again")

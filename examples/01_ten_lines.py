"""Ten lines: a Go2 in MuJoCo stands up and walks for ten seconds."""

from unicon_core import Chain, Loop, Program, block, elapsed, policy, pose, run

if __name__ == "__main__":
    program = Program(
        robot="go2",
        platform="mujoco",
        rate=50,
        policies={"walk": "go2_velocity"},
        commands=[block("velocity_command", constant=[0.5, 0.0, 0.0])],
        flow=Chain(pose("stand"), Loop(policy("walk"), until=elapsed(10))),
        safety=["finite", "joint_limits", "tilt_stop"],
    )
    print(run(program, speed="max").summary())

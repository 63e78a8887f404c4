"""The workflow `go2_walk` as a program: it sends the same commands, bit-exact."""

from unicon_core import Chain, Loop, Program, block, elapsed, policy, pose, run

SCHEDULE = [  # [s, m/s, m/s, rad/s]
    [0.0, 0.0, 0.0, 0.0],
    [4.0, 0.8, 0.0, 0.0],
    [9.0, 0.5, 0.0, 0.8],
    [13.0, 0.0, 0.3, 0.0],
    [16.0, -0.4, 0.0, 0.0],
    [18.0, 0.0, 0.0, 0.0],
]

if __name__ == "__main__":
    program = Program(
        robot="go2",
        platform="mujoco",  # the one word that changes from simulation to the robot
        scene={"initial_pose": "rest"},
        policies={"walk": "go2_velocity"},
        rate=50,
        duration=60,
        commands=[block("velocity_command", schedule=SCHEDULE)],
        flow=Chain(
            pose("stand", duration=2.0),
            block("hold", duration=0.5),
            Loop(policy("walk"), until=elapsed(17.5)),
            block("hold", duration=0.5),
            pose("rest", duration=2.0),
            block("damp", duration=0.5),
        ),
        safety=["finite", "joint_limits", "tilt_stop"],
    )
    report = run(program, speed="max")
    print(f"sha256_commands {report.sha256_commands}")

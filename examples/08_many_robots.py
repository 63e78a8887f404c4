"""One tick moves many: a batch axis in front of every state."""

from unicon_core import Chain, Loop, Program, block, elapsed, policy, pose, run

if __name__ == "__main__":
    program = Program(
        robot="go2",
        platform="mujoco",
        num_robots=8,
        scene={"seed": 1, "push": {"every": 1.0, "velocity": 0.5}},
        rate=50,
        policies={"walk": "go2_velocity"},
        commands=[block("velocity_command", constant=[0.5, 0.0, 0.0])],
        flow=Chain(pose("stand"), Loop(policy("walk"), until=elapsed(6))),
    )
    run(program, speed="max")
    x = program.states.base_pos_w[:, 0]
    way = ", ".join(f"{value:.1f}" for value in x)
    print(f"{len(x)} robots went {way} m under pushes")

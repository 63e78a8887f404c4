"""Before and after the flow: a gate that must hold before the first tick, and a soft end."""

from unicon_core import Chain, Fault, Loop, Program, block, elapsed, pose, run

if __name__ == "__main__":
    program = Program(
        robot="go2",
        platform="fake",
        rate=100,
        flow=Loop(pose("stand"), until=elapsed(3)),
        wind_down=Chain(pose("rest", duration=2.0), block("damp", duration=0.5)),
    )

    def upright() -> str:
        if program.states.projected_gravity[2] > 0:
            raise Fault("the robot lies on its back; turn it over")
        return ""

    program.gates.append(upright)
    report = run(program, speed="max")
    thigh = program.states.joint_pos[1]
    print(f"{report.ended}; at the end the thigh is at {thigh:.2f} rad")

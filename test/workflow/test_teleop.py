"""Workflows that stay: they stand until commanded, walk, stand again, and end by a stop."""

from __future__ import annotations

import numpy as np
import pytest

from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner, RunOptions
from unicon_core.runtime.phases import Phase
from unicon_core.workflow import HookBlocks, Program, load_workflow

pytest.importorskip("mujoco", reason="these walk in MuJoCo")


@pytest.mark.parametrize("rate", [50, 500])
@pytest.mark.parametrize(
    ("name", "least", "lies"),
    [("go2_teleop", 1.2, True), ("g1_teleop", 1.0, False)],
)
def test_it_stands_walks_and_stands_again(name: str, least: float, lies: bool, rate: int) -> None:
    rows: list[tuple[Phase, float, float, float, float]] = []

    def hook(program: Program) -> HookBlocks:
        states = program.states
        command, pos, target = (
            states[key] for key in ("velocity_command", "base_pos_w", "joint_pos_target")
        )
        before = target.copy()

        def drive() -> None:
            seconds = float(states["tick"]) / rate
            command[...] = (0.5, 0.0, 0.0) if 4.0 <= seconds < 8.0 else 0.0

        def look() -> None:
            step = float(np.abs(target - before).max())
            before[...] = target
            seconds = float(states["tick"]) / rate
            rows.append((runner.phase, seconds, float(pos[0]), float(pos[2]), step))
            if seconds >= 12.0 and runner.phase is Phase.RUN:
                runner.stop()

        drives = Block("drive", drive, reads=("tick",), writes=("velocity_command",))
        return {Stage.COMMAND: [drives], Stage.OBSERVE: [Block("look", look)]}

    try:
        program = load_workflow(name, {"rate": rate}, hooks=[hook])
    except Exception as error:
        if name == "g1_teleop" and "assets" in str(error):
            pytest.skip(str(error))
        raise
    runner = Runner(program, RunOptions(speed="max"))
    report = runner.run()
    assert (report.faults, report.ended, report.fell) == ([], "stopped", False)

    def at(seconds: float) -> tuple[float, float]:
        row = next(row for row in rows if row[1] >= seconds)
        return row[2], row[3]

    stood, walked, stands = at(3.9), at(9.5), at(11.9)
    assert walked[0] - stood[0] > least
    assert abs(stands[0] - walked[0]) < 0.1  # stands again
    assert abs(stands[1] - stood[1]) < 0.03
    # What is sent goes over from one to the other without a jump, at any rate.
    calm = [row for row in rows if row[0] is Phase.RUN and (1.0 < row[1] < 4.0 or row[1] > 10.0)]
    assert max(row[4] for row in calm) < 0.05
    ends = [row for row in rows if row[0] is Phase.SOFT]
    assert 0 < len(ends) <= 5 * rate
    assert (ends[-1][3] < 0.6 * stood[1]) == lies

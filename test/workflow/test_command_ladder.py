"""A robot without commands stands, then lies down: the ladder of docs/explanation/safety.md."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow

WORKFLOW = """\
robot: go2
platform: fake
rate: 50
policies: {walk: go2_velocity}
commands:
  - velocity_command: {schedule: [[0, 0, 0, 0], [5, 0.5, 0, 0], [10, 0, 0, 0]]}
"""


def ladder() -> str:
    """Return the flow of docs/explanation/safety.md, with less patience."""
    text = (Path(__file__).parents[2] / "docs" / "explanation" / "safety.md").read_text(
        encoding="utf-8"
    )
    (flow,) = [block for block in text.split("```") if "commanded: {hold: 30.0}" in block]
    return flow.removeprefix("yaml").replace("hold: 30.0", "hold: 3.0")


def test_who_is_not_commanded_stands_and_then_lies_down(tmp_path: Path) -> None:
    path = tmp_path / "ladder.yaml"
    path.write_text(WORKFLOW + ladder(), encoding="utf-8")
    program = load_workflow(path)
    runner = Runner(program, RunOptions(speed="max"))
    states, robot = program.states, program.robot
    postures = {"rest": robot.rest_joint_pos, "stand": robot.default_joint_pos}
    seen = {}
    for second in (4, 6, 9, 12.5, 18):
        while int(states.tick) < 50 * second:
            runner.tick(0)
        at = [name for name, pos in postures.items() if np.abs(states.joint_pos - pos).max() < 0.02]
        seen[second] = (*at, "limp") if not states.joint_stiffness.any() else (*at,)
    runner.close()
    rising, walking = (), ()
    assert seen == {
        4: ("rest", "limp"),
        6: rising,
        9: walking,
        12.5: ("stand",),
        18: ("rest", "limp"),
    }

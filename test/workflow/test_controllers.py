"""Controllers that are not networks: what a workflow asks of them is what it asks of a policy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import WorkflowError
from unicon_core.blocks.postures import JointCommand
from unicon_core.check import check_workflow
from unicon_core.flow import Reads, as_block
from unicon_core.policies.controller import controller_contract
from unicon_core.robots import Robot, load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow

GO2 = load_robot("go2")


@dataclass
class Reach:
    """What a controller says of itself."""

    name: str = "reach"
    period: Any = 0.02
    joints: tuple[str, ...] = GO2.joint_names
    default_joint_pos: Any = field(default_factory=lambda: GO2.default_joint_pos)
    command_ranges: Any = field(default_factory=lambda: {"lin_vel_x": (-0.1, 0.2)})


def reach(
    command: JointCommand,
    velocity_command: Reads,
    *,
    robot: Robot,
    period_: Any = 0.02,
    joints_: list[str] = list(GO2.joint_names),  # noqa: B006
) -> Any:
    """Move all joints by the command, with gains of its own."""
    pose = GO2.default_joint_pos[: 12 if len(joints_) == 12 else 1]
    gains = np.full(robot.num_joints, 20.0, np.float32)

    class Tick:
        contract = Reach(period=period_, joints=tuple(joints_), default_joint_pos=pose)
        calls = 0

        def __call__(self) -> None:
            self.calls += 1
            command.joint_pos_target[...] = command.joint_pos + 0.0 * velocity_command[0]
            command.joint_vel_target[...] = 0.0
            command.joint_effort_ff[...] = 0.0
            command.joint_stiffness[...] = gains
            command.joint_damping[...] = 1.0

    return Tick()


def partial(joint_pos: Reads) -> Callable[[], bool]:
    """A block whose contract says next to nothing."""

    def tick() -> bool:
        return False

    tick.contract = {"period": 0.02}  # type: ignore[attr-defined]
    return tick


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))

    def write(rate: int = 50, call: str = "reach", more: str = "") -> Path:
        path = tmp_path / "w.yaml"
        path.write_text(
            "robot: go2\nplatform: fake\n"
            f"rate: {rate}\n"
            "commands: [{velocity_command: {constant: [3.0, 0, 0]}}]\n"
            f"flow: {{call: {{function: 'test_controllers:{call}'{more}}}}}\n"
        )
        return path

    return write


def test_a_faster_workflow_runs_it_at_its_period_and_holds_the_command(
    write: Callable[..., Path],
) -> None:
    workflow = load_workflow(write(rate=100))
    told: list[str] = []
    runner = Runner(workflow, RunOptions(speed="max", warn=told.append))
    for _ in range(6):
        runner.tick(0)
    tick: Any = next(b.tick for b in workflow.blocks if hasattr(b.tick, "contract"))
    assert tick.calls == 3
    assert workflow.states.velocity_command[0] == np.float32(0.2)
    assert workflow.command_bounds[0].sources[1] == ("command_ranges of controller 'reach'")
    runner.close()


def test_a_rate_that_does_not_fit_is_refused(write: Callable[..., Path]) -> None:
    with pytest.raises(
        WorkflowError, match="block 'call': reach is made for 50 Hz, which does not"
    ):
        load_workflow(write(rate=60))


@pytest.mark.parametrize(
    ("said", "wrong"),
    [
        ({"command_ranges": None}, "says command_ranges None"),
        ({"command_ranges": {"lin_vel_x": 0.5}}, "says command_ranges {'lin_vel_x': 0.5}"),
        ({"joints": None}, "has 12 positions for 1 joints"),
        ({"default_joint_pos": 0.0}, "has 1 positions for 12 joints"),
    ],
)
def test_what_does_not_fit_together_is_refused(said: dict[str, Any], wrong: str) -> None:
    def tick() -> None: ...

    tick.contract = Reach(**said)  # type: ignore[attr-defined]
    with pytest.raises(WorkflowError) as caught:
        controller_contract(as_block(tick, name="reach"))
    assert str(caught.value).startswith(f"block 'reach': its contract {wrong}; a controller says ")


@pytest.mark.parametrize("period", [0.0, -1.0, float("nan"), float("inf"), "'x'"])
def test_a_period_that_is_not_a_time_is_refused(write: Callable[..., Path], period: Any) -> None:
    value = {"nan": ".nan", "inf": ".inf"}.get(str(period), period)
    with pytest.raises(WorkflowError, match="block 'call': its contract says period"):
        load_workflow(write(more=f", period_: {value}"))


def test_a_contract_that_leaves_something_out_is_refused(write: Callable[..., Path]) -> None:
    with pytest.raises(WorkflowError) as caught:
        load_workflow(write(call="partial"))
    assert str(caught.value).endswith(
        "w.yaml:5: block 'call': its contract does not say name, period, joints, "
        "default_joint_pos, command_ranges; a controller says name, period, joints, "
        "default_joint_pos, command_ranges, the period in [s] above 0, one position in [rad] for "
        "each joint, ranges as (lowest, highest)"
    )


def test_the_check_asks_where_it_begins(write: Callable[..., Path]) -> None:
    result = check_workflow(write())
    culprits = [note.culprit for note in result.notes if note.code == "pose.start"]
    assert culprits == ["controller 'reach'"]


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (", joints_: [waist]", "robot go2 has no joint 'waist'; "),
        (", joints_: [FR_hip_joint, waist]", "its contract has 1 positions for 2 joints; "),
    ],
)
def test_joints_that_do_not_fit_are_refused(
    write: Callable[..., Path], more: str, message: str
) -> None:
    with pytest.raises(WorkflowError, match=f"block 'call': {message}"):
        load_workflow(write(more=more))

"""No command beyond what policy or robot file allow reaches the flow, from any source."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from unicon_base.errors import RobotError, WorkflowError
from unicon_base.resources import find_config
from unicon_core.check import check_workflow
from unicon_core.flow import Block, Stage
from unicon_core.flow.block import Amends, Reads, Tick, Writes
from unicon_core.policies.controller import PrefixedStates
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import Layout, States, standard_states
from unicon_core.workflow import HookBlocks, Program, load_workflow

SWAY = """\
schema: unicon.workflow/1
robot: go2
platform: fake
rate: 50
flow: {sway: {gains: {"*_hip_joint": [1.0, 0, 0]}, time_constant: 0.0}}
"""
WALK = """\
schema: unicon.workflow/1
robot: go2
platform: mujoco
policies: {walk: go2_velocity}
flow: {policy: walk}
"""
CAUTIOUS = "neither policy nor go2.yaml has command_ranges"
OF_WALK = "command_ranges of policy 'walk'"


def full_speed(velocity_command: Amends) -> Tick:
    """Somebody's own block."""

    def step() -> None:
        velocity_command[...] = (50.0, -1e30, 2.0)

    return step


def lean(velocity_command: Reads, lean: Writes) -> Tick:
    """Somebody's own block that makes another command of it."""

    def step() -> None:
        lean[...] = velocity_command[0]

    return step


class Seen:
    """What the flow got, tick by tick, and what was told."""

    def __init__(self, tmp_path: Path, text: str, overrides: dict[str, Any], source: Any = None):
        path = tmp_path / "bounded.yaml"
        path.write_text(text)
        self.told: list[str] = []

        def hook(workflow: Program) -> HookBlocks:
            command = workflow.states.velocity_command

            def give() -> None:
                command[...] = source(int(workflow.states.tick))

            return {Stage.INPUT: [Block("source", give, writes=("velocity_command",))]}

        self.program = load_workflow(path, overrides, hooks=[] if source is None else [hook])
        self.runner = Runner(self.program, RunOptions(speed="max", warn=self.told.append))

    def after(self, ticks: int) -> list[float]:
        """Return the command after so many ticks."""
        for _ in range(ticks):
            self.runner.tick(0)
        return [round(v, 6) for v in self.program.states.velocity_command.tolist()]


@pytest.fixture
def seen(tmp_path: Path) -> Any:
    made: list[Seen] = []

    def make(text: str, overrides: dict[str, Any] | None = None, source: Any = None) -> Seen:
        made.append(Seen(tmp_path, text, overrides or {}, source))
        return made[-1]

    yield make
    for each in made:
        each.runner.close()


SCRIPT = [{"velocity_command": {"constant": [50.0, -50.0, 50.0]}}]


def test_a_script_is_held_to_the_policys_ranges_and_told_once(seen: Callable[..., Seen]) -> None:
    run = seen(WALK, {"commands": SCRIPT})
    assert run.after(100) == [1.0, -0.4, 1.0]
    assert run.told == [
        f"velocity_command vx is 50, held to 1 m/s ({OF_WALK})",
        f"velocity_command vy is -50, held to -0.4 m/s ({OF_WALK})",
        f"velocity_command wz is 50, held to 1 rad/s ({OF_WALK})",
    ]


def test_without_anybodys_ranges_cautious_ones_hold(seen: Callable[..., Seen]) -> None:
    run = seen(SWAY, {"commands": SCRIPT})
    assert run.after(3) == [1.0, -0.5, 1.0]
    assert run.told[0] == f"velocity_command vx is 50, held to 1 m/s ({CAUTIOUS})"


def test_a_block_of_ones_own_is_bounded_before_and_within_the_flow(
    seen: Callable[..., Seen],
) -> None:
    own = {"call": {"function": f"{__name__}:full_speed"}}
    assert seen(SWAY, {"commands": [own]}).after(3) == [1.0, -0.5, 1.0]
    sway = yaml.safe_load(SWAY)["flow"]
    inside = seen(SWAY, {"flow": {"zip": [own, sway]}})
    assert inside.after(3) == [1.0, -0.5, 1.0]
    targets = inside.program.states.joint_pos_target
    go2 = load_robot("go2")
    assert np.abs(targets - go2.default_joint_pos).max() <= 1.0 + 1e-6


def test_a_block_that_reads_it_among_the_commands_gets_it_bounded(
    seen: Callable[..., Seen],
) -> None:
    reader = {"call": {"function": f"{__name__}:lean"}}
    run = seen(SWAY, {"commands": [*SCRIPT, reader], "states": {"lean": {"shape": [1]}}})
    run.after(3)
    assert run.program.states.lean.tolist() == [1.0]


def test_the_robot_file_is_asked_where_the_policy_says_nothing(
    seen: Callable[..., Seen], tmp_path: Path
) -> None:
    text = find_config("robots", "go2", ".yaml").read_text("utf-8")
    text = text.replace("name: go2\n", "name: slow\n", 1)
    text = text.replace(
        "unknown: []", "command_ranges: {vx: [-0.2, 0.3], wz: [0, 0.1]}\nunknown: []"
    )
    text = text.replace("sources:\n", "sources:\n  command_ranges: made up\n", 1)
    (tmp_path / "slow.yaml").write_text(text)
    run = seen(SWAY, {"commands": SCRIPT, "robot": "./slow.yaml"})
    assert run.after(3) == [0.3, -0.5, 0.1]
    assert "vx is 50, held to 0.3 m/s (command_ranges of robot slow)" in run.told[0]
    (tmp_path / "slow.yaml").write_text(text.replace("[-0.2, 0.3]", "[0.2, 0.3]"))
    with pytest.raises(RobotError, match=r"vx is \[0\.2, 0\.3\]; write \[lowest, highest\] with 0"):
        load_robot(tmp_path / "slow.yaml")


def test_of_several_policies_the_tightest_holds_and_zero_is_always_allowed() -> None:
    from unicon_core.workflow.program_data import command_bounds

    class Contract:
        def __init__(self, **ranges: tuple[float, float]) -> None:
            self.command_ranges = ranges

    readers: Any = [
        ("policy 'run'", Contract(lin_vel_x=(0.5, 3.0), lin_vel_y=(-0.1, 0.1))),
        ("policy 'walk'", Contract(lin_vel_x=(0.25, 0.75), ang_vel_z=(-math.inf, math.inf))),
    ]
    vx, vy, wz = command_bounds(readers, load_robot("go2"))
    assert (vx.low, vx.high, vx.sources[1]) == (0.0, 0.75, OF_WALK)
    assert (vy.low, vy.high, vy.given) == (np.float32(-0.1), np.float32(0.1), True)
    assert (wz.low, wz.high, wz.given) == (-1.0, 1.0, False)


def test_what_is_not_finite_commands_nothing_and_is_told(seen: Callable[..., Seen]) -> None:
    values = {0: (0.3, 0.1, math.nan), 1: (math.inf, 0.1, 0.0), 2: (0.3, 0.1, 0.0)}
    run = seen(SWAY, source=lambda tick: values[tick])
    assert run.after(1) == [0.0, 0.0, 0.0]
    assert run.after(1) == [0.0, 0.0, 0.0]
    assert run.after(1) == [0.3, 0.1, 0.0]
    assert run.told == [
        "velocity_command wz is nan: the whole command is zero",
        "velocity_command vx is inf: the whole command is zero",
    ]


def test_an_episode_is_told_once_and_the_next_one_again(seen: Callable[..., Seen]) -> None:
    # Out and in by turns for 2 s, then within for 3 s, then out: of 50 Hz.
    run = seen(
        SWAY, source=lambda tick: (9.0 * (tick % 2) if tick < 100 or tick > 250 else 0, 0, 0)
    )
    run.after(100)
    assert len(run.told) == 1
    run.after(200)
    assert len(run.told) == 2


def test_what_is_within_its_bounds_keeps_every_bit(seen: Callable[..., Seen]) -> None:
    rng = np.random.default_rng(7)
    given = rng.uniform((-1.0, -0.5, -1.0), (1.0, 0.5, 1.0), (50, 3)).astype(np.float32)
    run = seen(SWAY, source=lambda tick: given[tick])
    for row in given:
        run.after(1)
        assert run.program.states.velocity_command.tobytes() == row.tobytes()
    assert run.told == []


def test_check_notes_who_has_no_ranges(tmp_path: Path) -> None:
    path = tmp_path / "sway.yaml"
    path.write_text(SWAY)
    (note,) = [note for note in check_workflow(path).notes if note.code == "command.bounds"]
    assert "vx to -1…1 m/s, vy to -0.5…0.5 m/s, wz to -1…1 rad/s" in note.evidence
    assert "give command_ranges in policy.yaml" in note.remedy
    path.write_text(WALK)
    assert not [note for note in check_workflow(path).notes if note.code == "command.bounds"]


@pytest.mark.ros
@pytest.mark.timeout(60)
def test_a_topic_is_bounded_and_told_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ros_attack = pytest.importorskip("ros_attack")
    from geometry_msgs.msg import Twist

    from unicon_ros.bench.report import free_domain

    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain()))
    path = tmp_path / "sway.yaml"
    path.write_text(SWAY)
    with ros_attack.running(path) as run:
        told: list[str] = []
        run.program.warn = told.append
        publisher = run.session.node.create_publisher(Twist, "cmd_vel", 10)
        twist = Twist()
        twist.linear.x, twist.angular.z = 1e30, -50.0
        targets, default = run.program.states.joint_pos_target, load_robot("go2").default_joint_pos

        def driven() -> bool:
            publisher.publish(twist)
            return len(told) == 2

        ros_attack.wait_for(driven, "the bounds")
        ticks = run.runner.statistics.count
        ros_attack.wait_for(lambda: run.runner.statistics.count > ticks + 5, "ticks")
        assert np.abs(targets - default).max() <= 1.0 + 1e-6
        assert run.end().faults == []
    assert told == [
        f"velocity_command vx is 1e+30, held to 1 m/s ({CAUTIOUS})",
        f"velocity_command wz is -50, held to -1 rad/s ({CAUTIOUS})",
    ]


ODD = """
robot: go2
platform: fake
rate: 50
flow: {flow}
"""


def hurry(velocity_command: Amends) -> Callable[[], bool]:
    """A condition that commands beside it."""

    def tick() -> bool:
        velocity_command[...] = 50.0
        return True

    return tick


@pytest.mark.parametrize(
    "flow",
    [
        "{when: {if: {call: {function: 'HERE:hurry'}}, do: SWAY}}",
        "{loop: {do: SWAY, until: {call: {function: 'HERE:hurry'}}}}",
        "{switch: {on: {call: {function: 'HERE:hurry'}}, cases: {a: SWAY, b: hold}}}",
    ],
)
def test_a_condition_that_gives_commands_is_refused_by_name(tmp_path: Path, flow: str) -> None:
    path = tmp_path / "odd.yaml"
    sway = "{sway: {gains: {'*_hip_joint': [0.1, 0.1, 0.1]}}}"
    text = flow.replace("HERE", __name__).replace("SWAY", sway)
    path.write_text(ODD.format(flow=text), encoding="utf-8")
    with pytest.raises(WorkflowError, match="chooses what runs and writes 'velocity_command'"):
        load_workflow(path)


def test_a_policy_of_several_reads_the_bounded_command_whatever_else_is_declared() -> None:
    robot = load_robot("go2")
    specs = standard_states(robot.joint_names)
    states = States(Layout({**specs, "walk_velocity_command": specs["velocity_command"]}))
    seen = PrefixedStates(states, "walk_")
    seen["velocity_command"][...] = 7.0
    assert states["velocity_command"].tolist() == [7.0, 7.0, 7.0]
    assert seen.offset("velocity_command") == states.offset("velocity_command")


@pytest.mark.parametrize("num_robots", [1, 3])
def test_every_robot_of_a_batch_is_held_to_the_bounds(tmp_path: Path, num_robots: int) -> None:
    path = tmp_path / "batch.yaml"
    path.write_text(SWAY)

    def hook(workflow: Program) -> HookBlocks:
        command = workflow.states.velocity_command

        def give() -> None:
            command[...] = 0.5
            command[-1] = (50.0, -1e30, 0.1)

        return {Stage.INPUT: [Block("source", give, writes=("velocity_command",))]}

    workflow = load_workflow(path, {"num_robots": num_robots}, hooks=[hook])
    told: list[str] = []
    runner = Runner(workflow, RunOptions(speed="max", warn=told.append))
    runner.tick(0)
    command = workflow.states.velocity_command
    assert command.shape == (num_robots, 3)
    assert command[-1].tolist() == pytest.approx([1.0, -0.5, 0.1])
    if num_robots > 1:
        assert command[0].tolist() == [0.5, 0.5, 0.5]
    assert len(told) == 2
    runner.close()

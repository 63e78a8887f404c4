"""Where a flow begins, and its first command: asked for without moving anything."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from gate_robots import waiting

from unicon_base.errors import Fault
from unicon_core import Chain, Loop, Program, Zip, block, elapsed, policy, pose
from unicon_core.flow import Block, Switch
from unicon_core.gates.build import beginning, first_command
from unicon_core.states.standard import COMMAND_STATES

ROBOT = "gate_robots:make"
OFF = 0.3


def _idle() -> None:
    """A block that does not act."""


def program_of(flow: Any, **described: Any) -> Program:
    """Build a Go2 that was received from, 0.3 rad away from its default pose."""
    keys = {"policies": {"walk": "go2_velocity"}} | described
    program = Program(
        robot="go2",
        platform=ROBOT,
        platforms={ROBOT: {"pose": OFF}},
        rate=50,
        flow=flow,
        **keys,
    )
    waiting(program)()
    return program


def test_a_policy_begins_at_its_default_pose_with_its_gains() -> None:
    program = program_of(policy("walk"))
    contract, target = program.policies["walk"], beginning(program)
    own = [program.robot.joint_names.index(name) for name in contract.joints]
    np.testing.assert_array_equal(target.joint_pos[own], contract.default_joint_pos)
    np.testing.assert_array_equal(target.stiffness[own], contract.stiffness)
    np.testing.assert_array_equal(target.damping[own], contract.damping)
    assert target.source == "the default pose of 'go2_velocity'"


@pytest.mark.parametrize(
    "flow",
    [
        Chain(Loop(policy("walk"), until=elapsed(2)), pose("rest")),
        Zip(_idle, Loop(Chain(policy("walk")))),
        Switch(lambda: "b", {"a": pose("stand"), "b": policy("walk")}),
    ],
)
def test_the_first_that_acts_is_found_in_a_tree(flow: Any) -> None:
    assert beginning(program_of(flow)).source == "the default pose of 'go2_velocity'"


@pytest.mark.parametrize("first", ["pose", "hold", "damp"])
def test_postures_begin_wherever_the_robot_is(first: str) -> None:
    program = program_of(Chain(block(first, duration=1.0), policy("walk")))
    target = beginning(program)
    np.testing.assert_array_equal(target.joint_pos, program.states.joint_pos)
    stiff = program.robot.joint_stiffness
    np.testing.assert_array_equal(target.stiffness, 0 * stiff if first == "damp" else stiff)


def test_joints_that_a_controller_does_not_know_stay_where_they_are() -> None:
    class Partial:
        name, period = "legs", 0.02
        joints = ("FL_hip_joint",)
        default_joint_pos = np.array([0.5])
        command_ranges = MappingProxyType({})

    class Controller:
        contract = Partial()
        writes = COMMAND_STATES

        def __call__(self) -> None: ...

    program = program_of(Controller(), policies={})
    target, place = beginning(program), program.robot.joint_names.index("FL_hip_joint")
    assert target.joint_pos[place] == 0.5
    others = np.arange(12) != place
    np.testing.assert_array_equal(target.joint_pos[others], program.states.joint_pos[others])
    np.testing.assert_array_equal(target.stiffness, program.robot.joint_stiffness)


def test_any_other_block_begins_with_its_first_command() -> None:
    program: Program

    def wave() -> None:
        program.states.joint_pos_target[...] = 0.25
        program.states.joint_stiffness[...] = 20.0

    program = program_of(Block("wave", wave, writes=COMMAND_STATES), safety={"only": ["finite"]})
    assert beginning(program).joint_pos.tolist() == [0.25] * 12
    assert beginning(program).stiffness.tolist() == [20.0] * 12


def test_the_first_command_is_that_of_a_run_and_leaves_no_trace() -> None:
    program = program_of(policy("walk"), start="none")  # else it comes in slowly
    program.states.action[...] = 0.125  # which a policy that is made fresh sets to 0
    before = program.states.buffer.copy()
    first, again = first_command(program), first_command(program)
    np.testing.assert_array_equal(first.joint_pos, again.joint_pos)  # its memory is fresh again
    np.testing.assert_array_equal(program.states.buffer, before)
    assert np.abs(first.joint_pos - program.states.joint_pos).max() > 0.05

    from unicon_core.runtime import Runner

    runner = Runner(program)  # the first tick of a run does the same
    runner.graph.step()
    np.testing.assert_allclose(program.states.joint_pos_target, first.joint_pos, atol=0.05)


def test_a_block_that_declares_no_memory_is_fresh_after_the_first_command() -> None:
    program: Program

    class Ramp:
        ticks = 0

        def __call__(self) -> None:
            self.ticks += 1
            program.states.joint_pos_target[...] = 0.125 * self.ticks

        def reset(self) -> None:
            self.ticks = 0

    ramp = Ramp()
    program = program_of(
        Block("ramp", ramp, writes=COMMAND_STATES, reset=ramp.reset), safety={"only": ["finite"]}
    )
    assert [first_command(program).joint_pos[0] for _ in range(2)] == [0.125, 0.125]
    assert ramp.ticks == 0


def test_a_fault_of_the_first_command_is_told_and_the_states_are_put_back() -> None:
    program = program_of(policy("walk"))
    program.states.base_ang_vel[0] = np.nan
    with pytest.raises(Fault, match="the observation is not finite"):
        first_command(program)
    assert program.states.joint_pos_target.tolist() == [0.0] * 12

"""The node's gain scales stand between flow and safety, do not add up, and keep joints damped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import Fault
from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states.groups import groups_hash, groups_of
from unicon_core.workflow import HookBlocks, Program, load_document, load_workflow
from unicon_ros.parameters import Tuning, too_little_damping

WORKFLOW = """\
schema: unicon.workflow/1
robot: go2
platform: fake
rate: 100
flow: {flow}
safety: {safety}
"""
SAFETY = {
    "a block": "[finite]",
    "below when": "[{when: {if: tick > 5, do: finite}}]",
    "below every": "[{every: {n: 2, do: finite}}]",
    "below zip": "[{zip: [finite, joint_limits]}]",
    "below loop, after when": "[{when: {if: tick > 5, do: finite}}, {loop: {do: joint_limits}}]",
    "none": "none",
}


def built(folder: Path, tuning: Tuning, safety: str, flow: str = "{hold: {}}") -> Program:
    path = folder / "scaled.yaml"
    path.write_text(WORKFLOW.format(safety=safety, flow=flow))
    return load_workflow(path, hooks=[tuning.hook, last_look])


def last_look(workflow: Program) -> HookBlocks:
    return {Stage.SAFETY: [Block("last look", lambda: None, endless=True)]}


def test_the_state_that_tells_the_scales_is_in_no_group_and_takes_no_place(tmp_path: Path) -> None:
    path = tmp_path / "told.yaml"
    path.write_text(WORKFLOW.format(safety="none", flow="hold"))
    document, plain = load_document(path), groups_of(load_workflow(path).states.layout)
    tuning = Tuning()
    tuning.declare(document)
    workflow = Program(document, hooks=[tuning.hook])
    workflow.close()
    assert "gain_scale" in workflow.states
    assert groups_hash(groups_of(workflow.states.layout)) == groups_hash(plain)
    own = load_document(path, {"states.gain_scale": {"shape": [3]}})
    tuning.declare(own)
    workflow = Program(own, hooks=[tuning.hook])
    workflow.close()
    assert workflow.states["gain_scale"].shape == (3,)
    assert all("gain_scale" not in block.writes for block in workflow.blocks)


@pytest.mark.parametrize("safety", SAFETY.values(), ids=SAFETY)
def test_gains_are_scaled_between_flow_and_the_first_safety_node(
    tmp_path: Path, safety: str
) -> None:
    workflow = built(tmp_path, Tuning(), safety)
    blocks = Runner(workflow).graph.blocks
    names = [each.name for block in blocks for each in (block.parts or (block,))]
    workflow.close()
    order = [name for name in names if name in ("hold", "gain scale", "finite", "joint_limits")]
    assert order[:2] == ["hold", "gain scale"]
    assert names[names.index("send") - 1] == "last look"
    assert set(order) == {
        "hold",
        "gain scale",
        *(w for w in ("finite", "joint_limits") if w in safety),
    }


@pytest.mark.parametrize("safety", [text for text in SAFETY.values() if "finite" in text])
def test_a_check_below_a_condition_sees_the_scaled_gains(tmp_path: Path, safety: str) -> None:
    tuning = Tuning()
    runner = Runner(built(tmp_path, tuning, safety), RunOptions(speed="max"))
    for _ in range(8):
        runner.tick(0)
    tuning.scales[0] = float("nan")
    with pytest.raises(Fault, match="joint_stiffness") as fault:
        runner.tick(0)
    runner.close()
    assert "nothing was sent" not in str(fault.value), "the platform found it, not safety"


@pytest.mark.parametrize("flow", ["{hold: {}}", "{every: {n: 4, do: {hold: {}}}}"])
def test_scales_do_not_add_up_where_gains_are_not_written_in_every_tick(
    tmp_path: Path, flow: str
) -> None:
    tuning = Tuning()
    workflow = built(tmp_path, tuning, "[finite]", flow)
    runner = Runner(workflow, RunOptions(speed="max"))
    gains = [workflow.states[name] for name in ("joint_stiffness", "joint_damping")]
    runner.tick(0)
    plain = [array.copy() for array in gains]
    for scales in ((1.5, 2.0), (2.0, 1.0), (0.0, 0.5)):
        tuning.scales[0], tuning.scales[1] = scales
        for _ in range(9):
            runner.tick(0)
            for array, before, scale in zip(gains, plain, scales):
                np.testing.assert_allclose(array, before * scale, rtol=1e-6)
    tuning.scales[0] = tuning.scales[1] = 1.0
    runner.tick(0)
    for array, before in zip(gains, plain):
        np.testing.assert_array_equal(array, before)
    runner.close()


@pytest.mark.parametrize(
    ("stiffness", "damping", "refused"),
    [
        (1.0, 1.0, False),
        (2.0, 1.0, False),
        (2.0, 0.71, False),
        (1.0, 0.5, False),
        (0.0, 0.1, False),
        (2.0, 0.0, True),
        (2.0, 0.7, True),
        (1.0, 0.1, True),
    ],
)
def test_stiff_joints_stay_damped(stiffness: float, damping: float, refused: bool) -> None:
    assert bool(too_little_damping(stiffness, damping)) is refused


@pytest.fixture
def node() -> Any:
    rclpy = pytest.importorskip("rclpy")
    from rclpy.context import Context
    from rclpy.signals import SignalHandlerOptions

    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    made = rclpy.create_node("scales", context=context)
    yield made
    made.destroy_node()
    rclpy.try_shutdown(context=context)


@pytest.mark.ros
def test_the_node_refuses_scales_that_ring_and_numbers_that_are_none(node: Any) -> None:
    from rclpy.parameter import Parameter

    from unicon_ros.parameters import Parameters

    tuning = Tuning()
    Parameters(node, tuning)

    def given(**values: float) -> str:
        parameters = [Parameter(name, value=value) for name, value in values.items()]
        result = node.set_parameters_atomically(parameters)
        return "" if result.successful else str(result.reason)

    assert "damping_scale" in given(damping_scale=0.0)
    assert "give at least 0.5 (0.5 · √stiffness_scale)" in given(damping_scale=0.2)
    assert given(stiffness_scale=2.0) == ""
    assert "is too little for stiffness_scale 2" in given(damping_scale=0.5)
    assert given(stiffness_scale=1.0, damping_scale=0.5) == ""
    assert "is too little for stiffness_scale 2" in given(stiffness_scale=2.0)
    for name in ("stiffness_scale", "damping_scale", "max_vx", "rate"):
        for value in (float("nan"), float("inf"), -1.0):
            assert given(**{name: value}), (name, value)
    assert tuple(tuning.scales) == (1.0, 0.5)


@pytest.mark.ros
def test_the_node_does_not_start_with_scales_that_ring(capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rclpy")
    from unicon_ros.node_main import main

    given = ("workflow:=go2_stand", "stiffness_scale:=2.0", "damping_scale:=0.1")
    assert main(["--ros-args", *(part for text in given for part in ("-p", text))]) == 1
    said = capfd.readouterr().err.strip().splitlines()
    assert len(said) == 1
    assert "damping_scale 0.1 is too little for stiffness_scale 2" in said[0]


def test_a_fault_of_the_last_look_comes_before_send(tmp_path: Path) -> None:
    sent: list[int] = []

    def stop(workflow: Program) -> HookBlocks:
        def look() -> None:
            raise Fault("stop")

        send = workflow.platform.send
        workflow.platform.send = lambda: sent.append(1) or send()  # type: ignore[method-assign,func-returns-value]
        return {Stage.SAFETY: [Block("last look", look, endless=True)]}

    path = tmp_path / "stopped.yaml"
    path.write_text(WORKFLOW.format(safety="[finite]", flow="{hold: {}}"))
    report = Runner(load_workflow(path, hooks=[stop]), RunOptions(speed="max")).run()
    assert report.faults == ["stop"]
    assert sent == []

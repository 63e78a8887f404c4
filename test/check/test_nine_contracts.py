"""Nine broken contracts of policies that walk: the twin names what is wrong in each, and no more.

The G1's two policies have two pairs of joints exchanged, twice the action scale, another default
pose, twenty times the scale of the joint velocities, twice the damping, and twice and half the
period. A third, which takes its joint velocities out of a history, has that the wrong way round.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the twin runs in MuJoCo")
pytest.importorskip("onnxruntime", reason="the policies need onnxruntime")
pytest.importorskip("onnx", reason="the network with a history is written with onnx")

import onnx
from drafts import Draft, swap
from mistakes import edit
from mistakes_in_time import period_doubled, period_halved

from unicon_core.check import check_workflow

Mistake = Callable[[Draft], None]
FRAMES = 3
SIZES = (29, 3, 1, 2, 2, 29, 29, 3, 2)
"""Elements of the terms of g1_holosoma_ppo: [5] are the joints' positions, [6] their velocities."""


def right(draft: Draft) -> None:
    """Nothing is wrong."""


def _exchanged(i: int, j: int) -> Mistake:
    """Exchange two joints; pose, gains and scales stay where they are."""

    def swapped(names: list[Any]) -> list[Any]:
        swap(names, i, j)
        return names

    def change(draft: Draft) -> None:
        if draft.policy == "mjlab":
            swapped(draft.deploy["joint_ids_map"])
        else:
            edit(draft, "dof_names", swapped)

    return change


def action_doubled(draft: Draft) -> None:
    if draft.policy == "mjlab":
        action = draft.deploy["actions"]["JointPositionAction"]
        action["scale"] = [2.0 * scale for scale in action["scale"]]
    else:
        draft.given["action"]["scale"] *= 2.0


def pose_wrong(draft: Draft) -> None:
    """All joints at 0, as in the model's file."""
    if draft.policy == "mjlab":
        draft.deploy["actions"]["JointPositionAction"]["offset"] = [0.0] * 29
        draft.deploy["default_joint_pos"] = [0.0] * 29
    else:
        draft.given["default_joint_pos"] = [0.0] * 29


def velocities_scaled(draft: Draft) -> None:
    if draft.policy == "mjlab":
        draft.deploy["observations"]["joint_vel_rel"]["scale"] = [20.0] * 29
    else:
        next(t for t in draft.terms if t["state"] == "joint_vel")["scale"] *= 20.0


def damping_doubled(draft: Draft) -> None:
    if draft.policy == "mjlab":
        draft.deploy["damping"] = [2.0 * kd for kd in draft.deploy["damping"]]
    else:
        edit(draft, "kd", lambda values: [2.0 * kd for kd in values])


def newest_first(draft: Draft) -> None:
    draft.given["observation.newest"] = "first"


def frames_whole(draft: Draft) -> None:
    draft.given["observation.layout"] = "frame_major"


CONTRACTS: dict[str, tuple[str, Mistake]] = {
    "left and right knee": ("joint order", _exchanged(3, 9)),
    "hip pitch and knee": ("joints", _exchanged(0, 3)),
    "action scale doubled": ("action.scale", action_doubled),
    "default pose": ("default_joint_pos", pose_wrong),
    "joint velocities times 20": ("scale", velocities_scaled),
    "damping doubled": ("damping", damping_doubled),
    "period doubled": ("period", period_doubled),
    "period halved": ("period", period_halved),
}
HISTORIES: dict[str, tuple[str, Mistake]] = {
    "newest frame first": ("observation.newest", newest_first),
    "whole frames": ("observation.layout", frames_whole),
}


def _write(policy: str, folder: Path, assets: Path, mistake: Mistake) -> Path:
    """Write a workflow; `history` is holosoma's network behind one of several frames."""
    draft = Draft("holosoma" if policy == "history" else policy, folder, assets)
    if policy == "history":
        for term in draft.terms:
            term["history"] = FRAMES
    mistake(draft)
    path = draft.write()
    if policy == "history":
        _with_history(next((folder / "policy").glob("*.onnx")))
    return path


def _with_history(path: Path) -> None:
    """Let a network take frames, each term's oldest first, and differentiate its joints itself."""
    model = onnx.load(str(path))
    starts = np.cumsum(SIZES) - SIZES
    frame = np.zeros((FRAMES * sum(SIZES), sum(SIZES)), np.float32)
    for start, size in zip(starts, SIZES):
        each = np.arange(start, start + size)
        frame[each + (FRAMES - 1) * (start + size), each] = 1.0
    newest = np.arange(29) + FRAMES * starts[5] + (FRAMES - 1) * 29
    speeds = np.arange(29) + starts[6]
    frame[:, speeds] = 0.0
    frame[newest, speeds], frame[newest - 29, speeds] = 0.05 / 0.02, -0.05 / 0.02
    graph = model.graph
    graph.input[0].type.tensor_type.shape.dim[1].dim_value = len(frame)
    obs = graph.input[0].name
    for node in graph.node:
        node.input[:] = ["newest" if name == obs else name for name in node.input]
    graph.initializer.append(onnx.numpy_helper.from_array(frame, "frame"))
    graph.node.insert(0, onnx.helper.make_node("MatMul", [obs, "frame"], ["newest"]))
    onnx.save(model, str(path))


def _rows() -> list[tuple[str, str]]:
    both = [(policy, name) for policy in ("mjlab", "holosoma") for name in CONTRACTS]
    return both + [("history", name) for name in HISTORIES]


QUICK = ("holosoma", "damping doubled"), ("mjlab", "period halved")


def _named(policy: str, name: str, folder: Path, assets: Path) -> None:
    culprit, mistake = (CONTRACTS | HISTORIES)[name]
    result = check_workflow(_write(policy, folder, assets, mistake), twin=True)
    assert result.findings, result.text()
    assert culprit in result.findings[0].culprit, result.text()


@pytest.mark.parametrize(("policy", "name"), QUICK)
def test_a_broken_contract_that_walks_is_named(
    policy: str, name: str, tmp_path: Path, assets: Path
) -> None:
    _named(policy, name, tmp_path / "v", assets)


@pytest.mark.slow
@pytest.mark.parametrize(("policy", "name"), [row for row in _rows() if row not in QUICK])
def test_each_broken_contract_is_named(
    policy: str, name: str, tmp_path: Path, assets: Path
) -> None:
    _named(policy, name, tmp_path / "v", assets)


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["mjlab", "holosoma", "history", "go1", "go2", "dance"])
def test_no_right_contract_is_accused(policy: str, tmp_path: Path, assets: Path) -> None:
    result = check_workflow(_write(policy, tmp_path / "v", assets, right), twin=True)
    assert result.clean, result.text()

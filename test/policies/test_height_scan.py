"""A height scan: the layout of Isaac Lab, what fills it, and a refusal where nothing does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from policy_helpers import robot, toy_values, write_linear, write_toy

from unicon_base.errors import Fault, PolicyError, WorkflowError
from unicon_core.policies import Policy, load_policy, policy_states, policy_table
from unicon_core.policies.perception import HeightScan, HeightScanSpec
from unicon_core.policies.policy_yaml import write_policy_yaml
from unicon_core.runtime.rollouts import Rollouts
from unicon_core.states import States, standard_states
from unicon_core.workflow import Program, load_document
from unicon_lab.replay.platform import replayed_on
from unicon_ros.cli.main import main

SCAN: dict[str, Any] = {"size": [1.6, 1.0], "resolution": 0.1}
TERM = {"name": "height_scan", "state": "height_scan", "subtract": 0.5, "clip": [-1.0, 1.0]}
TERMS = [*toy_values()["observation"]["terms"], TERM]


def isaac(scan: HeightScanSpec) -> list[tuple[float, float]]:
    """Return the points one by one, as rows of x where it varies fastest."""
    (nx, ny), step = scan.counts, scan.resolution
    xs = [scan.offset[0] - scan.size[0] / 2 + i * step for i in range(nx)]
    ys = [scan.offset[1] - scan.size[1] / 2 + i * step for i in range(ny)]
    if scan.order == "xy":
        return [(x, y) for y in ys for x in xs]
    return [(x, y) for x in xs for y in ys]


@pytest.mark.parametrize("order", ["xy", "yx"])
def test_points_and_heights_are_those_of_isaac_lab(order: Any) -> None:
    spec = HeightScanSpec((1.6, 1.0), 0.1, (0.3, -0.1), order=order)
    states = States(standard_states(["j"]) | {"height_scan": spec.state()}, 4)
    random = np.random.default_rng(0)
    quat = random.normal(size=(4, 4))
    quat[3] = 0.0, 1.0, 0.0, 0.0  # on its back, as turned about x
    quat /= np.linalg.norm(quat, axis=1)[:, None]
    states["base_quat"][...], states["base_pos_w"][...] = quat, random.normal(size=(4, 3))
    HeightScan(spec, states, lambda p: 0.5 * p[0] - 0.2 * p[1])()
    assert states["height_scan"].shape == (4, 187)
    for k in range(4):
        (w, x, y, z), (px, py, pz) = states["base_quat"][k], states["base_pos_w"][k]
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        for value, (gx, gy) in zip(states["height_scan"][k], isaac(spec)):
            there = np.array(
                [
                    px + gx * np.cos(yaw) - gy * np.sin(yaw),
                    py + gx * np.sin(yaw) + gy * np.cos(yaw),
                ]
            )
            assert value == pytest.approx(pz - (0.5 * there[0] - 0.2 * there[1]), abs=1e-5)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"size": [1.65, 1.0]}, "height_scan.size has 1.65 m, which is no multiple of the "
         "resolution of 0.1 m; the nearest is 1.6 m"),
        ({"resolution": 0.001}, "makes 1602601 points, at most 10000"),
        ({"resolution": 0.0}, "height_scan.resolution is 0.0; write"),
        ({"size": [1.6]}, "height_scan.size is [1.6]; write"),
        ({"frame": "world"}, "height_scan.frame is 'world'; write yaw"),
        ({"order": "zx"}, "height_scan.order 'zx' is not known; known: xy, yx"),
        ({"offset": [0.0, float("nan")]}, "height_scan.offset.1 is nan"),
        ({"spacing": 0.1}, "height_scan: unknown key 'spacing'"),
    ],
)  # fmt: skip
def test_a_wrong_grid_is_told(tmp_path: Path, changed: dict[str, Any], message: str) -> None:
    path = write_toy(tmp_path, toy_values(height_scan=SCAN | changed))
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    assert message in str(caught.value)


def test_a_contract_with_a_grid_survives_being_written_and_is_printed(tmp_path: Path) -> None:
    values = toy_values(height_scan=SCAN | {"order": "yx"}, observation={"terms": TERMS})
    contract = load_policy(write_toy(tmp_path / "a", values, 202))
    again = load_policy(write_policy_yaml(contract, tmp_path / "b"))
    assert again.height_scan == contract.height_scan
    table = policy_table(contract)
    assert (
        "17 x 11 points, 0.1 m apart, middle at [0.0, 0.0] m of the base's yaw, order yx" in table
    )
    row = next(line.split() for line in table.splitlines() if line.startswith("height_scan "))
    assert row == ["height_scan", "height_scan", "[15:202]", "0.5", "1", "-1…1", "1", "m"]


@pytest.mark.parametrize(
    ("state", "value"),
    [("base_pos_w", np.nan), ("base_pos_w", np.inf), ("base_quat", np.nan)],
)
def test_a_pose_that_is_not_finite_is_a_fault(tmp_path: Path, state: str, value: float) -> None:
    values = toy_values(height_scan=SCAN, observation={"terms": TERMS})
    contract, toy = load_policy(write_toy(tmp_path, values, 202)), robot()
    states = States(
        standard_states(toy.joint_names) | policy_states(contract, toy.joint_names), None
    )
    policy = Policy(contract, states, toy, ground=lambda points: np.zeros(points.shape[1]))
    states["base_pos_w"][2] = 0.3
    policy()
    assert states["observation"][15:] == pytest.approx(np.full(187, -0.2))
    states[state][1] = value
    with pytest.raises(Fault, match="the observation is not finite: term 'height_scan'"):
        policy()


# -- in a workflow ------------------------------------------------------------------------------

STAIRS = """\
robot: go2
platform: mujoco
policies: {walk: ./policy}
scene: {initial_pose: "policy:walk", terrain: {stairs: {rise: 0.1, flat: 1.0}}}
flow: {policy: walk}
safety: [finite]
"""


@pytest.fixture
def workflow(tmp_path: Path) -> Path:
    """Return a workflow of a Go2 before stairs, whose network sees them."""
    pytest.importorskip("mujoco")
    from unicon_core.robots import load_robot

    go2 = load_robot("go2")
    terms = [{**term, "scale": 0.05} for term in TERMS]
    values = toy_values(
        joints=list(go2.joint_names),
        default_joint_pos=[float(x) for x in go2.default_joint_pos],
        stiffness=30.0,
        damping=1.0,
        height_scan=SCAN,
        observation={"terms": terms},
    )
    write_toy(tmp_path / "policy", values, 1)
    write_linear(tmp_path / "policy/policy.onnx", 226, 12, batch="n")
    path = tmp_path / "stairs.yaml"
    path.write_text(STAIRS, "utf-8")
    return path


def test_stairs_are_seen_by_every_robot_of_a_batch_and_flat_ground_as_well(workflow: Path) -> None:
    for changed, ahead in (({}, 0.1), ({"scene.terrain": "flat"}, 0.0)):
        program = Program(load_document(workflow, changed | {"num_robots": 4}))
        Rollouts(program).run(2)
        scan, height = program.states["height_scan"], program.states["base_pos_w"][:, 2]
        rows = scan.reshape(4, 11, 17)
        assert np.ptp(rows[:, 5], axis=1) == pytest.approx(ahead, abs=1e-5)
        assert rows[:, 5, 0] == pytest.approx(height, abs=2e-3)
        assert scan.std(axis=0).max() == 0.0
        program.close()


def test_another_scene_is_seen_once_it_is_begun(workflow: Path) -> None:
    program = Program(load_document(workflow))
    rollouts = Rollouts(program)
    seen = []
    for rise in (0.1, 0.2, 0.1):
        rollouts.begin(load_document(workflow, {"scene.terrain.stairs.rise": rise}))
        seen.append(rollouts.run(3).sha256_commands)
        assert np.ptp(program.states["height_scan"].reshape(11, 17)[5]) == pytest.approx(rise)
    program.close()
    assert seen[0] == seen[2] != seen[1]


def test_a_record_replays_bit_exact(workflow: Path, tmp_path: Path) -> None:
    out = tmp_path / "record"
    run = ["run", str(workflow), "--no-ros", "--speed", "max", "--duration", "0.2"]
    assert main([*run, "--record", str(out)]) == 0
    assert main(["replay", str(out), "--verify"]) == 0
    document = load_document(workflow, {"scene.seed": 5})
    replayed_on(document, out)  # an open loop sees the same ground
    program = Program(document)
    for _ in range(3):
        program.platform.recv()
        next(block for block in program.blocks if block.name == "policy").tick()
    assert np.ptp(program.states["height_scan"]) > 0.05
    program.close()


def test_a_robot_needs_a_height_map_and_where_its_base_is(workflow: Path) -> None:
    changed = {"platform": "unitree", "scene": {}}
    with pytest.raises(PolicyError, match="nothing fills its height_scan: platform 'unitree'"):
        Program(load_document(workflow, changed), dry=True)
    seen = {"elevation_map": {"handle": "realsense_cloud_handle"}}
    changed |= {"deferred": [{"realsense": {"cloud": True}}, seen]}
    with pytest.raises(WorkflowError, match="reads 'base_pos_w', which no block writes"):
        Program(load_document(workflow, changed), dry=True)
    changed |= {"estimate": ["leg_odometry"]}
    program = Program(load_document(workflow, changed), dry=True)
    policy = next(block for block in program.blocks if block.name == "policy")
    assert {"height_map", "height_map_centre", "base_pos_w", "base_quat"} <= {*policy.reads}
    states = program.states
    with pytest.raises(Fault, match="not finite: term 'height_scan'"):  # nothing was seen yet
        policy.tick()
    states["height_map"][...], states["height_map_centre"][...] = 0.1, 0.0
    states["base_pos_w"][2] = 0.4
    policy.tick()
    assert states["height_scan"] == pytest.approx(np.full(187, 0.3))
    program.close()

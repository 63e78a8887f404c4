"""Policies that follow a motion: files, references of the network, anchors, beginning, end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motion_helpers import (
    BODIES,
    JOINTS,
    POLICY,
    Kinematics,
    model_in,
    motion,
    product,
    waisted,
    write_csv,
    write_tracker,
)
from onnx import TensorProto

from unicon_base.errors import Fault, PolicyError
from unicon_core.policies import Policy, load_policy, policy_states, write_policy_yaml
from unicon_core.policies.motion.clip import Chain, Step
from unicon_core.states import Layout, States, standard_states

pytest.importorskip("mujoco", reason="anchors are found in a model")
ort = pytest.importorskip("onnxruntime", reason="the networks are ONNX")

TERMS = [
    {"name": "command", "state": "motion_command"},
    {"name": "motion_anchor_pos_b", "state": "motion_anchor_pos_b"},
    {"name": "motion_anchor_ori_b", "state": "motion_anchor_ori_b"},
    {"name": "joint_pos", "state": "joint_pos", "subtract": "default_joint_pos"},
    {"name": "actions", "state": "action"},
]
SIZE = 8 + 3 + 6 + 4 + 4
GIVEN: dict[str, Any] = {
    "period": 0.02, "joints": POLICY, "default_joint_pos": [0.1, 0.2, 0.3, 0.4],
    "stiffness": 10.0, "damping": 1.0, "action.scale": 0.25, "observation.terms": TERMS,
}  # fmt: skip
TOLD = {
    "inputs": {"observation": "obs", "time_step": "time_step"},
    "outputs": {
        "action": "actions", "motion_joint_pos": "joint_pos", "motion_joint_vel": "joint_vel",
        "motion_ref_quat_xyzw": "ref_quat_xyzw", "motion_ref_pos_xyz": "ref_pos_xyz",
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a motion in every form, the model, and networks with and without it."""
    made = tmp_path_factory.mktemp("motion")
    moved = motion()
    np.savez(made / "walk.npz", **moved)
    write_csv(made / "walk.csv", moved)
    model_in(made)
    write_tracker(made / "plain.onnx", SIZE, None)
    write_tracker(made / "telling.onnx", SIZE, moved)
    return made


def policy_of(folder: Path, name: str = "plain", rows: int | None = None, **more: Any) -> Policy:
    given = {**GIVEN, **(TOLD if name != "plain" else {}), **more}
    contract = load_policy(folder / f"{name}.onnx", given=given)
    specs = {**standard_states(JOINTS), **policy_states(contract, JOINTS)}
    states = States(Layout(specs, rows))
    return Policy(contract, states, waisted(), model=folder / "waisted.xml")


def place(policy: Policy, rng: np.random.Generator, row: Any = ...) -> None:
    """Put the robot anywhere, leaning by up to half a radian."""
    states = policy._states
    axis = rng.normal(size=2)
    lean = rng.uniform(0.0, 0.5)
    tip = [np.cos(lean / 2), *(np.sin(lean / 2) * axis / np.linalg.norm(axis)), 0.0]
    heading = rng.uniform(-3.0, 3.0)
    quat = product([np.cos(heading / 2), 0.0, 0.0, np.sin(heading / 2)], tip)
    states["base_quat"][row] = quat
    states["base_pos_w"][row] = rng.normal(size=3)
    states["joint_pos"][row] = rng.uniform(-1.0, 1.0, 4)


def heading_of(matrix: Any) -> float:
    return float(np.arctan2(matrix[1, 0], matrix[0, 0]))


def about_z(angle: float) -> Any:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("source", ["npz", "csv", "outputs"])
@pytest.mark.parametrize("align", ["yaw", "none"])
def test_the_anchor_is_seen_as_mujoco_has_it(folder: Path, source: str, align: str) -> None:
    spec: dict[str, Any] = {"anchor_body": "torso", "align": align}
    if source != "outputs":
        spec |= {"file": str(folder / f"walk.{source}"), "joints": "policy", "fps": 50.0}
    policy = policy_of(folder, "plain" if source != "outputs" else "telling", motion=spec)
    states, moved = policy._states, motion()
    kinematics, rng = Kinematics(), np.random.default_rng(1)
    turn, begun, there = np.eye(3), np.zeros(3), np.zeros(3)
    for k in range(6):
        place(policy, rng)
        policy()
        joints = dict(zip(JOINTS, states["joint_pos"].astype(float)))
        quat = states["base_quat"].astype(float)
        own_p, _, own_r = kinematics(states["base_pos_w"], quat, joints)
        p, r = own_p[2], own_r[2]
        row = dict(zip(POLICY, moved["joint_pos"][k]))
        first = moved["body_pos_w"][k, 0], moved["body_quat_w"][k, 0]
        ref_p, _, ref_r = kinematics(*first, row)
        goal_p, goal_r = ref_p[2], ref_r[2]
        if k == 0 and align == "yaw":
            turn = about_z(heading_of(r) - heading_of(goal_r))
            begun, there = goal_p * (1, 1, 0), p * (1, 1, 0)
        goal_p, goal_r = turn @ (goal_p - begun) + there, turn @ goal_r
        relative = r.T @ goal_r
        np.testing.assert_allclose(
            states["motion_anchor_ori_b"], relative[:, :2].ravel(), atol=3e-5
        )
        np.testing.assert_allclose(states["motion_anchor_pos_b"], r.T @ (goal_p - p), atol=3e-5)
        np.testing.assert_allclose(states["motion_anchor_pos"], goal_p, atol=3e-5)
        angle = np.arccos(np.clip((np.trace(relative) - 1.0) / 2.0, -1.0, 1.0))
        assert states["motion_error"][1] == pytest.approx(angle, abs=2e-3)
        assert float(states["motion_time"]) == pytest.approx(0.02 * k)
        observed = states["observation"]
        np.testing.assert_allclose(observed[:4], moved["joint_pos"][k], atol=1e-6)
        np.testing.assert_allclose(observed[11:17], relative[:, :2].ravel(), atol=3e-5)


@pytest.mark.parametrize("name", ["telling", "whole_steps"])
def test_a_reference_of_the_networks_own_is_bit_equal_to_a_plain_loop(
    folder: Path, tmp_path: Path, name: str
) -> None:
    """The observation of tick k holds frame k, told by the run before; after a reset again."""
    if name == "whole_steps":
        write_tracker(folder / f"{name}.onnx", SIZE, motion(), TensorProto.INT64)
    policy = policy_of(folder, name, motion={"anchor_body": "torso"})
    states = policy._states
    session = ort.InferenceSession(folder / f"{name}.onnx")
    kind = np.int64 if name == "whole_steps" else np.float32
    names = ["actions", "joint_pos", "joint_vel"]
    for _ in range(2):
        zero = np.zeros((1, SIZE), np.float32)
        _, pos, vel = session.run(names, {"obs": zero, "time_step": np.zeros((1, 1), kind)})
        action = np.zeros((1, 4), np.float32)
        for step in range(8):
            place(policy, np.random.default_rng(step))
            policy.warm_up()
            policy()
            obs = states["observation"].copy()
            own = obs[11:17]
            default = np.float32([0.1, 0.2, 0.3, 0.4])
            joints = states["joint_pos"][[JOINTS.index(j) for j in POLICY]] - default
            plain = np.concatenate((pos[0], vel[0], obs[8:11], own, joints, action[0]))
            assert plain.tobytes() == obs.tobytes()
            feed = {"obs": plain[None], "time_step": np.full((1, 1), step + 1, kind)}
            action, pos, vel = session.run(names, feed)
            assert states["action"].tobytes() == action.tobytes()
        policy.reset()


@pytest.mark.parametrize("source", ["npz", "csv", "outputs"])
def test_it_is_done_with_the_last_frame_and_begins_anew(folder: Path, source: str) -> None:
    spec: dict[str, Any] = {"anchor_body": "torso", "start": 0.1}
    if source != "outputs":
        spec |= {"file": str(folder / f"walk.{source}"), "joints": "policy", "fps": 50.0}
    policy = policy_of(folder, "plain" if source != "outputs" else "telling", motion=spec)
    assert not policy.endless
    moved = motion()
    for _ in range(2):
        policy._states["base_quat"][:] = (1.0, 0.0, 0.0, 0.0)
        told = [policy() for _ in range(35)]
        assert told == [False] * 34 + [True]  # frames 5 to 39
        shown = policy._states["observation"][:4]
        np.testing.assert_allclose(shown, moved["joint_pos"][39], atol=1e-6)
        policy.reset()
    short = policy_of(
        folder, "plain" if source != "outputs" else "telling", motion={**spec, "end": 0.2}
    )
    assert [short() for _ in range(6)] == [False] * 5 + [True]
    held = policy_of(
        folder,
        "plain" if source != "outputs" else "telling",
        motion={**spec, "end": 0.2, "hold": 0.06},
    )
    for _ in range(2):
        for frame, done in zip([5, 5, 5, 5, 6, 7, 8, 9, 10], [False] * 8 + [True]):
            assert held() is done
            shown = held._states["observation"][:4]
            np.testing.assert_allclose(shown, moved["joint_pos"][frame], atol=1e-6)
        held.reset()


def test_frames_between_are_interpolated_and_velocities_differentiated(folder: Path) -> None:
    """A .csv at 25 frames per second under a policy at 50 Hz; by the known sines, within 1 %."""
    slow = folder / "slow.csv"
    write_csv(slow, motion(20, 25.0))
    spec = {"anchor_body": "torso", "file": str(slow), "joints": "policy", "fps": 25.0}
    policy = policy_of(folder, motion=spec)
    told = []
    for _ in range(37):
        policy._states["base_quat"][:] = (1.0, 0.0, 0.0, 0.0)
        policy()
        told.append(policy._states["motion_command"].copy())
    t = np.arange(37) * 0.02
    expected = np.stack([0.3 * np.sin(2.0 * t + k) for k in range(4)], axis=1)
    np.testing.assert_allclose(np.stack(told)[:, :4], expected, atol=5e-4)
    fast = np.stack([0.6 * np.cos(2.0 * t + k) for k in range(4)], axis=1)
    np.testing.assert_allclose(np.stack(told)[1:-1, 4:], fast[1:-1], atol=0.03)


def test_joints_of_a_file_are_taken_by_name(folder: Path) -> None:
    moved = motion()
    order = ["arm", "waist_pitch", "leg", "waist_yaw"]
    by_order = moved["joint_pos"][:, [POLICY.index(name) for name in order]]
    write_csv(folder / "named.csv", {**moved, "joint_pos": by_order})
    spec = {"anchor_body": "torso", "file": str(folder / "named.csv"), "joints": order, "fps": 50}
    policy = policy_of(folder, motion=spec)
    policy()
    np.testing.assert_allclose(policy._states["motion_joint_pos"], moved["joint_pos"][0], atol=1e-6)


def test_each_of_several_robots_is_aligned_by_itself(folder: Path) -> None:
    spec = {"anchor_body": "torso", "file": str(folder / "walk.npz")}
    both = policy_of(folder, rows=2, motion=spec)
    alone = [policy_of(folder, motion=spec) for _ in range(2)]
    generators = [np.random.default_rng(i) for i in range(2)]
    for _ in range(4):
        for i, policy in enumerate(alone):
            place(policy, generators[i])
            for name in ("base_quat", "base_pos_w", "joint_pos"):
                both._states[name][i] = policy._states[name]
            policy()
        both()
        for i, policy in enumerate(alone):
            for name in ("motion_anchor_ori_b", "motion_anchor_pos_b", "motion_error"):
                assert both._states[name][i].tobytes() == policy._states[name].tobytes()


def test_joints_between_may_be_said_in_place_of_a_model(folder: Path) -> None:
    spec = {"anchor_body": "torso", "chain": {"waist_yaw": "z", "waist_pitch": "y"}}
    terms = [term for term in TERMS if term["name"] != "motion_anchor_pos_b"]
    contract = load_policy(
        folder / "telling.onnx", given={**GIVEN, **TOLD, "motion": spec, "observation.terms": terms}
    )
    write_tracker(folder / "said.onnx", SIZE - 3, motion())
    contract = replace(contract, model=folder / "said.onnx")
    states = States({**standard_states(JOINTS), **policy_states(contract, JOINTS)})
    policy = Policy(contract, states, waisted())
    states["joint_pos"][:] = (0.0, 0.4, 0.7, 0.0)
    policy()
    yaw, pitch = 0.7, 0.4
    tip = np.array(
        [[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]]
    )
    own = about_z(yaw) @ tip
    _, _, matrices = Kinematics()(
        motion()["body_pos_w"][0, 0],
        motion()["body_quat_w"][0, 0],
        dict(zip(POLICY, motion()["joint_pos"][0])),
    )
    goal = about_z(heading_of(own) - heading_of(matrices[2])) @ matrices[2]
    np.testing.assert_allclose(
        states["motion_anchor_ori_b"], (own.T @ goal)[:, :2].ravel(), atol=1e-5
    )


def test_a_joint_that_slides_moves_the_anchor_along_its_axis() -> None:
    turned = (np.cos(0.25), 0.0, np.sin(0.25), 0.0)
    steps = (Step((0.5, 0.0, 0.0), turned), Step(index=1, axis=(0.0, 0.0, 1.0), sliding=True))
    position, quat = Chain(steps)((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0), [9.0, 0.25])
    assert position == pytest.approx([1.5 + 0.25 * np.sin(0.5), 2.0, 3.0 + 0.25 * np.cos(0.5)])
    assert quat == pytest.approx(turned)


def test_garbage_of_the_imu_never_reaches_the_motors(folder: Path) -> None:
    spec = {"anchor_body": "torso", "file": str(folder / "walk.npz")}
    for bad in (np.nan, np.inf):
        for name in ("base_quat", "joint_pos"):
            policy = policy_of(folder, motion=spec)
            policy()
            target = policy._states["joint_pos_target"].copy()
            policy._states[name][1] = bad
            with pytest.raises(Fault, match="observation is not finite"):
                policy()
            assert policy._states["joint_pos_target"].tobytes() == target.tobytes()


def test_a_contract_with_a_motion_is_written_and_read_back(folder: Path, tmp_path: Path) -> None:
    spec = {"anchor_body": "torso", "file": str(folder / "walk.npz"), "start": 0.1, "end": 0.5}
    contract = load_policy(folder / "plain.onnx", given={**GIVEN, "motion": spec})
    again = load_policy(write_policy_yaml(contract, tmp_path))
    assert again.motion is not None
    assert contract.motion is not None
    assert again.motion.file == tmp_path / "walk.npz"
    assert replace(again.motion, file=None) == replace(contract.motion, file=None)


BAD: list[tuple[dict[str, Any], str]] = [
    ({"file": "walk.npz"}, r"motion needs anchor_body, or duration in \[s\]"),
    ({"duration": 0.5, "anchor_body": "torso"}, r"motion.duration stands beside anchor_body; only"),
    ({"duration": 0.5, "start": 0.5}, r"motion.duration is 0.5 s and start 0.5 s; end after"),
    ({"duration": -1.0}, r"motion.duration is -1.0; write"),
    ({"anchor_body": "torso", "file": "absent.npz"}, "no such file .*absent.npz"),
    ({"anchor_body": "torso", "file": "walk.pkl"}, "not a .npz or .csv file"),
    ({"anchor_body": "torso", "file": "walk.npz", "align": "pitch"}, "known: none, yaw"),
    (
        {"anchor_body": "torso", "file": "walk.npz", "aline": "yaw"},
        "motion: unknown key 'aline'; .*align",
    ),
    ({"anchor_body": "torsp", "file": "walk.npz"}, "'torsp' is not a body of .*torso"),
    ({"anchor_body": "torso", "file": "walk.npz", "end": 9.0}, "it lasts 0.78 s, .* to 9 s"),
    ({"anchor_body": "torso", "file": "walk.npz", "start": 0.5, "end": 0.2}, "end after the start"),
    (
        {"anchor_body": "torso", "file": "walk.csv"},
        r"does not name its joints; give motion\.joints",
    ),
    ({"anchor_body": "torso", "file": "walk.npz", "joints": "robot"}, "no body of it is where"),
    ({"anchor_body": "torso", "file": "walk.npz", "joints": ["arm"]}, "has 4 joints and .* has 1"),
    (
        {"anchor_body": "torso", "file": "walk.npz", "joints": ["a", "b", "c", "d"]},
        "lacks joint 'waist_yaw'",
    ),
    (
        {"anchor_body": "torso", "chain": {"waist": "w"}},
        "chain.waist 'w' is not known; known: -x, -y, -z, x, y, z",
    ),
    ({"anchor_body": "torso"}, "nothing tells motion_joint_pos"),
    (
        {"anchor_body": "torso", "file": "walk.npz", "chain": {"waist_yow": "z"}},
        "motion.chain names 'waist_yow'; .*waist_yaw",
    ),
]


@pytest.mark.parametrize(("spec", "message"), BAD)
def test_a_motion_that_does_not_fit_is_refused(
    folder: Path, spec: dict[str, Any], message: str
) -> None:
    with pytest.raises(PolicyError, match=message):
        policy_of(folder, motion=spec)


def _changed(key: str, change: Any) -> dict[str, Any]:
    moved = motion()
    moved[key] = change(moved[key].copy())
    return moved


def _spoilt(values: Any) -> Any:
    values[7] = np.nan
    return values


FILES: dict[str, tuple[Any, str]] = {
    "no_zip": (motion, r"not a motion in \.npz"),
    "nan": (lambda: _changed("joint_pos", _spoilt), "frame 7 holds a number that is not finite"),
    "short": (lambda: _changed("joint_vel", lambda v: v[:9]), "joint_vel has shape"),
    "flat": (lambda: _changed("body_pos_w", lambda v: v[:, 0]), "body_pos_w has shape"),
    "one": (lambda: {k: v[:1] for k, v in motion().items()}, "it has 1 frames; give 2 to"),
    "stopped": (lambda: _changed("fps", lambda v: v * 0.0), "0 frames per second"),
    "long": (lambda: _changed("body_quat_w", lambda v: v * 2.0), "has length 2.00, not 1"),
    "xyzw": (
        lambda: _changed("body_quat_w", lambda v: v[..., [1, 2, 3, 0]]),
        "upside down|no body of it is where",
    ),
    "keyless": (
        lambda: {k: v for k, v in motion().items() if k != "joint_vel"}, "it has no 'joint_vel'"
    ),
    "objects": (
        lambda: {**motion(), "joint_pos": np.array([{}], dtype=object)}, "not a motion in .npz"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_a_broken_npz_is_refused_in_one_line(folder: Path, tmp_path: Path, name: str) -> None:
    make, message = FILES[name]
    np.savez(tmp_path / "bad.npz", **make())
    if name == "no_zip":
        (tmp_path / "bad.npz").write_bytes(b"\x93NUMPY garbage")
    with pytest.raises(PolicyError, match=message) as caught:
        policy_of(folder, motion={"anchor_body": "torso", "file": str(tmp_path / "bad.npz")})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "it has 0 frames|a row has|not a motion"),
        ("1,2,3\n1,2,3\n", "a row has 3 numbers"),
        ("0,0,0,0,0,0,1,0,0,0,0\n0,0,0,0,0,1,0,0\n", "not a motion in .csv"),
        ("0,0,0,1,0,0,0,0,0,0,0\n" * 3, "upside down; its quaternions must be x, y, z, w"),
    ],
)
def test_a_broken_csv_is_refused_in_one_line(
    folder: Path, tmp_path: Path, text: str, message: str
) -> None:
    (tmp_path / "bad.csv").write_text(text)
    spec = {"anchor_body": "torso", "file": str(tmp_path / "bad.csv"), "joints": "policy"}
    with pytest.raises(PolicyError, match=message) as caught:
        policy_of(folder, motion=spec)
    assert "\n" not in str(caught.value)


def test_bodies_of_outputs_are_counted(folder: Path) -> None:
    spec = {"anchor_body": "torso", "bodies": BODIES}
    told = {**TOLD["outputs"], "motion_body_quat_w": "ref_quat_xyzw"}
    with pytest.raises(PolicyError, match="has 4 values, not 4 for each of 6 bodies"):
        policy_of(folder, "telling", motion=spec, outputs=told)

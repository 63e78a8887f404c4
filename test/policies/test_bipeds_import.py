"""humanoid-gym, LimX TRON1, Agibot X1 and RoboMimic: what their files say, and their programs add.

The files have the layout of the public ones, with numbers of ours.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from policy_helpers import robot, write_graph, write_linear

from unicon_base.errors import PolicyError
from unicon_core.policies import Policy, PolicyContract, import_policy, load_policy, policy_states
from unicon_core.states import States, standard_states

ort = pytest.importorskip("onnxruntime", reason="the plain loops run onnxruntime")

F: Any = np.float32


def policy_of(contract: PolicyContract, joints: tuple[str, ...] = ()) -> tuple[Policy, States]:
    machine = robot(joints or contract.joints)
    names = machine.joint_names
    states = States(standard_states(names) | policy_states(contract, names))
    return Policy(contract, states, machine), states


HUMANOID = '''
"""A comment."""
from humanoid.envs.base.legged_robot_config import LeggedRobotCfg, LeggedRobotCfgPPO
import os; os.abort()  # which is never run


class ToyBase(LeggedRobotCfg):
    class env(LeggedRobotCfg.env):
        frame_stack = 3
        num_single_obs = 17
        num_observations = int(frame_stack * num_single_obs)
        num_actions = 2

    class sim(LeggedRobotCfg.sim):
        dt = 0.001


class ToyCfg(ToyBase):
    class env(ToyBase.env):
        num_envs: int = 4096

    class init_state(LeggedRobotCfg.init_state):
        default_joint_angles = {"left_knee_joint": 0.5, "right_knee_joint": -0.25}

    class control(LeggedRobotCfg.control):
        stiffness = {"knee": 350.0}
        damping = {"left_knee": 10, "knee": 8}
        action_scale = 0.25
        decimation = 10

    class commands:
        class ranges:
            lin_vel_x = [-0.25, 0.5]
            ang_vel_yaw = [-0.5, 0.5]

    class rewards:
        cycle_time = 0.64

    class normalization:
        class obs_scales:
            lin_vel, ang_vel = 2.0, 1.0
            lin_vel = 2.0
            ang_vel = 0.5
            dof_pos = 1.0
            dof_vel = 0.0625
            quat = 1.0

        clip_observations = 18.0
        clip_actions = 4.0


class ToyCfgPPO(LeggedRobotCfgPPO):
    seed = 5
'''
KNEES = ["right_knee_joint", "left_knee_joint"]


def humanoid(folder: Path, text: str = HUMANOID) -> Path:
    path = folder / "toy_config.py"
    path.write_text(text, "utf-8")
    write_linear(folder / "toy.onnx", 51, 2)
    return path


def test_a_configuration_of_humanoid_gym_is_read_and_never_run(tmp_path: Path) -> None:
    path = humanoid(tmp_path)
    given = {"joints": KNEES}
    contract = load_policy(path, given=given)
    assert contract.source == "humanoid-gym configuration"
    assert contract.period == pytest.approx(0.01)
    assert contract.default_joint_pos.tolist() == [-0.25, 0.5]
    assert contract.stiffness.tolist() == [350.0, 350.0]
    assert contract.damping.tolist() == [8.0, 10.0]
    assert contract.command_ranges == {"lin_vel_x": (-0.25, 0.5), "ang_vel_z": (-0.5, 0.5)}
    assert contract.action.feedback == "clipped"
    policy, states = policy_of(contract)
    session = ort.InferenceSession(str(tmp_path / "toy.onnx"))
    frames = [np.zeros(17, F)] * 3
    last = np.zeros(2, F)
    for k in range(1, 6):
        states.velocity_command = [0.5, -0.25, 0.125]
        states.joint_pos = [0.5 * k, -20.0]
        states.joint_vel = [k, -500.0]
        states.base_ang_vel = [0.5, k, 0.0]
        states.base_quat = [np.cos(0.1 * k), 0.0, 0.0, np.sin(0.1 * k)]
        policy()
        turn = 2 * np.pi * 0.01 * k / 0.64
        w, z = map(float, states.base_quat[[0, 3]])
        yaw = np.arctan2(2.0 * w * z, 1.0 - 2.0 * z * z)
        frame = np.concatenate([
            [np.sin(turn), np.cos(turn), 1.0, -0.5, 0.0625], [0.5 * k + 0.25, -20.5],
            [0.0625 * k, -31.25], last, [0.25, 0.5 * k, 0.0, 0.0, 0.0, yaw],
        ])  # fmt: skip
        frames = [*frames[1:], np.clip(F(frame), F(-18.0), F(18.0))]
        np.testing.assert_allclose(states.observation, np.concatenate(frames), atol=1e-6)
        (action,) = session.run(None, {"obs": states.observation[None]})
        last = np.clip(action[0], -4.0, 4.0)
        np.testing.assert_array_equal(states.action, last)
    out = import_policy(path, tmp_path / "out", given=given)
    assert out.missing == {}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("class control", "class kontrol", r"has 0 configurations .* \(none\); leave one in a"),
        ("class ToyCfgPPO(LeggedRobotCfgPPO)", "class Other(ToyCfg)", r"2 configurations .*Toy"),
        ("class ToyCfg(", "class ToyCfg((", "toy_config.py: no Python: "),
        ("num_single_obs = 17", "num_single_obs = 18", "num_single_obs is 18, and what humanoid_"),
        ("cycle_time = 0.64", "cycle_time = -0.64", r"py:37: phase.period is -0.64; write"),
        ("quat = 1.0", "quat = sqrt(2)", "the humanoid-gym configuration has no .*scales.quat'"),
        ("frame_stack = 3", "frame_stack = 0", "py:9: env.frame_stack is 0; write"),
    ],
)
def test_a_wrong_humanoid_configuration_gets_one_line(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert HUMANOID.count(old) >= 1
    path = humanoid(tmp_path, HUMANOID.replace(old, new, 1))
    with pytest.raises(PolicyError, match=message) as caught:
        load_policy(path, given={"joints": KNEES})
    assert "\n" not in str(caught.value)


def test_the_joints_of_a_humanoid_are_asked_for(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="humanoid-gym configuration does not say joints"):
        load_policy(humanoid(tmp_path))


# -- LimX ---------------------------------------------------------------------------------------

SIDES = ("L", "R")


def limx_values(last: str) -> dict[str, Any]:
    """A params.yaml of legs that end in wheels, ankles or points."""
    parts = ["abad", "knee", *([last] if last else [])]
    names = [f"{part}_{side}_Joint" for side in SIDES for part in parts]
    seen = 4 if last == "wheel" else len(names)
    return {
        "loop_frequency": 500,
        "joint_names": names,
        "init_state": {
            "default_joint_angle": {n: 0.25 if n.startswith("knee") else 0.0 for n in names}
        },
        "control": {
            "stiffness": 42.0, "damping": 2.5, "wheel_joint_damping": 0.8, "user_torque_limit": 80,
            "ankle_joint_damping": 1.5, "action_scale_pos": 0.25, "decimation": 10,
        },
        "normalization": {
            "clip_scales": {"clip_observations": 100.0, "clip_actions": 0.5},
            "obs_scales": {"ang_vel": 0.25, "dof_pos": 1.0, "dof_vel": 0.0625},
        },
        "gait": {"frequencies": 1.25, "swing_height": 0.125},
        "size": {
            "observations_size": 6 + seen + 2 * len(names) + (0 if last == "wheel" else 6),
            "obs_history_length": 5, "encoder_output_size": 3,
        },
        "imu_orientation_offset": {"roll": 0.0, "pitch": 0.0, "yaw": 0.0},
        "user_cmd_scales": {"lin_vel_x": 1.5, "lin_vel_y": 1.0, "ang_vel_yaw": 0.5},
    }  # fmt: skip


def limx(folder: Path, last: str, kind: str, zeros: int = 0, frames: int = 4, **more: Any) -> Path:
    values = limx_values(last) | more
    size, moved = values["size"]["observations_size"], len(values["joint_names"])
    below = folder / "policy" / kind
    random = np.random.default_rng(5)
    for name, taken, made in (
        ("encoder", size * frames, 3), ("policy", size + 6 + zeros, moved)
    ):  # fmt: skip
        write_graph(
            below / f"{name}.onnx",
            "mlp_output = MatMul(mlp_input, w)",
            ["mlp_input"],
            {"mlp_input": [taken], "mlp_output": [made]},
            {"w": random.normal(size=(taken, made)) * 0.1},
        )
    path = folder / "params.yaml"
    path.write_text(yaml.safe_dump({"PointfootCfg": values}), "utf-8")
    return path


class LimxProgram:
    """The programs' rule, in their joint order; `swapped` as for Isaac Lab's networks."""

    def __init__(self, folder: Path, values: dict[str, Any], swapped: bool, zeros: int) -> None:
        self.encoder, self.actor = (
            ort.InferenceSession(str(folder / f"{name}.onnx")) for name in ("encoder", "policy")
        )
        self.values, self.zeros = values, zeros
        names = values["joint_names"]
        half = len(names) // 2
        rows = [k + side for k in range(half) for side in (0, half)]
        self.order = rows if swapped else list(range(len(names)))
        self.wheel = np.array([n.startswith("wheel") for n in names])
        self.ankle = np.array([n.startswith("ankle") for n in names])
        self.pose = np.array([values["init_state"]["default_joint_angle"][n] for n in names])
        self.last, self.index, self.frames = np.zeros(len(names)), 0.0, None

    def __call__(self, gyro: Any, gravity: Any, pos: Any, vel: Any, command: Any) -> Any:
        order, wheel = self.order, self.wheel
        parts = [
            np.array(gyro) * 0.25, gravity, (pos - self.pose)[order][~wheel[order]],
            vel[order] * 0.0625, self.last[order],
        ]  # fmt: skip
        if not wheel.any():
            gait = [1.25, 0.5, 0.5, 0.125] if self.ankle.any() else [2.0, 0.5, 0.5, 0.1]
            self.index += 0.02 * gait[0]
            turn = 2 * np.pi * self.index
            parts += [[np.sin(turn), np.cos(turn)], gait]
        frame = np.concatenate(parts)
        self.frames = [*(self.frames or [frame] * 4)[1:], frame]
        history = np.concatenate(self.frames).astype(F)
        (latent,) = self.encoder.run(None, {"mlp_input": history})
        scaled = np.array(command) * [1.5, 1.0, 0.5]
        taken = np.concatenate([latent, frame, scaled, np.zeros(self.zeros)]).astype(F)
        (action,) = self.actor.run(None, {"mlp_input": taken})
        self.last[order] = np.clip(action, -0.5, 0.5)
        moved = self.last * np.where(wheel, 0.8, 0.25)
        return np.where(wheel, 0.0, moved + self.pose), np.where(wheel, moved, 0.0)


@pytest.mark.parametrize("kind", ["isaacgym", "isaaclab"])
@pytest.mark.parametrize(("last", "zeros"), [("wheel", 0), ("ankle", 2), ("", 0)])
def test_limx_runs_as_its_program_does(tmp_path: Path, last: str, zeros: int, kind: str) -> None:
    path = limx(tmp_path, last, kind, zeros)
    values = limx_values(last)
    contract = load_policy(path)
    names = tuple(values["joint_names"])
    policy, states = policy_of(contract, names)
    program = LimxProgram(tmp_path / "policy" / kind, values, kind == "isaaclab", zeros)
    random = np.random.default_rng(7)
    for _ in range(9):
        gyro, gravity, command = random.normal(size=(3, 3)).astype(F)
        pos, vel = random.normal(size=(2, len(names))).astype(F)
        states.base_ang_vel, states.projected_gravity = gyro, gravity
        states.joint_pos, states.joint_vel, states.velocity_command = pos, vel, command
        policy()
        target, speed = program(gyro, gravity, pos, vel, command)
        wheel = program.wheel
        np.testing.assert_allclose(states.joint_pos_target[~wheel], target[~wheel], atol=2e-6)
        np.testing.assert_allclose(states.joint_vel_target, speed, atol=2e-6)
    damping = np.where(wheel, 0.8, np.where(program.ankle, 1.5, 2.5))
    np.testing.assert_array_equal(states.joint_damping, F(damping))
    np.testing.assert_array_equal(states.joint_stiffness, np.where(wheel, 0.0, 42.0))
    report = import_policy(path, tmp_path / "out")
    assert not report.missing
    again = load_policy(tmp_path / "out")
    assert again.networks[0].model.name == "encoder.onnx"
    policy_of(again, names)[0]()


def test_one_of_the_networks_of_limx_is_chosen(tmp_path: Path) -> None:
    limx(tmp_path, "wheel", "isaacgym")
    path = limx(tmp_path, "wheel", "isaaclab")
    with pytest.raises(PolicyError, match=r"2 networks .*; give onnx: policy/isaacgym/policy.onnx"):
        load_policy(path)
    contract = load_policy(path, given={"onnx": "policy/isaaclab/policy.onnx"})
    assert contract.joints[:2] == ("abad_L_Joint", "abad_R_Joint")
    assert contract.networks[0].model.parent.name == "isaaclab"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"loop_frequency": 0}, "loop_frequency is 0; write"),
        ({"joint_names": ["a", "b", "c"]}, "joint_names has 3 names; both legs have as many"),
        ({"size": {"observations_size": 27, "encoder_output_size": 3}}, "27, .*lays out 22 for 6"),
        ({"size": {"observations_size": 22, "encoder_output_size": 9}}, "which fit no frames of"),
        ({"control": {"decimation": 10}}, "LimX params.yaml has no 'control.action_scale_pos'"),
    ],
)
def test_a_wrong_file_of_limx_gets_one_line(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    path = limx(tmp_path, "wheel", "isaacgym")
    values = yaml.safe_load(path.read_text())["PointfootCfg"] | change
    path.write_text(yaml.safe_dump({"PointfootCfg": values}), "utf-8")
    with pytest.raises(PolicyError, match=message) as caught:
        load_policy(path)
    assert "\n" not in str(caught.value)


def test_an_encoder_of_limx_takes_one_vector(tmp_path: Path) -> None:
    path = limx(tmp_path, "wheel", "isaacgym")
    write_graph(
        tmp_path / "policy" / "isaacgym" / "encoder.onnx",
        "mlp_output = Add(a, b)",
        ["a", "b"],
        {"a": [3], "b": [3], "mlp_output": [3]},
        {},
    )
    with pytest.raises(PolicyError, match=r"encoder.onnx: it has a .*, b .*; one vector is wanted"):
        load_policy(path)


def test_an_imu_that_is_turned_gets_a_note(tmp_path: Path) -> None:
    offset = {"roll": 0.0, "pitch": 0.125, "yaw": 0.0}
    notes = load_policy(limx(tmp_path, "", "isaacgym", imu_orientation_offset=offset)).notes
    assert any("imu_orientation_offset is not imported; the robot file has it" in n for n in notes)


# -- Agibot -------------------------------------------------------------------------------------


def agibot_values() -> dict[str, Any]:
    walk = {
        "joint_list": ["left_knee_joint", "left_ankle_joint"],
        "init_state": [0.5, -0.25], "stiffness": [100.0, 35.0], "damping": [10.0, 0.5],
        "walk_step_conf": {
            "action_scale": 0.5, "decimation": 10, "cycle_time": 0.7, "sw_mode": True,
            "cmd_threshold": 0.05,
        },
        "obs_scales": {"lin_vel": 2.0, "ang_vel": 1, "dof_pos": 1, "dof_vel": 0.0625, "quat": 1},
        "onnx_conf": {
            "policy_file": "cfg/control_module/policy/walk.onnx", "actions_size": 2,
            "observations_size": 17, "num_hist": 3, "observations_clip": 100.0, "actions_clip": 2,
        },
        "lpf_conf": {"wc": 100.0, "ts": 0.001, "paralle_list": ["left_ankle_joint"]},
    }  # fmt: skip
    stand = {"joint_list": ["left_knee_joint"], "init_state": [0.5]}
    return {"control_frequecy": 1000, "controllers": {"pd_stand": stand, "rl_walk": walk}}


def agibot(folder: Path, values: dict[str, Any]) -> Path:
    write_linear(folder / "policy" / "walk.onnx", 51, 2)
    path = folder / "cfg" / "rl_x1.yaml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(yaml.safe_dump(values), "utf-8")
    return path


def test_a_policy_of_agibot_stands_while_the_command_is_zero(tmp_path: Path) -> None:
    contract = load_policy(agibot(tmp_path, agibot_values()))
    assert contract.name == "rl_walk"
    assert contract.period == pytest.approx(0.01)
    assert contract.model == tmp_path / "policy" / "walk.onnx"
    (note,) = contract.notes
    assert "gives left_ankle_joint filtered torques" in note
    policy, states = policy_of(contract)
    for k in range(1, 5):
        states.velocity_command = [0.5 if k > 2 else 0.0, 0.0, 0.25 if k > 2 else 0.0]
        policy()
        turn = 2 * np.pi * 0.01 * k / 0.7 if k > 2 else 0.0
        newest = states.observation[34:]
        clock = [np.sin(turn), np.cos(turn)]
        np.testing.assert_allclose(newest[:2], clock, atol=1e-6)
        assert newest[2:5].tolist() == ([1.0, 0.0, 0.25] if k > 2 else [0.0, 0.0, 0.0])
        assert newest[5:7].tolist() == [-0.5, 0.25]


def test_a_network_for_mnn_gives_way_to_the_onnx_beside_it(tmp_path: Path) -> None:
    values = agibot_values()
    values["controllers"]["rl_walk"]["onnx_conf"]["policy_file"] = "cfg/walk.mnn"
    (tmp_path / "policy").mkdir()
    (tmp_path / "policy" / "walk.mnn").write_bytes(b"\x18")
    contract = load_policy(agibot(tmp_path, values))
    assert contract.model.name == "walk.onnx"
    contract.model.unlink()
    with pytest.raises(PolicyError, match=r"walk\.mnn: is a network for MNN, which cannot be run"):
        load_policy(tmp_path / "cfg" / "rl_x1.yaml")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"controllers": {"rl_a": {}, "rl_b": {}}}, "has the policies rl_a, rl_b; give name: one"),
        ({"controllers": {"pd": {}}}, "it has the policies none; give name: one"),
        ({"controllers": 5}, "controllers is 5; write"),
        ({"control_frequecy": 0}, "control_frequecy is 0; write"),
    ],
)
def test_a_wrong_file_of_agibot_gets_one_line(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    with pytest.raises(PolicyError, match=message):
        load_policy(agibot(tmp_path, agibot_values() | change))


def test_the_phase_of_robomimic_asks_for_the_duration(tmp_path: Path) -> None:
    gains = {key: [1.0, 1.0] for key in ("rl_kp", "rl_kd", "default_dof_pos", "action_scale")}
    values = {
        **gains, "model_name": "dance.onnx", "num_of_dofs": 2, "joint_mapping": [0, 1],
        "joint_names": ["a", "b"], "dt": 0.005, "decimation": 4, "clip_obs": 100.0,
        "observations": ["dof_vel", "RoboMimic_Deploy/phase"], "dof_vel_scale": 0.0625,
    }  # fmt: skip
    path = tmp_path / "config.yaml"
    path.write_text(yaml.safe_dump({"g1/charleston": values}), "utf-8")
    write_linear(tmp_path / "dance.onnx", 3, 2)
    with pytest.raises(PolicyError, match=r"motion \({duration: of the .* \[s\], start: 0.02}\)"):
        load_policy(path)
    given = {"motion": {"duration": 18.0, "start": 0.02}}
    policy, states = policy_of(load_policy(path, given=given))
    for k in range(1, 4):
        policy()
        assert states.observation[2] == F(0.02 * k / 18.0)

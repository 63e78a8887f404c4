"""go2_velocity written in every format that can hold it, and what the loop of each is.

Each network is go2_velocity's actor, which no format's own loop gives a memory to, with inputs and
outputs brought into the format's order.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnx.shape_inference
import onnx.utils
import yaml
from onnx import helper, numpy_helper

F = np.float32
ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ROOT / "config" / "policies" / "go2_velocity"
PARTS = ("hip", "thigh", "calf")
MOTORS = [f"{leg}_{part}_joint" for leg in ("FR", "FL", "RR", "RL") for part in PARTS]
OTHER = [f"{leg}_{part}_joint" for leg in ("FL", "FR", "RL", "RR") for part in PARTS]
ISAAC = [f"{leg}_{part}_joint" for part in PARTS for leg in ("FR", "FL", "RR", "RL")]
POSE = dict(zip(MOTORS, [-0.1, 0.8, -1.6, 0.1, 0.8, -1.6] * 2))
MAPPING = [MOTORS.index(name) for name in OTHER]
# What the network of go2_velocity sees, and the scale of each.
SEEN = {"ang_vel": 0.25, "gravity": 1.0, "command": 2.0, "q": 1.0, "dq": 0.05, "action": 1.0}
SIZES = {"q": 12, "dq": 12, "action": 12, "phase": 2, "cos": 1, "sin": 1}


@dataclass(frozen=True)
class Form:
    """A format's loop.

    Attributes:
        write: writes its files to a folder and returns what a workflow says under `policies`.
        order: of the joints.
        blocks: of the input in order, with their scales.
        history: frames; the oldest first, whole frames together, beginning with zeros.
        clip: of the action; clipped ones are fed back where `feeds_clipped`.
        bound: of everything after scaling.
        gait: period of the clock in [s].
        slew: of the command in [m/s²] and [rad/s²].
    """

    write: Callable[[Path, Form], dict[str, Any]]
    order: list[str] = field(default_factory=lambda: OTHER)
    blocks: dict[str, Any] = field(default_factory=lambda: SEEN)
    history: int = 1
    clip: float | None = None
    feeds_clipped: bool = False
    bound: float | None = None
    gait: float | None = None
    slew: float | None = None


def actor() -> onnx.ModelProto:
    """Return go2_velocity's network without the integral before it: `obs` -> `actions`."""
    whole = onnx.shape_inference.infer_shapes(onnx.load(str(SHIPPED / "policy.onnx")))
    model = onnx.utils.Extractor(whole).extract_model(["told"], ["actions"])
    model.graph.input[0].name = model.graph.node[0].input[0] = "obs"
    return model


def network(path: Path, form: Form, metadata: dict[str, str] | None = None) -> None:
    """Write go2_velocity's network with the inputs and outputs of a format."""
    model = actor()
    graph, start, places, factors = model.graph, 0, {}, {}
    for name, scale in form.blocks.items():
        size = SIZES.get(name, 3)
        places[name], factors[name] = np.arange(start, start + size), np.broadcast_to(scale, size)
        start += size
    total = start * form.history
    mine = [form.order.index(name) for name in MOTORS]
    gather, factor = [], []
    for name, scale in SEEN.items():
        at = mine if SIZES.get(name) == 12 else range(SIZES.get(name, 3))
        gather += [total - start + places[name][i] for i in at]
        factor += [scale / factors[name][i] for i in at]
    theirs = np.array([MOTORS.index(name) for name in form.order])
    graph.initializer.extend(
        numpy_helper.from_array(array, name)
        for name, array in (
            ("f_in", np.array(gather)), ("f_scale", F(factor)), ("f_out", theirs),
        )
    )  # fmt: skip
    for node in graph.node:
        node.output[:] = ["f_actions" if name == "actions" else name for name in node.output]
        node.input[:] = ["f_obs" if name == "obs" else name for name in node.input]
    graph.node.insert(0, helper.make_node("Mul", ["f_taken", "f_scale"], ["f_obs"]))
    graph.node.insert(0, helper.make_node("Gather", ["obs", "f_in"], ["f_taken"], axis=1))
    graph.node.append(helper.make_node("Gather", ["f_actions", "f_out"], ["actions"], axis=1))
    del graph.input[:], graph.value_info[:]
    graph.input.append(helper.make_tensor_value_info("obs", onnx.TensorProto.FLOAT, [1, total]))
    del model.metadata_props[:]
    for key, value in (metadata or {}).items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, str(path))


def pose(form: Form) -> list[float]:
    return [POSE[name] for name in form.order]


def dump(path: Path, values: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(values, sort_keys=False), "utf-8")


STATES = {
    "ang_vel": {"state": "base_ang_vel"}, "gravity": {"state": "projected_gravity"},
    "command": {"state": "velocity_command"}, "dq": {"state": "joint_vel"},
    "q": {"state": "joint_pos", "subtract": "default_joint_pos"}, "action": {"state": "action"},
}  # fmt: skip
TERMS = [{"name": name, **STATES[name], "scale": scale} for name, scale in SEEN.items()]


def policy_yaml(folder: Path, form: Form) -> dict[str, Any]:
    network(folder / "walk.onnx", form)
    values = {
        "schema": "unicon.policy/1", "onnx": "walk.onnx", "period": 0.02, "joints": form.order,
        "default_joint_pos": pose(form), "stiffness": 40.0, "damping": 1.0,
        "action": {"scale": 0.25, "clip": [-8.0, 8.0]}, "observation": {"terms": TERMS},
    }  # fmt: skip
    dump(folder / "policy.yaml", values)
    return {"path": str(folder)}


def bare(folder: Path, form: Form) -> dict[str, Any]:
    network(folder / "walk.onnx", form)
    given = {
        "period": 0.02, "joints": form.order, "default_joint_pos": pose(form), "stiffness": 40.0,
        "damping": 1.0, "action.scale": 0.25, "observation.terms": TERMS,
    }  # fmt: skip
    return {"path": str(folder / "walk.onnx"), "given": given}


UNITREE = dict(zip(SEEN, (
    "base_ang_vel", "projected_gravity", "velocity_commands", "joint_pos_rel", "joint_vel_rel",
    "last_action",
)))  # fmt: skip


def deploy_yaml(folder: Path, form: Form) -> dict[str, Any]:
    network(folder / "exported" / "policy.onnx", form)
    terms = {
        UNITREE[name]: {
            "params": {}, "clip": None, "scale": [scale] * SIZES.get(name, 3), "history_length": 1,
        }
        for name, scale in SEEN.items()
    }  # fmt: skip
    action = {"clip": None, "joint_names": [".*"], "scale": [0.25] * 12, "offset": pose(form)}
    values = {
        "joint_ids_map": MAPPING, "step_dt": 0.02, "stiffness": [40.0] * 12, "damping": [1.0] * 12,
        "default_joint_pos": pose(form), "commands": {},
        "actions": {"JointPositionAction": {**action, "joint_ids": None}}, "observations": terms,
    }  # fmt: skip
    dump(folder / "params" / "deploy.yaml", values)
    return {"path": str(folder)}


def mjlab(folder: Path, form: Form) -> dict[str, Any]:
    names = ("base_ang_vel", "projected_gravity", "command", "joint_pos", "joint_vel", "actions")
    metadata = {
        "joint_names": ",".join(form.order), "joint_stiffness": ",".join(["40.000"] * 12),
        "joint_damping": ",".join(["1.000"] * 12), "command_names": "twist",
        "default_joint_pos": ",".join(f"{value:.3f}" for value in pose(form)),
        "observation_names": ",".join(names), "action_scale": "0.250",
        "observation_terms_scale": ",".join(f"{scale:.3f}" for scale in SEEN.values()),
        "observation_terms_history_length": ",".join(["0.000"] * 6),
    }  # fmt: skip
    network(folder / "walk.onnx", form, metadata)
    return {"path": str(folder / "walk.onnx"), "given": {"period": 0.02}}


def holosoma(folder: Path, form: Form) -> dict[str, Any]:
    metadata = {"dof_names": form.order, "kp": [40.0] * 12, "kd": [1.0] * 12}
    network(folder / "walk.onnx", form, {key: json.dumps(v) for key, v in metadata.items()})
    given = {
        "period": 0.02, "default_joint_pos": pose(form), "observation.terms": TERMS,
        "action": {"scale": 0.25, "clip": [-100, 100], "feedback": "clipped"},
    }  # fmt: skip
    return {"path": str(folder), "given": given}


def env_yaml(folder: Path, form: Form) -> dict[str, Any]:
    network(folder / "exported" / "policy.onnx", form)
    functions = ("base_ang_vel", "projected_gravity", "generated_commands", "joint_pos_rel",
                 "joint_vel_rel", "last_action")  # fmt: skip
    where = "isaaclab.envs.mdp"
    robot = {
        "init_state": {"joint_pos": {
            "F?R_hip_joint|RR_hip_joint": -0.1, ".L_hip_joint": 0.1, ".*thigh.*": 0.8,
            ".*calf.*": -1.6,
        }},
        "actuators": {"legs": {"joint_names_expr": [".*"], "stiffness": 40.0, "damping": 1.0}},
    }  # fmt: skip
    values = {
        "sim": {"dt": 0.005}, "decimation": 4, "scene": {"robot": robot},
        "observations": {"policy": {"concatenate_terms": True, "history_length": None, **{
            name: {"func": f"{where}.observations:{function}", "scale": scale}
            for (name, scale), function in zip(SEEN.items(), functions)
        }}},
        "actions": {"joint_pos": {
            "class_type": f"{where}.actions.joint_actions:JointPositionAction",
            "joint_names": [".*"], "scale": 0.25, "use_default_offset": True,
        }},
    }  # fmt: skip
    dump(folder / "params" / "env.yaml", values)
    return {"path": str(folder), "given": {"joints": {"from": "model"}}}


def legged_gym(folder: Path, form: Form) -> dict[str, Any]:
    network(folder / "policy.onnx", form)
    values = {
        "init_state": {"default_joint_angles": dict(zip(form.order, pose(form)))},
        "control": {"stiffness": {"joint": 40.0}, "damping": {"joint": 1.0}, "action_scale": 0.25,
                    "decimation": 4},
        "sim": {"dt": 0.005}, "normalization": {"clip_actions": 100.0},
    }  # fmt: skip
    dump(folder / "config.yaml", values)
    return {"path": str(folder), "given": {"joints": form.order, "observation.terms": TERMS}}


def rl_gym(form: Form) -> dict[str, Any]:
    return {
        "policy_path": "{LEGGED_GYM_ROOT_DIR}/deploy/pre_train/go2/motion.onnx",
        "kps": [40] * 12, "kds": [1] * 12, "default_angles": pose(form), "ang_vel_scale": 0.25,
        "dof_pos_scale": 1.0, "dof_vel_scale": 0.05, "action_scale": 0.25,
        "cmd_scale": [2.0, 2.0, 2.0], "num_actions": 12, "num_obs": 47,
    }  # fmt: skip


def rl_gym_real(folder: Path, form: Form) -> dict[str, Any]:
    network(folder / "deploy" / "pre_train" / "go2" / "motion.onnx", form)
    more = {"control_dt": 0.02, "leg_joint2motor_idx": MAPPING, "max_cmd": [1.0, 0.5, 1.0]}
    path = folder / "deploy" / "deploy_real" / "configs" / "go2.yaml"
    dump(path, {**rl_gym(form), **more})
    return {"path": str(path)}


def rl_gym_mujoco(folder: Path, form: Form) -> dict[str, Any]:
    network(folder / "deploy" / "pre_train" / "go2" / "motion.onnx", form)
    more = {"simulation_dt": 0.002, "control_decimation": 10, "cmd_init": [0.5, 0, 0]}
    path = folder / "deploy" / "deploy_mujoco" / "configs" / "go2.yaml"
    dump(path, {**rl_gym(form), **more})
    return {"path": str(path), "given": {"joints": {"from": "model"}}}


def rl_sar(folder: Path, form: Form) -> dict[str, Any]:
    network(folder / "go2" / "walk" / "policy.onnx", form)
    base = {"dt": 0.005, "decimation": 4, "num_of_dofs": 12, "wheel_indices": [],
            "joint_names": MOTORS, "joint_mapping": list(range(12))}  # fmt: skip
    config = {
        "model_name": "policy.onnx", "num_observations": 45,
        "observations": ["ang_vel", "gravity_vec", "commands", "dof_pos", "dof_vel", "actions"],
        "observations_history": [2, 1, 0], "observations_history_priority": "time",
        "clip_obs": 100.0, "clip_actions_lower": [-100.0] * 12, "clip_actions_upper": [100.0] * 12,
        "rl_kp": [40.0] * 12, "rl_kd": [1.0] * 12, "num_of_dofs": 12, "wheel_indices": [],
        "action_scale": [0.25] * 12, "ang_vel_scale": 0.25, "dof_pos_scale": 1.0,
        "dof_vel_scale": 0.05, "commands_scale": [2.0] * 3, "default_dof_pos": pose(form),
        "joint_mapping": MAPPING,
    }  # fmt: skip
    dump(folder / "go2" / "base.yaml", {"go2": base})
    dump(folder / "go2" / "walk" / "config.yaml", {"go2/walk": config})
    return {"path": str(folder / "go2" / "walk")}


def booster(folder: Path, form: Form) -> dict[str, Any]:
    network(folder / "deploy" / "models" / "go2.onnx", form)
    values = {
        "common": {"dt": 0.002, "stiffness": [40] * 12, "damping": [1] * 12,
                   "default_qpos": pose(form), "torque_limit": [23] * 12},
        "policy": {
            "policy_path": "./models/go2.onnx", "num_actions": 12, "num_observations": 47,
            "gait_frequency": 2, "control": {"action_scale": 0.25, "decimation": 10},
            "normalization": {"gravity": 1.0, "lin_vel": 2.0, "ang_vel": 0.25, "dof_pos": 1.0,
                              "dof_vel": 0.05, "clip_actions": 8.0},
        },
    }  # fmt: skip
    path = folder / "deploy" / "configs" / "go2.yaml"
    dump(path, values)
    return {"path": str(path)}


PHASED = {**SEEN, "phase": 1.0}
T1 = {"gravity": 1.0, "ang_vel": 0.25, "command": [2.0, 2.0, 0.25], "cos": 1.0, "sin": 1.0,
      "q": 1.0, "dq": 0.05, "action": 1.0}  # fmt: skip
FORMS = {
    "policy.yaml": Form(policy_yaml, clip=8.0),
    "bare ONNX": Form(bare),
    "deploy.yaml": Form(deploy_yaml),
    "mjlab metadata": Form(mjlab),
    "holosoma metadata": Form(holosoma, clip=100.0, feeds_clipped=True),
    "env.yaml": Form(env_yaml, ISAAC),
    "legged_gym": Form(legged_gym, clip=100.0, feeds_clipped=True),
    "unitree_rl_gym real": Form(rl_gym_real, OTHER, PHASED, gait=0.8),
    "unitree_rl_gym mujoco": Form(rl_gym_mujoco, MOTORS, PHASED, gait=0.8),
    "rl_sar": Form(rl_sar, history=3, clip=100.0, feeds_clipped=True, bound=100.0),
    "Booster": Form(booster, MOTORS, T1, clip=8.0, feeds_clipped=True, gait=0.5, slew=1.0),
}

"""ONNX metadata of holosoma (JSON: `dof_names`, `kp`, `kd`, `command_ranges`) as facts.

From amazon-far/holosoma: `utils/inference_helpers.py` writes each value as JSON. Observation terms,
default pose, action scale and rate stand in its program's configuration, not in the file.
Of whole-body tracking, told by the network's `time_step` and `ref_quat_xyzw`, the program has one
layout (`config_values/observation.py`: wbt, in alphabetical order), clips the action to ±100 and
feeds the clipped one back (`policies/wbt.py`); it compares the body `torso_link`.
"""

from __future__ import annotations

import json
from typing import Any

from unicon_base.errors import PolicyError
from unicon_core.policies.facts import GAINS, Facts, term_state
from unicon_core.policies.importers.training import RENAMED_RANGES
from unicon_core.policies.networks.onnx_file import OnnxFile

_ANCHOR = "torso_link"
_TERMS = ("actions", "base_ang_vel", "dof_pos", "dof_vel", "motion_command", "motion_ref_ori_b")
_REFERENCE = {
    "action": "actions",
    "motion_joint_pos": "joint_pos",
    "motion_joint_vel": "joint_vel",
    "motion_ref_quat_xyzw": "ref_quat_xyzw",
}


def json_metadata(onnx: OnnxFile) -> dict[str, Any]:
    """Return the metadata with every value decoded; a value that is not JSON stays a text.

    Raises:
        PolicyError: a key stands twice with different values.
    """
    result: dict[str, Any] = {}
    for key, text in onnx.unique_metadata().items():
        try:
            result[key] = json.loads(text)
        except ValueError:
            result[key] = text
    return result


def holosoma_facts(onnx: OnnxFile) -> Facts:
    """Return what the metadata of holosoma say.

    Raises:
        PolicyError: a key twice, or a value of another kind.
    """
    metadata = json_metadata(onnx)
    facts = Facts(onnx.path, "holosoma metadata", {"onnx": onnx.path.name})
    joints = metadata["dof_names"]
    if not isinstance(joints, list):
        raise PolicyError(
            f"{onnx.path}: metadata dof_names is {joints!r}, no list; export the policy again"
        )
    facts.say("joints", joints, "dof_names")
    for fact, key in zip(GAINS, ("kp", "kd")):
        if key not in metadata:
            continue
        values = metadata[key]
        if not isinstance(values, list) or len(values) != len(joints):
            count = len(values) if isinstance(values, list) else 1
            raise PolicyError(
                f"{onnx.path}: metadata {key} has {count} values for {len(joints)} dof_names; "
                "export the policy again"
            )
        facts.say(fact, values, key)
    ranges = metadata.get("command_ranges")
    if isinstance(ranges, dict):
        facts.values["command_ranges"] = {
            RENAMED_RANGES.get(name, name): pair
            for name, pair in ranges.items()
            if pair is not None
        }
    _tracking(facts, onnx, len(joints), metadata)
    return facts


def _tracking(facts: Facts, onnx: OnnxFile, count: int, metadata: dict[str, Any]) -> None:
    """Add what the program of whole-body tracking says of a network that tells the reference."""
    inputs = {tensor.name: tensor for tensor in onnx.inputs}
    outputs = {tensor.name for tensor in onnx.outputs}
    if not {"obs", "time_step"} <= set(inputs) or not set(_REFERENCE.values()) <= outputs:
        return
    facts.source = "holosoma whole-body tracking metadata"
    facts.values["inputs"] = {"observation": "obs", "time_step": "time_step"}
    facts.values["outputs"] = dict(_REFERENCE)
    facts.values["action"] = {"clip": [-100.0, 100.0], "feedback": "clipped"}
    if f'name="{_ANCHOR}"' in str(metadata.get("robot_urdf", "")):
        facts.say("motion.anchor_body", _ANCHOR)
    else:
        facts.asks["motion"] = f"the body that is compared; robot_urdf has no {_ANCHOR}"
    size, laid_out = inputs["obs"].shape[-1], 5 * count + 9
    if size != laid_out:
        facts.asks["observation.terms"] = (
            f"obs has {size} elements, and the layout wbt of its program {laid_out} for {count} "
            "joints"
        )
        return
    terms = [{"name": name, **term_state(name), "scale": 1.0} for name in _TERMS]
    facts.say("observation.terms", terms, "its program's layout wbt")

"""ONNX metadata of exploy (JSON for each tensor) as facts.

From rai-opensource/exploy: `control/include/exploy/matcher.hpp` and `metadata.hpp` give the names.
The network takes raw states by name and gives joint targets in [rad], so there is no observation
vector, no default pose and no scale: `obj.R.joints.{pos,vel}`, `obj.R.B.{w_Q_b,…}`,
`sensor.imu.B.…`, `cmd.se2_velocity.C`, `output.joint_targets.J.pos`, `memory.M.{in,out}`.
Quaternions are wxyz (Isaac Lab's order). `update_rate` is in [Hz].
"""

from __future__ import annotations

import re
from typing import Any

from unicon_base.errors import PolicyError
from unicon_core.policies.facts import GAINS, Facts
from unicon_core.policies.importers.holosoma import json_metadata
from unicon_core.policies.networks.onnx_file import OnnxFile

_WORD = r"[A-Za-z0-9_\-]+"
_BASE_FIELDS = {
    "pos_b_rt_w_in_w": "base_pos_w",
    "w_Q_b": "base_quat",
    "lin_vel_b_rt_w_in_b": "base_lin_vel",
    "ang_vel_b_rt_w_in_b": "base_ang_vel",
}
_OUTPUT = re.compile(rf"(output\.joint_targets\.{_WORD})\.(pos|vel|effort)")
_MEMORY = re.compile(r"memory\.(.*)\.in")


def exploy_facts(onnx: OnnxFile) -> Facts:
    """Return what the metadata of exploy say.

    Raises:
        PolicyError: a key twice, several groups of joint targets, or values of another kind.
    """
    metadata = json_metadata(onnx)
    facts = Facts(onnx.path, "exploy metadata", {"onnx": onnx.path.name})
    rate = metadata.get("update_rate")
    if isinstance(rate, (int, float)) and rate > 0:
        facts.say("period", 1.0 / rate, "update_rate")
    moved = _outputs(facts, onnx, metadata)
    _inputs(facts, onnx, metadata, moved)
    return facts


def _outputs(facts: Facts, onnx: OnnxFile, metadata: dict[str, Any]) -> list[str]:
    groups: dict[str, list[str]] = {}
    for tensor in onnx.outputs:
        match = _OUTPUT.fullmatch(tensor.name)
        if match:
            groups.setdefault(match[1], []).append(match[2])
    named = {group: kinds for group, kinds in groups.items() if "pos" in kinds}
    if len(named) != 1:
        raise PolicyError(
            f"{onnx.path}: outputs have {len(named)} groups of joint position targets "
            f"({', '.join(named) or 'none'}); only one 'output.joint_targets.NAME.pos' can be run"
        )
    group = next(iter(named))
    about = metadata.get(group)
    if not isinstance(about, dict) or not isinstance(about.get("names"), list):
        raise PolicyError(
            f"{onnx.path}: metadata {group!r} has no joint names; export the policy again"
        )
    moved: list[str] = about["names"]
    facts.values["joints"] = moved
    facts.values["outputs"] = {"action": f"{group}.pos"}
    # The output is the target itself in [rad].
    facts.values["action"] = {"scale": 1.0, "offset": 0.0}
    for key in GAINS:
        if key in about:
            facts.say(key, about[key], f"{group}.{key}")
    if set(named[group]) & {"vel", "effort"}:
        facts.notes.append(f"{onnx.path.name}: velocity and effort targets of {group} are not used")
    return moved


def _inputs(facts: Facts, onnx: OnnxFile, metadata: dict[str, Any], moved: list[str]) -> None:
    inputs: dict[str, str] = {}
    recurrent = []
    outputs = {tensor.name for tensor in onnx.outputs}
    unknown = []
    orders: dict[str, list[str]] = {}
    for tensor in onnx.inputs:
        state = _state(tensor.name)
        memory = _MEMORY.fullmatch(tensor.name)
        if memory and f"memory.{memory[1]}.out" in outputs:
            recurrent.append({"input": tensor.name, "output": f"memory.{memory[1]}.out"})
        elif state is not None and state not in inputs:
            inputs[state] = tensor.name
        else:
            unknown.append(tensor.name)
        about = metadata.get(tensor.name)
        if state == "velocity_command" and isinstance(about, dict) and about.get("ranges"):
            facts.values["command_ranges"] = about["ranges"]
        about = metadata.get(tensor.name.rsplit(".", 1)[0])
        if state in ("joint_pos", "joint_vel") and isinstance(about, dict):
            orders[tensor.name] = list(about.get("joint_names") or [])
    if unknown:
        raise PolicyError(
            f"{onnx.path}: no state is known for the inputs {', '.join(unknown)}; write a "
            "policy.yaml with 'inputs: {STATE: INPUT}'"
        )
    facts.values["inputs"] = inputs
    if recurrent:
        facts.values["recurrent"] = recurrent
    if orders:
        _take_order(facts, orders, moved)


def _take_order(facts: Facts, orders: dict[str, list[str]], moved: list[str]) -> None:
    """The joints are those that the network reads, in that order; it may move a part of them."""
    name, order = next(iter(orders.items()))
    for other, joints in orders.items():
        if joints != order or not set(moved) <= set(joints):
            raise PolicyError(
                f"{facts.path}: input {name} has the joints {', '.join(order)}, {other} has "
                f"{', '.join(joints)} and the targets are {', '.join(moved)}; the inputs must have "
                "one order, and the targets among them"
            )
    if order == moved:
        return
    facts.values["joints"] = order
    facts.values["action"]["joints"] = moved
    for key in GAINS:
        known = facts.values.pop(key, None)
        if isinstance(known, list) and set(order) == set(moved) and len(known) == len(moved):
            by_name = dict(zip(moved, known))
            facts.values[key] = [by_name[joint] for joint in order]


def _state(name: str) -> str | None:
    match = re.fullmatch(rf"obj\.{_WORD}\.joints\.(pos|vel)", name)
    if match:
        return f"joint_{match[1]}"
    match = re.fullmatch(rf"(?:obj\.{_WORD}|sensor\.imu)\.{_WORD}\.(\w+)", name)
    if match and match[1] in _BASE_FIELDS:
        return _BASE_FIELDS[match[1]]
    if re.fullmatch(rf"cmd\.se2_velocity\.{_WORD}", name):
        return "velocity_command"
    return "time_step" if name == "ctx.step_count" else None

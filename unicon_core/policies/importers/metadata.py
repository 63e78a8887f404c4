"""ONNX metadata of mjlab and BeyondMimic, holosoma and exploy as facts; our exports use mjlab's.

**mjlab and BeyondMimic.** HybridRobotics/whole_body_tracking `utils/exporter.py` and
mujocolab/mjlab `tasks/velocity/rl/exporter.py` join lists with commas and print numbers with
3 decimals, so that an integer history reads `5.000`; newer mjlab adds `observation_terms_*`, where
vectors inside a list use `;`, true is `1.000` and history `0.000` means none. `action_scale` may be
one number. Terms are clipped, then scaled, histories are flattened term by term, oldest first
(Isaac Lab's and mjlab's observation managers); actions are relative to the default pose.

**holosoma**, from amazon-far/holosoma: `utils/inference_helpers.py` writes each value as JSON.
Observation terms, default pose, action scale and rate stand in its program's configuration, not in
the file. Of whole-body tracking, recognised by the network's `time_step` and `ref_quat_xyzw`, the
program has one layout (`config_values/observation.py`: wbt, in alphabetical order), clips the
action to ±100 and feeds the clipped one back (`policies/wbt.py`); it compares the body
`torso_link`.

**exploy**, from rai-opensource/exploy: `control/include/exploy/matcher.hpp` and `metadata.hpp` give
the names; a value is JSON for each tensor. The network takes raw states by name and gives joint
targets in [rad], so there is no observation vector, no default pose and no scale:
`obj.R.joints.{pos,vel}`, `obj.R.B.{w_Q_b,…}`, `sensor.imu.B.…`, `cmd.se2_velocity.C`,
`output.joint_targets.J.pos`, `memory.M.{in,out}`. Quaternions are wxyz (Isaac Lab's order).
`update_rate` is in [Hz].
"""

from __future__ import annotations

import json
import re
from typing import Any

from unicon_base import AnyDict, PolicyError
from unicon_core.policies.facts import GAINS, Facts, term_state
from unicon_core.policies.importers.source import RENAMED_RANGES, plural
from unicon_core.policies.networks.onnx_file import OnnxFile

_VECTORS = {
    "default_joint_pos": "default_joint_pos",
    "stiffness": "joint_stiffness",
    "damping": "joint_damping",
    "action.scale": "action_scale",
}
_HISTORIES = ("observation_terms_history_length", "observation_history_lengths")
_ROUNDED = re.compile(r"-?\d+\.\d{3}\Z")
# Outputs of a BeyondMimic network beside the actions: its reference motion at `time_step`.
_MOTION_OUTPUTS = (
    "joint_pos", "joint_vel", "body_pos_w", "body_quat_w", "body_lin_vel_w", "body_ang_vel_w",
)  # fmt: skip

_ANCHOR = "torso_link"
_WBT = ("actions", "base_ang_vel", "dof_pos", "dof_vel", "motion_command", "motion_ref_ori_b")
_REFERENCE = {
    "action": "actions",
    "motion_joint_pos": "joint_pos",
    "motion_joint_vel": "joint_vel",
    "motion_ref_quat_xyzw": "ref_quat_xyzw",
}

_WORD = r"[A-Za-z0-9_\-]+"
_BASE_FIELDS = {
    "pos_b_rt_w_in_w": "base_pos_w",
    "w_Q_b": "base_quat",
    "lin_vel_b_rt_w_in_b": "base_lin_vel",
    "ang_vel_b_rt_w_in_b": "base_ang_vel",
}
_OUTPUT = re.compile(rf"(output\.joint_targets\.{_WORD})\.(pos|vel|effort)")
_MEMORY = re.compile(r"memory\.(.*)\.in")


def _begun(onnx: OnnxFile, source: str) -> Facts:
    return Facts(onnx.path, source, {"onnx": onnx.path.name})


def _names(tensors: Any) -> list[str]:
    return [tensor.name for tensor in tensors]


def mjlab_facts(onnx: OnnxFile) -> Facts:
    """Return what the metadata of BeyondMimic or mjlab say.

    Raises:
        PolicyError: a key twice, no number where one belongs, or lists of different lengths.
    """
    inputs, outputs = _names(onnx.inputs), _names(onnx.outputs)
    reader = _Lists(onnx)
    metadata = reader.metadata
    anchor = metadata.get("anchor_body_name")
    motion = anchor is not None or "time_step" in inputs
    facts = _begun(onnx, "BeyondMimic metadata" if motion else "mjlab metadata")
    joints = reader.words("joint_names")
    facts.say("joints", joints)
    for fact, key in _VECTORS.items():
        numbers = reader.numbers(key) if key in metadata else []
        if len(numbers) not in (0, len(joints), 1 if key == "action_scale" else 0):
            raise reader.fail(key, f"has {len(numbers)} numbers for {len(joints)} joint_names")
        if numbers:
            facts.say(fact, plural(numbers), key)
    if "observation_names" in metadata:
        terms = _terms(reader, motion)
        if "observation_terms_scale" not in metadata:
            facts.asks["observation.scale"] = ""
        layout = {"layout": "term_major", "newest": "last", "terms": terms}
        facts.values["observation"] = layout
    if motion and {"obs", "time_step"} <= {*inputs} and "actions" in outputs:
        facts.values["inputs"] = {"observation": "obs", "time_step": "time_step"}
        reference = {f"motion_{name}": name for name in _MOTION_OUTPUTS if name in outputs}
        facts.values["outputs"] = {"action": "actions", **reference}
        if anchor is not None and "motion_joint_vel" in reference:
            facts.say("motion.anchor_body", anchor.strip())
            if "body_names" in metadata:
                facts.say("motion.bodies", reader.words("body_names"))
    rounded = [
        key
        for key in metadata
        if key in _VECTORS.values()
        and all(map(_ROUNDED.match, map(str.strip, metadata[key].split(","))))
    ]
    if rounded:
        facts.tolerance = (1e-6, 5.1e-4)
        facts.notes.append(
            f"{onnx.path.name}: {', '.join(rounded)} are rounded to 3 decimals, so up to "
            "0.0005 off; give exact values to replace them"
        )
    return facts


def _terms(reader: _Lists, motion: bool) -> list[AnyDict]:
    names = reader.words("observation_names")
    motion = motion or "motion" in reader.metadata.get("command_names", "")
    terms = [{"name": name, **term_state(name)} for name in names]
    for term in terms:
        if term["name"] == "command" and motion:
            term["state"] = "motion_command"
    history = next((key for key in _HISTORIES if key in reader.metadata), "")
    for term, (length,) in zip(terms, reader.entries(history, names, 1)):
        if length != int(length) or length < 0:
            raise reader.fail(history, f"has {length:g}; give whole numbers")
        term["history"] = max(int(length), 1)
    flat, scale = "observation_terms_flatten_history_dim", "observation_terms_scale"
    for term, (value,) in zip(terms, reader.entries(flat, names, 1)):
        if not value and term.get("history", 1) > 1:
            text = f"is off for {term['name']!r} with history {term['history']}"
            raise reader.fail(flat, f"{text}; only flattened histories can be run")
    for term, pair in zip(terms, reader.entries("observation_terms_clip", names, 2)):
        if pair not in ([], [float("-inf"), float("inf")]):
            term["clip"] = pair
    for term, factors in zip(terms, reader.entries(scale, names)):
        term["scale"] = plural(factors or [1.0])
    return terms


class _Lists:
    """Metadata as lists of words and numbers."""

    def __init__(self, onnx: OnnxFile) -> None:
        self.path, self.metadata = onnx.path, onnx.unique_metadata()

    def fail(self, key: str, message: str) -> PolicyError:
        return PolicyError(f"{self.path}: metadata {key} {message}; export the policy again")

    def words(self, key: str) -> list[str]:
        return [word.strip() for word in self.metadata[key].split(",") if word.strip()]

    def numbers(self, key: str, text: str | None = None, between: str = ",") -> list[float]:
        """Return the numbers in a text, by default all of a key."""
        text = text or self.metadata[key].strip().removeprefix("[").removesuffix("]")
        found = []
        for word in filter(None, map(str.strip, text.split(between))):
            try:
                found.append(float({"True": "1", "False": "0"}.get(word, word)))
            except ValueError:
                raise self.fail(key, f"has {word!r} where a number belongs") from None
        return found

    def entries(self, key: str, names: list[str], size: int = 0) -> list[list[float]]:
        """Return the numbers of each term, which `;` parts; `None` has none; [] without the key.

        Args:
            key: where they stand.
            names: of the terms.
            size: how many numbers a term has; 0 for any.
        """
        texts = self.metadata[key].split(",") if key in self.metadata else []
        if len(texts) not in (0, len(names)):
            text = f"has {len(texts)} entries for {len(names)} observation_names"
            raise self.fail(key, text)
        none = ("", "None", "none", "null") if size != 1 else ()
        found = [[] if t.strip() in none else self.numbers(key, t, ";") for t in texts]
        for numbers in found:
            if numbers and len(numbers) != (size or len(numbers)):
                wanted = "lowest;highest" if size == 2 else "one number"
                raise self.fail(key, f"has {numbers}; give {wanted}")
        return found


def _json(onnx: OnnxFile) -> AnyDict:
    """Return the metadata with every value decoded; a value that is not JSON stays a text."""
    result: AnyDict = {}
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
    metadata, facts = _json(onnx), _begun(onnx, "holosoma metadata")
    joints = metadata["dof_names"]
    if not isinstance(joints, list):
        text = f"metadata dof_names is {joints!r}, no list; export the policy again"
        raise PolicyError(f"{onnx.path}: {text}")
    facts.say("joints", joints, "dof_names")
    for fact, key in zip(GAINS, ("kp", "kd")):
        values = metadata.get(key, joints)
        if not isinstance(values, list) or len(values) != len(joints):
            found = f"has {len(values)} values" if isinstance(values, list) else f"is {values!r}"
            raise PolicyError(
                f"{onnx.path}: metadata {key} {found} for {len(joints)} dof_names; export the "
                "policy again"
            )
        if key in metadata:
            facts.say(fact, values, key)
    ranges = metadata.get("command_ranges")
    if isinstance(ranges, dict):
        named = {RENAMED_RANGES.get(name, name): pair for name, pair in ranges.items()}
        facts.values["command_ranges"] = {n: pair for n, pair in named.items() if pair is not None}
    inputs = {tensor.name: tensor for tensor in onnx.inputs}
    needed = {"obs", "time_step", *_REFERENCE.values()}
    if not needed <= {*inputs, *_names(onnx.outputs)}:
        return facts
    # What the program of whole-body tracking says of a network that gives the reference.
    facts.source = "holosoma whole-body tracking metadata"
    facts.values["inputs"] = {"observation": "obs", "time_step": "time_step"}
    facts.values["outputs"] = dict(_REFERENCE)
    facts.values["action"] = {"clip": [-100.0, 100.0], "feedback": "clipped"}
    if f'name="{_ANCHOR}"' in str(metadata.get("robot_urdf", "")):
        facts.say("motion.anchor_body", _ANCHOR)
    else:
        facts.asks["motion"] = f"the body that is compared; robot_urdf has no {_ANCHOR}"
    size, laid_out = inputs["obs"].width, 5 * len(joints) + 9
    if size == laid_out:
        terms = [{"name": name, **term_state(name), "scale": 1.0} for name in _WBT]
        facts.say("observation.terms", terms, "its program's layout wbt")
    else:
        facts.asks["observation.terms"] = (
            f"obs has {size} elements, and its program's layout wbt {laid_out} for {len(joints)} "
            "joints"
        )
    return facts


def exploy_facts(onnx: OnnxFile) -> Facts:
    """Return what the metadata of exploy say.

    Raises:
        PolicyError: a key twice, several groups of joint targets, or values of another kind.
    """
    metadata, facts = _json(onnx), _begun(onnx, "exploy metadata")
    rate = metadata.get("update_rate")
    if isinstance(rate, int | float) and rate > 0:
        facts.say("period", 1.0 / rate, "update_rate")
    outputs = _names(onnx.outputs)
    targets = [match.groups() for name in outputs if (match := _OUTPUT.fullmatch(name))]
    groups = [group for group, kind in targets if kind == "pos"]
    if len(groups) != 1:
        raise PolicyError(
            f"{onnx.path}: outputs have {len(groups)} groups of joint position targets "
            f"({', '.join(groups) or 'none'}); only one 'output.joint_targets.NAME.pos' can be run"
        )
    (group,) = groups
    about = metadata.get(group)
    if not isinstance(about, dict) or not isinstance(about.get("names"), list):
        raise PolicyError(
            f"{onnx.path}: metadata {group!r} has no joint names; export the policy again"
        )
    moved: list[str] = about["names"]
    # The output is the target itself in [rad].
    action = {"scale": 1.0, "offset": 0.0}
    facts.values |= {"joints": moved, "outputs": {"action": f"{group}.pos"}, "action": action}
    for key in GAINS:
        if key in about:
            facts.say(key, about[key], f"{group}.{key}")
    if any(other == group and kind != "pos" for other, kind in targets):
        facts.notes.append(f"{onnx.path.name}: velocity and effort targets of {group} are not used")
    inputs: dict[str, str] = {}
    recurrent, unknown, orders = [], [], {}
    for name in _names(onnx.inputs):
        state, memory = _state(name), _MEMORY.fullmatch(name)
        if memory and (output := f"memory.{memory[1]}.out") in outputs:
            recurrent.append({"input": name, "output": output})
        elif state is not None and state not in inputs:
            inputs[state] = name
        else:
            unknown.append(name)
        own, parent = metadata.get(name), metadata.get(name.rsplit(".", 1)[0])
        if state == "velocity_command" and isinstance(own, dict) and own.get("ranges"):
            facts.values["command_ranges"] = own["ranges"]
        if state in ("joint_pos", "joint_vel") and isinstance(parent, dict):
            orders[name] = list(parent.get("joint_names") or [])
    if unknown:
        raise PolicyError(
            f"{onnx.path}: no state is known for the inputs {', '.join(unknown)}; write a "
            "policy.yaml with 'inputs: {STATE: INPUT}'"
        )
    facts.values |= {"inputs": inputs, **({"recurrent": recurrent} if recurrent else {})}
    _take_order(facts, orders, moved)
    return facts


def _take_order(facts: Facts, orders: dict[str, list[str]], moved: list[str]) -> None:
    """The joints are those that the network reads, in that order; it may move a part of them."""
    name, order = next(iter(orders.items()), ("", moved))
    for other, joints in orders.items():
        if joints != order or not {*moved} <= {*joints}:
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
        if isinstance(known, list) and {*order} == {*moved} and len(known) == len(moved):
            by_name = dict(zip(moved, known))
            facts.values[key] = [by_name[joint] for joint in order]


def _state(name: str) -> str | None:
    if match := re.fullmatch(rf"obj\.{_WORD}\.joints\.(pos|vel)", name):
        return f"joint_{match[1]}"
    match = re.fullmatch(rf"(?:obj\.{_WORD}|sensor\.imu)\.{_WORD}\.(\w+)", name)
    if match and match[1] in _BASE_FIELDS:
        return _BASE_FIELDS[match[1]]
    if re.fullmatch(rf"cmd\.se2_velocity\.{_WORD}", name):
        return "velocity_command"
    return "time_step" if name == "ctx.step_count" else None

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
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from unicon_base import AnyDict, PolicyError
from unicon_core.policies.facts import GAINS, VOCABULARY, Facts, dig, term_state
from unicon_core.policies.importers.source import OF_JOINTS, RENAMED_RANGES, plural
from unicon_core.policies.networks.onnx_file import OnnxFile

_MJLAB, _HOLOSOMA = VOCABULARY["mjlab"], VOCABULARY["holosoma"]
_HISTORIES = ("observation_terms_history_length", "observation_history_lengths")
_ROUNDED = re.compile(r"(\s*-?\d+\.\d{3}\s*(,|$))+")
_INPUTS = {"observation": "obs", "time_step": "time_step"}  # of a network with its motion
_ANCHOR = "torso_link"
_OUTPUT = re.compile(r"(output\.joint_targets\.[A-Za-z0-9_\-]+)\.(pos|vel|effort)")
_MEMORY = re.compile(r"memory\.(.*)\.in")


class _Metadata:
    """Metadata of a file, and the facts that they say.

    Args:
        onnx: the file.
        source: its format.
    """

    def __init__(self, onnx: OnnxFile, source: str) -> None:
        self.path, self.texts = onnx.path, onnx.unique_metadata()
        self.facts = Facts(onnx.path, source, {"onnx": onnx.path.name})

    def fail(self, key: str, message: str) -> PolicyError:
        return PolicyError(f"{self.path}: metadata {key} {message}; export the policy again")

    def decoded(self) -> AnyDict:
        """Return every value decoded; a value that is not JSON stays a text."""
        found: AnyDict = {}
        for key, text in self.texts.items():
            found[key] = text
            with suppress(ValueError):
                found[key] = json.loads(text)
        return found

    def say_joints(self, key: str, joints: Any, places: Mapping[str, str], read: Any) -> None:
        """Note the joints, and what a list has of each.

        Args:
            key: where they stand.
            joints: what stands there.
            places: fact to its key, which may be missing.
            read: returns the value of a key.
        """
        if not isinstance(joints, list):
            raise self.fail(key, f"is {joints!r}, no list")
        self.facts.say("joints", joints, key)
        for fact, place in places.items():
            value = read(place) if place in self.texts else []
            size = len(value) if isinstance(value, list) else -1
            if size not in (0, len(joints), 1 if fact == "action.scale" else 0):
                found = f"has {size} values" if size > 0 else f"is {value!r}"
                raise self.fail(place, f"{found} for {len(joints)} {key}")
            if value:
                self.facts.say(fact, plural(value), place)

    def words(self, key: str) -> list[str]:
        return [word.strip() for word in self.texts[key].split(",") if word.strip()]

    def numbers(self, key: str, text: str | None = None, between: str = ",") -> list[float]:
        """Return the numbers in a text, by default all of a key."""
        text = text or self.texts[key].strip().removeprefix("[").removesuffix("]")
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
        texts = self.texts[key].split(",") if key in self.texts else []
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


def _names(tensors: Any) -> list[str]:
    return [tensor.name for tensor in tensors]


def mjlab_facts(onnx: OnnxFile) -> Facts:
    """Return what the metadata of BeyondMimic or mjlab say.

    Raises:
        PolicyError: a key twice, no number where one belongs, or lists of different lengths.
    """
    inputs, outputs = _names(onnx.inputs), _names(onnx.outputs)
    reader = _Metadata(onnx, "mjlab metadata")
    facts, texts = reader.facts, reader.texts
    anchor = texts.get("anchor_body_name")
    motion = anchor is not None or "time_step" in inputs
    if motion:
        facts.source = "BeyondMimic metadata"
    vectors = _MJLAB["facts"]
    reader.say_joints("joint_names", reader.words("joint_names"), vectors, reader.numbers)
    terms: list[AnyDict] = []
    if "observation_names" in texts:
        terms = _terms(reader, motion)
        if "observation_terms_scale" not in texts:
            facts.asks["observation.scale"] = ""
        layout = {"layout": "term_major", "newest": "last", "terms": terms}
        facts.values["observation"] = layout
    if motion and {*_INPUTS.values()} <= {*inputs} and "actions" in outputs:
        reference = {f"motion_{name}": name for name in _MJLAB["motion"] if name in outputs}
        facts.values |= {"inputs": dict(_INPUTS), "outputs": {"action": "actions", **reference}}
        if anchor is not None and "motion_joint_vel" in reference:
            facts.say("motion.anchor_body", anchor.strip())
            if "body_names" in texts:
                facts.say("motion.bodies", reader.words("body_names"))
        elif anchor is None and any(
            str(dig(t, "state")).startswith("motion_anchor") for t in terms
        ):
            facts.asks["motion"] = "anchor_body, by which robot and motion are compared"
    rounded = [key for key in vectors.values() if _ROUNDED.fullmatch(texts.get(key, ""))]
    if rounded:
        facts.tolerance = (1e-6, 5.1e-4)
        facts.notes.append(
            f"{onnx.path.name}: {', '.join(rounded)} are rounded to 3 decimals, so up to "
            "0.0005 off; give exact values to replace them"
        )
    return facts


def _terms(reader: _Metadata, motion: bool) -> list[AnyDict]:
    names = reader.words("observation_names")
    terms = [{"name": name, **term_state(name)} for name in names]
    if motion or "motion" in reader.texts.get("command_names", ""):
        for term in terms:
            if term["name"] == "command":
                term["state"] = "motion_command"
    history = next((key for key in _HISTORIES if key in reader.texts), "")
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


def holosoma_facts(onnx: OnnxFile) -> Facts:
    """Return what the metadata of holosoma say.

    Raises:
        PolicyError: a key twice, or a value of another kind.
    """
    reader = _Metadata(onnx, "holosoma metadata")
    metadata, facts = reader.decoded(), reader.facts
    joints = metadata["dof_names"]
    reader.say_joints("dof_names", joints, _HOLOSOMA["facts"], metadata.__getitem__)
    ranges = metadata.get("command_ranges")
    if isinstance(ranges, dict):
        facts.values["command_ranges"] = {
            RENAMED_RANGES.get(name, name): pair
            for name, pair in ranges.items()
            if pair is not None
        }
    inputs = {tensor.name: tensor for tensor in onnx.inputs}
    reference = _HOLOSOMA["outputs"]
    needed = {*_INPUTS.values(), *reference.values()}
    if not needed <= {*inputs, *_names(onnx.outputs)}:
        return facts
    # What the program of whole-body tracking says of a network that gives the reference.
    facts.source = "holosoma whole-body tracking metadata"
    action = {"clip": [-100.0, 100.0], "feedback": "clipped"}
    facts.values |= {"inputs": dict(_INPUTS), "outputs": {**reference}, "action": action}
    if f'name="{_ANCHOR}"' in str(metadata.get("robot_urdf", "")):
        facts.say("motion.anchor_body", _ANCHOR)
    else:
        facts.asks["motion"] = f"the body that is compared; robot_urdf has no {_ANCHOR}"
    size, laid_out = inputs["obs"].width, 5 * len(joints) + 9
    if size == laid_out:
        terms = [{"name": name, **term_state(name), "scale": 1.0} for name in _HOLOSOMA["terms"]]
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
    reader = _Metadata(onnx, "exploy metadata")
    metadata, facts = reader.decoded(), reader.facts
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
    about: AnyDict = metadata.get(group, {})
    if not isinstance(moved := dig(about, "names"), list):
        raise reader.fail(repr(group), "has no joint names")
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
        if state == "velocity_command" and (ranges := dig(metadata.get(name), "ranges")):
            facts.values["command_ranges"] = ranges
        parent = metadata.get(name.rpartition(".")[0])
        if state in OF_JOINTS and isinstance(parent, dict):
            orders[name] = list(parent.get("joint_names") or [])
    if unknown:
        raise PolicyError(
            f"{onnx.path}: no state is known for the inputs {', '.join(unknown)}; write a "
            "policy.yaml with 'inputs: {STATE: INPUT}'"
        )
    facts.values["inputs"] = inputs
    if recurrent:
        facts.values["recurrent"] = recurrent
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
            facts.values[key] = [known[moved.index(joint)] for joint in order]


def _state(name: str) -> str | None:
    patterns = VOCABULARY["exploy"]["inputs"].items()
    found = ((re.fullmatch(pattern, name), state) for pattern, state in patterns)
    return next((match.expand(state) for match, state in found if match), None)

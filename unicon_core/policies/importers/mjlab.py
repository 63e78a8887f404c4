"""ONNX metadata of BeyondMimic and mjlab, old and new keys, as facts; our own exports use them too.

Facts of the format: HybridRobotics/whole_body_tracking `utils/exporter.py` and mujocolab/mjlab
`tasks/velocity/rl/exporter.py` join lists with commas and print numbers with 3 decimals, so that an
integer history reads `5.000`; newer mjlab adds `observation_terms_*`, where vectors inside a list
use `;`, true is `1.000` and history `0.000` means none. `action_scale` may be one number. Terms are
clipped, then scaled, histories are flattened term by term, oldest first (Isaac Lab's and mjlab's
observation managers); actions are relative to the default pose.
"""

from __future__ import annotations

import re
from typing import Any

from unicon_base.errors import PolicyError
from unicon_core.policies.facts import Facts, term_state
from unicon_core.policies.networks.onnx_file import OnnxFile

_VECTORS = {
    "default_joint_pos": "default_joint_pos",
    "stiffness": "joint_stiffness",
    "damping": "joint_damping",
}
_HISTORIES = ("observation_terms_history_length", "observation_history_lengths")
_ROUNDED = re.compile(r"-?\d+\.\d{3}\Z")
# Outputs of a BeyondMimic network beside the actions: its reference motion at `time_step`.
_MOTION_OUTPUTS = (
    "joint_pos", "joint_vel", "body_pos_w", "body_quat_w", "body_lin_vel_w", "body_ang_vel_w",
)  # fmt: skip


def mjlab_facts(onnx: OnnxFile) -> Facts:
    """Return what the metadata of BeyondMimic or mjlab say.

    Raises:
        PolicyError: a key twice, no number where one belongs, or lists of different lengths.
    """
    metadata = onnx.unique_metadata()
    motion = "anchor_body_name" in metadata or any(t.name == "time_step" for t in onnx.inputs)
    label = "BeyondMimic metadata" if motion else "mjlab metadata"
    facts = Facts(onnx.path, label, {"onnx": onnx.path.name})
    reader = _Metadata(facts, metadata)
    joints = reader.words("joint_names")
    facts.say("joints", joints)
    for fact, key in _VECTORS.items():
        if key in metadata:
            facts.say(fact, reader.vector(key, len(joints), "joint_names"), key)
    if "action_scale" in metadata:
        scale = reader.numbers("action_scale")
        if len(scale) not in (1, len(joints)):
            raise reader.fail(
                "action_scale", f"has {len(scale)} numbers for {len(joints)} joint_names"
            )
        facts.say("action.scale", scale if len(scale) > 1 else scale[0], "action_scale")
    _observation(reader, motion)
    _tensors(facts, onnx, motion)
    if "anchor_body_name" in metadata and facts.values.get("outputs", {}).get("motion_joint_vel"):
        facts.say("motion.anchor_body", metadata["anchor_body_name"].strip())
        if "body_names" in metadata:
            facts.say("motion.bodies", reader.words("body_names"))
    _rounding(reader)
    return facts


def _observation(reader: _Metadata, motion: bool) -> None:
    facts, metadata = reader.facts, reader.metadata
    if "observation_names" not in metadata:
        return
    names = reader.words("observation_names")
    count = len(names)
    commands = reader.words("command_names") if "command_names" in metadata else []
    terms: list[dict[str, Any]] = []
    for name in names:
        term: dict[str, Any] = {"name": name, **term_state(name)}
        if name == "command" and (motion or any("motion" in command for command in commands)):
            term = {"name": name, "state": "motion_command"}
        terms.append(term)
    history = next((key for key in _HISTORIES if key in metadata), "")
    if history:
        for term, length in zip(terms, reader.vector(history, count, "observation_names")):
            if length != int(length) or length < 0:
                raise reader.fail(history, f"has {length:g}; give whole numbers")
            term["history"] = max(int(length), 1)
    flat = "observation_terms_flatten_history_dim"
    if flat in metadata:
        for term, value in zip(terms, reader.vector(flat, count, "observation_names")):
            if not value and term.get("history", 1) > 1:
                raise reader.fail(
                    flat,
                    f"is off for {term['name']!r} with history {term['history']}; only flattened "
                    "histories can be run",
                )
    if "observation_terms_clip" in metadata:
        for term, pair in zip(terms, reader.nested("observation_terms_clip", count)):
            if pair is None:
                continue
            if len(pair) != 2:
                raise reader.fail("observation_terms_clip", f"has {pair}; give lowest;highest")
            if pair != [float("-inf"), float("inf")]:
                term["clip"] = pair
    if "observation_terms_scale" in metadata:
        for term, scale in zip(terms, reader.nested("observation_terms_scale", count)):
            factors = [1.0] if scale is None else scale
            term["scale"] = factors if len(factors) > 1 else factors[0]
    else:
        facts.asks["observation.scale"] = ""
    facts.values["observation"] = {"layout": "term_major", "newest": "last", "terms": terms}


def _tensors(facts: Facts, onnx: OnnxFile, motion: bool) -> None:
    inputs = {tensor.name for tensor in onnx.inputs}
    outputs = {tensor.name for tensor in onnx.outputs}
    if motion and {"obs", "time_step"} <= inputs and "actions" in outputs:
        facts.values["inputs"] = {"observation": "obs", "time_step": "time_step"}
        facts.values["outputs"] = {
            "action": "actions",
            **{f"motion_{name}": name for name in _MOTION_OUTPUTS if name in outputs},
        }


def _rounding(reader: _Metadata) -> None:
    rounded = [
        key
        for key, text in reader.metadata.items()
        if key in (*_VECTORS.values(), "action_scale")
        and all(_ROUNDED.match(word.strip()) for word in text.split(","))
    ]
    if rounded:
        reader.facts.tolerance = (1e-6, 5.1e-4)
        reader.facts.notes.append(
            f"{reader.facts.path.name}: {', '.join(rounded)} are rounded to 3 decimals, so up to "
            "0.0005 off; give exact values to replace them"
        )


class _Metadata:
    def __init__(self, facts: Facts, metadata: dict[str, str]) -> None:
        self.facts = facts
        self.metadata = metadata

    def fail(self, key: str, message: str) -> PolicyError:
        return PolicyError(f"{self.facts.path}: metadata {key} {message}; export the policy again")

    def words(self, key: str) -> list[str]:
        return [word.strip() for word in self.metadata[key].split(",") if word.strip()]

    def number(self, key: str, word: str) -> float:
        text = word.strip()
        if text in ("True", "False"):
            return float(text == "True")
        try:
            return float(text)
        except ValueError:
            raise self.fail(key, f"has {text!r} where a number belongs") from None

    def numbers(self, key: str) -> list[float]:
        text = self.metadata[key].strip().removeprefix("[").removesuffix("]")
        return [self.number(key, word) for word in text.split(",") if word.strip()]

    def vector(self, key: str, count: int, other: str) -> list[float]:
        values = self.numbers(key)
        if len(values) != count:
            raise self.fail(key, f"has {len(values)} numbers for {count} {other}")
        return values

    def nested(self, key: str, count: int) -> list[list[float] | None]:
        """One entry for each term; an entry's own numbers are parted by `;`, "None" is none."""
        entries = self.metadata[key].split(",")
        if len(entries) != count:
            raise self.fail(key, f"has {len(entries)} entries for {count} observation_names")
        return [
            None
            if entry.strip() in ("None", "none", "null", "")
            else [self.number(key, word) for word in entry.split(";")]
            for entry in entries
        ]

"""Which importer reads an ONNX file's metadata: BeyondMimic and mjlab, holosoma, or exploy."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from unicon_core.errors import PolicyError
from unicon_core.policies.facts import Facts, says
from unicon_core.policies.importers.exploy import exploy_facts
from unicon_core.policies.importers.holosoma import holosoma_facts
from unicon_core.policies.importers.mjlab import mjlab_facts
from unicon_core.policies.networks.onnx_file import OnnxFile, short_text

# A key that tells the format -> its reader; the first one counts.
_READERS: dict[str, Callable[[OnnxFile], Facts]] = {
    "exploy_version": exploy_facts,
    "dof_names": holosoma_facts,
    "joint_names": mjlab_facts,
}


def _reader(onnx: OnnxFile) -> Callable[[OnnxFile], Facts] | None:
    keys = {key for key, _ in onnx.metadata}
    return next((reader for key, reader in _READERS.items() if key in keys), None)


def has_metadata(onnx: OnnxFile) -> bool:
    """Whether the metadata are of a known format."""
    return _reader(onnx) is not None


# What a key says, as the fact that settles it where it stands twice.
_SAYS = {
    "joint_names": "joints",
    "dof_names": "joints",
    "default_joint_pos": "default_joint_pos",
    "joint_stiffness": "stiffness",
    "kp": "stiffness",
    "joint_damping": "damping",
    "kd": "damping",
    "action_scale": "action.scale",
    "command_ranges": "command_ranges",
    "update_rate": "period",
    "observation_names": "observation.terms",
    "observation_terms_scale": "observation.terms.*.scale",
    "observation_terms_clip": "observation.terms.*.clip",
    "observation_terms_history_length": "observation.terms.*.history",
    "observation_history_lengths": "observation.terms.*.history",
    "anchor_body_name": "motion.anchor_body",
    "body_names": "motion.bodies",
}
_NAMES = {"joint_names": ",".join, "dof_names": json.dumps}


def settled(
    onnx: OnnxFile, said: Mapping[str, Any], where: str, *, whole: bool = False
) -> tuple[OnnxFile, list[str]]:
    """Return the file without keys that stand twice with different values, and notes of them.

    Args:
        onnx: the file.
        said: facts that count instead, with the keys of `policy.yaml`, nested or dotted.
        where: who says them, for messages: `given`, `policy.yaml`.
        whole: it is a whole contract, which leaves nothing to the metadata.

    Raises:
        PolicyError: a key stands twice, and its fact is not said.
    """
    values: dict[str, list[str]] = {}
    for key, value in onnx.metadata:
        if value not in values.setdefault(key, []):
            values[key].append(value)
    twice = {key: listed for key, listed in values.items() if len(listed) > 1}
    notes = []
    for key, (first, second, *_) in twice.items():
        fact = _SAYS.get(key)
        if fact is None:
            onnx.unique_metadata()  # refuses it
        elif not whole and not says(said, fact):
            raise PolicyError(
                f"{onnx.path}: metadata key {key!r} stands twice, as {short_text(first)} and as "
                f"{short_text(second)}; export the policy again with one of them, or say {fact} "
                "under 'given' or in a policy.yaml beside it"
            )
        else:
            notes.append(
                f"{onnx.path.name}: metadata key {key!r} stands twice, as {short_text(first)} and "
                f"as {short_text(second)}; {fact} of {where} counts"
            )
    kept = [pair for pair in onnx.metadata if pair[0] not in twice]
    for key, written in _NAMES.items():  # by which all vectors are read
        joints = said.get("joints")
        if key in twice and isinstance(joints, (list, tuple)):
            kept.append((key, written([str(name) for name in joints])))
    return replace(onnx, metadata=tuple(kept)), notes


def metadata_facts(onnx: OnnxFile) -> Facts:
    """Return what the metadata say.

    Raises:
        PolicyError: no known format, a key twice, or a value against the format.
    """
    reader = _reader(onnx)
    if reader is None:
        raise PolicyError(
            f"{onnx.path}: its metadata are of no known format (BeyondMimic, mjlab, holosoma, "
            "exploy); write a policy.yaml beside it"
        )
    return reader(onnx)

"""ONNX metadata of holosoma (JSON: `dof_names`, `kp`, `kd`, `command_ranges`) as facts.

From amazon-far/holosoma: `utils/inference_helpers.py` writes each value as JSON. Observation terms,
default pose, action scale and rate stand in its program's configuration, not in the file.
"""

from __future__ import annotations

import json
from typing import Any

from unicon_core.errors import PolicyError
from unicon_core.policies.facts import Facts
from unicon_core.policies.importers.training import RENAMED_RANGES
from unicon_core.policies.networks.onnx_file import OnnxFile

__all__ = ["holosoma_facts", "json_metadata"]


def json_metadata(onnx: OnnxFile) -> dict[str, Any]:
    """Return the metadata with every value decoded; a value that is no JSON stays a text.

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
    facts.values["joints"] = joints
    facts.keys[("joints",)] = "dof_names"
    for target, key in (("stiffness", "kp"), ("damping", "kd")):
        if key not in metadata:
            continue
        values = metadata[key]
        if not isinstance(values, list) or len(values) != len(joints):
            count = len(values) if isinstance(values, list) else 1
            raise PolicyError(
                f"{onnx.path}: metadata {key} has {count} values for {len(joints)} dof_names; "
                "export the policy again"
            )
        facts.values[target] = values
        facts.keys[(target,)] = key
    ranges = metadata.get("command_ranges")
    if isinstance(ranges, dict):
        facts.values["command_ranges"] = {
            RENAMED_RANGES.get(name, name): pair
            for name, pair in ranges.items()
            if pair is not None
        }
    return facts

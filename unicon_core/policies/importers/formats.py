"""Which importer reads a deployment's configuration, or the metadata of an ONNX file.

Configurations that are classes in Python, as legged_gym and humanoid-gym have them, are read as
data. Nothing is run: of each class the literals and the classes within are taken, and those of base
classes in the same file. What a base class of another file says, or what is computed, is not said.
"""

from __future__ import annotations

import ast
import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

from unicon_base import AnyDict, AnyMapping, PolicyError
from unicon_base.errors import one_line
from unicon_base.located_yaml import Located, Where, read_text
from unicon_core.policies.facts import Facts, says
from unicon_core.policies.importers.bipeds import agibot_facts, humanoid_gym_facts, limx_facts
from unicon_core.policies.importers.deploy_programs import booster_facts, unitree_rl_gym_facts
from unicon_core.policies.importers.deploy_yaml import deploy_yaml_facts, refuse_base, rl_sar_facts
from unicon_core.policies.importers.env_yaml import env_yaml_facts, legged_gym_facts, lerobot_facts
from unicon_core.policies.importers.metadata import exploy_facts, holosoma_facts, mjlab_facts
from unicon_core.policies.importers.source import Source
from unicon_core.policies.networks.onnx_file import OnnxFile, short_text

# A key of the metadata that tells the format -> its reader; the first one counts.
_METADATA: dict[str, Callable[[OnnxFile], Facts]] = {
    "exploy_version": exploy_facts,
    "dof_names": holosoma_facts,
    "joint_names": mjlab_facts,
}
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
# Keys of a configuration, with dots between nested ones, `*` for the only one -> its reader; the
# first one whose keys are all there counts.
_CONFIGURATIONS: dict[tuple[str, ...], Callable[[Source], Facts]] = {
    ("joint_ids_map", "step_dt"): deploy_yaml_facts,
    ("sim", "decimation", "observations"): env_yaml_facts,
    (
        "init_state.default_joint_angles",
        "control",
        "env.frame_stack",
        "rewards.cycle_time",
    ): humanoid_gym_facts,
    ("control", "init_state.default_joint_angles"): legged_gym_facts,
    ("PointfootCfg.size.encoder_output_size",): limx_facts,
    ("control_frequecy", "controllers"): agibot_facts,
    ("*.observations", "*.rl_kp"): rl_sar_facts,
    ("*.joint_names", "*.joint_mapping"): refuse_base,
    ("kps", "kds", "default_angles"): unitree_rl_gym_facts,
    ("common.default_qpos", "policy"): booster_facts,
    ("type", "input_features", "output_features"): lerobot_facts,
}
_MOTORS = ("joint_ids_map", "leg_joint2motor_idx", "common.default_qpos")


def metadata_reader(onnx: OnnxFile) -> Callable[[OnnxFile], Facts] | None:
    """Return what reads the metadata of a file; None where they are of no known format."""
    keys = {key for key, _ in onnx.metadata}
    return next((reader for key, reader in _METADATA.items() if key in keys), None)


def settled(
    onnx: OnnxFile, said: AnyMapping, where: str, *, whole: bool = False
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
    for key, value in dict.fromkeys(onnx.metadata):
        values.setdefault(key, []).append(value)
    notes = []
    for key, (first, *others) in values.items():
        if not others:
            continue
        fact, both = _SAYS.get(key), f"{short_text(first)} and as {short_text(others[0])}"
        text = f"metadata key {key!r} stands twice, as {both}"
        if fact is not None and (whole or says(said, fact)):
            notes.append(f"{onnx.path.name}: {text}; {fact} of {where} counts")
            continue
        settle = f", or say {fact} under 'given' or in a policy.yaml beside it" if fact else ""
        raise PolicyError(f"{onnx.path}: {text}; export the policy again with one of them{settle}")
    kept = [pair for pair in onnx.metadata if len(values[pair[0]]) == 1]
    for key, written in _NAMES.items():  # by which all vectors are read
        joints = said.get("joints")
        if len(values.get(key, ())) > 1 and isinstance(joints, list | tuple):
            kept.append((key, written([str(name) for name in joints])))
    return replace(onnx, metadata=tuple(kept)), notes


def configuration_reader(values: Any) -> Callable[[Source], Facts] | None:
    """Return what reads a YAML document of a deployment; None where it is of no known format."""
    readers = _CONFIGURATIONS.items()
    return next((read for keys, read in readers if all(_has(values, key) for key in keys)), None)


def counts_motors(values: Any) -> bool:
    """Whether a YAML document names joints by the numbers of a robot's motors."""
    return any(_has(values, key) for key in _MOTORS)


def _has(values: Any, key: str) -> bool:
    for step in key.split("."):
        if step == "*" and isinstance(values, Mapping) and len(values) == 1:
            (step,) = values
        if not isinstance(values, Mapping) or step not in values:
            return False
        values = values[step]
    return True


_Class: TypeAlias = tuple[AnyDict, dict[Where, int]]
_WRONG = (SyntaxError, ValueError, TypeError, MemoryError, RecursionError)


def read_python(path: Path) -> Located:
    """Return the one class of a file that is a known configuration, as nested mappings.

    Raises:
        PolicyError: the file cannot be read, or has none or several of them.
    """
    try:
        tree = ast.parse(read_text(path, PolicyError))
    except _WRONG as error:
        text = f"no Python: {one_line(error)}; give the file of the configuration"
        raise PolicyError(f"{path}: {text}") from error
    known: dict[str, _Class] = {}
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            _read(node, node.name, known)
    found = {
        name: made
        for name, made in known.items()
        if "." not in name and configuration_reader(made[0]) is not None
    }
    if len(found) != 1:
        names = ", ".join(found) or "none"
        text = f"has {len(found)} configurations of legged_gym or humanoid-gym ({names})"
        raise PolicyError(f"{path}: it {text}; leave one in a copy")
    ((values, lines),) = found.values()
    return Located(path, values, lines, PolicyError)


def _read(node: ast.ClassDef, name: str, known: dict[str, _Class]) -> _Class:
    """Return a class's literals and their lines; `known` gets it, and the classes within."""
    values: AnyDict = {}
    lines: dict[Where, int] = {}
    for base in node.bases:
        more, places = known.get(ast.unparse(base), ({}, {}))
        values, lines = values | more, lines | places
    lines[()] = node.lineno
    for item in node.body:
        match item:
            case ast.ClassDef(name=key):
                values[key], places = _read(item, f"{name}.{key}", known)
                lines |= {(key, *where): line for where, line in places.items()}
            case (
                ast.Assign(targets=[ast.Name(id=key)], value=ast.expr() as value)
                | ast.AnnAssign(target=ast.Name(id=key), value=ast.expr() as value)
            ):
                values.pop(key, None)
                with suppress(*_WRONG):  # computed
                    values[key] = ast.literal_eval(value)
                    lines[(key,)] = item.lineno
    known[name] = values, lines
    return values, lines

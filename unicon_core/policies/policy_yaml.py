"""Our own `policy.yaml`: reading it into facts, and writing a contract in canonical form."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from unicon_core.errors import PolicyError
from unicon_core.file_kinds import other_kind
from unicon_core.located_yaml import Tagged, read_yaml
from unicon_core.policies.build import SCHEMA, check_keys
from unicon_core.policies.contract import (
    FilterSpec,
    MotionSpec,
    ObservationTerm,
    PolicyContract,
)
from unicon_core.policies.facts import TO_GIVE, Facts
from unicon_core.policies.networks.onnx_file import read_onnx
from unicon_core.resources import sha256_of


def policy_yaml_facts(path: Path) -> Facts:
    """Read a `policy.yaml` as facts.

    Raises:
        PolicyError: not readable, not YAML, or no mapping.
    """
    located = read_yaml(path, PolicyError, foreign=True)
    if not isinstance(located.value, Mapping):
        raise located.error((), f"no policy; start it with 'schema: {SCHEMA}'")
    other = other_kind(located.value, "policy")
    if other:
        raise located.error(("schema",), other)
    for key, value in located.value.items():
        if isinstance(value, Mapping) and "from" in value:
            raise located.error(
                (key,),
                f"{key} is {dict(value)}, which belongs under 'given' of the workflow; give the "
                "values here, or remove it",
            )
    return Facts(path, "policy.yaml", dict(located.value), located.lines)


def write_policy_yaml(contract: PolicyContract, out_dir: str | Path) -> Path:
    """Write the canonical form, with the network's files copied beside it.

    Args:
        contract: the policy.
        out_dir: folder; made where it is missing.

    Returns:
        The `policy.yaml` written.

    Raises:
        PolicyError: the network or one of its files is missing, or the folder cannot be written.
    """
    values = contract_values(contract)
    values["sha256"] = sha256_of(contract.model)
    path = _write(Path(out_dir), _dump(values), contract.model)
    for part in contract.networks:
        _copy_model(part.model, path.parent)
    if contract.motion is not None and contract.motion.file is not None:
        _copy(contract.motion.file, Path(out_dir) / contract.motion.file.name)
    return path


def write_partial_yaml(facts: Facts, missing: Mapping[str, str], out_dir: str | Path) -> Path:
    """Write what a source says; what it does not say stands at the top as a list of comments.

    Args:
        facts: of the source.
        missing: dotted name -> what it is, from `missing_facts`.
        out_dir: folder; made where it is missing.

    Raises:
        PolicyError: as for `write_policy_yaml`; or a key is unknown.
    """
    check_keys(facts)
    key = "torchscript" if "torchscript" in facts.values else "onnx"
    model = None
    values: dict[str, Any] = {"schema": SCHEMA}
    if key in facts.values:
        model = facts.model()
        values[key] = model.name
        if os.path.isfile(model):
            values["sha256"] = sha256_of(model)
    values |= {k: v for k, v in facts.values.items() if k not in values}
    lines = [f"# {facts.path.name} does not say, so add:"]
    for name, what in missing.items():
        if name == "observation.scale":
            name, what = "scale of each term", f"where {TO_GIVE} stands; 1.0 for none"
            said = values["observation"]
            terms = [{**term, "scale": term.get("scale", TO_GIVE)} for term in said["terms"]]
            values["observation"] = {**said, "terms": terms}
        lines.append(f"#   {name}: {what}".rstrip(": "))
    return _write(Path(out_dir), "\n".join(lines) + "\n" + _dump(values), model)


def known_text(facts: Facts) -> str:
    """Return what an incomplete source says, as `policy.yaml` has it."""
    return f"{facts.path}  (from {facts.source}, incomplete)\n{_dump(facts.values)}".rstrip()


def _write(folder: Path, text: str, model: Path | None) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if model is not None:
            _copy_model(model, folder)
        path = folder / "policy.yaml"
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise PolicyError(
            f"{folder}: cannot write the policy: {error.strerror}; give another folder"
        ) from error
    return path


def _copy_model(model: Path, folder: Path) -> None:
    external = read_onnx(model).external if model.suffix == ".onnx" else ()
    for name in (model.name, *external):
        source, target = model.parent / name, folder / name
        if not os.path.isfile(source):
            raise PolicyError(
                f"{source}: no such file; {model.name} needs its weights, put it there"
            )
        _copy(source, target)


def _copy(source: Path, target: Path) -> None:
    if not os.path.exists(target) or not os.path.samefile(source, target):
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)


def contract_values(contract: PolicyContract) -> dict[str, Any]:
    """Return the canonical form as plain values; `build_contract` reads them back."""
    action, observation, phase = contract.action, contract.observation, contract.phase
    values: dict[str, Any] = {
        "schema": SCHEMA,
        "name": contract.name,
        "torchscript" if contract.is_torchscript else "onnx": contract.model.name,
        "sha256": contract.sha256,
        "networks": {
            part.name: {
                "onnx": part.model.name,
                "sha256": sha256_of(part.model),
                "feeds": {key: list(map(str, feeds)) for key, feeds in part.feeds.items()},
            }
            for part in contract.networks
        }
        or None,
        "feeds": {key: list(map(str, feeds)) for key, feeds in contract.feeds.items()} or None,
        "provider": None if contract.provider == "cpu" else contract.provider,
        "period": contract.period,
        "robot": contract.robot,
        "joints": list(contract.joints),
        "default_joint_pos": _plain(contract.default_joint_pos),
        "action": _without_none(
            joints=list(action.joints) if action.joints != contract.joints else None,
            kind=list(action.kinds) or None,
            scale=_plain(action.scale),
            offset=_plain(action.offset),
            clip=None if action.clip is None else _plain(action.clip),
            filter=_filter(action.filter),
            feedback=action.feedback,
        ),
        "stiffness": _plain(contract.stiffness),
        "damping": _plain(contract.damping),
        "observation": {
            "layout": observation.layout,
            "newest": observation.newest,
            "start": observation.start,
            "terms": [_term(term) for term in observation.terms],
        },
        "inputs": dict(contract.inputs) or None,
        "outputs": dict(contract.outputs) or None,
        "recurrent": [asdict(pair) for pair in contract.recurrent] or None,
        "command_ranges": {k: list(v) for k, v in contract.command_ranges.items()} or None,
        "command": contract.command and {"slew": list(contract.command.slew)},
        "phase": phase and _without_none(**asdict(phase) | {"offsets": list(phase.offsets)}),
        "motion": contract.motion and _motion(contract.motion),
    }
    if not observation.terms:
        del values["observation"]
    return _without_none(**values)


def _motion(motion: MotionSpec) -> dict[str, Any]:
    joints = motion.joints
    return _without_none(
        anchor_body=motion.anchor_body,
        file=None if motion.file is None else motion.file.name,
        bodies=list(motion.bodies) or None,
        align=motion.align,
        start=motion.start,
        end=motion.end,
        hold=motion.hold or None,
        fps=motion.fps,
        joints=list(joints) if isinstance(joints, tuple) else joints,
        chain=dict(motion.chain) or None,
    )


def _term(term: ObservationTerm) -> dict[str, Any]:
    subtract, clip = term.subtract, term.clip
    return _without_none(
        name=term.name,
        state=term.state,
        index=None if term.index is None else list(term.index),
        subtract=_scalar_or_list(subtract) if isinstance(subtract, np.ndarray) else subtract,
        scale=None if (term.scale == 1.0).all() else _scalar_or_list(term.scale),
        clip=None if clip is None else [_scalar_or_list(side) for side in clip],
        history=None if term.history == 1 else term.history,
        filter=_filter(term.filter),
    )


def _filter(spec: FilterSpec | None) -> dict[str, Any] | None:
    return None if spec is None else _without_none(**asdict(spec))


def _without_none(**values: Any) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def _plain(array: NDArray[np.float32]) -> Any:
    """Return shortest decimals that read back as the same float32."""
    if array.ndim > 1:
        return [_plain(row) for row in array]
    return [float(str(value)) for value in array]


def _scalar_or_list(array: NDArray[np.float32]) -> Any:
    values = _plain(array)
    return values[0] if len(set(values)) == 1 else values


class _Dumper(yaml.SafeDumper):
    """Lists of plain values and terms on one line, mappings spread out."""


def _list(dumper: yaml.SafeDumper, values: list[Any]) -> yaml.Node:
    flow = not any(isinstance(value, dict) for value in values)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=flow)


_Dumper.add_representer(list, _list)
_Dumper.add_representer(Tagged, lambda dumper, value: dumper.represent_str(str(value.value)))


def _dump(values: dict[str, Any]) -> str:
    return yaml.dump(
        values,
        Dumper=_Dumper,
        sort_keys=False,
        allow_unicode=True,
        width=98,
        default_flow_style=False,
    )

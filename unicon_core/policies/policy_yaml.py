"""Our own `policy.yaml`: reading it into facts, and writing a contract in canonical form."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from unicon_base import AnyDict, PolicyError, cannot
from unicon_base.located_yaml import Located, Tagged, other_kind
from unicon_base.resources import sha256_of
from unicon_core.policies.contract import ObservationTerm, PolicyContract, PolicyFacts
from unicon_core.policies.facts import TO_GIVE, Facts
from unicon_core.policies.file import read_facts
from unicon_core.policies.hints import Feed, MotionSpec
from unicon_core.policies.networks.onnx_file import read_onnx
from unicon_core.policies.perception import HeightScanSpec, ImageSpec

SCHEMA = "unicon.policy/1"


def policy_yaml_facts(located: Located) -> Facts:
    """Return what a `policy.yaml` says.

    Raises:
        PolicyError: it is no mapping, or another kind of file.
    """
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
    return Facts(located.path, "policy.yaml", dict(located.value), located.lines)


def write_policy_yaml(contract: PolicyContract, out_dir: str | Path) -> Path:
    """Write the canonical form, with the network's files copied beside it.

    Args:
        contract: the policy.
        out_dir: folder; made where it is missing.

    Returns:
        The `policy.yaml` written.

    Raises:
        PolicyError: the network or one of its files is missing.
        UniconError: the folder cannot be written.
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
        PolicyError: as for `write_policy_yaml`; or facts are wrong.
    """
    key = "torchscript" if "torchscript" in facts.values else "onnx"
    model = facts.model() if key in facts.values else None
    read_facts(facts, missing)
    values: AnyDict = {"schema": SCHEMA}
    if model is not None:
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
    with cannot(f"write the policy in {folder}", "give another folder"):
        folder.mkdir(parents=True, exist_ok=True)
        if model is not None:
            _copy_model(model, folder)
        path = folder / "policy.yaml"
        path.write_text(text, "utf-8")
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
    target.parent.mkdir(parents=True, exist_ok=True)
    with suppress(shutil.SameFileError):
        shutil.copyfile(source, target)


def contract_values(contract: PolicyContract) -> AnyDict:
    """Return the canonical form as plain values; `build_contract` reads them back."""
    values = _plain(contract)
    action = values["action"]
    if contract.action.joints == contract.joints:
        del action["joints"]
    if "kinds" in action:
        action["kind"] = action.pop("kinds")
    networks = {
        part.name: {
            "onnx": part.model.name,
            "sha256": sha256_of(part.model),
            "feeds": _plain(part.feeds),
        }
        for part in contract.networks
    }
    head = {
        "schema": SCHEMA,
        "name": contract.name,
        "torchscript" if contract.is_torchscript else "onnx": contract.model.name,
        "sha256": contract.sha256,
        "networks": networks or None,
    }
    if not contract.terms:
        del values["observation"]
    found = head | {each.name: values.get(each.name) for each in fields(PolicyFacts)}
    return {key: value for key, value in found.items() if value is not None}


# Of these what is as it would be unless it were said is left out.
_BRIEF = (PolicyContract, HeightScanSpec, ImageSpec, ObservationTerm, MotionSpec)


def _plain(value: Any, alone: bool = False) -> Any:
    """Return a value of a contract as YAML has it; what is None or empty is left out.

    Args:
        value: any; numbers become the shortest decimals that read back as the same float32.
        alone: one number is no list.
    """
    if isinstance(value, np.floating):
        return float(str(value))
    if isinstance(value, np.ndarray) and alone and value.ndim == 1 and len({*value.tolist()}) == 1:
        return _plain(value[0])
    if isinstance(value, np.ndarray | tuple):
        return [_plain(each, alone) for each in value]
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, Path):
        return value.name
    if isinstance(value, Feed):
        return str(value)
    if not is_dataclass(value):
        return value
    found = {}
    for each in fields(value):
        said: Any = getattr(value, each.name)
        usual: Any = each.default
        if each.default_factory is not MISSING:
            usual = each.default_factory()
        empty = said is None or (isinstance(said, tuple | Mapping) and not said)
        if not empty and not (isinstance(value, _BRIEF) and np.array_equal(said, usual)):
            found[each.name] = _plain(
                said, isinstance(value, ObservationTerm) and each.name != "value"
            )
    if "value" in found:  # of a constant, whose state follows from its name
        found.pop("state", None)
    return found


class _Dumper(yaml.SafeDumper):
    """Lists of plain values and terms on one line, mappings spread out."""


def _list(dumper: yaml.SafeDumper, values: list[Any]) -> yaml.Node:
    flow = not any(isinstance(value, dict) for value in values)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=flow)


_Dumper.add_representer(list, _list)
_Dumper.add_representer(Tagged, lambda dumper, value: dumper.represent_str(str(value.value)))


def _dump(values: AnyDict) -> str:
    return yaml.dump(
        values,
        Dumper=_Dumper,
        sort_keys=False,
        allow_unicode=True,
        width=98,
        default_flow_style=False,
    )

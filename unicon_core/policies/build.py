"""From facts to a checked PolicyContract, for every importer; every mistake is named at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from unicon_base.arrays import Float32
from unicon_base.errors import PolicyError
from unicon_base.located_yaml import Where
from unicon_base.resources import file_beside
from unicon_base.schema.read import refuse
from unicon_base.schema.records import record_of
from unicon_base.schema.types import Mistakes
from unicon_core.policies.contract import (
    ActionSpec,
    FilterSpec,
    NetworkPart,
    PolicyContract,
    PolicyFacts,
)
from unicon_core.policies.facts import Facts, dig, is_open, missing_facts
from unicon_core.policies.file import ActionFile, PolicyFile, is_single, kinds_of
from unicon_core.policies.motion.spec import with_clip
from unicon_core.robots import joint_index


class IncompletePolicyError(PolicyError):
    """A policy lacks facts.

    Args:
        message: which, and how to give them.
        facts: what it says.
    """

    def __init__(self, message: str, facts: Facts) -> None:
        super().__init__(message)
        self.facts = facts


class _Mistakes(Mistakes):
    """The mistakes of facts, but for facts that are missing, which `missing_facts` asks for."""

    def missing(self, where: Where, key: str, wanted: str) -> None:
        if not where or key in ("scale", "state"):
            self.found.append((where, ""))
        else:
            super().missing(where, key, wanted)


def read_facts(facts: Facts, missing: Mapping[str, str]) -> PolicyFile:
    """Return what facts say, which is of no use where some are missing.

    Args:
        facts: of a source.
        missing: those that are asked for elsewhere: a place that is still open is no mistake then.

    Raises:
        PolicyError: facts are wrong: file, line and remedy of each mistake.
    """
    mistakes = _Mistakes(facts.values)
    said: PolicyFile = record_of(PolicyFile).read(facts.values, (), mistakes)
    mistakes.found = [
        (where, text)
        for where, text in mistakes.found
        if text and not (missing and is_open(dig(facts.values, *where)))
    ]
    refuse(mistakes, facts.error, f"policy {facts.path}")
    return said


def build_contract(facts: Facts) -> PolicyContract:
    """Check facts and build the contract.

    Raises:
        PolicyError: facts are wrong or missing; all are named, missing ones with how to give them.
    """
    missing = missing_facts(facts)
    said = read_facts(facts, missing)
    if missing:
        names = "; ".join(f"{name} ({what})" if what else name for name, what in missing.items())
        remedy = (
            f"add it to {facts.path.name}"
            if facts.source == "policy.yaml"
            else "give it under 'given' in the workflow, with the keys of policy.yaml"
        )
        raise IncompletePolicyError(
            f"{facts.path}: the {facts.source} does not say {names}; {remedy}{facts.offer}", facts
        )
    shared = {each.name: getattr(said, each.name) for each in fields(PolicyFacts)}
    shared["default_joint_pos"] = default = _spread(said.default_joint_pos, len(said.joints))
    shared["action"] = action = _action(said.action, said.joints, default)
    shared["stiffness"] = _gains(facts, said, action, "stiffness", "velocity", "torque")
    shared["damping"] = _gains(facts, said, action, "damping", "torque")
    shared["motion"] = said.motion and with_clip(said.motion, facts)
    networks = [
        NetworkPart(
            name,
            file_beside(facts.path, part.onnx, "onnx", error=PolicyError),
            part.feeds,
            part.sha256,
        )
        for name, part in said.networks.items()
    ]
    return PolicyContract(
        **shared,
        name=said.name or facts.path.parent.name or facts.path.stem,
        path=facts.path,
        model=facts.model(),
        networks=tuple(networks),
        source=facts.source,
        notes=tuple(facts.notes),
    )


def _spread(array: Float32, count: int) -> Float32:
    return np.array(np.broadcast_to(array, count))


def _action(said: ActionFile, joints: tuple[str, ...], default: Float32) -> ActionSpec:
    moved = said.joints or joints
    count, kinds = len(moved), kinds_of(said.kind, moved)
    positions = np.array([kind == "position" for kind in kinds])
    pose = np.where(positions, default[joint_index(moved, joints)], np.float32(0.0))
    return ActionSpec(
        moved,
        _spread(said.scale, count),
        pose if said.offset is None else _spread(said.offset, count),
        None if said.clip is None else np.array(np.broadcast_to(said.clip, (2, count))),
        said.feedback,
        () if set(kinds) == {"position"} else tuple(kinds),
        None if said.filter is None else FilterSpec(**asdict(said.filter)),
    )


def _gains(facts: Facts, said: PolicyFile, action: ActionSpec, key: str, *without: Any) -> Float32:
    """Return gains, shape (n,); a single one is not that of joints of some kinds."""
    gains = _spread(getattr(said, key), len(said.joints))
    for name, kind in zip(action.joints, action.kinds):
        if kind in without and is_single(facts.values[key]):
            gains[said.joints.index(name)] = 0.0
    return gains

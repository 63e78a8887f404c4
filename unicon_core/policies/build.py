"""From facts to a checked PolicyContract, for every importer; every error is one line."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from unicon_core.bounds import POSITION, SCALE
from unicon_core.errors import PolicyError
from unicon_core.policies.action_facts import (
    ACTION_KEYS,
    action_spec,
    command_spec,
    filter_spec,
    joint_gains,
)
from unicon_core.policies.chain_facts import chain_facts
from unicon_core.policies.contract import (
    ObservationSpec,
    ObservationTerm,
    PhaseSpec,
    PolicyContract,
    Recurrent,
)
from unicon_core.policies.fact_value import FactValue as _Value
from unicon_core.policies.fact_value import is_whole
from unicon_core.policies.facts import Facts, missing_facts
from unicon_core.policies.motion.spec import motion_spec

SCHEMA = "unicon.policy/1"
MOST_FRAMES = 10_000  # of a history

_KEYS = (
    "schema", "name", "description", "onnx", "torchscript", "sha256", "period", "robot", "joints",
    "default_joint_pos", "action", "stiffness", "damping", "observation", "inputs", "outputs",
    "recurrent", "command", "command_ranges", "phase", "motion", "provider", "networks",
    "feeds", "sources",
)  # fmt: skip
_OBSERVATION = ("terms", "layout", "newest", "start")
_TERM = ("name", "state", "index", "subtract", "scale", "clip", "history", "filter")
_PHASE = ("period", "offsets", "stand", "resume", "stand_below", "command")


class IncompletePolicyError(PolicyError):
    """A policy lacks facts.

    Args:
        message: which, and how to give them.
        facts: what it says.
    """

    def __init__(self, message: str, facts: Facts) -> None:
        super().__init__(message)
        self.facts = facts


def build_contract(facts: Facts) -> PolicyContract:
    """Check facts and build the contract.

    Raises:
        PolicyError: facts are missing (all are named, with how to give them) or wrong.
    """
    check_keys(facts)
    missing = missing_facts(facts)
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
    root = _Value(facts, (), facts.values)
    schema = root.at("schema", SCHEMA)
    if schema.value != SCHEMA:
        raise schema.refuse(f"this program reads {SCHEMA!r}")
    joints = root.at("joints").names()
    count = len(joints)
    default = root.at("default_joint_pos").vector(
        -POSITION, POSITION, count, " rad; are these degrees?"
    )
    period = root.at("period").positive("the control period in [s]")
    action = action_spec(root.at("action"), joints, default, period)
    stiffness, damping = joint_gains(root, joints, action)
    inputs, outputs = (_tensors(root.at(key)) for key in ("inputs", "outputs"))
    sha256 = root.at("sha256").value
    if sha256 is not None and not (isinstance(sha256, str) and len(sha256) == 64):
        raise root.at("sha256").refuse("give the 64 digits of 'sha256sum'")
    provider = root.choice("provider", "cpu", "cuda", "tensorrt")
    if provider != "cpu" and "torchscript" in facts.values:
        raise root.at("provider").refuse("TorchScript runs on the cpu; export the network as ONNX")
    networks, feeds = chain_facts(facts)
    observation = _observation(
        root.at("observation"), period, optional=bool(inputs) and "observation" not in inputs
    )
    phase = _phase(root.at("phase"))
    reads = {*inputs, *(term.state for term in observation.terms)}
    reads |= set() if phase is None or phase.stand is None else {phase.command}
    robot = root.at("robot").value
    return PolicyContract(
        name=str(root.at("name").value or facts.path.parent.name or facts.path.stem),
        path=facts.path,
        model=facts.model(),
        period=period,
        joints=joints,
        default_joint_pos=default,
        action=action,
        stiffness=stiffness,
        damping=damping,
        observation=observation,
        inputs=MappingProxyType(inputs),
        outputs=MappingProxyType(outputs),
        recurrent=_recurrent(root.at("recurrent")),
        command_ranges=MappingProxyType(_ranges(root.at("command_ranges"))),
        phase=phase,
        command=command_spec(root.at("command"), reads),
        motion=motion_spec(facts),
        robot=None if robot is None else str(robot),
        sha256=None if sha256 is None else sha256.lower(),
        provider=provider,
        networks=networks,
        feeds=feeds,
        source=facts.source,
        notes=tuple(facts.notes),
    )


def check_keys(facts: Facts) -> None:
    """Refuse an unknown key, which may be a missing fact misspelt.

    Raises:
        PolicyError: a key is unknown, or what has keys is no mapping.
    """
    root = _Value(facts, (), facts.values).mapping(_KEYS)
    for key, known in (("action", ACTION_KEYS), ("observation", _OBSERVATION)):
        if root.at(key).value is not None:
            root.at(key).mapping(known)
    observation = root.at("observation")
    terms = observation.value and observation.at("terms").value
    for i, term in enumerate(terms if isinstance(terms, list) else ()):
        if isinstance(term, Mapping):
            observation.at("terms").at(i).mapping(_TERM)


def _tensors(names: _Value) -> dict[str, str]:
    return {str(k): str(v) for k, v in names.entries().items()} if names.value else {}


def _observation(observation: _Value, period: float, optional: bool) -> ObservationSpec:
    if observation.value is None and optional:
        return ObservationSpec(())
    listed = observation.at("terms")
    if not isinstance(listed.value or [], (list, tuple)):
        raise listed.fail("is not a list; give '- {name: …, state: …}'")
    terms = tuple(_term(listed.at(i), period) for i in range(len(listed.value or ())))
    layout = observation.choice("layout", "term_major", "frame_major")
    odd = [term for term in terms if term.history != terms[0].history]
    if layout == "frame_major" and odd:
        raise observation.at("layout").fail(
            f"is frame_major, but term {terms[0].name!r} has history "
            f"{terms[0].history} and term {odd[0].name!r} {odd[0].history}; "
            "give all terms one history, or use term_major"
        )
    return ObservationSpec(
        terms,
        layout,
        observation.choice("newest", "last", "first"),
        observation.choice("start", "first", "zeros"),
    )


def _term(term: _Value, period: float) -> ObservationTerm:
    if not isinstance(term.value, Mapping) or not isinstance(term.value.get("name"), str):
        raise term.fail("has no name; give 'name:' and 'state:'")
    state, index, subtract = term.at("state"), term.at("index"), term.at("subtract")
    scale, history = term.at("scale"), term.at("history", 1)
    if not isinstance(state.value, str):
        raise state.refuse("name it")
    listed = index.value if isinstance(index.value, (list, tuple)) else [index.value]
    for place in () if index.value is None else listed:
        if not is_whole(place, 0):
            raise index.fail(f"has {place!r}; give whole numbers from 0")
    taken = subtract.value
    if isinstance(taken, str):
        if taken != "default_joint_pos":
            raise subtract.refuse("known: default_joint_pos, or numbers")
    elif taken is not None:
        taken = subtract.finite()
    if not is_whole(history.value, 1):
        raise history.refuse("give a whole number from 1")
    if history.value > MOST_FRAMES:
        raise history.refuse(f"give at most {MOST_FRAMES} frames")
    return ObservationTerm(
        term.value["name"],
        state.value,
        None if index.value is None else tuple(listed),
        taken,
        np.ones(1, np.float32) if scale.value is None else scale.vector(-SCALE, SCALE),
        term.at("clip").clip(),
        history.value,
        filter_spec(term.at("filter"), period, "first"),
    )


def _recurrent(recurrent: _Value) -> tuple[Recurrent, ...]:
    pairs = recurrent.value or []
    result = []
    for i, pair in enumerate(pairs if isinstance(pairs, (list, tuple)) else [pairs]):
        if not isinstance(pair, Mapping) or set(pair) != {"input", "output"}:
            raise recurrent.part(i, pair).refuse("give {input: …, output: …}")
        result.append(Recurrent(str(pair["input"]), str(pair["output"])))
    return tuple(result)


def _ranges(ranges: _Value) -> dict[str, tuple[float, float]]:
    result = {}
    for name in ranges.entries() if ranges.value else ():
        pair = ranges.at(name).clip(1)
        if pair is not None:
            result[str(name)] = (float(pair[0, 0]), float(pair[1, 0]))
    return result


def _phase(phase: _Value) -> PhaseSpec | None:
    if phase.value is None:
        return None
    offsets = phase.mapping(_PHASE).at("offsets", [0.0, np.pi]).finite()
    return PhaseSpec(
        phase.at("period").positive("the gait's period in [s]"),
        tuple(float(offset) for offset in offsets),
        _stand(phase.at("stand")),
        _threshold(phase.at("stand_below", 0.01)),
        str(phase.at("command", "velocity_command").value),
        _resume(phase),
    )


def _stand(stand: _Value) -> Any:
    if isinstance(stand.value, str):
        if stand.value not in ("freeze", "zero"):
            raise stand.refuse("give a phase in [rad], freeze or zero")
        return stand.value
    return None if stand.value is None else stand.single()


def _threshold(below: _Value) -> float:
    number = below.single()
    if not number > 0.0:
        raise below.refuse("give a speed above 0 in [m/s] and [rad/s]: no command is below it")
    return number


def _resume(phase: _Value) -> Any:
    if phase.value.get("resume") is None:
        return None
    if phase.value.get("stand") is None:
        raise phase.at("resume").fail(
            "says where the phases go on, and stand: does not say that they stand; add stand: "
            "a phase in [rad], freeze or zero"
        )
    return phase.choice("resume", "offsets", "stand", "clock")

"""Isaac Lab's `params/env.yaml` (the dumped environment) as facts, as far as it says them.

From isaac-sim/IsaacLab: period = `sim.dt` · `decimation`; pose, gains and scale stand as patterns
over joint names, so they are known once `joints` is given (the joint order is in the robot's USD
file only); a term is named by its function (`…mdp.observations:joint_pos_rel`), clipped, then
scaled; its history is oldest first and flattened term by term.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from unicon_core.errors import PolicyError
from unicon_core.located_yaml import Located, read_yaml
from unicon_core.policies.facts import Facts, dig, given_joints, term_state
from unicon_core.policies.importers.training import (
    command_ranges,
    matching,
    say_period,
    values_by_pattern,
)

__all__ = ["env_yaml_facts", "is_env_yaml"]

_GROUPS = ("policy", "actor")


def is_env_yaml(values: Any) -> bool:
    """Whether a YAML document is an Isaac Lab environment."""
    return (
        isinstance(values, Mapping)
        and isinstance(values.get("sim"), Mapping)
        and "decimation" in values
        and "observations" in values
    )


def env_yaml_facts(path: Path, given: Mapping[str, Any]) -> Facts:
    """Read an Isaac Lab `env.yaml`.

    Args:
        path: the file.
        given: facts of the user; `joints` resolves the patterns.

    Raises:
        PolicyError: not readable, or actions that are not joint position targets.
    """
    located = read_yaml(path, PolicyError, foreign=True)
    document = located.value
    facts = Facts(path, "Isaac Lab env.yaml", by_pattern=True)
    joints = given_joints(path, given)
    say_period(facts, document["sim"].get("dt"), document["decimation"], "sim.dt · decimation")
    if joints is not None:
        facts.values["joints"] = joints
        _robot(facts, document, joints)
    _action(facts, located, joints)
    _observation(facts, located)
    ranges = command_ranges(dig(document, "commands", "base_velocity", "ranges"))
    if ranges:
        facts.values["command_ranges"] = ranges
    if joints is None:
        facts.notes.append(
            "env.yaml: pose, gains and scale stand there by name patterns; "
            "they are known once joints is given"
        )
    return facts


def _robot(facts: Facts, document: Mapping[str, Any], joints: list[str]) -> None:
    pose = values_by_pattern(
        dig(document, "scene", "robot", "init_state", "joint_pos"), joints, default=0.0
    )
    if pose is not None:
        facts.values["default_joint_pos"] = pose
    actuators = dig(document, "scene", "robot", "actuators")
    for key in ("stiffness", "damping"):
        found: dict[str, float] = {}
        for actuator in (actuators or {}).values() if isinstance(actuators, Mapping) else ():
            patterns = dig(actuator, "joint_names_expr") or []
            own = matching(patterns if isinstance(patterns, list) else [patterns], joints)
            for joint in own:
                gain = values_by_pattern(dig(actuator, key), [joint])
                found |= {} if gain is None else {joint: gain[0]}
        if all(joint in found for joint in joints):
            facts.values[key] = [found[joint] for joint in joints]


def _action(facts: Facts, located: Located, joints: list[str] | None) -> None:
    actions = located.value.get("actions")
    terms = {
        name: term
        for name, term in (actions.items() if isinstance(actions, Mapping) else ())
        if isinstance(term, Mapping)
    }
    if len(terms) != 1:
        raise located.error(
            ("actions",),
            f"actions has {len(terms)} terms ({', '.join(terms) or 'none'}); only one of joint "
            "position targets can be run",
        )
    name, term = next(iter(terms.items()))
    kind = str(term.get("class_type", ""))
    if kind and "JointPositionAction" not in kind:
        raise located.error(
            ("actions", name),
            f"action {name!r} is {kind}; only joint position targets can be run",
        )
    action: dict[str, Any] = {"feedback": "raw"}
    moved = joints
    patterns = term.get("joint_names")
    if joints is not None and isinstance(patterns, list):
        moved = matching(patterns, joints)
        if moved and moved != joints:
            action["joints"] = moved
    scale = term.get("scale")
    if isinstance(scale, (int, float)):
        action["scale"] = scale
    elif moved:
        resolved = values_by_pattern(scale, moved, default=1.0)
        if resolved is not None:
            action["scale"] = resolved
    if not term.get("use_default_offset", True):
        offset = term.get("offset", 0.0)
        resolved = values_by_pattern(offset, moved or [], default=0.0)
        action["offset"] = offset if isinstance(offset, (int, float)) else resolved
    facts.values["action"] = action
    for key in ("scale", "offset"):
        facts.keys[("action", key)] = f"actions.{name}.{key}"


def _observation(facts: Facts, located: Located) -> None:
    observations = located.value["observations"]
    name = next((g for g in _GROUPS if isinstance(dig(observations, g), Mapping)), None)
    if name is None:
        raise located.error(("observations",), "observations has no group policy or actor")
    group = observations[name]
    if group.get("concatenate_terms") is False:
        raise located.error(
            ("observations", name),
            f"observations.{name} is not concatenated; only one input vector can be run",
        )
    shared = group.get("history_length")
    terms: list[dict[str, Any]] = []
    for key, value in group.items():
        if not isinstance(value, Mapping) or "func" not in value:
            continue
        function = str(value["func"]).rsplit(":", 1)[-1].rsplit(".", 1)[-1]
        term: dict[str, Any] = {"name": key, **term_state(function, absolute=True)}
        if not term_state(function):
            facts.notes.append(f"env.yaml: no state is known for {key!r} (function {function})")
        scale = value.get("scale")
        term["scale"] = 1.0 if scale is None else scale
        clip = value.get("clip")
        if clip is not None:
            term["clip"] = clip
        length = shared if shared is not None else value.get("history_length")
        term["history"] = 1 if length in (None, 0) else length
        facts.lines[("observation", "terms", len(terms))] = located.lines[
            ("observations", name, key)
        ]
        terms.append(term)
    facts.values["observation"] = {"layout": "term_major", "newest": "last", "terms": terms}

"""Isaac Lab's `params/env.yaml` (the dumped environment) as facts, as far as it says them.

From isaac-sim/IsaacLab: period = `sim.dt` · `decimation`; pose, gains and scale stand as patterns
over joint names, so they are known once the joints are. The articulation's order is in the robot's
USD file only, so `joints` must be given, unless the action and each term of joints name them one
by one with `preserve_order` (`managers/scene_entity_cfg.py`, `envs/mdp/actions/joint_actions.py`),
as robot_lab does. A term is named by its function (`…mdp.observations:joint_pos_rel`), clipped,
then scaled; its history is oldest first and flattened term by term.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import Any

from unicon_base.located_yaml import Located, Where
from unicon_core.policies.facts import GAINS, TO_GIVE, Facts, dig, open_joints, term_state
from unicon_core.policies.importers.source_reader import Source
from unicon_core.policies.importers.training import (
    chosen_ids,
    chosen_joints,
    matching,
    say_period,
    say_ranges,
    stated_order,
    values_by_pattern,
)

_GROUPS = ("policy", "actor")
_OF_JOINTS = ("joint_pos", "joint_vel")


def env_yaml_facts(source: Source) -> Facts:
    """Return what an Isaac Lab `env.yaml` says; given joints resolve its patterns.

    Raises:
        PolicyError: actions that are not joint position targets.
    """
    located, document = source.located, source.located.value
    facts = Facts(source.path, "Isaac Lab env.yaml", by_pattern=True)
    name, action = _action_term(located)
    where, terms = _terms(located)
    joints = source.joints or _stated_joints(facts, action, terms)
    say_period(facts, document, "sim.dt", "decimation")
    if joints is not None:
        facts.values["joints"] = joints
        _robot(facts, document, joints)
    _action(facts, located, name, action, joints)
    _observation(facts, located, where, terms, joints)
    say_ranges(facts, document, "commands.base_velocity.ranges")
    return facts


def _stated_joints(
    facts: Facts, action: Mapping[str, Any], terms: Mapping[str, Mapping[str, Any]]
) -> list[str] | None:
    """Return the joints in the action's order, where all that is of joints states its own order."""
    stated = stated_order(action)
    if stated is None:
        return None
    for name, term in terms.items():
        chosen = dig(term, "params", "asset_cfg")
        state = term_state(_function(term)).get("state", chosen and "joint_pos")
        if state not in _OF_JOINTS:
            continue
        own = stated_order(chosen)
        if own is None:
            facts.asks["joints"] = f"term {name!r} has them in the articulation's order"
            return None
        stated = list(dict.fromkeys([*stated, *own]))
    return stated


def _robot(facts: Facts, document: Mapping[str, Any], joints: list[str]) -> None:
    pose = values_by_pattern(
        dig(document, "scene", "robot", "init_state", "joint_pos"), joints, default=0.0
    )
    if pose is not None:
        facts.values["default_joint_pos"] = pose
    actuators = dig(document, "scene", "robot", "actuators")
    for key in GAINS:
        found: dict[str, float] = {}
        moved: list[str] = []
        for actuator in actuators.values() if isinstance(actuators, Mapping) else ():
            patterns = dig(actuator, "joint_names_expr") or []
            own = matching(patterns if isinstance(patterns, list) else [patterns], joints)
            moved += own
            for joint in own:
                gain = values_by_pattern(dig(actuator, key), [joint])
                found |= {} if gain is None else {joint: gain[0]}
        if found:
            facts.values[key] = [found.get(joint, TO_GIVE) for joint in joints]
        bare = [joint for joint in joints if joint not in moved]
        if found and bare:
            facts.asks[key] = f"no actuator's joint_names_expr matches {', '.join(bare)}"


def suggest_joints(facts: Facts, widths: Collection[int | str]) -> None:
    """Where the network moves as many joints as have gains, say that those may be all.

    Args:
        facts: changed in place.
        widths: of the network's outputs.
    """
    for key in GAINS:
        bare = open_joints(facts, key)
        driven = [joint for joint in facts.values["joints"] if joint not in bare] if bare else []
        if driven and key in facts.asks and len(driven) in widths:
            facts.asks[key] += (
                f"; the network's output is as wide as the {len(driven)} others: if they are all "
                f"that it was trained with, give joints without these: --joints {','.join(driven)}"
            )
            return  # said once


def _action_term(located: Located) -> tuple[str, Mapping[str, Any]]:
    actions = located.value.get("actions")
    terms = {
        name: term
        for name, term in (actions.items() if isinstance(actions, Mapping) else ())
        if isinstance(term, Mapping)
    }
    if len(terms) != 1:
        raise located.error(
            ("actions",),
            f"actions has {len(terms)} terms ({', '.join(map(str, terms)) or 'none'}); only one of "
            "joint position targets can be run",
        )
    name, term = next(iter(terms.items()))
    kind = str(term.get("class_type", ""))
    if kind and not re.search(r"\bJointPositionAction", kind):
        raise located.error(
            ("actions", name),
            f"action {name!r} is {kind}; only joint position targets can be run",
        )
    return name, term


def _action(
    facts: Facts,
    located: Located,
    name: str,
    term: Mapping[str, Any],
    joints: list[str] | None,
) -> None:
    action: dict[str, Any] = {"feedback": "raw"}
    moved = (joints and _chosen(located, ("actions", name), name, term, joints)) or joints
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
    if term.get("clip") is not None:
        facts.notes.append(f"env.yaml: actions.{name}.clip, bounds of its targets, is not imported")
    for key in ("scale", "offset"):
        facts.keys[("action", key)] = f"actions.{name}.{key}"


def _chosen(
    located: Located, where: Where, name: str, chosen: Any, joints: list[str]
) -> list[str] | None:
    """Return the joints that an action or a term chooses; None: all, in the articulation's order.

    Raises:
        PolicyError: one that it names is not among the joints.
    """
    try:
        named = chosen_joints(chosen, joints)
        if named is not None:
            return named
        ids = chosen_ids(dig(chosen, "joint_ids"))
        if ids is not None and not all(0 <= i < len(joints) for i in ids):
            raise ValueError(f"joint_ids is {ids}, and there are {len(joints)} joints")
    except ValueError as error:
        raise located.error(where, f"{name!r}: {error}") from error
    return None if ids is None else [joints[i] for i in ids]


def _terms(located: Located) -> tuple[Where, dict[str, Mapping[str, Any]]]:
    """Return where the terms stand, and each by its name."""
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
    terms = {
        key: value for key, value in group.items() if isinstance(value, Mapping) and "func" in value
    }
    return ("observations", name), terms


def _function(term: Mapping[str, Any]) -> str:
    return str(term["func"]).rsplit(":", 1)[-1].rsplit(".", 1)[-1]


def _observation(
    facts: Facts,
    located: Located,
    where: Where,
    said: Mapping[str, Mapping[str, Any]],
    joints: list[str] | None,
) -> None:
    shared = dig(located.value, *where, "history_length")
    terms: list[dict[str, Any]] = []
    for key, value in said.items():
        function = _function(value)
        term: dict[str, Any] = {"name": key, **term_state(function, absolute=True)}
        if not term_state(function):
            facts.notes.append(f"env.yaml: no state is known for {key!r} (function {function})")
        unread = _unread(located.value, value, function)
        if unread:
            term = {"name": key}
            facts.asks[f"observation.terms.{key}.state"] = (
                f"env.yaml gives it {unread}, which is not read: give its state, index, subtract, "
                "scale and clip"
            )
        elif joints is not None and term.get("state", "joint_pos") in _OF_JOINTS:
            chosen = dig(value, "params", "asset_cfg")
            of_it = _chosen(located, (*where, key), key, chosen, joints)
            if of_it is not None and of_it != joints:
                term["index"] = [joints.index(joint) for joint in of_it]
        if function == "gait_phase" and not unread:
            period = dig(value, "params", "period")
            facts.values["phase"] = {"period": period, "offsets": [0.0]}
        if not unread:
            term["scale"] = 1.0 if value.get("scale") is None else value["scale"]
            term |= {} if value.get("clip") is None else {"clip": value["clip"]}
        length = shared if shared is not None else value.get("history_length")
        term["history"] = 1 if length in (None, 0) else length
        facts.lines[("observation", "terms", len(terms))] = located.lines[(*where, key)]
        terms.append(term)
    facts.values["observation"] = {"layout": "term_major", "newest": "last", "terms": terms}


def _unread(document: Mapping[str, Any], term: Mapping[str, Any], function: str) -> str:
    """Return what changes a term and is not understood, "" where nothing does.

    A function without a known state has parameters that only a given state can mind.
    """
    modifiers = term.get("modifiers")
    if modifiers:
        listed = modifiers if isinstance(modifiers, list) else [modifiers]
        return f"modifiers ({', '.join(str(dig(each, 'func') or each) for each in listed)})"
    params = term.get("params") or {}
    if not term_state(function):
        return ""
    if not isinstance(params, Mapping):
        return f"params ({params})"
    for key, value in params.items():
        if value is None:
            continue
        known = {
            "asset_cfg": dig(value, "name") in (None, "robot") and isinstance(value, Mapping),
            "command_name": value == "base_velocity"
            or "VelocityCommand" in str(dig(document, "commands", str(value), "class_type")),
            "action_name": isinstance(value, str) and value in document["actions"],
            "period": function == "gait_phase",
        }
        if not known.get(key):
            shown = dig(value, "name") or value
            return f"params.{key} ({shown})"
    return ""

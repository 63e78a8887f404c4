"""Unitree's `deploy.yaml` (unitree_rl_lab, unitree_rl_mjlab) as facts.

Facts of the format, from unitreerobotics/unitree_rl_lab:
`utils/export_deploy_cfg.py` rounds to 3 significant digits; `stiffness` and `damping` are in the
SDK's motor order, everything else in policy order, and policy joint i is motor `joint_ids_map[i]`
(`deploy/include/unitree_articulation.h`). An action is scaled, offset, then clipped, and the raw
one is fed back (`envs/mdp/actions/joint_actions.h`). A term is clipped, then scaled, unless
`scale_first`; its history is oldest first and filled with the first value at the start
(`manager/manager_term_cfg.h`); `use_gym_history` interleaves whole frames
(`manager/observation_manager.h`). The gait phase is [sin, cos] of one clock (`mdp/observations.h`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from unicon_base.errors import alternatives
from unicon_base.located_yaml import Where
from unicon_core.policies.facts import GAINS, Facts, dig, term_state
from unicon_core.policies.hints import Pair
from unicon_core.policies.importers.source import Source, clip_before_scale

_FLAGS = ("scale_first", "use_gym_history")
_KEYS = ("params", "scale", "clip", "history_length")
_USUAL = ("base_ang_vel", "projected_gravity", "velocity_commands", "joint_pos_rel",
          "joint_vel_rel", "last_action", "gait_phase")  # fmt: skip


def deploy_yaml_facts(source: Source) -> Facts:
    """Return what a `deploy.yaml` says.

    Raises:
        PolicyError: it is against the format.
    """
    facts = source.facts
    facts.source, facts.tolerance = "deploy.yaml", (6e-3, 1e-6)
    count = _joints(source)
    _action(source, count)
    _observation(source)
    source.say_ranges("commands.base_velocity.ranges")
    facts.notes.append("deploy.yaml: numbers are rounded to 3 significant digits by its exporter")
    return facts


def _joints(source: Source) -> int:
    facts, order = source.facts, source.places("joint_ids_map")
    if not order:
        raise source.wrong("joint_ids_map", "joint_ids_map is empty; give motor numbers")
    source.say("period", source.document["step_dt"], "step_dt")
    if source.robot is not None:
        source.say_motors("joint_ids_map", order, source.robot)
    else:
        facts.notes.append(
            "deploy.yaml: joints are numbers of the robot's motors (joint_ids_map); "
            "name the robot and they are known"
        )
    for fact in GAINS:
        values = source.numbers(fact)
        if max(order) < len(values):
            source.say(fact, [values[i] for i in order], fact)
        else:  # Unitree's own G1 file with 23 joints; its program gives value i to motor i
            facts.asks[fact] = (
                f"the file has {len(values)} values in motor order, but joint_ids_map names "
                f"motor {max(order)}"
            )
    source.copy("default_joint_pos", "default_joint_pos", len(order))
    return len(order)


def _action(source: Source, count: int) -> None:
    actions = source.need("actions")
    if not isinstance(actions, Mapping) or list(actions) != ["JointPositionAction"]:
        names = ", ".join(actions) if isinstance(actions, Mapping) else repr(actions)
        text = f"actions are {names}; only one JointPositionAction (joint position targets) runs"
        raise source.wrong("actions", text)
    where, action = "actions.JointPositionAction", actions["JointPositionAction"]
    if not isinstance(action, Mapping):
        raise source.wrong(where, f"JointPositionAction is {action!r}; give scale and offset")
    size = count
    if isinstance(action.get("joint_ids"), list):
        ids, joints = source.places(f"{where}.joint_ids", count), source.facts.values.get("joints")
        size = len(ids)
        if joints is not None and ids != list(range(count)):
            source.say("action.joints", [joints[i] for i in ids], f"{where}.joint_ids")
    for key in ("scale", "offset"):
        values = source.numbers(f"{where}.{key}")
        source.copy(f"action.{key}", f"{where}.{key}", 0 if len(values) == 1 else size)
    if action.get("clip") is not None:
        # Unitree clips the target, we clip the action: bring the bounds to the other side.
        clip = f"{where}.clip"
        pairs = source.value(list[Pair], clip)
        scale, offset = (source.numbers(f"{where}.{key}") for key in ("scale", "offset"))
        if not all(scale) or len({len(pairs), len(scale), len(offset)} - {1}) > 1:
            raise source.wrong(clip, f"clip is {action['clip']!r}; give [lowest, highest] each")
        bounds = np.sort((np.array(pairs) - np.c_[offset]) / np.c_[scale], axis=1)
        source.say("action.clip", bounds.T.tolist(), clip)
    source.say("action.feedback", "raw", where)


def _observation(source: Source) -> None:
    where: Where = ("observations",)
    group = source.need("observations")
    if not isinstance(group, Mapping) or not group:
        raise source.wrong(where, f"observations are {group!r}; give the terms")
    entries = [key for key in group if key not in _FLAGS]
    if entries and not any(_is_term(group[key]) for key in entries):
        if len(entries) > 1:
            raise source.wrong(
                where,
                f"observations has the groups {', '.join(entries)}; only one can be imported, "
                "write a policy.yaml with 'inputs' for the others",
            )
        where, group = (*where, entries[0]), group[entries[0]]
        source.say("inputs.observation", entries[0], where)
        if not isinstance(group, Mapping):
            raise source.wrong(where, f"observations.{where[-1]} is {group!r}; no term")
    terms: list[dict[str, Any]] = []
    for name, value in group.items():
        if name in _FLAGS:
            continue
        place = (*where, name)
        if not _is_term(value):
            raise source.wrong(place, f"observations.{name} is {value!r}; no term")
        source.facts.lines[("observation", "terms", len(terms))] = source.located.lines[place]
        terms.append(_term(source, place, value, bool(group.get("scale_first"))))
    source.facts.values["observation"] = {
        "layout": "frame_major" if group.get("use_gym_history") else "term_major",
        "newest": "last",
        "start": "first",
        "terms": terms,
    }


def _term(
    source: Source, where: Where, value: Mapping[str, Any], scale_first: bool
) -> dict[str, Any]:
    name, params = str(where[-1]), value.get("params")
    term: dict[str, Any] = {"name": name, **term_state(name, absolute=True)}
    places = source.ids(where, dig(params, "asset_cfg", "joint_ids"))
    if places is not None:
        term["index"] = places
    if name == "gait_phase" and (period := dig(params, "period")) is not None:
        source.say("phase", {"period": period, "offsets": [0.0]}, (*where, "params"))
    if value.get("scale") is not None:
        term["scale"] = source.numbers((*where, "scale"))
    if value.get("clip") is not None:
        pair = source.value(Pair, (*where, "clip"))
        term["clip"] = list(pair)
        if scale_first and "scale" in term:
            if not all(term["scale"]):
                raise source.wrong((*where, "scale"), f"{name}: scale 0 with scale_first and clip")
            term["clip"] = clip_before_scale(pair, term["scale"])
    term["history"] = value.get("history_length") or 1
    if not term_state(name):
        known = alternatives(name, _USUAL)
        source.facts.notes.append(f"deploy.yaml: no state is known for term {name!r}; {known}")
    return term


def _is_term(value: Any) -> bool:
    return isinstance(value, Mapping) and any(key in value for key in _KEYS)

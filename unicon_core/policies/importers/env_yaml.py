"""Dumped environments of training, as far as they say what a policy needs, as facts.

**Isaac Lab's `params/env.yaml`**, from isaac-sim/IsaacLab: period = `sim.dt` · `decimation`; pose,
gains and scale stand as patterns over joint names, so they are known once the joints are. The
articulation's order is in the robot's USD file only, so `joints` must be given, unless the action
and each term of joints name them one by one with `preserve_order` (`managers/scene_entity_cfg.py`,
`envs/mdp/actions/joint_actions.py`), as robot_lab does. A term is named by its function
(`…mdp.observations:joint_pos_rel`), clipped, then scaled; its history is oldest first and flattened
term by term. Joints are chosen as `SceneEntityCfg` does: by `joint_names`, which are patterns, in
the articulation's order unless `preserve_order` is set, else by `joint_ids`.

The function `height_scan` takes a sensor of the scene (`sensors/ray_caster/patterns/
patterns_cfg.py`, GridPatternCfg; `ray_caster_cfg.py`, ray_alignment), less its `offset` of 0.5 m.

**legged_gym**, from leggedrobotics/legged_gym `envs/base/legged_robot.py`: period = `sim.dt` ·
`control.decimation`; gains match by a part of the joint's name; actions are clipped to
`normalization.clip_actions`, and the clipped action is fed back. The terms and the joint order
stand in Python code, so they must be given; `normalization.obs_scales` has a term's scale.

**LeRobot's `config.json`** beside `model.safetensors`, from huggingface/lerobot 0.4:
`policies/act/configuration_act.py` and `policies/diffusion/configuration_diffusion.py` name sizes,
rows and frames. Joints, period, gains and pose stand nowhere in the folder; a data set of ours has
the robot file's joint order, and positions in [rad] as actions (`unicon bag export --lerobot`).
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Any

from unicon_base import AnyDict, AnyMapping, alternatives
from unicon_base.located_yaml import Where
from unicon_base.schema.marks import NotEmpty
from unicon_core.policies.facts import (
    GAINS,
    TO_GIVE,
    VOCABULARY,
    Facts,
    dig,
    open_joints,
    term_state,
    value_of,
)
from unicon_core.policies.hints import listed
from unicon_core.policies.importers.source import OF_JOINTS, Source, matches, values_by_pattern

_GROUPS = ("policy", "actor")
_SCAN, _SCAN_OFFSET = "height_scan", 0.5  # of the function, in [m], unless it says another


def legged_gym_facts(source: Source) -> Facts:
    """Return what a legged_gym configuration says; given joints resolve its names.

    Raises:
        PolicyError: given joints are no names, or numbers are none.
    """
    facts, document = source.facts, source.document
    facts.source, facts.by_pattern = "legged_gym configuration", True
    source.say_period("sim.dt", "control.decimation")
    facts.say("action.feedback", "clipped")
    if (scale := value_of(document, "control.action_scale")) is not None:
        source.say("action.scale", scale, "control.action_scale")
    if value_of(document, "normalization.clip_actions") is not None:
        source.say_clip("normalization.clip_actions")
    scales = value_of(document, "normalization.obs_scales")
    if isinstance(scales, Mapping):
        text = ", ".join(f"{name} {value}" for name, value in scales.items())
        facts.notes.append(f"{source.path.name}: scales for the terms to give: {text}")
    if (joints := source.joints()) is not None:
        facts.say("joints", joints)
        for fact, place in VOCABULARY["legged_gym"]["facts"].items():
            whole = fact not in GAINS
            values = values_by_pattern(value_of(document, place), joints, whole=whole)
            if values is not None:
                source.say(fact, values, place)
    source.say_ranges("commands.ranges")
    facts.say("observation.start", "zeros")
    return facts


def env_yaml_facts(source: Source) -> Facts:
    """Return what an Isaac Lab `env.yaml` says; given joints resolve its patterns.

    Raises:
        PolicyError: actions that are not joint position targets.
    """
    facts = source.facts
    facts.source, facts.by_pattern = "Isaac Lab env.yaml", True
    name, action = _action_term(source)
    where, terms = _term_group(source)
    joints = source.joints() or _stated_joints(facts, action, terms)
    source.say_period("sim.dt", "decimation")
    if joints is not None:
        facts.values["joints"] = joints
        _robot(facts, source.document, joints)
    _action(source, name, action, joints)
    shared = dig(source.document, *where, "history_length")
    said: list[AnyDict] = []
    for key, value in terms.items():
        facts.lines[("observation", "terms", len(said))] = source.located.lines[(*where, key)]
        length = value.get("history_length") if shared is None else shared
        said.append({**_term(source, (*where, key), value, joints), "history": length or 1})
    facts.values["observation"] = {"layout": "term_major", "newest": "last", "terms": said}
    source.say_ranges("commands.base_velocity.ranges")
    return facts


def _names(chosen: Any, key: str = "joint_names") -> list[str]:
    """The names or patterns under a key."""
    names = dig(chosen, key)
    return [str(name) for name in listed(names) if name is not None]


def _matching(patterns: Sequence[object], joints: Sequence[str]) -> list[str]:
    """Return the joints whose whole name matches one of the patterns, in joint order."""
    return [joint for joint in joints if any(matches(p, joint) for p in patterns)]


def _stated_order(chosen: Any) -> list[str] | None:
    """Return the joints where they are named one by one in an order that is kept, else None."""
    names = _names(chosen)
    said = bool(names) and all(re.fullmatch(r"[\w/-]+", name) for name in names)
    kept = len(names) == 1 or dig(chosen, "preserve_order") is True
    return list(dict.fromkeys(names)) if said and kept else None


def _stated_joints(
    facts: Facts, action: AnyMapping, terms: Mapping[str, AnyMapping]
) -> list[str] | None:
    """Return the joints in the action's order, where all that is of joints states its own order."""
    stated = _stated_order(action)
    for name, term in terms.items() if stated is not None else ():
        chosen = dig(term, "params", "asset_cfg")
        state = term_state(_function(term)).get("state", chosen and "joint_pos")
        if state not in OF_JOINTS:
            continue
        if (own := _stated_order(chosen)) is None:
            facts.asks["joints"] = f"term {name!r} has them in the articulation's order"
            return None
        stated = list(dict.fromkeys([*(stated or ()), *own]))
    return stated


def _robot(facts: Facts, document: AnyMapping, joints: list[str]) -> None:
    said = dig(document, "scene", "robot", "init_state", "joint_pos")
    pose = values_by_pattern(said, joints, default=0.0)
    if pose is not None:
        facts.values["default_joint_pos"] = pose
    actuators = dig(document, "scene", "robot", "actuators")
    driven = {
        joint: actuator
        for actuator in (actuators.values() if isinstance(actuators, Mapping) else ())
        for joint in _matching(_names(actuator, "joint_names_expr"), joints)
    }
    bare = ", ".join(joint for joint in joints if joint not in driven)
    for key in GAINS:
        gains = [values_by_pattern(dig(driven.get(name), key), [name]) for name in joints]
        if any(gains):
            facts.values[key] = [gain[0] if gain else TO_GIVE for gain in gains]
            if bare:
                facts.asks[key] = f"no actuator's joint_names_expr matches {bare}"


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


def _action_term(source: Source) -> tuple[str, AnyMapping]:
    actions = source.document.get("actions")
    pairs = actions.items() if isinstance(actions, Mapping) else ()
    terms = {name: term for name, term in pairs if isinstance(term, Mapping)}
    if len(terms) != 1:
        raise source.wrong(
            "actions",
            f"actions has {len(terms)} terms ({', '.join(map(str, terms)) or 'none'}); only one of "
            "joint position targets can be run",
        )
    ((name, term),) = terms.items()
    kind = str(term.get("class_type", ""))
    if kind and not re.search(r"\bJointPositionAction", kind):
        text = f"action {name!r} is {kind}; only joint position targets can be run"
        raise source.wrong(("actions", name), text)
    return name, term


def _action(source: Source, name: str, term: AnyMapping, joints: list[str] | None) -> None:
    facts = source.facts
    moved = (joints and _chosen(source, ("actions", name), term, joints)) or joints
    if moved != joints:
        facts.say("action.joints", moved)
    facts.say("action.feedback", "raw")
    defaults: dict[str, float | None] = {"scale": None, "offset": 0.0}
    if term.get("use_default_offset", True):
        del defaults["offset"]
    for key, default in defaults.items():
        value = term.get(key, default)
        if not isinstance(value, int | float):
            default = 1.0 if default is None else default
            value = values_by_pattern(value, moved, default=default) if moved else None
        if value is not None:
            source.say(f"action.{key}", value, ("actions", name, key))
    if term.get("clip") is not None:
        facts.notes.append(f"env.yaml: actions.{name}.clip, bounds of its targets, is not imported")


def _chosen(source: Source, where: Where, chosen: Any, joints: list[str]) -> list[str] | None:
    """Return the joints that an action or a term chooses; None: all, in the articulation's order.

    Raises:
        PolicyError: one that it names is not among the joints.
    """
    names, what = _names(chosen), repr(where[-1])
    found: list[str] = []
    for name in names:
        if not (some := _matching([name], joints)):
            text = f"{name!r}, which is none of the joints; {alternatives(name, joints)}"
            raise source.wrong(where, f"{what}: joint_names has {text}")
        found += some
    if names:
        kept = dig(chosen, "preserve_order") is True
        return list(dict.fromkeys(found if kept else _matching(names, joints)))
    ids = source.ids(where, dig(chosen, "joint_ids"))
    if ids is not None and not all(0 <= i < len(joints) for i in ids):
        text = f"joint_ids is {ids}, and there are {len(joints)} joints"
        raise source.wrong(where, f"{what}: {text}")
    return None if ids is None else [joints[i] for i in ids]


def _term_group(source: Source) -> tuple[Where, dict[str, AnyMapping]]:
    """Return where the terms stand, and each by its name."""
    observations = source.document["observations"]
    name = next((g for g in _GROUPS if isinstance(dig(observations, g), Mapping)), None)
    if name is None:
        raise source.wrong("observations", "observations has no group policy or actor")
    where, group = ("observations", name), observations[name]
    if group.get("concatenate_terms") is False:
        text = f"observations.{name} is not concatenated; only one input vector can be run"
        raise source.wrong(where, text)
    return where, {key: value for key, value in group.items() if dig(value, "func") is not None}


def _function(term: AnyMapping) -> str:
    return str(term["func"]).rsplit(":", 1)[-1].rsplit(".", 1)[-1]


def _term(source: Source, where: Where, value: AnyMapping, joints: list[str] | None) -> AnyDict:
    facts, key, function = source.facts, where[-1], _function(value)
    state = term_state(function, absolute=True)
    term = {"name": key, **state}
    if not state:
        facts.notes.append(f"env.yaml: no state is known for {key!r} (function {function})")
    if unread := _unread(source.document, value, function):
        facts.asks[f"observation.terms.{key}.state"] = (
            f"env.yaml gives it {unread}, which is not read: give its state, index, subtract, "
            "scale and clip"
        )
        return {"name": key}
    if joints is not None and term.get("state", "joint_pos") in OF_JOINTS:
        named = _chosen(source, where, dig(value, "params", "asset_cfg"), joints)
        if named not in (None, joints):
            term["index"] = [joints.index(joint) for joint in named or ()]
    if function == "gait_phase":
        facts.values["phase"] = {"period": dig(value, "params", "period"), "offsets": [0.0]}
    if function == _SCAN:
        name, offset = dig(value, "params", "sensor_cfg", "name"), dig(value, "params", "offset")
        facts.values[_SCAN] = _scan(source.document, name)
        term["subtract"] = _SCAN_OFFSET if offset is None else offset
        body = str(dig(source.document, "scene", str(name), "prim_path")).rpartition("/")[2]
        facts.notes.append(f"env.yaml: {name} hangs on {body}; here heights are of the base")
    term["scale"] = 1.0 if value.get("scale") is None else value["scale"]
    return term if value.get("clip") is None else {**term, "clip": value["clip"]}


def _scan(document: AnyMapping, name: Any) -> AnyDict | None:
    """Return the grid of a scanner that looks down and turns by the yaw; None of any other."""
    sensor = dig(document, "scene", str(name))
    pattern, pos = dig(sensor, "pattern_cfg"), dig(sensor, "offset", "pos")
    turns = dig(sensor, "ray_alignment") or ("yaw" if dig(sensor, "attach_yaw_only") else "base")
    down = dig(pattern, "direction") in (None, [0.0, 0.0, -1.0])
    grid = str(dig(pattern, "func")).endswith("grid_pattern")
    if not (grid and down and turns == "yaw" and isinstance(pos, list) and len(pos) == 3):
        return None
    made = {key: dig(pattern, key) for key in ("size", "resolution")}
    return {**made, "offset": pos[:2], "order": dig(pattern, "ordering") or "xy"}


def _unread(document: AnyMapping, term: AnyMapping, function: str) -> str:
    """Return what changes a term and is not understood, "" where nothing does.

    A function without a known state has parameters that only a given state can mind.
    """
    if modifiers := term.get("modifiers"):
        names = (str(dig(each, "func") or each) for each in listed(modifiers))
        return f"modifiers ({', '.join(names)})"
    params = term.get("params") or {}
    if not term_state(function):
        return ""
    if not isinstance(params, Mapping):
        return f"params ({params})"
    for key, value in params.items():
        known = {
            "asset_cfg": dig(value, "name") in (None, "robot") and isinstance(value, Mapping),
            "command_name": value == "base_velocity"
            or "VelocityCommand" in str(dig(document, "commands", str(value), "class_type")),
            "action_name": isinstance(value, str) and value in document["actions"],
            "period": function == "gait_phase",
            "sensor_cfg": function == _SCAN and _scan(document, dig(value, "name")) is not None,
            "offset": function == _SCAN,
        }
        if value is not None and not known.get(key):
            return f"params.{key} ({dig(value, 'name') or value})"
    return ""


WEIGHTS = "model.safetensors"


def lerobot_facts(source: Source) -> Facts:
    """Return what the folder says.

    Raises:
        PolicyError: it is of a kind that does not run here, or takes pictures as none does here, or
            is against the format.
    """
    facts, kind = source.facts, str(source.document["type"])
    facts.source, facts.network = "LeRobot config.json", source.path.parent / WEIGHTS
    rows_of, states = VOCABULARY["lerobot"]["rows"], VOCABULARY["lerobot"]["states"]
    if kind not in rows_of:
        raise source.wrong("type", f"type: policies that run are {alternatives(kind, rows_of)}")
    moved = source.value(Annotated[list[int], NotEmpty], ("output_features", "action", "shape"))[0]
    names = source.joints(moved, f"the action in {source.path.name} moves {moved}")
    if names is None and source.robot is not None and source.robot.num_joints == moved:
        source.say("joints", list(source.robot.joint_names), "output_features")
        facts.notes.append(f"{source.path.name}: joints are those of {source.robot.name} in order")
    frames = source.whole("n_obs_steps")
    source.say("observation", {"layout": "frame_major", "terms": []}, "input_features")
    inputs, images = {"observation": "observation"}, {}
    for feature, said in source.value(Mapping[str, AnyDict], "input_features").items():
        name = feature.removeprefix("observation.")
        if name.startswith("image"):
            shape = said.get("shape")
            if kind != "act" or not isinstance(shape, list) or shape[:1] != [3]:
                text = f"{feature} is a picture, which ACT alone takes here, of shape"
                text = f"{text} [3, height, width]; train it so, or on states"
                raise source.wrong(("input_features", feature), text)
            camera = re.sub(r"^images?_?|_image$", "", re.sub(r"\W", "_", name.lower())) or "rgb"
            images[f"{camera}_image"], inputs[f"{camera}_image"] = {"size": shape[1:]}, feature
            continue
        term: AnyDict = {"name": name, "scale": 1.0, "history": frames}
        if name != "environment_state":
            term["state"] = states.get(name, name)
        facts.values["observation"]["terms"].append(term)
    source.say("action", {"scale": 1.0, "offset": 0.0}, "output_features")
    rows, steps = source.whole(rows_of[kind]), source.whole("n_action_steps")
    source.say("chunk", {"size": rows}, rows_of[kind])
    if steps < rows and dig(source.given, "chunk", "steps") is None:
        source.say("chunk.steps", steps, "n_action_steps")
    if (weight := source.document.get("temporal_ensemble_coeff")) is not None:
        facts.values["chunk"] |= {"execution": "ensemble", "weight": weight}
    source.say("images", images, "input_features")
    facts.values |= {"inputs": inputs, "outputs": {"action": "action"}}
    return facts

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
from typing import Annotated, Any, Literal

import numpy as np

from unicon_base import AnyDict, AnyMapping, PolicyError, alternatives
from unicon_base.located_yaml import Where, read_yaml
from unicon_base.schema.marks import NotEmpty, Write
from unicon_core.policies.facts import GAINS, VOCABULARY, Facts, dig, term_state
from unicon_core.policies.hints import Pair
from unicon_core.policies.importers.source import Source, clip_before_scale

_GROUP = Annotated[AnyMapping, NotEmpty, Write("a mapping of terms")]
_FLAGS = ("scale_first", "use_gym_history")
_KEYS = ("params", "scale", "clip", "history_length")


def deploy_yaml_facts(source: Source) -> Facts:
    """Return what a `deploy.yaml` says.

    Raises:
        PolicyError: it is against the format.
    """
    facts = source.facts
    facts.source, facts.tolerance = "deploy.yaml", (6e-3, 1e-6)
    order = source.places("joint_ids_map")
    source.say("period", source.document["step_dt"], "step_dt")
    source.say_motors("joint_ids_map", order)
    for fact in GAINS:
        values = source.numbers(fact)
        if max(order) < len(values):
            source.say(fact, [values[i] for i in order], fact)
        else:  # Unitree's own G1 file with 23 joints; its program gives value i to motor i
            facts.asks[fact] = (
                f"the file has {len(values)} values in motor order, but joint_ids_map names "
                f"motor {max(order)}"
            )
    source.copy("default_joint_pos", "default_joint_pos", len(order), "joint_ids_map")
    _action(source, len(order))
    _observation(source)
    source.say_ranges("commands.base_velocity.ranges")
    facts.notes.append("deploy.yaml: numbers are rounded to 3 significant digits by its exporter")
    return facts


def _action(source: Source, count: int) -> None:
    actions, where = source.value(AnyMapping, "actions"), "actions.JointPositionAction"
    if list(actions) != ["JointPositionAction"]:
        text = f"actions are {', '.join(map(str, actions))}; only one JointPositionAction"
        raise source.wrong("actions", f"{text} (joint position targets) runs")
    action, size = source.value(AnyMapping, where), count
    if isinstance(action.get("joint_ids"), list):
        ids = source.places(f"{where}.joint_ids", count)
        size = len(ids)
        if (joints := source.facts.values.get("joints")) is not None:
            source.say("action.joints", [joints[i] for i in ids], f"{where}.joint_ids")
    scale, offset = (source.numbers(f"{where}.{key}") for key in ("scale", "offset"))
    for key, values in (("scale", scale), ("offset", offset)):
        source.copy(f"action.{key}", f"{where}.{key}", size if len(values) > 1 else 0)
    if action.get("clip") is not None:
        # Unitree clips the target, we clip the action: bring the bounds to the other side.
        clip = f"{where}.clip"
        pairs = source.value(list[Pair], clip)
        if not all(scale) or len({len(pairs), len(scale), len(offset)} - {1}) > 1:
            raise source.wrong(clip, f"clip is {action['clip']!r}; give [lowest, highest] each")
        bounds = np.sort((np.array(pairs) - np.c_[offset]) / np.c_[scale], axis=1)
        source.say("action.clip", bounds.T.tolist(), clip)
    source.say("action.feedback", "raw", where)


def _observation(source: Source) -> None:
    where: Where = ("observations",)
    group = source.value(_GROUP, where)
    entries = [key for key in group if key not in _FLAGS]
    if entries and not any(_is_term(group[key]) for key in entries):
        if len(entries) > 1:
            raise source.wrong(
                where,
                f"observations has the groups {', '.join(entries)}; only one can be imported, "
                "write a policy.yaml with 'inputs' for the others",
            )
        where = (*where, entries[0])
        source.say("inputs.observation", entries[0], where)
        group = source.value(_GROUP, where)
    terms: list[AnyDict] = []
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


def _term(source: Source, where: Where, value: AnyMapping, scale_first: bool) -> AnyDict:
    name, params = str(where[-1]), value.get("params")
    term: AnyDict = {"name": name, **term_state(name, absolute=True)}
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
        known = alternatives(name, VOCABULARY["deploy_yaml"]["terms"])
        source.facts.notes.append(f"deploy.yaml: no state is known for term {name!r}; {known}")
    return term


def _is_term(value: Any) -> bool:
    return isinstance(value, Mapping) and any(key in value for key in _KEYS)


_RL_SAR = VOCABULARY["rl_sar"]
_RL_TERMS = _RL_SAR["terms"]


def refuse_base(source: Source) -> Facts:
    """Refuse a `base.yaml` that was named in place of a `config.yaml`.

    Raises:
        PolicyError: always; with the policies below it.
    """
    folder = source.path.parent
    policies = sorted(str(path.relative_to(folder)) for path in folder.glob("**/config.yaml"))
    raise PolicyError(
        f"{source.path}: an rl_sar base.yaml has no policy; name the config.yaml of one: "
        f"{', '.join(policies) or 'none is below it'}"
    )


def rl_sar_facts(source: Source) -> Facts:
    """Return what a `config.yaml` says, and the `base.yaml` above or beside it.

    Raises:
        PolicyError: one is against the format.
    """
    facts = source.facts
    facts.source = "rl_sar config.yaml"
    _find_base(source)
    count = source.whole("num_of_dofs")
    wheels = source.places("wheel_indices", count) if source.document.get("wheel_indices") else []
    source.say_period("dt", "decimation")
    mapping = source.places("joint_mapping", count, count, "num_of_dofs")
    if source.document.get("joint_names") is not None:
        names = source.numbers("joint_names", count, "num_of_dofs", list[str])
        source.say("joints", [names[i] for i in mapping], "joint_mapping")
    for name in ("period", "joints") if len(source.files) == 1 else ():
        if name not in facts.values:
            facts.asks[name] = "it stands in base.yaml, which is neither above nor beside it"
    for fact, key in _RL_SAR["facts"].items():
        source.copy(fact, key, count, "num_of_dofs")
    if wheels:
        kinds = ["velocity" if i in wheels else "position" for i in range(count)]
        source.say("action.kind", kinds, "wheel_indices")
    sides = ("clip_actions_lower", "clip_actions_upper")
    if all(map(source.document.get, sides)):  # its program clips only then
        source.say("action.clip", [source.numbers(side, count) for side in sides], sides[0])
    source.say("action.feedback", "clipped", sides[0])
    _rl_observation(source, count, wheels)
    _rl_motion(source, count)
    source.network("model_name", source.need("model_name"))
    return facts


def _find_base(source: Source) -> None:
    """Find the robot's base.yaml: as many folders up as the place has parts, or beside."""
    path, ((place, said),) = source.path, source.located.value.items()
    robot, depth = str(place).split("/")[0], str(place).count("/")
    source.files, source.document = [(source.located, (place,))], said
    above = path.parents[min(depth, len(path.parents) - 1)]
    found = [file for f in (above, path.parent) if (file := f / "base.yaml").is_file()]
    if not found:
        return
    base = read_yaml(found[0], PolicyError, foreign=True)
    keys = list(base.value) if isinstance(base.value, Mapping) else []
    if keys != [robot] or not isinstance(base.value[robot], Mapping):
        text = f"base.yaml is of {', '.join(map(repr, keys)) or 'no robot'}, and {path.name} is of"
        raise base.error((), f"{text} {place!r}; put that of {robot!r} there")
    source.files.append((base, (robot,)))
    source.document = {**base.value[robot], **said}  # config.yaml wins


def _rl_observation(source: Source, count: int, wheels: list[int]) -> None:
    document, key = source.document, "observations_history"
    names = source.value(list[str], "observations")
    ages = source.places(key) if document.get(key) else [0]
    rising = list(range(len(ages)))
    if ages not in (rising, rising[::-1]):
        text = f"{key} is {ages}; only whole histories can be run: {rising} or {rising[::-1]}"
        raise source.wrong(key, text)
    bound = None if document.get("clip_obs") is None else source.number("clip_obs")
    terms = [_rl_term(source, name, bound, count, wheels) for name in names]
    laid_out = document.get("num_observations")
    if laid_out is not None and {*names} <= {*_RL_TERMS}:
        sizes = (_RL_TERMS[name][2:] for name in names)
        if laid_out != (width := sum(size + each * count for size, each in sizes)):
            raise source.wrong(
                "num_observations",
                f"num_observations is {laid_out!r}, and the terms {', '.join(names)} have {width} "
                "values; correct one of them",
            )
    priority = "observations_history_priority"
    by_time = source.value(Literal["time", "term"], priority) if priority in document else "time"
    layout = {
        "layout": "frame_major" if by_time == "time" else "term_major",
        "newest": "first" if ages == rising and len(ages) > 1 else "last",
        "start": "zeros",
        "terms": [{**term, "history": len(ages)} for term in terms],
    }
    source.say("observation", layout, "observations")


def _rl_term(
    source: Source, name: str, bound: float | None, count: int, wheels: list[int]
) -> AnyDict:
    if name not in _RL_TERMS:
        known = alternatives(name, _RL_TERMS)
        source.facts.notes.append(
            f"{source.path.name}: no state is known for term {name!r}; {known}"
        )
        return {"name": name}
    term = source.term(*_RL_TERMS[name][:2], bound=bound)
    if name == "dof_pos" and wheels:
        term["scale"] = [0.0 if i in wheels else term["scale"] for i in range(count)]
    return {**term, "name": name}


def _rl_motion(source: Source, count: int) -> None:
    """Note the motion of whole-body tracking: rows in the robot's order, compared at the torso."""
    file, names = map(source.document.get, ("motion_file", "joint_names"))
    period = source.facts.values.get("period")
    # Counted from 1, to a duration in fsm_g1.hpp.
    if "RoboMimic_Deploy/phase" in source.need("observations"):
        start = f", start: {period:g}" if period else ""
        source.facts.asks["motion"] = f"{{duration: of the motion in [s]{start}}}"
    if file is None or not isinstance(names, list) or not period:
        return
    waist = source.places("waist_joint_indices", count, 3, "yaw, roll and pitch")
    motion = {
        "anchor_body": "torso_link",
        "file": file,
        "fps": 1.0 / period,
        "joints": names,
        "chain": {names[i]: axis for i, axis in zip(waist, "zxy")},
    }
    source.say("motion", motion, "motion_file")

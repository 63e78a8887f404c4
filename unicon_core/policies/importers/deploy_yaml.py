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

from unicon_base.errors import alternatives
from unicon_base.located_yaml import Where
from unicon_core.policies.facts import GAINS, Facts, dig, term_state
from unicon_core.policies.hints import Pair
from unicon_core.policies.importers.source_reader import Source, SourceReader
from unicon_core.policies.importers.training import chosen_ids, clip_before_scale, command_ranges

_FLAGS = ("scale_first", "use_gym_history")


def deploy_yaml_facts(source: Source) -> Facts:
    """Return what a `deploy.yaml` says.

    Raises:
        PolicyError: it is against the format.
    """
    facts = Facts(source.path, "deploy.yaml", tolerance=(6e-3, 1e-6))
    reader = _Deploy(facts, source.located)
    reader.joints(source)
    reader.action()
    reader.observation()
    reader.ranges()
    facts.notes.append("deploy.yaml: numbers are rounded to 3 significant digits by its exporter")
    return facts


class _Deploy(SourceReader):
    count = 0

    def joints(self, source: Source) -> None:
        order = self.places("joint_ids_map")
        if not order:
            raise self.wrong("joint_ids_map", "joint_ids_map is empty; give motor numbers")
        self.count = len(order)
        self.say("period", self.document["step_dt"], "step_dt")
        if source.robot is not None:
            self.say_motors("joint_ids_map", order, source.robot)
        else:
            self.facts.notes.append(
                "deploy.yaml: joints are numbers of the robot's motors (joint_ids_map); "
                "name the robot and they are known"
            )
        for fact in GAINS:
            values = self.floats(fact)
            if max(order) >= len(values):
                # Unitree's own G1 file with 23 joints does so, and its program gives value i to
                # motor i whatever the map says.
                self.facts.asks[fact] = (
                    f"the file has {len(values)} values in motor order, but joint_ids_map names "
                    f"motor {max(order)}"
                )
                continue
            self.say(fact, [values[i] for i in order], fact)
        of = f"{self.count} joints of joint_ids_map"
        self.say_vector("default_joint_pos", "default_joint_pos", self.count, of)

    def action(self) -> None:
        actions = self.need("actions")
        if not isinstance(actions, Mapping) or list(actions) != ["JointPositionAction"]:
            names = ", ".join(actions) if isinstance(actions, Mapping) else repr(actions)
            raise self.wrong(
                "actions",
                f"actions are {names}; only one JointPositionAction (joint position targets) can "
                "be run",
            )
        where = "actions.JointPositionAction"
        action = actions["JointPositionAction"]
        if not isinstance(action, Mapping):
            raise self.wrong(where, f"JointPositionAction is {action!r}; give scale and offset")
        size = self.count
        if isinstance(action.get("joint_ids"), list):
            ids = self.places(f"{where}.joint_ids", self.count)
            size, joints = len(ids), self.facts.values.get("joints")
            if joints is not None and ids != list(range(self.count)):
                self.say("action.joints", [joints[i] for i in ids], f"{where}.joint_ids")
        scale, offset = (self.spread(f"{where}.{key}", size) for key in ("scale", "offset"))
        self.say("action.scale", scale, f"{where}.scale")
        self.say("action.offset", offset, f"{where}.offset")
        if action.get("clip") is not None:
            # Unitree clips the target, we clip the action: bring the bounds to the other side.
            clip = f"{where}.clip"
            pairs = self.value(list[Pair], clip)
            if len(pairs) not in (size, 1) or not all(scale):
                raise self.wrong(clip, f"clip is {action['clip']!r}; give [lowest, highest] each")
            bounds = [
                sorted((bound - zero) / factor for bound in pair)
                for pair, zero, factor in zip(pairs * (size // len(pairs)), offset, scale)
            ]
            self.say("action.clip", [list(side) for side in zip(*bounds)], clip)
        self.say("action.feedback", "raw", where)

    def spread(self, key: str, size: int) -> list[float]:
        values = self.floats(key)
        if len(values) not in (1, size):
            word = key.rpartition(".")[2]
            raise self.wrong(
                key, f"{word} has {len(values)} values for {size} joints; give one for each"
            )
        return values * (size // len(values))

    def observation(self) -> None:
        where: Where = ("observations",)
        group = self.need("observations")
        if not isinstance(group, Mapping) or not group:
            raise self.wrong(where, f"observations are {group!r}; give the terms")
        entries = [key for key in group if key not in _FLAGS]
        if entries and not any(_is_term(group[key]) for key in entries):
            if len(entries) > 1:
                raise self.wrong(
                    where,
                    f"observations has the groups {', '.join(entries)}; only one group can be "
                    "imported, write a policy.yaml with 'inputs' for the others",
                )
            self.say("inputs.observation", entries[0], (*where, entries[0]))
            where, group = (*where, entries[0]), group[entries[0]]
            if not isinstance(group, Mapping):
                raise self.wrong(where, f"observations.{where[-1]} is {group!r}; no term")
        terms: list[dict[str, Any]] = []
        for name, value in group.items():
            if name in _FLAGS:
                continue
            if not _is_term(value):
                raise self.wrong((*where, name), f"observations.{name} is {value!r}; no term")
            source: Where = (*where, name)
            self.facts.lines[("observation", "terms", len(terms))] = self.located.lines[source]
            terms.append(self.term(source, name, value, bool(group.get("scale_first"))))
        self.facts.values["observation"] = {
            "layout": "frame_major" if group.get("use_gym_history") else "term_major",
            "newest": "last",
            "start": "first",
            "terms": terms,
        }

    def term(
        self, where: Where, name: str, value: Mapping[str, Any], scale_first: bool
    ) -> dict[str, Any]:
        term: dict[str, Any] = {"name": name, **term_state(name, absolute=True)}
        params = value.get("params")
        try:
            places = chosen_ids(dig(params, "asset_cfg", "joint_ids"))
        except ValueError as error:
            raise self.wrong(where, f"{name}: {error}") from error
        if places is not None:
            term["index"] = places
        if name == "gait_phase" and isinstance(params, Mapping) and "period" in params:
            self.say("phase", {"period": params["period"], "offsets": [0.0]}, (*where, "params"))
        scale = value.get("scale")
        if scale is not None:
            term["scale"] = self.floats((*where, "scale"))
        if value.get("clip") is not None:
            pair = self.value(Pair, (*where, "clip"))
            term["clip"] = list(pair)
            if scale_first and scale is not None:
                if not all(term["scale"]):
                    raise self.wrong(
                        (*where, "scale"), f"{name}: scale 0 with scale_first and clip"
                    )
                term["clip"] = clip_before_scale(pair, term["scale"])
        term["history"] = value.get("history_length") or 1
        if not term_state(name):
            known = alternatives(name, ("base_ang_vel", "projected_gravity", "velocity_commands",
                                        "joint_pos_rel", "joint_vel_rel", "last_action",
                                        "gait_phase"))  # fmt: skip
            self.facts.notes.append(f"deploy.yaml: no state is known for term {name!r}; {known}")
        return term

    def ranges(self) -> None:
        where = ("commands", "base_velocity", "ranges")
        ranges = command_ranges(dig(self.document, *where))
        if ranges:
            self.say("command_ranges", ranges, where)


def _is_term(value: Any) -> bool:
    return isinstance(value, Mapping) and any(
        key in value for key in ("params", "scale", "clip", "history_length")
    )

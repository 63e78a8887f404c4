"""rl_sar's `policy/ROBOT/CONFIG/config.yaml`, with the robot's `base.yaml` above it, as facts.

From fan-ziqi/rl_sar: `rl_sdk.cpp` reads `base.yaml` first, and `config.yaml` wins; it lays out the
terms named in `observations`, clips what is scaled to ±`clip_obs`, clips the action and feeds the
clipped one back; wheels (`wheel_indices`) are given velocities and seen at position 0. Policy joint
i is joint `joint_mapping[i]` of `joint_names`, which only `base.yaml` has (`rl_sim_mujoco.cpp`). In
`observations_history` 0 is the newest frame; priority `time` puts whole frames together
(`observation_buffer.cpp`), whose buffer begins with zeros. A motion is played with one row for each
tick, and compared at the torso (`motion_loader.cpp`, `fsm_g1.hpp`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from unicon_base.errors import PolicyError, UniconError, alternatives
from unicon_base.located_yaml import Located, read_yaml
from unicon_core.policies.facts import Facts
from unicon_core.policies.importers.source_reader import Place, Source, SourceReader, keys_of
from unicon_core.policies.importers.training import clip_before_scale

# A term's name -> the state, the key of its scale and its number of elements; None: all joints.
_TERMS: dict[str, tuple[str, str, int | None]] = {
    "lin_vel": ("base_lin_vel", "lin_vel_scale", 3),
    "ang_vel": ("base_ang_vel", "ang_vel_scale", 3),
    "gravity_vec": ("projected_gravity", "", 3),
    "commands": ("velocity_command", "commands_scale", 3),
    "dof_pos": ("joint_pos", "dof_pos_scale", None),
    "dof_vel": ("joint_vel", "dof_vel_scale", None),
    "actions": ("action", "", None),
    "whole_body_tracking/motion_command": ("motion_command", "", None),
    "whole_body_tracking/motion_anchor_ori_b": ("motion_anchor_ori_b", "", 6),
}
_GAINS = {"stiffness": "rl_kp", "damping": "rl_kd", "default_joint_pos": "default_dof_pos"}


def _inside(values: Any) -> tuple[str, Mapping[str, Any]] | None:
    """Return the one key of a document, which is its place, and what stands under it."""
    if not isinstance(values, Mapping) or len(values) != 1:
        return None
    key, inside = next(iter(values.items()))
    return (str(key), inside) if isinstance(inside, Mapping) else None


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
    located = source.located
    facts = Facts(source.path, "rl_sar config.yaml")
    (place,) = located.value
    reader = _Config(facts, located, (place,))
    reader.find_base(str(place))
    reader.joints()
    reader.action()
    reader.observation()
    reader.motion()
    reader.network("model_name", reader.need("model_name"), None)
    return facts


class _Config(SourceReader):
    base: Located | None = None
    count = 0

    def find_base(self, place: str) -> None:
        """Find the robot's base.yaml: as many folders up as the place has parts, or beside."""
        path, robot = self.facts.path, place.split("/")[0]
        above = path.parents[min(place.count("/"), len(path.parents) - 1)]
        found = next(
            (f / "base.yaml" for f in (above, path.parent) if (f / "base.yaml").is_file()), None
        )
        if found is None:
            return
        self.base = located = read_yaml(found, PolicyError, foreign=True)
        said = _inside(located.value)
        if said is None or said[0] != robot:
            other = repr(said[0]) if said else "no robot"
            raise located.error(
                (), f"base.yaml is of {other}, and {path.name} is of {place!r}; put that of "
                f"{robot!r} there"
            )  # fmt: skip
        self.document = {**said[1], **self.document}  # config.yaml wins

    def wrong(self, place: Place, message: str) -> UniconError:
        """Return the error of the file that says the key."""
        (key,), base = self.inside, self.base
        keys = keys_of(place)
        if base is None or not keys or keys[0] in self.located.value[key]:
            return super().wrong(place, message)
        return base.error((*base.value, *keys), message)

    def vector_of(self, key: str) -> list[float]:
        return self.vector(key, self.count, f"num_of_dofs {self.count}")

    def joints(self) -> None:
        facts = self.facts
        self.count = count = self.whole("num_of_dofs")
        if {"dt", "decimation"} <= set(self.document):
            self.say_period("dt", "decimation")
        mapping = self.places("joint_mapping", count)
        if len(mapping) != count:
            raise self.wrong(
                "joint_mapping",
                f"joint_mapping has {len(mapping)} numbers for num_of_dofs {count}; name each "
                "joint once",
            )
        names = self.document.get("joint_names")
        if names is not None:
            if not isinstance(names, list) or len(names) != count:
                raise self.wrong("joint_names", f"joint_names is {names!r}; give {count} names")
            self.say("joints", [names[i] for i in mapping], "joint_mapping")
        for name in ("period", "joints") if self.base is None else ():
            if name not in facts.values:
                facts.asks[name] = "it stands in base.yaml, which is neither above nor beside it"
        for fact, key in _GAINS.items():
            self.say(fact, self.vector_of(key), key)

    def wheels(self) -> list[int]:
        if not self.document.get("wheel_indices"):
            return []
        return self.places("wheel_indices", self.count)

    def action(self) -> None:
        self.say("action.scale", self.vector_of("action_scale"), "action_scale")
        wheels = self.wheels()
        if wheels:
            kinds = ["velocity" if i in wheels else "position" for i in range(self.count)]
            self.say("action.kind", kinds, "wheel_indices")
        sides = ("clip_actions_lower", "clip_actions_upper")
        if all(map(self.document.get, sides)):  # its program clips only then
            self.say("action.clip", list(map(self.vector_of, sides)), sides[0])
        self.say("action.feedback", "clipped", sides[0])

    def observation(self) -> None:
        names = self.need("observations")
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise self.wrong("observations", f"observations is {names!r}; give names of terms")
        history, newest = self.history()
        bound = None
        if self.document.get("clip_obs") is not None:
            bound = self.number("clip_obs")
        terms, width = [], 0
        for i, name in enumerate(names):
            terms.append({**self.term(name, bound), "history": history})
            self.facts.lines[("observation", "terms", i)] = self.line("observations") or 1
            size = _TERMS[name][2] if name in _TERMS else None
            many = 2 if name.endswith("motion_command") else 1
            width += many * self.count if size is None else size
        laid_out = self.document.get("num_observations")
        if laid_out is not None and laid_out != width and set(names) <= set(_TERMS):
            raise self.wrong(
                "num_observations",
                f"num_observations is {laid_out!r}, and the terms {', '.join(names)} have {width} "
                "values; correct one of them",
            )
        time = self.document.get("observations_history_priority", "time")
        if time not in ("time", "term"):
            raise self.wrong(
                "observations_history_priority",
                f"observations_history_priority is {time!r}; known: time, term",
            )
        self.facts.values["observation"] = {
            "layout": "frame_major" if time == "time" else "term_major",
            "newest": newest,
            "start": "zeros",
            "terms": terms,
        }

    def history(self) -> tuple[int, str]:
        """Return the number of frames, and where the newest one stands."""
        key = "observations_history"
        if not self.document.get(key):
            return 1, "last"
        ages = self.places(key)
        rising = list(range(len(ages)))
        if ages not in (rising, rising[::-1]):
            raise self.wrong(
                key, f"{key} is {ages}; only whole histories can be run: {rising} or {rising[::-1]}"
            )
        return len(ages), "first" if ages == rising and len(ages) > 1 else "last"

    def term(self, name: str, bound: float | None) -> dict[str, Any]:
        if name not in _TERMS:
            self.facts.notes.append(
                f"{self.facts.path.name}: no state is known for term {name!r}; "
                f"{alternatives(name, _TERMS)}"
            )
            return {"name": name}
        state, key, _ = _TERMS[name]
        term: dict[str, Any] = {"name": name, "state": state}
        scale: list[float] = [1.0]
        if key == "commands_scale":
            scale = self.vector(key, 3, "vx, vy and wz")
        elif key:
            scale = [self.number(key)]
        if state == "joint_pos":
            term["subtract"] = "default_joint_pos"
            wheels = self.wheels()
            if wheels:
                scale = [0.0 if i in wheels else scale[0] for i in range(self.count)]
        term["scale"] = scale if len(scale) > 1 else scale[0]
        if bound is not None:
            term["clip"] = clip_before_scale([-bound, bound], scale)
        return term

    def motion(self) -> None:
        """The motion of whole-body tracking: rows in the robot's order, compared at the torso."""
        file, names = map(self.document.get, ("motion_file", "joint_names"))
        period = self.facts.values.get("period")
        if file is None or not isinstance(names, list) or not period:
            return
        waist = self.places("waist_joint_indices", self.count)
        if len(waist) != 3:
            raise self.wrong(
                "waist_joint_indices",
                f"waist_joint_indices is {waist}; give the numbers of yaw, roll and pitch",
            )
        motion = {
            "anchor_body": "torso_link",
            "file": file,
            "fps": 1.0 / period,
            "joints": names,
            "chain": {names[i]: axis for i, axis in zip(waist, "zxy")},
        }
        self.say("motion", motion, "motion_file")

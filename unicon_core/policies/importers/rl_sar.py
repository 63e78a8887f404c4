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

from unicon_core.errors import PolicyError, alternatives
from unicon_core.located_yaml import read_yaml
from unicon_core.policies.facts import Facts
from unicon_core.policies.importers.source_reader import Source, SourceReader
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


def _inside(values: Any) -> tuple[str, Mapping[str, Any]] | None:
    """Return the one key of a document, which is its place, and what stands under it."""
    if not isinstance(values, Mapping) or len(values) != 1:
        return None
    key, inside = next(iter(values.items()))
    return (str(key), inside) if isinstance(inside, Mapping) else None


def is_rl_sar(values: Any) -> bool:
    """Whether a YAML document is a `config.yaml` of rl_sar."""
    said = _inside(values)
    return said is not None and {"observations", "rl_kp"} <= set(said[1])


def is_rl_sar_base(values: Any) -> bool:
    """Whether a YAML document is a `base.yaml` of rl_sar."""
    said = _inside(values)
    return said is not None and {"joint_names", "joint_mapping"} <= set(said[1])


def rl_sar_facts(source: Source) -> Facts:
    """Return what a `config.yaml` says, and the `base.yaml` above or beside it.

    Raises:
        PolicyError: one is against the format, or `base.yaml` was named.
    """
    path, located = source.path, source.located
    said = _inside(located.value)
    if said is None or not is_rl_sar(located.value):
        policies = sorted(
            str(p.relative_to(path.parent)) for p in path.parent.glob("**/config.yaml")
        )
        raise PolicyError(
            f"{path}: an rl_sar base.yaml has no policy; name the config.yaml of one: "
            f"{', '.join(policies) or 'none is below it'}"
        )
    facts = Facts(path, "rl_sar config.yaml")
    reader = _Config(facts, located, (next(iter(located.value)),))
    reader.find_base(said[0])
    reader.joints()
    reader.action()
    reader.observation()
    reader.motion()
    reader.network(("model_name",), reader.need("model_name"), None)
    return facts


class _Config(SourceReader):
    base: SourceReader | None = None
    count = 0

    def of(self, key: str) -> SourceReader:
        """The reader of the file that says a key: config.yaml wins."""
        has = key in self.document or self.base is None or key not in self.base.document
        return self if has or self.base is None else self.base

    def find_base(self, place: str) -> None:
        """Find the robot's base.yaml: as many folders up as the place has parts, or beside."""
        path, robot = self.facts.path, place.split("/")[0]
        above = path.parents[min(place.count("/"), len(path.parents) - 1)]
        found = next(
            (f / "base.yaml" for f in (above, path.parent) if (f / "base.yaml").is_file()), None
        )
        if found is None:
            return
        located = read_yaml(found, PolicyError, foreign=True)
        said = _inside(located.value)
        if said is None or said[0] != robot:
            other = repr(said[0]) if said else "no robot"
            raise located.error(
                (), f"base.yaml is of {other}, and {path.name} is of {place!r}; put that of "
                f"{robot!r} there"
            )  # fmt: skip
        self.base = SourceReader(self.facts, located, (said[0],))
        self.base.lines = {}  # errors of facts name config.yaml, and these lines are not its own

    def vector_of(self, key: str) -> list[float]:
        return self.of(key).vector(key, count=self.count, of=f"num_of_dofs {self.count}")

    def joints(self) -> None:
        facts = self.facts
        self.count = count = self.of("num_of_dofs").whole("num_of_dofs")
        if all(key in self.of(key).document for key in ("dt", "decimation")):
            dt, decimation = self.of("dt").number("dt"), self.of("decimation").whole("decimation")
            self.say(("period",), dt * decimation, ("dt",))
            facts.keys[("period",)] = "dt · decimation"
        mapping = self.of("joint_mapping").places("joint_mapping", below=count)
        if len(mapping) != count:
            raise self.of("joint_mapping").wrong(
                ("joint_mapping",),
                f"joint_mapping has {len(mapping)} numbers for num_of_dofs {count}; name each "
                "joint once",
            )
        names = self.of("joint_names").document.get("joint_names")
        if names is not None:
            if not isinstance(names, list) or len(names) != count:
                raise self.of("joint_names").wrong(
                    ("joint_names",), f"joint_names is {names!r}; give {count} names"
                )
            self.say(("joints",), [names[i] for i in mapping], ("joint_mapping",))
        for name in ("period", "joints") if self.base is None else ():
            if name not in facts.values:
                facts.asks[name] = "it stands in base.yaml, which is neither above nor beside it"
        for target, key in (
            ("stiffness", "rl_kp"), ("damping", "rl_kd"), ("default_joint_pos", "default_dof_pos"),
        ):  # fmt: skip
            self.of(key).say((target,), self.vector_of(key), (key,))

    def wheels(self) -> list[int]:
        if not self.of("wheel_indices").document.get("wheel_indices"):
            return []
        return self.of("wheel_indices").places("wheel_indices", below=self.count)

    def action(self) -> None:
        self.say(("action", "scale"), self.vector_of("action_scale"), ("action_scale",))
        wheels = self.wheels()
        if wheels:
            kinds = ["velocity" if i in wheels else "position" for i in range(self.count)]
            self.say(("action", "kind"), kinds, ("wheel_indices",))
        sides = [
            self.vector_of(key) if self.of(key).document.get(key) else []
            for key in ("clip_actions_lower", "clip_actions_upper")
        ]
        if all(sides):  # its program clips only then
            self.say(("action", "clip"), sides, ("clip_actions_lower",))
        self.say(("action", "feedback"), "clipped", ("clip_actions_lower",))

    def observation(self) -> None:
        names = self.need("observations")
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise self.wrong(("observations",), f"observations is {names!r}; give names of terms")
        history, newest = self.history()
        bound = None
        if self.of("clip_obs").document.get("clip_obs") is not None:
            bound = self.of("clip_obs").number("clip_obs")
        terms, width = [], 0
        for i, name in enumerate(names):
            terms.append({**self.term(name, bound), "history": history})
            self.facts.lines[("observation", "terms", i)] = self.lines.get(
                (*self.inside, "observations"), 1
            )
            size = _TERMS[name][2] if name in _TERMS else None
            many = 2 if name.endswith("motion_command") else 1
            width += many * self.count if size is None else size
        laid_out = self.document.get("num_observations")
        if laid_out is not None and laid_out != width and set(names) <= set(_TERMS):
            raise self.wrong(
                ("num_observations",),
                f"num_observations is {laid_out!r}, and the terms {', '.join(names)} have {width} "
                "values; correct one of them",
            )
        time = self.document.get("observations_history_priority", "time")
        if time not in ("time", "term"):
            raise self.wrong(
                ("observations_history_priority",),
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
                (key,), f"{key} is {ages}; only whole histories can be run: {rising} or "
                f"{rising[::-1]}"
            )  # fmt: skip
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
            scale = self.of(key).vector(key, count=3, of="vx, vy and wz")
        elif key:
            scale = [self.of(key).number(key)]
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
        file, base = self.document.get("motion_file"), self.base
        names = None if base is None else base.document.get("joint_names")
        period = self.facts.values.get("period")
        if file is None or not isinstance(names, list) or not period:
            return
        waist = self.places("waist_joint_indices", below=self.count)
        if len(waist) != 3:
            raise self.wrong(
                ("waist_joint_indices",),
                f"waist_joint_indices is {waist}; give the numbers of yaw, roll and pitch",
            )
        motion = {
            "anchor_body": "torso_link",
            "file": file,
            "fps": 1.0 / period,
            "joints": names,
            "chain": {names[i]: axis for i, axis in zip(waist, "zxy")},
        }
        self.say(("motion",), motion, ("motion_file",))

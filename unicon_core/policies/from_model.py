"""FromModel: facts that a user takes from the robot's model with `{from: model}`.

    given:
      joints: {from: model, order: breadth_first}
      default_joint_pos: {from: model, keyframe: home}

Nothing is taken without these words; what could be is offered where a fact is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from unicon_base.arrays import Float64
from unicon_base.errors import PolicyError, UniconError, alternatives
from unicon_base.schema.marks import Key, Made
from unicon_base.schema.read import read_value
from unicon_core.models.find import pick_model
from unicon_core.models.load import load_model
from unicon_core.models.loaded import drives, position_gains
from unicon_core.policies.facts import GAINS, Facts, is_open, missing_facts
from unicon_core.policies.hints import listed
from unicon_core.robots import Robot, load_robot
from unicon_core.text_table import figure


@dataclass(frozen=True)
class _Asked:
    """What is to be taken, as it is given.

    Attributes:
        source: the robot's model.
    """

    source: Annotated[Literal["model"], Key("from")]


@dataclass(frozen=True)
class _Joints(_Asked):
    """The joints.

    Attributes:
        order: of them; that of the source's simulator unless given.
        only: names or patterns with * and ?.
    """

    order: Literal["depth_first", "breadth_first", "actuators"] | None = None
    only: Annotated[tuple[str, ...], Made(listed, str | list[str])] = ("*",)


@dataclass(frozen=True)
class _Pose(_Asked):
    """The pose of a key frame.

    Attributes:
        keyframe: its name; the only one unless given.
    """

    keyframe: str | None = None


@dataclass(frozen=True)
class _Damping(_Asked):
    """The damping.

    Attributes:
        of: the actuators or the joints.
    """

    of: Literal["actuators", "joints"] = "actuators"


_OPTIONS: dict[str, type[_Asked]] = {
    "joints": _Joints,
    "default_joint_pos": _Pose,
    "stiffness": _Asked,
    "damping": _Damping,
}


class FromModel:
    """The facts that are given, those of the model filled in as they become known.

    Args:
        source: the policy's source, for messages.
        given: facts of the user.
        robot: whose model it is; `given: {robot: …}` names another.
        find: returns the model's file; None: the robot's own.

    Attributes:
        given: what is given, without `{from: model}` once `joints` and `others` were called.
        notes: what was taken from where.
    """

    def __init__(
        self,
        source: Path,
        given: Mapping[str, Any],
        robot: Robot | None,
        find: Callable[[], Path] | None = None,
    ) -> None:
        self._source, self._robot, self._find = source, robot, find
        self.given = dict(given)
        self.notes: list[str] = []
        self._asked: dict[str, Any] = {}
        for key, value in given.items():
            if isinstance(value, Mapping) and "from" in value:
                self._asked[str(key)] = self._checked(str(key), value)
        made_for = given.get("robot")
        other = isinstance(made_for, str) and (robot is None or made_for != robot.name)
        if self._asked and other:
            self._robot, self._find = load_robot(str(made_for)), None

    def _wrong(self, key: str, rest: str) -> PolicyError:
        return PolicyError(f"{self._source}: given {key} {rest}")

    def _checked(self, key: str, value: Mapping[str, Any]) -> Any:
        if key not in _OPTIONS:
            raise self._wrong(
                key, f"is {dict(value)}; a model says only {', '.join(_OPTIONS)}: give the value"
            )
        place = f"{self._source}: given"
        return read_value(
            _OPTIONS[key], value, lambda where, text: PolicyError(f"{place} {text}"), key
        )

    def asks(self, key: str) -> bool:
        """Return whether a fact is to be taken from the model."""
        return key in self._asked

    def joints(self, usual: str) -> None:
        """Fill in the joints.

        Args:
            usual: order of the source's simulator, unless `order` says another.

        Raises:
            PolicyError: there is no model, it cannot be read, or lacks what is asked for.
        """
        asked = self._asked.get("joints")
        if asked is None:
            return
        order = asked.order or usual
        names = self._known.ordered(order)
        for pattern in asked.only:
            if not any(fnmatchcase(name, pattern) for name in names):
                raise self._wrong(
                    "joints",
                    f"has only: {pattern!r}, which is none of the model's joints; "
                    f"{alternatives(pattern, names)}",
                )
        names = [name for name in names if any(fnmatchcase(name, p) for p in asked.only)]
        self._take("joints", names, f"{order.replace('_', ' ')} order of {self._known.name}")

    def others(self, joints: Any) -> None:
        """Fill in pose and gains in policy order.

        Args:
            joints: the policy's; what is not a list of names is refused elsewhere.

        Raises:
            PolicyError: as for `joints`; or the joints are not known yet.
        """
        for key in self._asked:
            if key == "joints":
                continue
            names = self.given.get("joints") or joints
            if not isinstance(names, (list, tuple)):
                raise self._wrong(key, "is from the model, and the joints are not said; give them")
            lacking = [str(name) for name in names if name not in self._known.ids]
            if lacking:
                raise self._wrong(
                    key,
                    f"is from the model, and {self._known.name} has no joint {lacking[0]!r}; "
                    f"{alternatives(lacking[0], self._known.ids)}",
                )
            values, where = getattr(self, f"_{key}")(self._asked[key], names)
            self._take(key, [float(value) for value in values], f"{where} of {self._known.name}")

    def _take(self, key: str, value: list[Any], where: str) -> None:
        self.given[key] = value
        shown = value if key == "joints" else list(map(figure, value))
        self.notes.append(f"{key} is taken from the {where}: {', '.join(shown)}")

    def _default_joint_pos(
        self, asked: _Pose, joints: Sequence[str]
    ) -> tuple[Iterable[float], str]:
        frames, name = self._known.frames, asked.keyframe
        if not frames:
            raise self._wrong(
                "default_joint_pos", f"is from the model, and {self._known.name} has no key frame"
            )
        if name is None and len(frames) > 1:
            raise self._wrong(
                "default_joint_pos",
                f"is from the model, which has the key frames {', '.join(frames)}; say which: "
                f"{{from: model, keyframe: {next(iter(frames))}}}",
            )
        name = next(iter(frames)) if name is None else name
        if name not in frames:
            raise self._wrong(
                "default_joint_pos",
                f"has no keyframe {name!r}; {alternatives(name, frames)}",
            )
        return (self._known.pose(frames[name], joint) for joint in joints), f"key frame {name}"

    def _stiffness(self, _: _Asked, joints: Sequence[str]) -> tuple[Any, str]:
        return self._gains("stiffness", 0, joints), "position actuators"

    def _damping(self, asked: _Damping, joints: Sequence[str]) -> tuple[Any, str]:
        known = self._known
        if asked.of == "joints":
            return [known.passive(joint) for joint in joints], "joint damping"
        gains = self._gains("damping", 1, joints)
        if not any(gains) and any(known.passive(joint) for joint in joints):
            raise self._wrong(
                "damping",
                f"is from the model, whose actuators have none; its joints have "
                f"{known.passive(joints[0]):g} N·m·s/rad: write {{from: model, of: joints}} for "
                "those",
            )
        return gains, "position actuators"

    def _gains(self, key: str, place: int, joints: Sequence[str]) -> list[float]:
        gains = [self._known.gains(joint) for joint in joints]
        for joint, gain in zip(joints, gains):
            if gain is None:
                raise self._wrong(
                    key,
                    f"is from the model, and {self._known.name} has no position actuator for "
                    f"{joint}; give the numbers",
                )
        return [gain[place] for gain in gains if gain is not None]

    def offer(self, facts: Facts) -> str:
        """Return what the model could say of missing facts, "" where it is nothing.

        Where the source has gains of some joints, those of the model are other ones.

        Args:
            facts: of the source.
        """
        missing = missing_facts(facts)
        partly = any(is_open(facts.values.get(key)) for key in GAINS)
        wanted = [key for key in _OPTIONS if key in missing and not (partly and key in GAINS)]
        if facts.by_pattern and "joints" in wanted:  # the source says the others by them
            wanted = ["joints"]
        if not wanted or self._robot is None or self._robot.members:
            return ""
        try:
            known = self._known
        except UniconError:
            return ""
        joints = list(known.ids)
        offered = {}
        if "joints" in wanted:
            offered["joints"] = "{from: model}"
        if "default_joint_pos" in wanted and known.frames:
            offered["default_joint_pos"] = f"{{from: model, keyframe: {' | '.join(known.frames)}}}"
        gains = [gain for joint in joints if (gain := known.gains(joint)) is not None]
        if len(gains) == len(joints):
            passive = "" if any(damping for _, damping in gains) else ", of: joints"
            offered |= {
                key: f"{{from: model{more}}}"
                for key, more in (("stiffness", ""), ("damping", passive))
                if key in wanted
            }
        if not offered:
            return ""
        words = ", ".join(f"{key}: {value}" for key, value in offered.items())
        return f"; model {known.name} can say some of it: given: {{{words}}}"

    @cached_property
    def _known(self) -> _Known:
        robot = self._robot
        key = next(iter(self._asked), "joints")
        if robot is None:
            raise self._wrong(
                key, "is from the model of a robot, and none is named; name it (robot: go2)"
            )
        try:
            path = pick_model(robot) if self._find is None else self._find()
            return _Known(path, robot)
        except PolicyError:
            raise
        except UniconError as error:
            raise self._wrong(key, f"is from the model: {error}") from error


class _Known:
    """A model's joints, by the robot's names."""

    def __init__(self, path: Path, robot: Robot) -> None:
        anything = replace(robot, weldable=frozenset(robot.joint_names))
        self._loaded = loaded = load_model(path, anything, quiet=True)
        self._model = model = loaded.model
        self.name = path.name
        found = zip(robot.joint_names, loaded.joints)
        ids = {name: joint for name, joint in found if name not in loaded.welded}
        self.ids: dict[str, int] = dict(sorted(ids.items(), key=lambda item: item[1]))
        self.frames = {model.key(i).name: i for i in range(model.nkey) if model.key(i).name}
        self._driven = drives(model)

    def ordered(self, order: str) -> list[str]:
        """Return the joints in an order; siblings stand as in the file."""
        if order == "breadth_first":
            return sorted(self.ids, key=lambda name: (self._depth(name), self.ids[name]))
        if order == "actuators":
            return sorted(self.ids, key=lambda name: self._driven[self.ids[name]][0])
        return list(self.ids)

    def _depth(self, name: str) -> int:
        """The number of bodies with joints above a joint's."""
        body = int(self._model.jnt_bodyid[self.ids[name]])
        depth = 0
        while body:
            depth += int(self._model.body_jntnum[body] > 0)
            body = int(self._model.body_parentid[body])
        return depth

    def pose(self, frame: int, joint: str) -> float:
        return round(
            float(self._model.key_qpos[frame][self._model.jnt_qposadr[self.ids[joint]]]), 9
        )

    def gains(self, joint: str) -> tuple[float, float] | None:
        return position_gains(self._model, self._driven[self.ids[joint]][0])

    def passive(self, joint: str) -> float:
        damping: Float64 = self._model.dof_damping
        return float(damping[self._model.jnt_dofadr[self.ids[joint]]])

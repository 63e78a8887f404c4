"""FromModel: facts that a user takes from the robot's model with `{from: model}`.

    given:
      joints: {from: model, order: breadth_first}
      default_joint_pos: {from: model, keyframe: home}

Nothing is taken without these words; what could be is offered where a fact is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from unicon_base import AnyDict, AnyMapping, PolicyError, UniconError, alternatives
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
        given: AnyMapping,
        robot: Robot | None,
        find: Callable[[], Path] | None = None,
    ) -> None:
        self._source, self._robot, self._find = source, robot, find
        self.given = dict(given)
        self.notes: list[str] = []
        self._asked: AnyDict = {}
        for key, value in given.items():
            if not isinstance(value, Mapping) or "from" not in value:
                continue
            if key not in _OPTIONS:
                text = f"is {dict(value)}; a model says only {', '.join(_OPTIONS)}: give the value"
                raise self._wrong(key, text)
            self._asked[key] = read_value(
                _OPTIONS[key], value, lambda _, text: PolicyError(f"{source}: given {text}"), key
            )
        made_for = given.get("robot")
        other = isinstance(made_for, str) and (robot is None or made_for != robot.name)
        if self._asked and other:
            self._robot, self._find = load_robot(str(made_for)), None

    def _wrong(self, key: str, rest: str) -> PolicyError:
        return PolicyError(f"{self._source}: given {key} {rest}")

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
                text = f"has only: {pattern!r}, which is none of the model's joints"
                raise self._wrong("joints", f"{text}; {alternatives(pattern, names)}")
        names = [name for name in names if any(fnmatchcase(name, p) for p in asked.only)]
        self._take("joints", names, f"{order.replace('_', ' ')} order", names)

    def others(self, joints: Any) -> None:
        """Fill in pose and gains in policy order.

        Args:
            joints: the policy's; what is not a list of names is refused elsewhere.

        Raises:
            PolicyError: as for `joints`; or the joints are not known yet.
        """
        takes = {"default_joint_pos": self._pose, "damping": self._damping}
        for key, asked in self._asked.items():
            if key == "joints":
                continue
            names = self.given.get("joints") or joints
            if not isinstance(names, list | tuple):
                raise self._wrong(key, "is from the model, and the joints are not said; give them")
            known = self._known
            for name in names:
                if name not in known.ids:
                    text = f"is from the model, and {known.name} has no joint {name!r}"
                    raise self._wrong(key, f"{text}; {alternatives(name, known.ids)}")
            values, where = takes.get(key, self._stiffness)(asked, names)
            self._take(key, values, where, list(map(figure, values)))

    def _take(self, key: str, value: list[Any], where: str, shown: Sequence[str]) -> None:
        self.given[key] = value
        text = f"{key} is taken from the {where} of {self._known.name}: {', '.join(shown)}"
        self.notes.append(text)

    def _pose(self, asked: Any, joints: Sequence[str]) -> tuple[list[float], str]:
        frames, name, key = self._known.frames, asked.keyframe, "default_joint_pos"
        if not frames:
            raise self._wrong(key, f"is from the model, and {self._known.name} has no key frame")
        if name is None and len(frames) > 1:
            text = f"is from the model, which has the key frames {', '.join(frames)}; say which: "
            raise self._wrong(key, f"{text}{{from: model, keyframe: {next(iter(frames))}}}")
        name = next(iter(frames)) if name is None else name
        if name not in frames:
            raise self._wrong(key, f"has no keyframe {name!r}; {alternatives(name, frames)}")
        return [self._known.pose(frames[name], joint) for joint in joints], f"key frame {name}"

    def _stiffness(
        self, asked: Any, joints: Sequence[str], place: int = 0
    ) -> tuple[list[float], str]:
        gains = [self._known.gains(joint) for joint in joints]
        if None in gains:
            text = f"and {self._known.name} has no position actuator for"
            joint = joints[gains.index(None)]
            text = f"is from the model, {text} {joint}; give the numbers"
            raise self._wrong(GAINS[place], text)
        return [float(gain[place]) for gain in gains if gain is not None], "position actuators"

    def _damping(self, asked: Any, joints: Sequence[str]) -> tuple[list[float], str]:
        passive = [self._known.passive(joint) for joint in joints]
        if asked.of == "joints":
            return passive, "joint damping"
        gains, where = self._stiffness(asked, joints, 1)
        if not any(gains) and any(passive):
            raise self._wrong(
                "damping",
                f"is from the model, whose actuators have none; its joints have {passive[0]:g} "
                "N·m·s/rad: write {from: model, of: joints} for those",
            )
        return gains, where

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
        offered = {"joints": ""}
        if known.frames:
            offered["default_joint_pos"] = f", keyframe: {' | '.join(known.frames)}"
        gains = [known.gains(joint) for joint in known.ids]
        if None not in gains:
            passive = not any(gain and gain[1] for gain in gains)
            offered |= {"stiffness": "", "damping": ", of: joints" if passive else ""}
        words = [f"{key}: {{from: model{offered[key]}}}" for key in wanted if key in offered]
        if not words:
            return ""
        return f"; model {known.name} can say some of it: given: {{{', '.join(words)}}}"

    @cached_property
    def _known(self) -> _Known:
        robot, key = self._robot, next(iter(self._asked), "joints")
        if robot is None:
            text = "is from the model of a robot, and none is named; name it (robot: go2)"
            raise self._wrong(key, text)
        try:
            return _Known(pick_model(robot) if self._find is None else self._find(), robot)
        except PolicyError:
            raise
        except UniconError as error:
            raise self._wrong(key, f"is from the model: {error}") from error


class _Known:
    """A model's joints, by the robot's names."""

    def __init__(self, path: Path, robot: Robot) -> None:
        anything = replace(robot, weldable=frozenset(robot.joint_names))
        loaded = load_model(path, anything, quiet=True)
        self._model = model = loaded.model
        self.name = path.name
        found = [pair for pair in zip(loaded.joints, robot.joint_names)
                 if pair[1] not in loaded.welded]  # fmt: skip
        self.ids: dict[str, int] = {name: joint for joint, name in sorted(found)}
        self.frames = {model.key(i).name: i for i in range(model.nkey) if model.key(i).name}
        self._driven = drives(model)

    def ordered(self, order: str) -> list[str]:
        """Return the joints in an order; siblings stand as in the file."""
        if order == "breadth_first":
            return sorted(self.ids, key=self._depth)
        if order == "actuators":
            return sorted(self.ids, key=lambda name: self._driven[self.ids[name]][0])
        return list(self.ids)

    def _depth(self, name: str) -> int:
        """The number of bodies with joints above a joint's."""
        body, depth = int(self._model.jnt_bodyid[self.ids[name]]), 0
        while body:
            depth += int(self._model.body_jntnum[body] > 0)
            body = int(self._model.body_parentid[body])
        return depth

    def pose(self, frame: int, joint: str) -> float:
        place = self._model.jnt_qposadr[self.ids[joint]]
        return round(float(self._model.key_qpos[frame][place]), 9)

    def gains(self, joint: str) -> tuple[float, float] | None:
        return position_gains(self._model, self._driven[self.ids[joint]][0])

    def passive(self, joint: str) -> float:
        return float(self._model.dof_damping[self._model.jnt_dofadr[self.ids[joint]]])

"""SourceReader: what importers of YAML files share: a value, its place, and where it goes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from unicon_base.errors import PolicyError, UniconError, alternatives
from unicon_base.located_yaml import Located, Where
from unicon_base.schema.marks import Checked, Within, twice
from unicon_base.schema.read import refuse
from unicon_base.schema.records import type_of
from unicon_base.schema.types import Mistakes
from unicon_core.policies.contract import TORCHSCRIPT
from unicon_core.policies.facts import Facts
from unicon_core.policies.given import given_joints
from unicon_core.policies.hints import ClipBound, listed
from unicon_core.robots import Robot

_SUFFIXES = {".onnx": "onnx", **dict.fromkeys(TORCHSCRIPT, "torchscript")}


@dataclass(frozen=True)
class Source:
    """A configuration that is read, and what is known beside it.

    Attributes:
        located: its document.
        given: facts of the user.
        robot: whose motors the source may count, or None.
    """

    located: Located
    given: Mapping[str, Any]
    robot: Robot | None

    @property
    def path(self) -> Path:
        """The file."""
        return self.located.path

    @property
    def joints(self) -> list[str] | None:
        """The joints that the user gives: they resolve patterns, or stand for unknown motors.

        Raises:
            PolicyError: they are not a list of names.
        """
        return given_joints(self.path, self.given)


def motors_of(robot: Robot) -> dict[int, str]:
    """Return motor numbers of the vendor's SDK to joints: places unless the robot says more."""
    names, numbers = robot.joint_names, robot.transport.get("motors")
    if not isinstance(numbers, (list, tuple)) or len(numbers) != len(names):
        numbers = range(len(names))
    return {int(number): name for number, name in zip(numbers, names)}


Place: TypeAlias = str | Where


def keys_of(place: Place) -> Where:
    """Return the keys of a place."""
    return tuple(place.split(".")) if isinstance(place, str) else place


class SourceReader:
    """Takes values out of a source's document into facts, each with its place for messages.

    A place of a value is its keys, or these with dots between them.

    Args:
        facts: filled.
        located: the source's document.
        inside: keys under which everything stands.

    Attributes:
        document: what stands under `inside`.
    """

    def __init__(self, facts: Facts, located: Located, inside: Where = ()) -> None:
        self.facts, self.located, self.inside = facts, located, inside
        document: Any = located.value
        for key in inside:
            document = document[key]
        self.document: Mapping[str, Any] = document

    def line(self, place: Place) -> int | None:
        """Return the line of a place, None where it has none in the file that errors name."""
        return self.located.lines.get((*self.inside, *keys_of(place)))

    def say(self, fact: str, value: Any, place: Place, word: str = "") -> None:
        """Note a value and where it stood.

        Args:
            fact: its dotted name.
            value: of it.
            place: where it stood.
            word: the source's own word for it; the place unless given.
        """
        self.facts.say(fact, value, word or ".".join(map(str, keys_of(place))), self.line(place))

    def need(self, place: Place) -> Any:
        """Return what stands at a place.

        Raises:
            PolicyError: nothing does.
        """
        value: Any = self.document
        keys = keys_of(place)
        for i, key in enumerate(keys):
            if not isinstance(value, Mapping) or value.get(key) is None:
                known = map(str, value) if isinstance(value, Mapping) else ()
                raise self.wrong(
                    keys[:i],
                    f"the {self.facts.source} has no {'.'.join(map(str, keys))!r}; add it; "
                    f"{alternatives(str(key), known)}",
                )
            value = value[key]
        return value

    def wrong(self, place: Place, message: str) -> UniconError:
        """Return the error of a place below `inside`."""
        return self.located.error((*self.inside, *keys_of(place)), message)

    def value(self, hint: Any, place: Place) -> Any:
        """Return a value as a hint has it.

        Args:
            hint: its type, with units and bounds.
            place: where it stands.

        Raises:
            PolicyError: it is missing, or something else.
        """
        value, where = self.need(place), keys_of(place)
        name = ".".join(map(str, where))
        mistakes = Mistakes(value, name)
        found = type_of(hint).read(value, (), mistakes)
        what = f"{self.facts.path}: {name}"
        refuse(mistakes, lambda below, text: self.wrong((*where, *below), text), what)
        return found

    def floats(self, place: Place) -> list[float]:
        """Return a number or a list of numbers as a list.

        Raises:
            PolicyError: it is missing, or something else.
        """
        return list(listed(self.value(ClipBound, place)))

    def vector(self, key: str, count: int, of: str) -> list[float]:
        """Return one number for each joint; a single number is that of all.

        Args:
            key: where they stand.
            count: how many there must be.
            of: what they are counted by, for the message: `num_actions 12`.

        Raises:
            PolicyError: they are missing, no numbers, or of another count.
        """
        values = self.floats(key)
        if not isinstance(self.need(key), list):
            return values * count
        if len(values) != count:
            raise self.wrong(key, f"{key} has {len(values)} values for {of}; give {count}")
        return values

    def number(self, key: str) -> float:
        """Return a number.

        Raises:
            PolicyError: it is missing, or none.
        """
        number: float = self.value(float, key)
        return number

    def whole(self, key: str) -> int:
        """Return a whole number of at least 1.

        Raises:
            PolicyError: it is missing, or none.
        """
        number: int = self.value(Annotated[int, Within(1)], key)
        return number

    def places(self, place: Place, below: float = math.inf) -> list[int]:
        """Return numbers of joints or motors, each once.

        Args:
            place: where they stand.
            below: there are so many; infinite for any.

        Raises:
            PolicyError: they are missing, no whole numbers, repeated, or too large.
        """
        hint = Annotated[list[Annotated[int, Within(0, below - 1)]], Checked(twice)]
        places: list[int] = self.value(hint, place)
        return places

    def say_vector(self, fact: str, key: str, count: int, of: str) -> None:
        """Note a `vector`."""
        self.say(fact, self.vector(key, count, of), key)

    def say_period(self, dt: str, decimation: str) -> float:
        """Note the control period, the time of a step times the steps for one action.

        Returns:
            The time of a step in [s].
        """
        step = self.number(dt)
        self.say("period", step * self.whole(decimation), dt, f"{dt} · {decimation}")
        return step

    def is_laid_out(self, key: str, size: int, moved: int, program: str) -> bool:
        """Return whether a program lays out the network's input; the terms are asked for if not.

        Args:
            key: of the size that the network's input has.
            size: of what the program lays out.
            moved: number of actions.
            program: its file, and that it lays out.
        """
        wanted = self.whole(key)
        if wanted != size:
            self.facts.asks["observation.terms"] = (
                f"{key.rpartition('.')[2]} is {wanted}, and what {program} for {moved} "
                f"actions has {size}"
            )
        return wanted == size

    def given_joints(self, source: Source, count: int, what: str) -> list[str] | None:
        """Return the joints that the user gives in place of what the source only counts.

        Args:
            source: what is known beside the document.
            count: how many there must be.
            what: where they are counted, and which are meant, for the message.

        Raises:
            PolicyError: there are more or less.
        """
        joints = source.joints
        if joints is not None and len(joints) != count:
            raise PolicyError(
                f"{self.facts.path}: given joints has {len(joints)} names, and {what}"
            )
        return joints

    def say_motors(self, key: str, order: list[int], robot: Robot) -> None:
        """Note the joints of motors, and the robot that has them.

        Args:
            key: where the motors stand.
            order: their numbers in policy order.
            robot: the robot.

        Raises:
            PolicyError: the robot has no such motor.
        """
        motors = motors_of(robot)
        for i in order:
            if i not in motors:
                raise self.wrong(
                    key,
                    f"{key} names motor {i}, but robot {robot.name!r} has {len(motors)} motors up "
                    f"to number {max(motors)}; choose the robot whose motors it counts",
                )
        self.say("joints", [motors[i] for i in order], key)
        self.facts.values["robot"] = robot.name

    def network(self, key: str, named: Any, base: Path | None) -> None:
        """Find the network that the source names: where it says, else beside it by its name.

        Where only an `.onnx` of the same name is there, it is taken, and a note tells it.

        Args:
            key: where it is named.
            named: what stands there; of an absolute path the file's name counts.
            base: folder that the name counts from, above the source, or None.

        Raises:
            PolicyError: no file is named.
        """
        facts, path = self.facts, self.facts.path
        if not isinstance(named, str) or Path(named).suffix not in _SUFFIXES:
            known = ", ".join(_SUFFIXES)
            raise self.wrong(key, f"{key} is {named!r}; name a network ({known})")
        folder, name = path.parent, Path(named).name
        relative = Path(named)
        tries: list[Path] = []
        for stem in (relative, relative.with_suffix(".onnx")):
            if base is not None and not stem.is_absolute():
                tries.append(base / stem)
            tries.append(folder / stem.name)
        for found in tries:
            if not found.is_file() or not _within(found, base or folder, folder):
                continue
            if found.suffix != relative.suffix:
                facts.notes.append(
                    f"{path.name}: {key} names {name}, which is not there; {found.name} is taken"
                )
            self.say(_SUFFIXES[found.suffix], found.name, key)
            facts.network = found
            return
        facts.asks["onnx"] = f"{key} names {name}, which is not beside {path.name}; put it there"


def _within(found: Path, *folders: Path) -> bool:
    target = found.resolve()
    return any(target.is_relative_to(folder.resolve()) for folder in folders)

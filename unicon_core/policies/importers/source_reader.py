"""SourceReader: what importers of YAML files share: a value, its place, and where it goes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from unicon_core.errors import UniconError, alternatives
from unicon_core.located_yaml import Located, Where
from unicon_core.policies.facts import Facts
from unicon_core.policies.given import given_joints
from unicon_core.policies.hints import Side, listed
from unicon_core.robots import Robot
from unicon_core.schema.marks import Checked, Within, twice
from unicon_core.schema.read import refuse
from unicon_core.schema.records import type_of
from unicon_core.schema.types import Mistakes

_SUFFIXES = {".onnx": "onnx", ".pt": "torchscript", ".pth": "torchscript", ".jit": "torchscript"}


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

    @property
    def motors(self) -> dict[int, str]:
        """Motor numbers of the vendor's SDK to joints: places unless the robot says more."""
        if self.robot is None:
            return {}
        names = self.robot.joint_names
        numbers = self.robot.transport.get("motors")
        if not isinstance(numbers, (list, tuple)) or len(numbers) != len(names):
            numbers = range(len(names))
        return {int(number): name for number, name in zip(numbers, names)}


class SourceReader:
    """Takes values out of a source's document into facts, each with its place for messages.

    Args:
        facts: filled.
        located: the source's document.
        inside: keys under which everything stands.

    Attributes:
        document: what stands under `inside`.
        fail: makes the error of a place of the document.
    """

    def __init__(self, facts: Facts, located: Located, inside: Where = ()) -> None:
        self.facts = facts
        self.inside = inside
        document: Any = located.value
        for key in inside:
            document = document[key]
        self.document: Mapping[str, Any] = document
        self.lines = located.lines
        self.fail = located.error

    def say(self, target: Where, value: Any, source: Where) -> None:
        """Note a value and where it stood."""
        place: Any = self.facts.values
        for key in target[:-1]:
            place = place.setdefault(key, {})
        place[target[-1]] = value
        self.facts.keys[target] = ".".join(map(str, source))
        line = self.lines.get((*self.inside, *source))
        if line is not None:
            self.facts.lines[target] = line

    def need(self, *keys: str) -> Any:
        """Return what stands under nested keys.

        Raises:
            PolicyError: nothing does.
        """
        value: Any = self.document
        for i, key in enumerate(keys):
            if not isinstance(value, Mapping) or value.get(key) is None:
                known = map(str, value) if isinstance(value, Mapping) else ()
                raise self.wrong(
                    keys[:i],
                    f"the {self.facts.source} has no {'.'.join(keys)!r}; add it; "
                    f"{alternatives(key, known)}",
                )
            value = value[key]
        return value

    def wrong(self, where: Where, message: str) -> UniconError:
        """Return the error of a place below `inside`."""
        return self.fail((*self.inside, *where), message)

    def value(self, hint: Any, where: Where, value: Any) -> Any:
        """Return a value as a hint has it.

        Args:
            hint: its type, with units and bounds.
            where: its place below `inside`.
            value: as it stands there.

        Raises:
            PolicyError: it is something else.
        """
        name = ".".join(map(str, where))
        mistakes = Mistakes(value, name)
        found = type_of(hint).read(value, (), mistakes)
        what = f"{self.facts.path}: {name}"
        refuse(mistakes, lambda below, text: self.wrong((*where, *below), text), what)
        return found

    def floats(self, where: Where, value: Any) -> list[float]:
        """Return a number or a list of numbers as a list.

        Raises:
            PolicyError: it is something else.
        """
        return list(listed(self.value(Side, where, value)))

    def vector(self, *keys: str, count: int, of: str) -> list[float]:
        """Return one number for each joint; a single number is that of all.

        Args:
            keys: nested keys.
            count: how many there must be.
            of: what they are counted by, for the message: `num_actions 12`.

        Raises:
            PolicyError: they are missing, no numbers, or of another count.
        """
        value = self.need(*keys)
        values = self.floats(keys, value)
        if not isinstance(value, list):
            return values * count
        if len(values) != count:
            raise self.wrong(
                keys, f"{'.'.join(keys)} has {len(values)} values for {of}; give {count}"
            )
        return values

    def number(self, *keys: str) -> float:
        """Return a number.

        Raises:
            PolicyError: it is missing, or none.
        """
        number: float = self.value(float, keys, self.need(*keys))
        return number

    def whole(self, *keys: str, least: int = 1) -> int:
        """Return a whole number of at least so much.

        Raises:
            PolicyError: it is missing, or none.
        """
        number: int = self.value(Annotated[int, Within(least)], keys, self.need(*keys))
        return number

    def places(self, *keys: str, below: float = math.inf) -> list[int]:
        """Return numbers of joints or motors, each once.

        Args:
            keys: nested keys.
            below: there are so many; infinite for any.

        Raises:
            PolicyError: they are missing, no whole numbers, repeated, or too large.
        """
        hint = Annotated[list[Annotated[int, Within(0, below - 1)]], Checked(twice)]
        places: list[int] = self.value(hint, keys, self.need(*keys))
        return places

    def say_vector(self, target: Where, *keys: str, count: int, of: str) -> None:
        """Note a `vector`, which stands under nested keys."""
        self.say(target, self.vector(*keys, count=count, of=of), keys)

    def say_motors(self, key: str, order: list[int], robot: str, motors: dict[int, str]) -> None:
        """Note the joints of motors, and the robot that has them.

        Args:
            key: where the motors stand.
            order: their numbers in policy order.
            robot: the robot's name.
            motors: its motors to joints.

        Raises:
            PolicyError: the robot has no such motor.
        """
        for i in order:
            if i not in motors:
                raise self.wrong(
                    (key,),
                    f"{key} names motor {i}, but robot {robot!r} has {len(motors)} motors up to "
                    f"number {max(motors)}; choose the robot whose motors it counts",
                )
        self.say(("joints",), [motors[i] for i in order], (key,))
        self.facts.values["robot"] = robot

    def network(self, key: Where, named: Any, base: Path | None) -> None:
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
        word = ".".join(map(str, key))
        if not isinstance(named, str) or Path(named).suffix not in _SUFFIXES:
            known = ", ".join(_SUFFIXES)
            raise self.wrong(key, f"{word} is {named!r}; name a network ({known})")
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
                    f"{path.name}: {word} names {name}, which is not there; {found.name} is taken"
                )
            kind = _SUFFIXES[found.suffix]
            self.say((kind,), found.name, key)
            facts.network = found
            return
        facts.asks["onnx"] = f"{word} names {name}, which is not beside {path.name}; put it there"


def _within(found: Path, *folders: Path) -> bool:
    target = found.resolve()
    return any(target.is_relative_to(folder.resolve()) for folder in folders)

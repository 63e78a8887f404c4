"""Source: the configuration of another deployment, read into facts with places for messages.

A value by pattern stands as Isaac Lab writes it: a number, or {pattern: number}.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from unicon_base import AnyDict, AnyMapping, PolicyError, UniconError, alternatives
from unicon_base.located_yaml import Located, Tagged, Where
from unicon_base.schema.marks import Checked, Names, NotEmpty, Within, positive, twice
from unicon_base.schema.read import read_value
from unicon_core.policies.contract import TORCHSCRIPT
from unicon_core.policies.facts import Facts, dig, term_state, value_of
from unicon_core.policies.hints import ClipBound, listed
from unicon_core.robots import Robot

_SUFFIXES = {".onnx": "onnx", **dict.fromkeys(TORCHSCRIPT, "torchscript")}
RENAMED_RANGES = {"ang_vel_yaw": "ang_vel_z"}
"""A command's name in legged_gym and holosoma to its name in a contract."""
OF_JOINTS = ("joint_pos", "joint_vel")
"""States of which a policy may see a part of the joints."""
_ALL = "slice(None, None, None)"  # as Isaac Lab dumps it

RATE = Annotated[float, positive(unit="Hz")]
Place: TypeAlias = str | Where
"""Keys of a value, or these with dots between them."""


def keys_of(place: Place) -> Where:
    """Return the keys of a place."""
    return tuple(place.split(".")) if isinstance(place, str) else place


def motors_of(robot: Robot) -> dict[int, str]:
    """Return motor numbers of the vendor's SDK to joints: places unless the robot says more."""
    names, numbers = robot.joint_names, robot.transport.get("motors")
    if not isinstance(numbers, list | tuple) or len(numbers) != len(names):
        numbers = range(len(names))
    return {int(number): name for number, name in zip(numbers, names)}


class Source:
    """A configuration that is read, and what is known beside it.

    Args:
        located: its document.
        given: facts of the user.
        robot: whose motors the source may count, or None.

    Attributes:
        facts: what was read.
        files: each file and the keys under which everything stands in it; the first one wins.
        document: what the files say.
    """

    def __init__(self, located: Located, given: AnyMapping, robot: Robot | None) -> None:
        self.path, self.located, self.given, self.robot = located.path, located, given, robot
        self.facts = Facts(located.path, "")
        self.files: list[tuple[Located, Where]] = [(located, ())]
        self.document: AnyMapping = located.value

    def line(self, place: Place) -> int | None:
        """Return the line of a place in the first file, None where it has none."""
        located, inside = self.files[0]
        return located.lines.get((*inside, *keys_of(place)))

    def say(self, fact: str, value: Any, place: Place, word: str = "") -> None:
        """Note a value, where it stood, and the source's own word for it, by default the place."""
        self.facts.say(fact, value, word or ".".join(map(str, keys_of(place))), self.line(place))

    def need(self, place: Place) -> Any:
        """Return what stands at a place.

        Raises:
            PolicyError: nothing does.
        """
        value: Any = self.document
        keys = keys_of(place)
        for i, key in enumerate(keys):
            if dig(value, key) is None:
                known = map(str, value) if isinstance(value, Mapping) else ()
                raise self.wrong(
                    keys[:i],
                    f"the {self.facts.source} has no {'.'.join(map(str, keys))!r}; add it; "
                    f"{alternatives(str(key), known)}",
                )
            value = value[key]
        return value

    def wrong(self, place: Place, message: str) -> UniconError:
        """Return the error of a place, in the file that says it."""
        keys = keys_of(place)
        says = [file for file in self.files if dig(file[0].value, *file[1], *keys[:1]) is not None]
        located, inside = (says or self.files)[0]
        return located.error((*inside, *keys), message)

    def value(self, hint: Any, place: Place) -> Any:
        """Return a value as a hint has it: its type, with units and bounds.

        Raises:
            PolicyError: it is missing, or something else.
        """
        where = keys_of(place)
        name = ".".join(map(str, where))
        return read_value(
            hint, self.need(place), lambda below, text: self.wrong((*where, *below), text), name
        )

    def numbers(
        self, place: Place, count: int = 0, of: str = "", hint: Any = ClipBound
    ) -> list[Any]:
        """Return a value or a list of them as a list.

        Args:
            place: where they stand.
            count: how many a list must have; 0 for any.
            of: what counts them, where a key or words do.
            hint: of the values.

        Raises:
            PolicyError: as of `value`; or there are more or less.
        """
        values = list(listed(self.value(hint, place)))
        if count not in (0, len(values)) and isinstance(self.need(place), list):
            of = f" for the {count} of {of}" if of else ""
            text = f"{keys_of(place)[-1]} has {len(values)} values{of}; give {count}"
            raise self.wrong(place, text)
        return values

    def number(self, key: str) -> float:
        """Return a number; PolicyError as of `value`."""
        return float(self.value(float, key))

    def whole(self, key: str) -> int:
        """Return a whole number of at least 1; PolicyError as of `value`."""
        return int(self.value(Annotated[int, Within(1)], key))

    def places(
        self, place: Place, below: float = math.inf, count: int = 0, of: str = ""
    ) -> list[int]:
        """Return numbers of joints or motors below a limit, each once.

        Raises:
            PolicyError: as of `numbers`; or they are no whole numbers, repeated, or too large.
        """
        each = Annotated[int, Within(0, below - 1)]
        return self.numbers(place, count, of, Annotated[list[each], NotEmpty, Checked(twice)])

    def ids(self, where: Where, joint_ids: Any) -> list[int] | None:
        """Return the places that Isaac Lab's `joint_ids` chooses; None: all.

        Raises:
            PolicyError: they are something else.
        """
        if joint_ids is None or joint_ids == _ALL or isinstance(joint_ids, Tagged):
            return None
        if not isinstance(joint_ids, list) or not all(isinstance(i, int) for i in joint_ids):
            text = f"{where[-1]}: joint_ids is {joint_ids!r}; give places, or null"
            raise self.wrong(where, text)
        return joint_ids

    def copy(self, fact: str, key: str, count: int, of: str = "") -> None:
        """Note the `numbers` under a key; a single one is that of all."""
        values = self.numbers(key, count, of)
        self.say(fact, values if isinstance(self.need(key), list) else values[0], key)

    def say_period(self, dt: str, decimation: str) -> None:
        """Note the control period, the time of a step times the steps, where both are there."""
        if value_of(self.document, dt) is None or value_of(self.document, decimation) is None:
            return
        period = self.number(dt) * self.whole(decimation)
        self.say("period", period, dt, f"{dt} · {decimation}")

    def say_rate(self, rate: str, decimation: str) -> None:
        """Note the control period, steps over the rate of a step in [Hz]; PolicyError of both."""
        period = self.whole(decimation) / self.value(RATE, rate)
        self.say("period", period, decimation)

    def say_clip(self, key: str) -> None:
        """Note the highest size of an action, and that what is clipped is fed back."""
        most = self.number(key)
        self.say("action.clip", [-most, most], key)
        self.facts.say("action.feedback", "clipped")

    def say_ranges(self, place: str) -> None:
        """Note the pairs [lowest, highest] of commands that stand at a place, if any do."""
        found = value_of(self.document, place)
        ranges = {
            RENAMED_RANGES.get(name, name): list(pair)
            for name, pair in (found if isinstance(found, Mapping) else {}).items()
            if isinstance(pair, list | tuple) and len(pair) == 2
        }
        if ranges:
            self.say("command_ranges", ranges, place)

    def term(
        self,
        name: str,
        scale: str = "1",
        under: str = "",
        *,
        bound: float | None = None,
        seen: Iterable[int] = (),
    ) -> AnyDict:
        """Return a term that a program lays out, by its usual name; a gait phase by any other.

        Args:
            name: of the term.
            scale: keys of its factors, one for all elements or one for each; "1" is itself one.
            under: what stands before these keys.
            bound: of what is scaled, or None.
            seen: the joints that a term of joints sees; empty for all.

        Raises:
            PolicyError: as of `numbers`.
        """
        keys = scale.split()
        count = 3 if name.startswith("command") and len(keys) == 1 else 1
        found = ([1.0] if key == "1" else self.numbers(under + key, count) for key in keys)
        factors = [factor for each in found for factor in each]
        term = {"name": name, **(term_state(name) or {"state": "gait_phase"})}
        term["scale"] = plural(factors)
        if bound is not None:
            term["clip"] = clip_before_scale([-bound, bound], factors)
        if (places := list(seen)) and term["state"] in OF_JOINTS:
            term["index"] = places
        return term

    def say_terms(self, terms: list[AnyDict], key: str, size: int, program: str) -> None:
        """Note the terms that a program lays out; they are asked for where its size is another.

        Args:
            terms: of the program.
            key: where the size of the network's input stands.
            size: of what the program lays out.
            program: its file, and that it lays out.
        """
        wanted = self.whole(key)
        if wanted == size:
            self.facts.say("observation.terms", terms, "its deploy program")
        else:
            word = key.rpartition(".")[2]
            text = f"{word} is {wanted}, and what {program} has {size}"
            self.facts.asks["observation.terms"] = text

    def joints(self, count: int | None = None, what: str = "") -> list[str] | None:
        """Return the joints that the user gives: for patterns, or for what the source counts.

        Args:
            count: how many there must be, or None for any.
            what: where they are counted, and which are meant, for the message.

        Raises:
            PolicyError: they are no list of names, or more or less.
        """
        said = self.given.get("joints")
        if said is None:
            return None
        names = read_value(
            Names, said, lambda _, text: PolicyError(f"{self.path}: given {text}"), "joints"
        )
        if count not in (None, len(names)):
            raise PolicyError(f"{self.path}: given joints has {len(names)} names, and {what}")
        return list(names)

    def say_motors(self, key: str, order: Sequence[int]) -> None:
        """Note the joints of motors in policy order, of the robot or as given; else ask for them.

        Raises:
            PolicyError: the robot has no such motor, or there are more or fewer given joints.
        """
        robot, facts = self.robot, self.facts
        if robot is None:
            counted = f"motors {', '.join(map(str, order))}"
            what = f"it counts {counted}; name their joints in this order"
            if (joints := self.joints(len(order), what)) is not None:
                facts.values["joints"] = joints
            else:
                facts.asks["joints"] = f"{counted} of the robot: name the robot"
            return
        motors = motors_of(robot)
        for i in order:
            if i not in motors:
                raise self.wrong(
                    key,
                    f"{key} names motor {i}, but robot {robot.name!r} has {len(motors)} motors up "
                    f"to number {max(motors)}; choose the robot whose motors it counts",
                )
        self.say("joints", [motors[i] for i in order], key)
        facts.values["robot"] = robot.name

    def network(self, key: str, named: Any, base: Path | None = None) -> None:
        """Find the network that the source names: where it says, else beside it by its name.

        Where only an `.onnx` of the same name is there, it is taken, and a note says so.

        Args:
            key: where it is named.
            named: what stands there; of an absolute path the file's name counts.
            base: folder that the name counts from, above the source, or None.

        Raises:
            PolicyError: no file is named.
        """
        facts, folder = self.facts, self.path.parent.resolve()
        if not isinstance(named, str) or Path(named).suffix not in (*_SUFFIXES, ".mnn"):
            raise self.wrong(key, f"{key} is {named!r}; name a network ({', '.join(_SUFFIXES)})")
        base, relative = (base or folder).resolve(), Path(named)
        stems = [relative, relative.with_suffix(".onnx")]
        if relative.suffix == ".mnn":
            stems.reverse()
        for found in (place for stem in stems for place in (base / stem, folder / stem.name)):
            if not found.is_file() or not any(map(found.resolve().is_relative_to, (base, folder))):
                continue
            if found.suffix != relative.suffix:
                facts.notes.append(
                    f"{self.path.name}: {key} names {relative.name}, which is not there; "
                    f"{found.name} is taken"
                )
            self.say(_SUFFIXES.get(found.suffix, "onnx"), found.name, key)
            facts.network = found
            return
        facts.asks["onnx"] = (
            f"{key} names {relative.name}, which is not beside {self.path.name}; put it there"
        )


def plural(values: Sequence[Any]) -> Any:
    """Return values as `policy.yaml` has them: a single one is no list."""
    return values[0] if len(values) == 1 else list(values)


def clip_before_scale(pair: Sequence[float], scale: Sequence[float]) -> list[list[float]]:
    """Return the bounds before scaling of a term that is scaled first, then clipped.

    `clip(scale · x) = scale · clip(x)` with the bounds divided by the scale; where that is 0, any
    bounds do.

    Args:
        pair: lowest and highest after scaling.
        scale: factors, shape (d,).

    Returns:
        All the lowest, all the highest.
    """
    sides = [sorted(bound / s for bound in pair) if s else list(pair) for s in scale]
    return [list(side) for side in zip(*sides)]


def matches(pattern: object, joint: str) -> bool:
    """Return whether a joint's whole name matches a pattern; a broken pattern matches nothing."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # about brackets; the result is the same
            return re.fullmatch(str(pattern), joint) is not None
    except re.error:
        return False


def values_by_pattern(
    value: Any, joints: Sequence[str], *, default: float | None = None, whole: bool = True
) -> list[float] | None:
    """Return one value for each joint, or None where a joint gets none.

    Args:
        value: a number, a list in joint order, or a mapping from a pattern to a number.
        joints: joint names.
        default: value of a joint that no pattern matches.
        whole: whether a pattern must match the whole name (Isaac Lab), or a part (legged_gym).
    """
    if isinstance(value, Mapping):
        numbers = [item for item in value.items() if isinstance(item[1], int | float)]
        fits = matches if whole else lambda pattern, joint: str(pattern) in joint
        value = [next((n for p, n in numbers if fits(p, joint)), default) for joint in joints]
    elif isinstance(value, int | float) and not isinstance(value, bool):
        value = [value] * len(joints)
    if not isinstance(value, list | tuple) or len(value) != len(joints):
        return None
    return [*map(float, value)] if all(isinstance(v, int | float) for v in value) else None

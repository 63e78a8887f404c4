"""Facts: what a driver reads of a robot file's `transport`, declared by a dataclass; for vendors.

@dataclass(frozen=True)
class MyFacts(Transport):
    port: Port
    slots: Annotated[list[int], Key("motors"), slots(20)]

facts = MyFacts.of(robot)                               # or `fact` for one alone
raise wrong_fact(robot, "release", "{wait: seconds}")   # of what only this vendor has

Marks of `unicon_base.schema.marks` give bounds and keys; a function in `Annotated`, such as `each`
makes, takes the robot and returns the type of the fact.
"""

from __future__ import annotations

import dataclasses
import ipaddress
from collections.abc import Callable
from typing import Annotated, Any, TypeAlias, TypeVar, get_type_hints

import numpy as np

from unicon_base import PlatformError, RobotError
from unicon_base.schema.marks import Key, Size, Within
from unicon_base.schema.records import MadeOf, type_of
from unicon_base.schema.types import INVALID, ListOf, MapOf, Mistakes, Number, Plain, Type
from unicon_core.robots import Robot

F = TypeVar("F")
Fitted: TypeAlias = Callable[[Robot], Type]

Octet = Annotated[int, Within(0, 255)]
Word = Annotated[int, Within(0, 0xFFFF)]
Port = Annotated[int, Within(1, 65535)]
Baud = Annotated[int, Within(1, 10_000_000)]
Rate = Annotated[float, Key("rate_hz"), Within(1.0, 10_000.0)]
"""Of frames in [Hz]."""
AskingRate = Annotated[float, Key("rate_hz"), Within(1.0, 1000.0)]
"""Of frames that are asked for, in [Hz]."""


def each(low: float, high: float, *, whole: bool = False) -> Fitted:
    """Return the mark of a number of each joint: an array, or a list of whole ones."""

    def fitted(robot: Robot) -> Type:
        n, kind = robot.num_joints, "whole numbers" if whole else "numbers"
        wanted = f"{n} {kind} from {low:g} to {high:g}, one for each joint"
        numbers = ListOf(Number(whole, Within(low, high), ""), Size(n, n), wanted)
        return numbers if whole else MadeOf(np.array, numbers, "")

    return fitted


def each_text(robot: Robot) -> Type:
    """Mark a text of each joint."""
    n = robot.num_joints
    return ListOf(type_of(str), Size(n, n), f"{n} texts, one for each joint")


def slots(count: int | None = None) -> Fitted:
    """Return the mark of the motor slots of joints; there are `count`, or one for each joint."""

    def fitted(robot: Robot) -> Type:
        n = robot.num_joints
        last = (n if count is None else count) - 1
        wanted = f"{n} different slots of 0 to {last}"
        numbers = ListOf(Number(True, Within(0, last), ""), Size(n, n), wanted)
        return MadeOf(lambda found: found if len({*found}) == n else INVALID, numbers, "")

    return fitted


def one_of(*words: str) -> Fitted:
    """Return the mark of one of some words."""
    return lambda robot: Plain(words, f"one of {', '.join(words)}")


def joint_number(robot: Robot) -> Type:
    """Mark the name of a joint, of which its number is made."""
    names = robot.joint_names
    return MadeOf(names.index, one_of(*names)(robot), "")


def named(keys: tuple[Any, ...], low: int, high: int) -> Fitted:
    """Return the mark of whole numbers by name, where `keys` have to be there."""
    wanted = f"{{{': …, '.join(map(str, keys))}: …}} of {low} to {high}"
    numbers = MapOf(Type(), Number(True, Within(low, high), ""), Size(), wanted)
    made = MadeOf(lambda found: found if {*keys} <= {*found} else INVALID, numbers, "")
    return lambda robot: made


def fact(robot: Robot, key: str, hint: Any) -> Any:
    """Return a fact of a robot file's `transport`.

    Args:
        robot: the file.
        key: of the fact.
        hint: its type, as of a field of `Transport`.

    Raises:
        RobotError: the file does not say it, or says nonsense.
    """
    kinds: list[Type] = [mark(robot) for mark in _marks(hint) if callable(mark)]
    kind = kinds[0] if kinds else type_of(hint)
    found = kind.read(robot.transport.get(key), (), Mistakes())
    if found is INVALID:
        raise wrong_fact(robot, key, kind.wanted)
    return found


def _marks(hint: Any) -> tuple[Any, ...]:
    return getattr(hint, "__metadata__", ())


def wrong_fact(robot: Robot, key: str, wanted: str) -> RobotError:
    """Return the error of a fact that lacks or is wrong.

    Args:
        robot: the file.
        key: of the fact.
        wanted: what is to be written instead.
    """
    return RobotError(
        f"robot {robot.name}: transport.{key} is {robot.transport.get(key)!r:.60}; write "
        f"{wanted} into {robot.path.name}, with its source"
    )


def facts_of(kind: type[F], robot: Robot, **given: Any) -> F:
    """Return the facts that the fields of a dataclass declare, by type and key.

    Args:
        kind: the class; a field with a default may lack in the file.
        robot: the file.
        given: fields that are not the file's.

    Raises:
        RobotError: one lacks, or is not what it must be.
    """
    hints = get_type_hints(kind, include_extras=True)
    for each in dataclasses.fields(kind):  # type: ignore[arg-type]  # a dataclass
        if each.name not in given:
            hint = hints[each.name]
            keys = [mark.name for mark in _marks(hint) if isinstance(mark, Key)]
            key = keys[0] if keys else each.name
            if each.default is dataclasses.MISSING or robot.transport.get(key) is not None:
                given[each.name] = fact(robot, key, hint)
    return kind(**given)


class Transport:
    """Facts of a robot file's `transport`: the base of a dataclass whose fields are its keys."""

    @classmethod
    def of(cls: type[F], robot: Robot) -> F:
        """Read them.

        Raises:
            RobotError: one lacks, or is not what it must be.
        """
        return facts_of(cls, robot)


def ipv4(address: object, platform: str) -> str:
    """Return an option that is an IPv4 address.

    Raises:
        PlatformError: it is none.
    """
    try:
        if isinstance(address, str):
            return str(ipaddress.IPv4Address(address))
    except ValueError:
        pass
    raise PlatformError(
        f"platform {platform!r}: address is {address!r:.60}; give an IPv4 address such as "
        "192.168.1.201"
    )


def port_number(value: object, platform: str, key: str = "port") -> int:
    """Return an option that is the number of a port.

    Raises:
        PlatformError: it is none.
    """
    if type(value) is int and 1 <= value <= 65535:
        return value
    raise PlatformError(f"platform {platform!r}: {key} is {value!r:.60}; give one from 1 to 65535")

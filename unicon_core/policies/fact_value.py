"""FactValue: a value of the facts and its place, so that every check of it is one located line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import PolicyError, alternatives
from unicon_core.located_yaml import Where
from unicon_core.policies.facts import Facts, dotted


def is_whole(value: object, least: int) -> bool:
    """Return whether a value is a whole number of at least so much."""
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


@dataclass(frozen=True)
class FactValue:
    """A value of the facts and its place; every check raises PolicyError with that place."""

    facts: Facts
    where: Where
    value: Any

    def part(self, key: str | int, value: Any) -> FactValue:
        return FactValue(self.facts, (*self.where, key), value)

    def at(self, key: str | int, default: Any = None) -> FactValue:
        """What stands under a key of a mapping, or at a place of a list."""
        value = self.value[key] if isinstance(key, int) else self.value.get(key, default)
        return self.part(key, value)

    def fail(self, rest: str) -> PolicyError:
        return self.facts.error(self.where, f"{dotted(self.where)} {rest}")

    def refuse(self, remedy: str) -> PolicyError:
        return self.fail(f"is {self.value!r}; {remedy}")

    def mapping(self, known: tuple[str, ...]) -> FactValue:
        """Itself, checked: a mapping of known keys."""
        for key in self.entries():
            if key not in known:
                inside = f" in {dotted(self.where)}" if self.where else ""
                raise self.facts.error(
                    (*self.where, key),
                    f"unknown key {key!r}{inside}; {alternatives(str(key), known)}",
                )
        return self

    def entries(self) -> Mapping[str, Any]:
        if not isinstance(self.value, Mapping):
            raise self.refuse("give a mapping")
        return self.value

    def choice(self, key: str, *known: str) -> Any:
        """The word under a key; the first known one where it is not said."""
        word = self.at(key, known[0])
        if word.value not in known:
            raise word.refuse(f"known: {', '.join(known)}")
        return word.value

    def names(self) -> tuple[str, ...]:
        value = self.value
        if not isinstance(value, (list, tuple)) or not all(isinstance(v, str) for v in value):
            raise self.refuse("give a list of joint names")
        if not value:
            raise self.fail("is empty; name at least one joint")
        for name in value:
            if value.count(name) > 1:
                raise self.facts.error(
                    self.where,
                    f"joint {name!r} stands twice in {dotted(self.where)}; name each joint once",
                )
        return tuple(value)

    def positive(self, what: str) -> float:
        value = self.value
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < 1e6:
            raise self.refuse(f"give {what}, above 0")
        return float(value)

    def numbers(self) -> NDArray[np.float32]:
        """One number or a list of numbers, as float32 of shape (k,)."""
        value = self.value
        listed = list(value) if isinstance(value, (list, tuple, np.ndarray)) else [value]
        for i, item in enumerate(listed):
            number = (
                self.part(i, item) if len(listed) > 1 else FactValue(self.facts, self.where, item)
            )
            if isinstance(item, bool) or not isinstance(item, (int, float, np.number)):
                raise number.refuse("give a number")
            if np.isnan(float(item)):
                raise number.fail("is nan; give a number")
        if not listed:
            raise self.fail("is empty; give one number or a list")
        array = np.array(listed, dtype=np.float32)
        array.flags.writeable = False
        return array

    def finite(self) -> NDArray[np.float32]:
        array = self.numbers()
        bad = np.flatnonzero(~np.isfinite(array))
        if bad.size:
            number = self.part(int(bad[0]), None) if array.size > 1 else self
            raise number.fail(f"is {array[bad[0]]}; give a finite number")
        return array

    def single(self) -> float:
        """One finite number."""
        array = self.finite()
        if array.size != 1:
            raise self.fail(f"has {array.size} values; give one number")
        return float(array[0])

    def vector(
        self, lowest: float, highest: float, count: int | None = None, hint: str = ""
    ) -> NDArray[np.float32]:
        """Numbers within bounds; with a count one for each joint, or one for all of them."""
        if count is not None and isinstance(self.value, Mapping):
            joints = self.facts.values["joints"] if len(self.where) == 1 else ()
            lacking = ", ".join(name for name in joints if name not in self.value)
            raise self.fail(
                f"is a mapping{f' without {lacking}' if lacking else ''}; give a list with one "
                "value per joint, in policy order"
            )
        array = self.finite()
        if count is not None and array.size == 1:
            array = np.full(count, array[0], np.float32)
        if count is not None and array.size != count:
            raise self.fail(
                f"has {array.size} values for {count} joints; give one for each joint in policy "
                "order"
            )
        bad = np.flatnonzero((array < lowest) | (array > np.float32(highest)))
        if bad.size:
            i = int(bad[0])
            bound = f"at least {lowest:g}" if array[i] < lowest else f"at most {highest:g}"
            raise self.part(i, None).fail(f"is {array[i]!s}; it must be {bound}{hint}")
        return array

    def clip(self, count: int | None = None) -> NDArray[np.float32] | None:
        """`[lowest, highest]`, each one number or a list; shape (2, 1) or (2, count)."""
        if self.value is None:
            return None
        if not isinstance(self.value, (list, tuple)) or len(self.value) != 2:
            raise self.refuse("give [lowest, highest] or null")
        sides = [self.at(i).numbers() for i in range(2)]
        width = max(side.size for side in sides)
        for i, side in enumerate(sides):
            if side.size not in (1, width) or (count is not None and side.size not in (1, count)):
                raise self.at(i).fail(f"has {side.size} values; give 1 or {count or width}")
        array = np.stack([np.broadcast_to(side, (width,)) for side in sides])
        bad = np.flatnonzero(array[0] > array[1])
        if bad.size:
            low, high = array[:, bad[0]]
            raise self.fail(f"is [{low:g}, {high:g}]; the lowest must come first")
        return array

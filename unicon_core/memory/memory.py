"""Memory: takes what the blocks of a graph remember, and gives it back to those of a fresh one.

memory = Memory(roots_of(…), states)
before = memory.take()                 # between two ticks, some 0.1 ms
…
fresh.restore(before.content())        # another program, built of the same workflow
"""

from __future__ import annotations

import gc
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from unicon_core.errors import StateError
from unicon_core.memory.values import ATOMS, NotPlain, copied, from_json, put, to_json
from unicon_core.memory.walk import Found, Keeps, Key, walk
from unicon_core.states import States

__all__ = ["Memory", "Remembered"]

_SIMPLE = ATOMS  # a name of the module: it is looked up once for each value


@dataclass(frozen=True)
class Remembered:
    """What was remembered at one moment.

    Attributes:
        places: path of the owner and key of each value.
        values: of the places.
        kept: path of an object that keeps its own memory, to that memory.
        unkept: paths of what remembers something that cannot be had.
    """

    places: list[tuple[str, Key]]
    values: list[Any]
    kept: dict[str, Any]
    unkept: list[str]

    def content(self) -> dict[str, Any]:
        """Return it as what JSON can write; `Memory.restore` takes it."""
        owners: dict[str, list[Any]] = {}
        for (path, key), value in zip(self.places, self.values):
            owners.setdefault(path, []).append([key, to_json(value)])
        kept = {path: to_json(value) for path, value in self.kept.items()}
        return {"owners": owners, "kept": kept, "unkept": self.unkept}


class Memory:
    """The memory of some blocks.

    What is there is found once, which takes some milliseconds; `take` then only copies. Where an
    object has been put in the place of another meanwhile, it is found anew.

    Args:
        roots: label to what is looked into: the functions of blocks.
        states: what lies in them is left out.
        leave: objects that are not looked into.
    """

    def __init__(
        self, roots: Mapping[str, Any], states: States, leave: Collection[Any] = ()
    ) -> None:
        self._roots, self._buffer = dict(roots), states.buffer
        self._leave = [states, *leave]
        self._found = Found()
        self._look()

    def _look(self) -> None:
        found = self._found = walk(self._roots, self._buffer, self._leave)
        self._read = [(found.owners[path], key) for path, key in found.places]

    def _as_before(self) -> bool:
        """Return whether every object stands where it was found."""
        try:
            found = self._found
            return (
                all(len(each) == size for each, size in found.sizes)
                and all(len(gc.get_referents(each)) == size for each, size in found.objects)
                and all(owner[key] is part for owner, key, part in found.parts)
            )
        except (LookupError, ValueError):
            return False

    def take(self) -> Remembered:
        """Return what is remembered now; call it between two ticks."""
        if not self._as_before():
            self._look()
        values = self._values()
        if values is None:
            self._look()
            values = self._values()
            assert values is not None
        found = self._found
        kept, unkept = {}, list(found.unkept)
        for path, keeper in found.keepers.items():
            try:
                kept[path] = copied(keeper.memory())
            except Exception:  # whatever it is, the others' memory is kept
                unkept.append(path)
        return Remembered(found.places, values, kept, unkept)

    def _values(self) -> list[Any] | None:
        """Return copies of the values, None where an object stands in a value's place."""
        simple, array = _SIMPLE, np.ndarray
        values: list[Any] = []
        append = values.append
        try:
            for owner, key in self._read:
                value = owner[key]
                kind = type(value)
                if kind in simple:
                    append(value)
                else:
                    append(value.copy() if kind is array else copied(value))
        except (LookupError, NotPlain, ValueError):
            return None
        return values

    def put_back(self, remembered: Remembered) -> None:
        """Make the same blocks remember what they did; `restore` without the way through JSON.

        Raises:
            StateError: they hold other objects by now.
        """
        owners = self._found.owners
        try:
            for (path, key), value in zip(remembered.places, remembered.values):
                put(owners[path], key, value if type(value) in _SIMPLE else copied(value))
            for path, value in remembered.kept.items():
                self._found.keepers[path].restore(copied(value))
        except (LookupError, NotPlain, RuntimeError, TypeError, ValueError) as error:
            raise _other(f"{error!r}") from error

    def restore(self, content: Mapping[str, Any]) -> None:
        """Make the blocks remember what others did that were built alike; between two ticks.

        Raises:
            StateError: they were not built alike, or it is not a memory.
        """
        try:
            owners = [(path, pairs) for path, pairs in content["owners"].items()]
            kept = content["kept"].items()
        except (AttributeError, LookupError, TypeError) as error:
            raise StateError(f"not a memory of blocks: {error!r}") from error
        for path, pairs in owners:
            owner = self._found.owners.get(path)
            if owner is None:
                raise _other(path)
            for key, value in pairs:
                try:
                    put(owner, key, from_json(value))
                except (LookupError, TypeError, ValueError) as error:
                    raise _other(f"{path}, {key}: {error}") from error
        for path, value in kept:
            keeper: Keeps | None = self._found.keepers.get(path)
            if keeper is None:
                raise _other(path)
            try:
                keeper.restore(from_json(value))
            except (LookupError, RuntimeError, TypeError, ValueError) as error:
                raise _other(f"{path}: {error}") from error
        self._look()


def _other(path: str) -> StateError:
    return StateError(
        f"the memory is of other blocks ({path}); build the program of the same workflow, policies "
        "and version"
    )

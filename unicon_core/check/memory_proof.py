"""Proof of a block's declared memory: snapshot, tick, restore, tick again, and compare.

The second time everything that the block changed without declaring it holds other values: numbers
of an array are spoiled, all else is as the first time left it. A block whose outputs differ then
remembers something that it does not declare. What it changed is found by a walk over attributes,
enclosed and global variables, class attributes, iterators and caches.
"""

from __future__ import annotations

import random
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from types import BuiltinMethodType, FunctionType, GeneratorType, MethodType, ModuleType
from typing import Any

import numpy as np

from unicon_base.arrays import Array
from unicon_core.flow import Block
from unicon_core.memory import UNDECLARED, Memory, declared, holder_of
from unicon_core.states import States

TICKS = 16
"""Ticks in front of the snapshot, and behind it."""
MOST = 20_000
"""Objects that the walk looks into."""
_OURS = ("unicon_base", "unicon_core", "unicon_manipulation")
_ATOMS = (type(None), bool, int, float, complex, str, bytes)


@dataclass(frozen=True)
class Proof:
    """What was found out about a block.

    Attributes:
        hidden: undeclared attributes and variables, on which the next tick depends.
        undeclared: those that change and did not make a difference here.
        trouble: why nothing is known, or "".
    """

    hidden: tuple[str, ...] = ()
    undeclared: tuple[str, ...] = ()
    trouble: str = ""


def prove(block: Block, states: States) -> Proof:
    """Return whether a block remembers what it declares, and nothing else.

    The states are as before at the end; the block is made fresh.

    Args:
        block: is called; nothing is sent.
        states: that it reads and writes.
    """
    kept = states.snapshot()
    inputs = _inputs(block, states)
    try:
        memory = Memory({block.name: block.tick}, states.buffer)
        for why in memory.unproven.values():
            if why != UNDECLARED:
                return Proof(trouble=why)
        _run(block, states, inputs, range(TICKS))
        middle, remembered = states.snapshot(), memory.take()
        before = _Walker(block.tick, states).places
        first = _run(block, states, inputs, range(TICKS, 2 * TICKS))
        changed = _changed(before, _Walker(block.tick, states).places)
        states.restore(middle)
        memory.put_back(remembered)
        _spoil(changed)
        second = _run(block, states, inputs, range(TICKS, 2 * TICKS))
    except Exception as error:  # a block of somebody's may raise anything
        return Proof(trouble=f"{type(error).__name__}: {error}")
    finally:
        if block.reset is not None:
            block.reset()
        states.restore(kept)
    if first == second:
        return Proof(undeclared=tuple(path for path, (_, a) in changed.items() if a is None))
    return Proof(hidden=tuple(sorted(changed)) or ("something that was not found",))


def _inputs(block: Block, states: States) -> Callable[[int], None]:
    """Return what puts random values where a block reads, the same each time in a tick."""
    names = [*block.reads, *block.amends] or [*states]
    views = [(name, states[name], states[name].copy()) for name in names]

    def put(tick: int) -> None:
        rng = np.random.default_rng((0, tick))
        for name, view, initial in views:
            if view.dtype.kind == "f":
                noise = rng.normal(0.0, 0.05, view.shape)
                view[...] = np.where(np.isfinite(initial), initial, 0.0) + noise
            elif name == "stamp_ns":
                view[...] = (tick + 1) * 5_000_000
            elif view.dtype.kind in "iub" and name != "tick":
                view[...] = rng.integers(0, 2, view.shape)

    return put


def _run(
    block: Block, states: States, inputs: Callable[[int], None], ticks: Sequence[int]
) -> list[Any]:
    """Return what each tick wrote, or raised."""
    found: list[Any] = []
    for tick in ticks:
        inputs(tick)
        try:
            done = bool(block.tick())
            found.append((done, states.buffer.tobytes()))
            if done and block.reset is not None:
                block.reset()
        except Exception as error:  # a safety block on noise: it raises the same again
            found.append(repr(error))
    return found


_Places = dict[str, tuple[Any, Array | None]]
"""Path of what may change to its value, and the array that has it."""


def _changed(before: _Places, after: _Places) -> _Places:
    """Return what differs, with the values before."""
    found = {}
    for path, (value, array) in after.items():
        was, _ = before.get(path, (_Walker, None))  # which is no value
        if value != was:
            found[path] = was, array
    return found


def _spoil(changed: _Places) -> None:
    """Put other numbers where a tick put some, in arrays."""
    for value, array in changed.values():
        if array is None or not array.flags.writeable or not isinstance(value, bytes):
            continue
        was = np.frombuffer(value, array.dtype)
        if was.size == array.size and array.dtype.kind in "fiu":
            moved = was.reshape(array.shape) != array
            array[moved] = np.nan if array.dtype.kind == "f" else 77


class _Walker:
    """What a block can change without declaring it: `places`, by path."""

    def __init__(self, root: Any, states: States) -> None:
        self.places: _Places = {}
        self._states = states.buffer
        self._module = _package(holder_of(root))
        self._todo = deque([("", root)])
        seen = {id(states): states}
        while self._todo and len(seen) < MOST:
            path, value = self._todo.popleft()
            if id(value) not in seen:
                seen[id(value)] = value
                for name, each in self._parts(value, path):
                    self._take(name, each)

    def _take(self, path: str, value: Any) -> None:
        if isinstance(value, np.ndarray):
            if not np.may_share_memory(value, self._states) and not value.dtype.hasobject:
                self.places[path] = value.tobytes(), value
            return
        shown: Any
        if isinstance(value, (*_ATOMS, np.generic, Enum)):
            shown = type(value), repr(value)
        elif isinstance(value, np.random.Generator):
            shown = repr(value.bit_generator.state)
        elif isinstance(value, random.Random):
            shown = value.getstate()
        elif hasattr(type(value), "__next__") and not isinstance(value, GeneratorType):
            shown = repr(value.__reduce__())
        elif hasattr(value, "cache_info"):
            shown = repr(value.cache_info())
        else:
            self._todo.append((path, value))
            if isinstance(value, GeneratorType):
                shown = value.gi_frame and value.gi_frame.f_lasti
            elif isinstance(value, list | dict | set | deque | bytearray):
                shown = len(value)
            else:
                return
        self.places[path] = shown, None

    def _parts(self, value: Any, path: str) -> Iterator[tuple[str, Any]]:
        if isinstance(value, partial):
            yield from _enumerated(path, (value.func, *value.args, *value.keywords.values()))
        elif isinstance(value, MethodType):
            yield path, value.__func__
            yield path, value.__self__
        elif isinstance(value, BuiltinMethodType):
            if not isinstance(value.__self__, ModuleType):
                yield f"{path}.self", value.__self__
        elif isinstance(value, FunctionType):
            yield from self._of_function(value, path)
        elif isinstance(value, GeneratorType):
            if value.gi_frame is not None:
                yield from ((f"{path}.{n}", each) for n, each in value.gi_frame.f_locals.items())
        elif isinstance(value, list | tuple | deque | set | frozenset):
            yield from _enumerated(path, value)
        elif isinstance(value, dict):
            yield from ((f"{path}[{key!r}]", each) for key, each in value.items())
        elif isinstance(value, type) or _package(value) in {self._module, *_OURS}:
            yield from self._of_object(value, path)

    def _of_function(self, function: FunctionType, path: str) -> Iterator[tuple[str, Any]]:
        code = function.__code__
        for name, cell in zip(code.co_freevars, function.__closure__ or ()):
            try:
                yield _joined(path, name), cell.cell_contents
            except ValueError:  # nothing was put into it yet
                continue
        yield from _enumerated(_joined(path, "default"), function.__defaults__ or ())
        yield from ((_joined(path, n), each) for n, each in vars(function).items())
        if _package(function) != self._module:
            return
        for name in _names(code):
            each = function.__globals__.get(name)
            if each is not None and not isinstance(each, ModuleType):
                yield f"global {name}", each

    def _of_object(self, value: Any, path: str) -> Iterator[tuple[str, Any]]:
        kind = value if isinstance(value, type) else type(value)
        own = declared(kind) or ()
        if _package(value) == self._module:
            for base in kind.__mro__[:-1]:
                for name, each in vars(base).items():
                    if not (name.startswith("__") or name == "memory" or hasattr(each, "__set__")):
                        yield f"{base.__name__}.{name}", each
        if isinstance(value, type):
            return
        slots = [s for base in kind.__mro__ for s in vars(base).get("__slots__", ())]
        names = {**getattr(value, "__dict__", {}), **{s: getattr(value, s, None) for s in slots}}
        for name, each in names.items():
            if name not in own or not _plain(each):
                yield _joined(path, name), each


def _joined(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


def _enumerated(path: str, values: Any) -> Iterator[tuple[str, Any]]:
    """Yield elements with their paths."""
    yield from ((f"{path}[{i}]", each) for i, each in enumerate(values))


def _plain(value: Any) -> bool:
    """Return whether a declared attribute is a value, not an object with a memory of its own."""
    if isinstance(value, list | tuple | deque):
        return all(map(_plain, value))
    if isinstance(value, dict):
        return all(map(_plain, value.values()))
    return isinstance(value, (*_ATOMS, np.ndarray, np.generic, np.random.Generator, Enum))


def _names(code: Any) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if hasattr(constant, "co_names"):
            yield from _names(constant)


def _package(value: Any) -> str:
    kind = value if isinstance(value, type | FunctionType) else type(value)
    root = (getattr(kind, "__module__", None) or "").partition(".")[0]
    return "" if root in sys.stdlib_module_names and root != "__main__" else root

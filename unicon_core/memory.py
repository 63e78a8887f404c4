"""Memory: what a tick leaves to the next one, as blocks declare it.

    class Ramp:
        memory = ("_tick", "_held")

A class names the attributes that it carries from tick to tick: numbers, texts, NumPy arrays, lists
and dictionaries of them, generators of random numbers, and objects that declare a memory of their
own. `memory = ()` declares that there is none. Buffers that a tick fills before it reads them are
none either. What lives in another library has two methods instead: `save` returns such values,
`load` takes them. Nothing of this runs in a tick: a snapshot gathers attributes, a restore sets
them.
"""

from __future__ import annotations

import dis
import hashlib
import json
import sys
from collections import deque
from collections.abc import Iterator
from enum import Enum
from functools import lru_cache, partial
from types import BuiltinMethodType, FunctionType, MethodType, ModuleType
from typing import Any, Protocol, runtime_checkable

import numpy as np

from unicon_base import AnyDict, AnyMapping, StateError, one_line
from unicon_base.arrays import UInt8

UNDECLARED = "declares no memory"
"""Reason of `Memory.unproven` for a block that may have one all the same."""

ATOMS = frozenset({type(None), bool, int, float, str})
_WRONG = (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)


@runtime_checkable
class Library(Protocol):
    """An object whose memory lies in another library: a network, a simulator."""

    def save(self) -> Any:
        """Return its memory as numbers, texts, arrays and lists of them."""
        ...

    def load(self, saved: Any) -> None:
        """Continue as the object did that returned `saved`."""
        ...


class Snapshot(AnyDict):
    """Block to what it remembered."""


class Component(AnyDict):
    """The memory of an object that declares one: attribute to value."""


class FromLibrary(list[Any]):
    """What a `Library` saved, in a list of one."""


class GeneratorState(list[Any]):
    """The state of a generator of random numbers, in a list of one."""


class EnumMember(list[str]):
    """Class and name of a member of an enumeration."""


_SAVED = (FromLibrary, GeneratorState, EnumMember)


@lru_cache(maxsize=1024)
def declared(kind: Any) -> tuple[str, ...] | None:
    """Return the attributes that a class and its bases declare; None where none declares any."""
    found = [vars(base)["memory"] for base in kind.__mro__ if "memory" in vars(base)]
    found = [names for names in found if isinstance(names, tuple)]
    return tuple(dict.fromkeys(name for names in found for name in names)) if found else None


def _names_of(holder: Any) -> tuple[str, ...] | None:
    kind: Any = type(holder)
    return declared(kind)


def holder_of(tick: Any) -> Any:
    """Return the object that remembers for a block's function: that of a method, or itself."""
    while isinstance(tick, partial | MethodType):
        tick = tick.func if isinstance(tick, partial) else tick.__self__
    return tick


class Memory:
    """The memory of some blocks.

    Args:
        holders: label to the object of each, or its function.
        states: buffer of the states, for functions that enclose views of it.

    Attributes:
        unproven: block to why its memory is not known: it declares none and may have one, it
            declares what it lacks, or what cannot be saved.
    """

    def __init__(self, holders: AnyMapping, states: UInt8 | None = None) -> None:
        self._holders: AnyDict = {}
        self.unproven: dict[str, str] = {}
        for label, tick in holders.items():
            holder = holder_of(tick)
            try:
                if _declares(holder):
                    self._holders[label] = holder
                elif not _stateless(tick, states):
                    self.unproven[label] = UNDECLARED
            except Exception as error:  # such as of an object that raises when it is looked at
                self.unproven[label] = one_line(error)
        self.take()

    def take(self) -> Snapshot:
        """Return what the blocks remember now, without those of `unproven`; between two ticks."""
        found = Snapshot()
        for label, holder in tuple(self._holders.items()):
            try:
                found[label] = save(holder, label)
            except Exception as error:  # whatever a block raises, the memory of others is kept
                del self._holders[label]
                self.unproven[label] = one_line(error)
        return found

    def put_back(self, snapshot: Snapshot) -> None:
        """Let the blocks continue from a snapshot of theirs, or of blocks that were built alike.

        Blocks that the snapshot lacks keep their memory.

        Raises:
            StateError: the blocks differ; the message says in what, and all remember what they did.
        """
        before = self.take()
        lacking = [label for label in snapshot if label not in self._holders]
        if lacking:
            raise StateError(
                f"the snapshot is of another program: it has a block {lacking[0]!r}, which this "
                f"one lacks; this one has {', '.join(self._holders) or 'none'}"
            )
        try:
            self._load(snapshot)
        except StateError:
            self._load(before)
            raise

    def _load(self, snapshot: Snapshot) -> None:
        for label, saved in snapshot.items():
            try:
                load(self._holders[label], saved, label)
            except _WRONG as error:  # of another library, or of a damaged file
                raise StateError(f"the memory of block {label!r} does not fit: {error}") from error

    @property
    def layout(self) -> dict[str, str]:
        """Attribute, with its block, to type, or dtype and shape."""
        return dict(_layout(self.take()))

    @property
    def hash(self) -> str:
        """SHA-256 of the layout, hexadecimal."""
        return hashlib.sha256(json.dumps(self.layout, sort_keys=True).encode()).hexdigest()


def _declares(holder: Any) -> bool:
    return _names_of(holder) is not None or isinstance(holder, Library)


def _stateless(holder: Any, states: UInt8 | None) -> bool:
    """Return whether an object that declares nothing has nothing to remember with."""
    if isinstance(holder, partial):
        given = (*holder.args, *holder.keywords.values())
        return _stateless(holder.func, states) and all(_fixed(each, states) for each in given)
    if isinstance(holder, MethodType):
        return _stateless(holder.__self__, states)
    if isinstance(holder, FunctionType):
        code = holder.__code__
        rebound = any(
            each.opname == "STORE_DEREF" and each.argval in code.co_freevars
            for each in dis.get_instructions(code)
        )
        enclosed = [cell.cell_contents for cell in holder.__closure__ or ()]
        defaults = (*(holder.__defaults__ or ()), *(holder.__kwdefaults__ or {}).values())
        return not rebound and all(_fixed(each, states) for each in (*enclosed, *defaults))
    return _fixed(holder, states) or not (getattr(holder, "__dict__", True))


def _fixed(value: Any, states: UInt8 | None) -> bool:
    """Return whether a value that a function encloses is a state, a constant or stateless."""
    if isinstance(value, BuiltinMethodType):
        value = value.__self__
    if isinstance(value, np.ndarray):
        return not value.flags.writeable or (
            states is not None and np.may_share_memory(value, states)
        )
    if isinstance(value, tuple | frozenset):
        return all(_fixed(each, states) for each in value)
    if isinstance(value, FunctionType):
        return _stateless(value, states)
    return type(value) in ATOMS or isinstance(value, ModuleType | type | np.generic | np.ufunc)


def save(holder: Any, path: str = "") -> Any:
    """Return what an object remembers that declares it, or is a `Library`."""
    names = _names_of(holder)
    if names is None:
        return FromLibrary([_copied(holder.save(), path)])
    missing = [name for name in names if not hasattr(holder, name)]
    if missing:
        raise StateError(
            f"{path}: {type(holder).__name__}.memory names {missing[0]!r}, which it lacks; it has "
            + (", ".join(vars(holder)) or "no attributes")
        )
    return Component((name, _copied(getattr(holder, name), f"{path}.{name}")) for name in names)


def _copied(value: Any, path: str) -> Any:
    """Return a value that stays as it is when the block goes on."""
    kind = type(value)
    if kind in ATOMS or isinstance(value, np.generic):
        return value
    if kind is np.ndarray and not value.dtype.hasobject:
        return value.copy()
    if kind in (list, tuple, *_SAVED):  # a library may have saved parts of its own by `save`
        return kind(_copied(each, f"{path}[{i}]") for i, each in enumerate(value))
    if kind in (dict, Component):
        return kind((key, _copied(each, f"{path}[{key!r}]")) for key, each in value.items())
    if kind is deque:
        return deque((_copied(each, path) for each in value), value.maxlen)
    if isinstance(value, Enum):
        return EnumMember([kind.__qualname__, value.name])
    if _draws(value):
        return GeneratorState([_copied(value.bit_generator.state, path)])
    if _declares(value):
        return save(value, path)
    raise StateError(
        f"{path} is a {kind.__name__}, which no snapshot can hold; name numbers, arrays and lists "
        f"of them, give {kind.__name__} a memory = (…) of its own, or save and load"
    )


def _draws(value: Any) -> bool:
    """Return whether a value is a generator of random numbers, without importing any."""
    return "numpy.random" in sys.modules and isinstance(value, np.random.Generator)


def load(holder: Any, saved: Any, path: str = "") -> None:
    """Let an object continue from what `save` returned of one that was built alike.

    Raises:
        StateError: it was built otherwise.
    """
    if isinstance(saved, FromLibrary):
        if not isinstance(holder, Library):
            raise _differs(path, "an object that another library holds", holder)
        holder.load(_copied(saved[0], path))
        return
    names = _names_of(holder)
    if not isinstance(saved, Component) or names is None or not set(saved) <= set(names):
        raise _differs(path, ", ".join(saved) if isinstance(saved, dict) else saved, names)
    for name, value in saved.items():
        there = getattr(holder, name)
        new = _into(there, value, f"{path}.{name}")
        if new is not there:
            object.__setattr__(holder, name, new)


def _into(there: Any, saved: Any, path: str) -> Any:
    """Return what an attribute is to be: what is there, changed in place, or a new value."""
    kind = type(saved)
    if kind is np.ndarray:
        if type(there) is not np.ndarray:
            return saved.copy()
        if (there.shape, there.dtype) != (saved.shape, saved.dtype):
            raise _differs(path, _shown(saved), _shown(there))
        there[...] = saved
        return there
    if kind in (Component, FromLibrary):
        if not _declares(there):
            raise _differs(path, "an object", there)
        load(there, saved, path)
        return there
    if kind is GeneratorState:
        if not _draws(there):
            raise _differs(path, "a generator of random numbers", there)
        there.bit_generator.state = saved[0]
        return there
    if kind is EnumMember:
        if not isinstance(there, Enum) or type(there).__qualname__ != saved[0]:
            raise _differs(path, saved[0], there)
        return type(there)[saved[1]]
    if kind in (list, tuple):
        here = list(there) if type(there) is kind and len(there) == len(saved) else []
        here += [None] * (len(saved) - len(here))
        new = [_into(a, b, f"{path}[{i}]") for i, (a, b) in enumerate(zip(here, saved))]
        if kind is list and type(there) is list:
            there[:] = new
            return there
        return kind(new)
    if kind is dict:
        known = there if type(there) is dict else {}
        fresh = {
            key: _into(known.get(key), each, f"{path}[{key!r}]") for key, each in saved.items()
        }
        if known is not there:
            return fresh
        there.clear()
        there.update(fresh)
        return there
    if kind is deque and type(there) is deque and there.maxlen == saved.maxlen:
        there.clear()
        there.extend(_copied(saved, path))
        return there
    return _copied(saved, path)


def _differs(path: str, saved: Any, here: Any) -> StateError:
    return StateError(
        f"the snapshot is of another program: {path} is {saved} in it and {here} here; build the "
        "program of the same workflow, policies and version"
    )


def _layout(value: Any, path: str = "") -> Iterator[tuple[str, str]]:
    if isinstance(value, dict):
        for key, each in value.items():
            yield from _layout(each, f"{path}.{key}" if path else str(key))
    else:
        yield path, _shown(value)


def _shown(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{list(value.shape)}"
    return type(value).__name__.lstrip("_").lower()

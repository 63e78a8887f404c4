"""The walk over what blocks hold: from their functions to every number that a tick may change.

Followed are attributes, what functions enclose and their defaults, bound methods, partial functions
and the elements of lists and dictionaries. Left alone are the states, which are recorded anyway,
and what is not the block's own: modules, classes, networks' runtimes, files, sockets.
"""

from __future__ import annotations

import gc
import sys
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from types import BuiltinMethodType, FunctionType, MethodType, ModuleType
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from unicon_core.memory.attributes import Attributes, attributes_of
from unicon_core.memory.values import ATOMS, NotPlain, copied

__all__ = ["Found", "Keeps", "Key", "walk"]

Array: TypeAlias = NDArray[Any]
Key: TypeAlias = int | str
Path: TypeAlias = str

LARGEST, MOST = 1 << 24, 1 << 14
"""Bytes of an array and elements of a list beyond which it is not kept: the copy would be felt."""
OBJECTS = 4000
"""Objects that are looked into; a block that holds more holds what is not its own."""

_CONTAINERS = (list, dict, set, deque, bytearray)

_FOREIGN = frozenset(
    {
        *("genesis", "jax", "jaxlib", "mujoco", "numpy", "onnxruntime", "pybullet", "quadrants"),
        *("rclpy", "torch", "warp", "zmq"),
    }
)
"""Packages whose objects are not looked into; the standard library's are not either."""


class Keeps(Protocol):
    """What knows best what it remembers: such as a network, whose memory NumPy does not hold."""

    def memory(self) -> Any:
        """Return a value of numbers, texts, arrays and lists of them."""
        ...

    def restore(self, memory: Any) -> None:
        """Be as it was."""
        ...


@dataclass
class Found:
    """What was found.

    Attributes:
        owners: path to what holds values under keys.
        places: path of the owner and key of each value.
        parts: owner, key and the object there, which has parts of its own.
        sizes: dictionaries and lists, and how many elements they had.
        objects: others, and how many objects they refer to.
        keepers: path to objects that say themselves what they remember.
        unkept: paths of iterators, generators and tensors of a device, whose memory cannot be had.
    """

    owners: dict[Path, Any] = field(default_factory=dict)
    places: list[tuple[Path, Key]] = field(default_factory=list)
    parts: list[tuple[Any, Key, Any]] = field(default_factory=list)
    sizes: list[tuple[Any, int]] = field(default_factory=list)
    objects: list[tuple[Any, int]] = field(default_factory=list)
    keepers: dict[Path, Keeps] = field(default_factory=dict)
    unkept: list[Path] = field(default_factory=list)


class _Cells:
    """The variables that a function encloses, by name."""

    def __init__(self, function: FunctionType) -> None:
        self._cells = dict(zip(function.__code__.co_freevars, function.__closure__ or ()))

    def __getitem__(self, name: Key) -> Any:
        return self._cells[str(name)].cell_contents

    def __setitem__(self, name: Key, value: Any) -> None:
        self._cells[str(name)].cell_contents = value

    def items(self, seen: set[int]) -> Iterator[tuple[str, Any]]:
        for name, cell in self._cells.items():
            if id(cell) not in seen:  # functions share them
                seen.add(id(cell))
                try:
                    yield name, cell.cell_contents
                except ValueError:  # nothing was put into it yet
                    continue


def walk(roots: Mapping[str, Any], buffer: Array, leave: Collection[Any]) -> Found:
    """Return what is remembered below some roots.

    Args:
        roots: label to the function of a block.
        buffer: of the states; views of it are left out.
        leave: objects that are not looked into.
    """
    walker = _Walker(buffer)
    walker.seen |= set(map(id, leave))
    for label, root in roots.items():
        walker.todo.append((label, root))
        while walker.todo:
            if len(walker.keep) > OBJECTS:
                walker.found.unkept += sorted({path for path, _ in walker.todo})[:10]
                walker.todo.clear()
                break
            walker.object(*walker.todo.popleft())
    walker.arrays()
    return walker.found


class _Walker:
    def __init__(self, buffer: Array) -> None:
        self.found = Found()
        self.seen: set[int] = set()
        self.todo: deque[tuple[Path, Any]] = deque()  # no recursion: a chain of objects may be long
        self.keep: list[Any] = []  # so that no id is given away meanwhile
        self._states = _span(buffer)
        self._arrays: list[tuple[int, int, Path, Key, Array]] = []

    def value(self, path: Path, owner: Any, key: Key, value: Any) -> None:
        """Take what an owner holds: a value, or an object to go on with."""
        below = f"{path}[{key}]" if isinstance(key, int) else f"{path}.{key}"
        if isinstance(value, np.ndarray):
            self.array(path, key, value, below)
            return
        if isinstance(value, _CONTAINERS):
            if id(value) in self.seen:
                return
            if len(value) > MOST:
                self.found.unkept.append(below)
                return
        try:
            plain = not _holds_array(value)  # each on its own: they may be views of others
            copied(value)
        except (NotPlain, RecursionError):
            plain = False
        if not plain:
            self.found.parts.append((owner, key, value))
            self.todo.append((below, value))
        elif not isinstance(owner, tuple) or isinstance(value, _CONTAINERS):
            if isinstance(value, _CONTAINERS):
                self.seen.add(id(value))
            self.found.places.append((path, key))

    def array(self, path: Path, key: Key, array: Array, below: Path) -> None:
        if id(array) in self.seen or not array.size or array.dtype.hasobject:
            return
        if not array.flags.writeable:
            return  # a constant, or a view of what is found elsewhere
        self.seen.add(id(array))
        begin, end = _span(array)
        if self._states[0] <= begin and end <= self._states[1]:
            return
        if array.nbytes > LARGEST:
            self.found.unkept.append(below)
        else:
            self._arrays.append((begin, end, path, key, array))

    def object(self, path: Path, value: Any) -> None:
        """Go on with an object that has parts."""
        if id(value) in self.seen:
            return
        self.seen.add(id(value))
        self.keep.append(value)
        if isinstance(value, FunctionType):
            cells = _Cells(value)
            self.owner(path, cells, cells.items(self.seen))
            for number, default in enumerate(value.__defaults__ or ()):
                self.fixed(f"{path}.default{number}", default)
            for name, default in (value.__kwdefaults__ or {}).items():
                self.fixed(f"{path}.{name}", default)
        elif isinstance(value, MethodType):
            self.todo.append((path, value.__func__))
            self.todo.append((path, value.__self__))
        elif isinstance(value, BuiltinMethodType):
            if not isinstance(value.__self__, (ModuleType, type)):
                self.fixed(f"{path}.self", value.__self__)
        elif isinstance(value, partial):
            for name in ("func", "args", "keywords"):
                self.fixed(f"{path}.{name}", getattr(value, name))
        elif isinstance(value, memoryview):
            self.fixed(f"{path}.obj", value.obj)
        elif isinstance(value, (list, tuple, deque)):
            self.found.sizes.append((value, len(value)))
            self.owner(path, value, enumerate(list(value)))
        elif isinstance(value, dict):
            self.found.sizes.append((value, len(value)))
            self.owner(path, value, [i for i in value.items() if isinstance(i[0], (int, str))])
        elif isinstance(value, (type, ModuleType)):
            return
        elif _keeps(value):
            self.found.keepers[path] = value
        elif _is_tensor(value):
            try:
                self.fixed(f"{path}.numpy", value.detach().numpy())  # the same memory
            except (RuntimeError, TypeError):  # it lies on a device, or NumPy has no such type
                self.found.unkept.append(path)
        elif hasattr(type(value), "__next__"):
            self.found.unkept.append(path)
        else:
            self.attributes(path, value)

    def fixed(self, path: Path, value: Any) -> None:
        """Take something that nobody can set anew: it is changed in place or not at all."""
        holder = (value,)
        self.keep.append(holder)
        self.owner(path, holder, [(0, value)])

    def attributes(self, path: Path, value: Any) -> None:
        root = type(value).__module__.partition(".")[0]
        if root in _FOREIGN or (root in sys.stdlib_module_names and root != "__main__"):
            return
        names = [
            name
            for kind in type(value).__mro__
            for slots in [kind.__dict__.get("__slots__", ())]
            for name in ([slots] if isinstance(slots, str) else slots)
            if name not in ("__dict__", "__weakref__") and hasattr(value, name)
        ]
        if names:
            slots = Attributes(value)
            self.owner(f"{path}.slots", slots, [(name, slots[name]) for name in names])
        own = None if names else attributes_of(value)
        if own is not None:
            owner: Any = Attributes(value)
            self.found.objects.append((value, len(gc.get_referents(value))))
        else:
            owner = own = getattr(value, "__dict__", None)
            if own is not None:
                self.found.sizes.append((own, len(own)))
        if own:
            fixed = getattr(getattr(value, "__dataclass_params__", None), "frozen", False)
            # Numbers and texts of a frozen one stay as they are.
            items = sorted(own.items(), key=lambda item: str(item[0]))
            items = [item for item in items if not (fixed and _is_atom(item[1]))]
            self.owner(path, owner, items)

    def owner(self, path: Path, owner: Any, items: Iterable[tuple[Key, Any]]) -> None:
        while path in self.found.owners:  # of a method: what its function encloses, and its object
            path += "'"
        self.found.owners[path] = owner
        for key, value in items:
            self.value(path, owner, key, value)

    def arrays(self) -> None:
        """Take each array, but not those that lie within another one."""
        taken = (0, 0)
        for begin, end, path, key, array in sorted(self._arrays, key=lambda a: (a[0], -a[1])):
            if end > taken[1]:
                self.found.places.append((path, key))
                if array.flags.c_contiguous:
                    taken = (begin, end)


def _span(array: Array) -> tuple[int, int]:
    """Return the addresses between which an array lies."""
    begin = end = int(array.__array_interface__["data"][0])
    for length, stride in zip(array.shape, array.strides):
        if stride < 0:
            begin += (length - 1) * stride
        else:
            end += (length - 1) * stride
    return begin, end + array.itemsize


def _keeps(value: Any) -> bool:
    """Return whether an object keeps its own memory; attributes of its own do not count."""
    return all(callable(getattr(type(value), name, None)) for name in ("memory", "restore"))


def _is_atom(value: Any) -> bool:
    return type(value) in ATOMS or (type(value) is tuple and all(map(_is_atom, value)))


def _is_tensor(value: Any) -> bool:
    return type(value).__module__ == "torch" and type(value).__name__ == "Tensor"


def _holds_array(value: Any) -> bool:
    if isinstance(value, (list, tuple, deque)):
        return any(isinstance(each, np.ndarray) or _holds_array(each) for each in value)
    return isinstance(value, dict) and _holds_array(list(value.values()))

"""Operands of C++ twins: arrays by their address, numbers as literals, memory in shared slots.

A twin is a C++ text in which `$path` stands for an attribute of its block and `#path` for the
number of elements of one. Arrays become pointers in one table, so that the same source serves
every program of the same shapes. A number that a block remembers moves into a slot: an array of one
element, which the native code writes and which the block's class reads by a descriptor, so that
snapshots, replay and the Python twin see the same value. The memory of an exported controller is an
`Arena`: many arrays in one piece, as C++ finds them.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import BuiltinMethodType, FunctionType
from typing import Any

import numpy as np

from unicon_base.arrays import Array, UInt8
from unicon_base.errors import WorkflowError
from unicon_core.memory import declared
from unicon_core.states.c_header import TYPES
from unicon_core.states.layout import ALIGNMENT

C_TYPES = {name: kind for name, kind in TYPES.items() if name != "float16"}
"""Type of NumPy to the one of C++ that computes as it does."""

NEVER = (1 << 63) - 1
"""Constant that stands for None: a number of ticks that is never reached."""
UNSET = -(1 << 63)
"""Value of a slot that stands for None."""

_OPERAND = re.compile(r"([$#])([A-Za-z_]\w*(?:\.\w+)*)")


PRELUDE = """
#include <float.h>
#include <stdint.h>

static_assert(FLT_EVAL_METHOD == 0, "float32 has to be computed as float32");
#define each(n) for (int64_t i = 0; i < (int64_t)(n); ++i)
#define DONE(x) return (x) ? 1 : 0
#define finite(x) __builtin_isfinite(x)

template <class T, int64_t S> struct View {
  T* p;
  T& operator[](int64_t i) const { return p[i * S]; }
};

// As NumPy's maximum and minimum: NaN goes through, of two equal numbers the second one counts.
template <class T> static inline T greater(T a, T b) { return a != a ? a : a > b ? a : b; }
template <class T> static inline T lesser(T a, T b) { return a != a ? a : a < b ? a : b; }
// As Python's max and min.
template <class T> static inline T larger(T a, T b) { return b > a ? b : a; }
template <class T> static inline T smaller(T a, T b) { return b < a ? b : a; }
[[maybe_unused]] static inline float magnitude(float x) { return __builtin_fabsf(x); }
[[maybe_unused]] static inline double magnitude(double x) { return __builtin_fabs(x); }

// Of block drive.
[[maybe_unused]] static inline double steady(double value, double dead_zone) {
  double beyond = magnitude(value) - dead_zone;
  if (!(beyond > 0.0)) return 0.0;
  double share = smaller(beyond / (1.0 - dead_zone), 1.0);
  return value > 0.0 ? share : -share;
}

template <class A, class B> static inline bool within(A a, B low, B high, int64_t n) {
  bool holds = true;
  each(n) holds &= a[i] >= low[i] && a[i] <= high[i];
  return holds;
}
"""
"""What stands before the functions of blocks."""

BINDING = """
#include <time.h>

template <class T> static void compare(int way, const T* a, const T* b, T* out, int64_t n) {
  each(n) out[i] = way ? lesser(a[i], b[i]) : greater(a[i], b[i]);
}

extern "C" void unicon_compare(int way, const void* a, const void* b, void* out, int64_t n) {
  if (way < 2) compare(way, (const float*)a, (const float*)b, (float*)out, n);
  else if (way < 4) compare(way - 2, (const double*)a, (const double*)b, (double*)out, n);
  else each(n) ((double*)out)[i] = __builtin_cos(((const double*)a)[i]);
}

// A tick's code and pointers lie together, so that a warm-up can bring them into the caches.
#define CODE __attribute__((section("unicon_code"), noinline))
#define DATA __attribute__((section("unicon_data")))
extern const char __start_unicon_code[], __stop_unicon_code[];
extern const char __start_unicon_data[], __stop_unicon_data[];

DATA static int64_t* v = 0;
DATA static int64_t* T = 0;
// Functions of Python without arguments, which may raise: what they return counts as true or not.
DATA static void **calls = 0, *yes = 0, *no = 0, *(*invoke)(void*) = 0;
DATA static int (*truth)(void*) = 0;
DATA static void (*counted)(void*) = 0, (*dropped)(void*) = 0;
static int64_t call(int64_t n) {
  void* value = invoke(calls[n]);
  if (!value) return -1;
  int holds = truth(value);
  dropped(value);
  return holds;
}
#define FUNCTION(n) \\
  extern "C" CODE void* python_##n(void*, void*) { \\
    int result = n(); \\
    if (result < 0) return 0; \\
    counted(result ? yes : no); \\
    return result ? yes : no; \\
  }

static int touched(const char* p, const char* end) {
  int sum = 0;
  for (; p < end; p += 64) sum += *(const volatile char*)p;
  return sum & 0;
}
static int warm() {
  return touched(__start_unicon_code, __stop_unicon_code) |
         touched(__start_unicon_data, __stop_unicon_data);
}
FUNCTION(warm)

// The clock of time.perf_counter_ns on Linux.
static inline int64_t now() {
  timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}
"""
"""What binds a library to the Python process that has loaded it."""


class NotNative(Exception):
    """A block, or what it uses, has no exact twin; its Python code runs."""


class Slot:
    """Descriptor of a number that a block remembers, which lies in an array of one element."""

    def __init__(self, name: str, kind: type) -> None:
        self.name, self.kind = name, kind

    def __get__(self, owner: Any, _: Any = None) -> Any:
        value = owner.__dict__[self.name].item()
        return None if value == UNSET else self.kind(value)

    def __set__(self, owner: Any, value: Any) -> None:
        owner.__dict__[self.name][0] = UNSET if value is None else value


@dataclass
class Table:
    """What a library points at.

    Attributes:
        arrays: in the order of their addresses in the table.
        declarations: of the pointers, in C++.
        bindings: statements that set them to the addresses.
        moved: objects, their classes and names of the numbers that went into slots.
    """

    arrays: list[Array] = field(default_factory=list)
    declarations: list[str] = field(default_factory=list)
    bindings: list[str] = field(default_factory=list)
    moved: list[tuple[Any, type, str]] = field(default_factory=list)
    _names: dict[tuple[Any, ...], str] = field(default_factory=dict)

    def array(self, values: Array) -> str:
        """Return the name of an array in C++, which is indexed in C order by one number.

        Raises:
            NotNative: its type has none there, or its elements do not stand at equal distances.
        """
        dtype, address = values.dtype, values.__array_interface__["data"][0]
        kind = C_TYPES.get(dtype.name)
        stride = _stride(values)
        if kind is None or not (dtype.isnative and values.flags.aligned and values.size):
            raise NotNative(f"an array of {values.size} {dtype}")
        key = address, kind, stride, values.size
        if key not in self._names:
            name = self._names[key] = f"a{len(self.arrays)}"
            whole = stride == 1
            self.declarations.append(
                f"DATA static {kind}* {name} = 0;"
                if whole
                else f"DATA static View<{kind}, {stride}> {name} = {{0}};"
            )
            self.bindings.append(
                f"{name if whole else name + '.p'} = ({kind}*)t[{len(self.arrays)}];"
            )
            self.arrays.append(values)
        return self._names[key]

    def constants(self, values: Any, dtype: Any) -> str:
        """Return the name of an array of constants."""
        return self.array(np.ascontiguousarray(values, dtype))

    def slot(self, owner: Any, name: str) -> str:
        """Return the C++ of a number that an object remembers, and move it into a slot."""
        kind = type(owner)
        if not isinstance(vars(kind).get(name), Slot):
            value = getattr(owner, name)
            self.moved.append((owner, kind, name))
            if "_slots" not in vars(kind):
                named = {"__module__": kind.__module__, "__qualname__": kind.__qualname__}
                kind = type(kind.__name__, (kind,), named | {"_slots": True})
            setattr(kind, name, Slot(name, int if value is None else type(value)))
            dtype = np.float64 if type(value) is float else np.int64
            owner.__dict__[name] = np.array([UNSET if value is None else value], dtype)
            owner.__class__ = kind
        return f"{self.array(owner.__dict__[name])}[0]"

    def undo(self, first: int = 0) -> None:
        """Give objects their numbers back, from the given place of `moved` on."""
        for owner, kind, name in reversed(self.moved[first:]):
            value = getattr(owner, name)
            delattr(type(owner), name)
            owner.__class__ = kind
            owner.__dict__[name] = value
        del self.moved[first:]

    def expand(self, text: str, holder: Any) -> str:
        """Return a twin's text with its operands in place of `$path` and `#path`.

        Raises:
            NotNative: an operand cannot be had.
        """

        def operand(found: re.Match[str]) -> str:
            sign, path = found.groups()
            *owners, name = path.split(".")
            owner = holder
            for each in owners:
                owner = _part(owner, each)
            value = _part(owner, name)
            if sign == "#":
                return str(np.size(value))
            if isinstance(value, np.ndarray):
                return self.array(value)
            if name in (declared(type(owner)) or ()):  # type: ignore[arg-type]
                if type(value) not in (bool, int, float, type(None)):
                    raise NotNative(f"{path} is a {type(value).__name__}")
                return self.slot(owner, name)
            if isinstance(value, (list, tuple)):
                return self.constants(value, np.int64)
            return literal(value)

        return _OPERAND.sub(operand, text)


def literal(value: Any) -> str:
    """Return a constant in C++, exactly.

    Raises:
        NotNative: it is none.
    """
    if value is None:
        return f"INT64_C({NEVER})"
    if isinstance(value, (bool, np.bool_)):
        return str(int(value))
    if isinstance(value, (int, np.integer)) and UNSET < value <= NEVER:
        return f"INT64_C({value})"
    if isinstance(value, (float, np.float32)):
        number = float(value)
        kind = "float" if isinstance(value, np.float32) else "double"
        if number != number:
            return f'(({kind})__builtin_nan(""))'
        if abs(number) == np.inf:
            return f"(({kind}){'-' if number < 0 else ''}__builtin_inf())"
        return f"(({kind}){number.hex()})"
    raise NotNative(f"a constant {type(value).__name__}")


def _part(owner: Any, name: str) -> Any:
    """Return an attribute, an element of a list, or what a function encloses.

    A bound method of an array of one element, such as `item`, stands for the array.
    """
    if name.isdecimal():
        return owner[int(name)]
    if isinstance(owner, FunctionType):
        cells = zip(owner.__code__.co_freevars, owner.__closure__ or ())
        value: Any = next(cell.cell_contents for each, cell in cells if each == name)
    else:
        value = getattr(owner, name)
    if isinstance(value, BuiltinMethodType):
        value = value.__self__
        if np.size(value) != 1:
            raise NotNative(f"{name} of several robots")
    return value


def _stride(values: Array) -> int:
    """Return the distance of neighbours in elements, in C order."""
    steps = {stride for length, stride in zip(values.shape, values.strides) if length > 1}
    if not steps or values.flags.c_contiguous:
        return 1
    if len(steps) > 1 or min(steps) % values.itemsize or min(steps) <= 0:
        raise NotNative("an array that is not evenly spaced")
    return min(steps) // values.itemsize


class Arena:
    """Places for arrays, each as far from those that it shares bytes with as it is here.

    Args:
        arrays: the first one, which shares bytes with no array before it, lies at the beginning.

    Attributes:
        nbytes: length of all.
    """

    def __init__(self, arrays: Sequence[Array]) -> None:
        self._keep = arrays
        begin = _span(arrays[0])[0]
        joined: list[list[int]] = []
        for first, last in sorted(map(_span, arrays)):
            if joined and first < joined[-1][1]:
                joined[-1][1] = max(joined[-1][1], last)
            else:
                joined.append([first, last])
        self.nbytes = 0
        self._places: list[tuple[int, int, UInt8]] = []  # address, offset, bytes
        for first, last in sorted(joined, key=lambda each: each[0] != begin):
            at = self.nbytes + (first - begin - self.nbytes) % ALIGNMENT
            data = (ctypes.c_uint8 * (last - first)).from_address(first)
            self._places.append((first, at, np.ctypeslib.as_array(data)))
            self.nbytes = at + last - first

    def at(self, array: Array) -> str:
        """Return where an array of them begins, in C++."""
        first = _span(array)[0]
        places = (at + first - a for a, at, data in self._places if a <= first < a + data.size)
        return f"arena.memory + {next(places)}"

    def content(self) -> UInt8:
        """Return all bytes as they are now, zero between the places."""
        content = np.zeros(self.nbytes, np.uint8)
        for _, at, data in self._places:
            content[at : at + data.size] = data
        return content

    def effect(self, function: Callable[[], object], name: str) -> str:
        """Return statements that write what a function writes, whatever there was before.

        Raises:
            WorkflowError: that depends on what there was.
        """
        before = self.content()
        fill = np.random.default_rng(0).integers(0, 256, before.size, np.uint8)
        written, after = np.zeros(before.size, bool), []
        for values in (fill, ~fill):
            self._write(values)
            filled = self.content()
            try:
                function()
                after.append(self.content())
            finally:
                self._write(before)
            written |= after[-1] != filled
        if (after[0] != after[1])[written].any():
            raise WorkflowError(f"{name} depends on memory, which C++ cannot repeat; leave it out")
        lines = []
        (places,) = written.nonzero()
        for run in np.split(places, np.flatnonzero(np.diff(places) != 1) + 1):
            if not run.size:
                break
            said = ", ".join(map(str, after[0][run]))
            lines.append(f"{{ static const uint8_t x[] = {{{said}}}; ")
            lines.append(f"__builtin_memcpy(arena.memory + {run[0]}, x, sizeof x); }}")
        return "\n".join(lines)

    def _write(self, content: UInt8) -> None:
        for _, at, data in self._places:
            data[...] = content[at : at + data.size]


def _span(array: Array) -> tuple[int, int]:
    """Return the addresses of an array's first byte and behind its last one."""
    first = array.__array_interface__["data"][0]
    reach = sum((n - 1) * stride for n, stride in zip(array.shape, array.strides))
    return first, first + reach + array.itemsize

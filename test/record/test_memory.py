"""Memory: every kind of block goes on in a fresh program as it would have in the old one."""

from __future__ import annotations

import functools
import itertools
import json
import math
import random
import sys
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from unicon_core.errors import StateError
from unicon_core.memory import Memory, from_json, to_json
from unicon_core.memory.attributes import attributes_of
from unicon_core.memory.values import copied
from unicon_core.states import States, StateSpec

KINDS = ("bool", "int8", "uint16", "int64", "float32", "float64", "complex128")
ARRAYS = st.sampled_from(KINDS).flatmap(
    lambda kind: hnp.arrays(kind, hnp.array_shapes(min_side=0, max_side=3))
)
ATOMS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(),
    st.binary(),
    st.complex_numbers(),
)
VALUES = st.recursive(
    st.one_of(
        ATOMS,
        ARRAYS,
        hnp.scalar_dtypes().flatmap(hnp.from_dtype).filter(lambda s: s.dtype.kind in "biufc"),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.tuples(inner, inner),
        st.dictionaries(st.text(max_size=3), inner, max_size=3),
        st.lists(inner, max_size=3).map(lambda each: deque(each, 4)),
    ),
    max_leaves=6,
)


def bits(value: Any) -> Any:
    """Return what is equal for equal bits only: NaN too, and 1 is not 1.0 nor True."""
    if isinstance(value, (np.ndarray, np.generic)):
        array = np.asarray(value)
        return type(value), array.dtype, array.shape, array.tobytes()
    if isinstance(value, complex):
        return "complex", bits(value.real), bits(value.imag)
    if isinstance(value, float):
        return "float", "nan" if math.isnan(value) else value.hex()
    if isinstance(value, dict):
        return "dict", [(bits(k), bits(v)) for k, v in value.items()]
    if isinstance(value, (list, tuple, deque)):
        return type(value), getattr(value, "maxlen", None), [bits(each) for each in value]
    return type(value), value


@settings(max_examples=50)
@given(VALUES)
def test_a_value_is_the_same_to_the_bit_after_json(value: Any) -> None:
    text = json.dumps(to_json(copied(value)))
    assert bits(from_json(json.loads(text))) == bits(value)


@pytest.mark.parametrize(
    "text",
    [
        '{"eval": 1}',
        '{"array": {"dtype": "O", "shape": [1], "data": "AAAAAAAAAAA="}}',
        '{"array": {"dtype": "<f4", "shape": [3], "data": "AA"}}',
        '{"list": 3}',
        "[1]",
        "{}",
    ],
)
def test_what_is_not_a_memory_is_refused(text: str) -> None:
    with pytest.raises(StateError, match="not a memory of blocks"):
        from_json(json.loads(text))


class Mode(Enum):
    REST = 0
    MOVE = 1


@dataclass
class Filter:
    """An object that a block holds."""

    gain: float
    last: Any = None


class Slotted:
    __slots__ = ("count", "history")

    def __init__(self) -> None:
        self.count = 0
        self.history = np.zeros(4)


class Everything:
    """A block that remembers in every way there is."""

    def __init__(self, states: States) -> None:
        self.states, self.out = states, states["out"]
        self.count, self.mode = 0, Mode.REST
        self.ring = np.zeros((4, 3))
        self.rows = [(self.ring[i], memoryview(self.ring[i]).cast("B")) for i in range(4)]
        self.queue: deque[float] = deque(maxlen=3)
        self.seen: dict[str, list[int]] = {}
        self.filters = [Filter(0.5), Filter(0.25)]
        self.slotted = Slotted()
        self.noise, self.dice = np.random.default_rng(1), random.Random(2)
        self.maybe: tuple[float, ...] | None = None
        self.raw = bytearray(4)
        self.enclosed = enclosing()
        self.bound = self.slotted.history.dot
        self.later: Any

    def __call__(self) -> None:
        self.count += 1
        self.mode = Mode.MOVE if self.count % 3 == 0 else Mode.REST
        row, raw = self.rows[self.count % 4]
        row += self.noise.normal(size=3)
        raw[:8] = self.ring[0, :1].tobytes()
        self.queue.append(self.dice.random())
        self.seen.setdefault(str(self.count % 5), []).append(self.count)
        for each in self.filters:
            each.last = np.full(2, self.count) if each.last is None else each.last * each.gain + 1
        self.slotted.count += 2
        self.slotted.history[self.count % 4] = self.count
        self.maybe = (*(self.maybe or ())[-3:], float(self.count))
        self.raw[self.count % 4] ^= self.count & 0xFF
        self.later = self.count if not hasattr(self, "later") else self.later * 2 % 1000
        self.out[:] = self.told()

    def told(self) -> Any:
        return (
            self.count + self.mode.value,
            self.ring.sum() + sum(self.queue) + sum(map(len, self.seen.values())),
            sum(float(each.last.sum()) for each in self.filters) + self.enclosed(),
            self.slotted.count + self.bound(np.ones(4)) + sum(self.maybe or ()),
            sum(self.raw) + self.later,
        )


def enclosing(start: list[float] | None = None) -> Callable[[], float]:
    total, steps = 0.0, [0, 0] if start is None else start

    def add() -> float:
        nonlocal total
        total += 0.1
        steps[0] += 1
        return total + steps[0]

    return add


def built() -> tuple[Everything, Memory]:
    states = States({"out": StateSpec((5,), "float64")})
    block = Everything(states)
    return block, Memory({"block": block}, states)


@pytest.mark.parametrize("before", [0, 1, 7, 40])
def test_a_block_that_remembers_in_every_way_goes_on_alike(before: int) -> None:
    old, memory = built()
    for _ in range(before):
        old()
    content = json.loads(json.dumps(memory.take().content()))
    assert content["unkept"] == []
    new, other = built()
    for _ in range(3):  # it need not be untouched
        new()
    if before == 0:
        new, other = built()
    other.restore(content)
    for _ in range(20):
        old()
        new()
        assert old.out.tobytes() == new.out.tobytes()


def test_what_was_taken_does_not_change_when_the_block_goes_on() -> None:
    block, memory = built()
    block()
    taken = memory.take()
    before = json.dumps(taken.content())
    for _ in range(5):
        block()
    assert json.dumps(taken.content()) == before


def test_states_are_left_out_and_a_large_array_is_taken_once() -> None:
    states = States({"out": StateSpec((5,), "float64")})
    array = np.zeros((100, 3))
    views = [array[i] for i in range(100)]
    content = Memory({"a": lambda: (states["out"], array, views)}, states).take().content()
    assert [
        pair for pairs in content["owners"].values() for pair in pairs if pair[0] != "array"
    ] == []


def test_what_cannot_be_kept_is_named() -> None:
    states = States({"out": StateSpec((5,))})
    counter, steps, huge = itertools.count(), (i for i in range(3)), list(range(1 << 15))
    content = Memory({"a": lambda: (next(counter), next(steps), huge)}, states).take().content()
    assert sorted(content["unkept"]) == ["a.counter", "a.huge", "a.steps"]


def test_tensors_are_kept_as_the_memory_that_they_share() -> None:
    class Tensor:  # as torch's, which need not be installed
        def __init__(self, array: Any) -> None:
            self.array = array

        def detach(self) -> Tensor:
            return self

        def numpy(self) -> Any:
            if self.array is None:
                raise TypeError("it lies on a device")
            return self.array

    Tensor.__module__ = "torch"
    states = States({"out": StateSpec((5,))})
    tensors = [Tensor(np.arange(3.0)), Tensor(None)]
    content = Memory({"a": lambda: tensors}, states).take().content()
    assert content["unkept"] == ["a.tensors[1]"]
    tensors[0].array[:] = 7.0
    Memory({"a": lambda: tensors}, states).restore(content)
    assert tensors[0].array.tolist() == [0.0, 1.0, 2.0]


def test_a_long_chain_of_objects_and_one_that_holds_too_much_are_no_trouble() -> None:
    first: Any = Filter(1.0)
    for _ in range(10_000):
        first = Filter(1.0, first)
    unkept = Memory({"a": first}, States({"out": StateSpec((5,))})).take().content()["unkept"]
    assert unkept
    assert unkept[0].startswith("a.last")


def test_an_object_that_was_exchanged_is_found_anew() -> None:
    states = States({"out": StateSpec((5,))})
    holder = Filter(1.0, Filter(2.0, 3.0))
    memory = Memory({"a": holder}, states)
    holder.last = Filter(5.0, 7.0)
    values = memory.take().content()["owners"]["a.last"]
    assert values == [["gain", 5.0], ["last", 7.0]]


def test_the_memory_of_another_block_is_refused() -> None:
    states = States({"out": StateSpec((5,))})
    content = Memory({"a": Filter(1.0, Filter(2.0))}, states).take().content()
    with pytest.raises(StateError, match=r"the memory is of other blocks \(a.last\)"):
        Memory({"a": Filter(1.0)}, states).restore(content)
    with pytest.raises(StateError, match="not a memory"):
        Memory({"a": Filter(1.0)}, states).restore({"owners": 3})


class Asked:
    """Attributes that its methods name, and a property that must not be asked."""

    def __init__(self) -> None:
        self.one, self.two, self.__three = 1, None, [3]

    @property
    def trap(self) -> int:
        raise RuntimeError("asked")

    @functools.cached_property
    def late(self) -> int:
        raise RuntimeError("asked")

    def tick(self) -> None:
        self.four = [self.__three]


def test_attributes_are_found_without_the_dictionary() -> None:
    asked = Asked()
    if sys.version_info >= (3, 11):
        assert attributes_of(asked) == {"one": 1, "two": None, "_Asked__three": [3]}
        asked.tick()
        found = attributes_of(asked)
        assert found is not None
        assert found["four"] == [[3]]
        assert found == vars(asked)


def test_where_not_all_are_found_it_is_the_dictionary() -> None:
    class Default:
        count = 0

        def __init__(self) -> None:
            self.count = Default.count  # the class's own value: nobody can tell whose it is

    class Strange:
        def __getattr__(self, name: str) -> int:
            return 7

    given = Asked()
    setattr(given, "from outside", 5)
    states = States({"out": StateSpec((5,))})
    for each in (given, Default(), Strange()):
        assert attributes_of(each) is None
    content = Memory({"a": given}, states).take().content()
    assert ["from outside", 5] in content["owners"]["a"]


class Compiled:
    """As a function of Cython: its class has a descriptor in the place of annotations."""

    __annotations__ = property(lambda self: {})  # type: ignore[assignment]

    def __call__(self) -> None:
        return


def test_what_has_no_plain_annotations_is_looked_into() -> None:
    class Holder:
        def __init__(self) -> None:
            self.solve, self.count = Compiled(), 3

        def __call__(self) -> None:
            self.count += 1
            self.solve()

    holder = Holder()
    memory = Memory({"it": holder}, States({"x": StateSpec(())}))
    taken = memory.take()
    holder()
    memory.restore(taken.content())
    assert holder.count == 3

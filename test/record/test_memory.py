"""Memory: what blocks declare is all that they remember, and it comes back bit-exact."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections import deque
from collections.abc import Callable
from enum import Enum
from functools import cached_property, partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from unicon_base.errors import StateError
from unicon_core.check.memory_proof import prove
from unicon_core.flow import Block
from unicon_core.memory import Memory, Snapshot
from unicon_core.states import States, StateSpec
from unicon_lab.recording.ticks import changes, from_json, to_json

KINDS = ("bool", "int8", "uint16", "int64", "float32", "float64", "complex128")
ARRAYS = st.sampled_from(KINDS).flatmap(
    lambda kind: hnp.arrays(kind, hnp.array_shapes(min_side=0, max_side=3))
)
ATOMS = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text())
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
    if isinstance(value, float):
        return "float", "nan" if math.isnan(value) else value.hex()
    if isinstance(value, dict):
        return "dict", [(bits(k), bits(v)) for k, v in value.items()]
    if isinstance(value, (list, tuple, deque)):
        return type(value), getattr(value, "maxlen", None), [bits(each) for each in value]
    return type(value), value


@settings(max_examples=50)
@given(VALUES)
def test_a_value_is_bit_exact_after_json(value: Any) -> None:
    text = json.dumps(to_json(value))
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


class Filter:
    """A component that declares a memory of its own."""

    memory = ("last",)

    def __init__(self, gain: float) -> None:
        self.gain = gain
        self.last: Any = None


class Elsewhere:
    """As a network of another library."""

    def __init__(self) -> None:
        self._hidden = [0.0]

    def step(self) -> float:
        self._hidden[0] = 0.5 * self._hidden[0] + 1.0
        return self._hidden[0]

    def save(self) -> Any:
        return list(self._hidden)

    def load(self, saved: Any) -> None:
        self._hidden[:] = saved


class Everything:
    """A block that remembers in every way that can be declared."""

    memory = ("count", "mode", "ring", "queue", "seen", "filters", "noise", "maybe", "network")

    def __init__(self, states: States) -> None:
        self.out = states["out"]
        self.count, self.mode = 0, Mode.REST
        self.ring = np.zeros((4, 3))
        self.rows = [(self.ring[i], memoryview(self.ring[i]).cast("B")) for i in range(4)]
        self.queue: deque[float] = deque(maxlen=3)
        self.seen: dict[str, list[int]] = {}
        self.filters = [Filter(0.5), Filter(0.25)]
        self.noise = np.random.default_rng(1)
        self.maybe: tuple[float, ...] | None = None
        self.network = Elsewhere()
        self.scratch = np.zeros(3)

    def __call__(self) -> None:
        self.count += 1
        self.mode = Mode.MOVE if self.count % 3 == 0 else Mode.REST
        row, raw = self.rows[self.count % 4]
        self.scratch[:] = self.noise.normal(size=3)
        row += self.scratch
        raw[:8] = self.ring[0, :1].tobytes()
        self.queue.append(float(self.noise.random()))
        self.seen.setdefault(str(self.count % 5), []).append(self.count)
        for each in self.filters:
            each.last = (
                np.full(2, 1.0 * self.count) if each.last is None else each.last * each.gain + 1
            )
        self.maybe = (*(self.maybe or ())[-3:], float(self.count))
        self.out[:] = (
            self.count + self.mode.value,
            self.ring.sum() + sum(self.queue) + sum(map(len, self.seen.values())),
            sum(float(each.last.sum()) for each in self.filters),
            sum(self.maybe or ()),
            self.network.step(),
        )


def built() -> tuple[Everything, States, Memory]:
    states = States({"out": StateSpec((5,), "float64")})
    block = Everything(states)
    return block, states, Memory({"block": block}, states.buffer)


def through_json(snapshot: Snapshot) -> Snapshot:
    read: Snapshot = from_json(json.loads(json.dumps(to_json(snapshot))))
    return read


@pytest.mark.parametrize("before", [0, 1, 7, 40])
def test_a_block_that_remembers_in_every_way_goes_on_alike(before: int) -> None:
    old, _, memory = built()
    for _ in range(before):
        old()
    snapshot = through_json(memory.take())
    new, _, other = built()
    for _ in range(3):  # it need not be untouched
        new()
    other.put_back(snapshot)
    for _ in range(20):
        old()
        new()
        assert old.out.tobytes() == new.out.tobytes()


def test_a_snapshot_does_not_change_when_the_block_goes_on() -> None:
    block, _, memory = built()
    block()
    snapshot = memory.take()
    before = json.dumps(to_json(snapshot))
    for _ in range(5):
        block()
    assert json.dumps(to_json(snapshot)) == before
    memory.put_back(snapshot)
    block()  # nor what is put back
    assert json.dumps(to_json(snapshot)) == before


def test_nan_and_infinity_come_back() -> None:
    block, _, memory = built()
    block.filters[0].last = np.array([math.nan, -math.inf])
    block.maybe = (math.nan, math.inf)
    snapshot = through_json(memory.take())
    block.filters[0].last, block.maybe = None, None
    memory.put_back(snapshot)
    assert np.isnan(block.filters[0].last[0])
    assert block.maybe is not None
    assert math.isnan(block.maybe[0])


def test_only_changes_are_restored_into_blocks_with_other_options() -> None:
    old, _, memory = built()
    fresh = memory.take()
    old()
    found = changes(memory.take(), fresh)["block"]
    assert "count" in found
    assert not changes(memory.take(), memory.take())


# -- declarations ----------------------------------------------------------------------------------


def holding(**attributes: Any) -> Any:
    """Return an object that declares its attributes."""
    made = type("Holder", (), {"memory": tuple(attributes), "__call__": lambda self: None})()
    vars(made).update(attributes)
    return made


def test_what_is_declared_and_lacking_is_named() -> None:
    made = holding(one=1)
    del made.one
    made.two = 2
    (why,) = Memory({"a": made, "b": holding(n=1)}).unproven.values()
    assert why == "a: Holder.memory names 'one', which it lacks; it has two"


def test_what_no_snapshot_can_hold_is_named_with_the_remedy() -> None:
    (why,) = Memory({"a": holding(it=[object()])}).unproven.values()
    assert re.fullmatch(r"a\.it\[0\] is a object, .* memory = .* save and load", why)


def test_the_snapshot_of_another_program_is_refused_with_what_differs() -> None:
    memory = Memory({"a": holding(x=np.zeros(3), n=1)})
    with pytest.raises(StateError, match=r"a\.x is float64\[4\] in it and float64\[3\] here"):
        memory.put_back(Memory({"a": holding(x=np.zeros(4), n=1)}).take())
    with pytest.raises(StateError, match=r"it has a block 'b', which this one lacks"):
        memory.put_back(Memory({"b": holding(x=np.zeros(3))}).take())
    two = Memory({"a": holding(x=np.zeros(3), n=1), "b": holding(y=np.zeros(2))})
    other = Memory({"a": holding(x=np.ones(3), n=7), "b": holding(y=np.zeros(9))})
    with pytest.raises(StateError, match=r"b\.y is float64\[9\] in it"):
        two.put_back(other.take())
    assert two.take()["a"]["n"] == 1  # all of it or nothing
    with pytest.raises(StateError, match=r"a is x, z in it"):
        memory.put_back(Memory({"a": holding(x=np.zeros(3), z=1)}).take())
    assert memory.hash != Memory({"a": holding(x=np.zeros(4), n=1)}).hash
    assert memory.hash == Memory({"a": holding(x=np.ones(3), n=7)}).hash


# -- proof -----------------------------------------------------------------------------------------


class Hides:
    """A block whose count is an attribute that it does not declare."""

    memory = ("declared",)

    def __init__(self, x: Any, y: Any) -> None:
        self.x, self.y, self.declared, self.count = x, y, 0.0, 0

    def __call__(self) -> None:
        self.declared = 0.5 * self.declared + float(self.x[0])
        self.count += 1
        self.y[:] = self.declared + self.count


def in_closure(x: Any, y: Any) -> Callable[[], None]:
    total = 0.0

    def tick() -> None:
        nonlocal total
        total += float(x[0])
        y[:] = total

    return tick


def in_closed_list(x: Any, y: Any) -> Callable[[], None]:
    steps = [0]

    def tick() -> None:
        steps[0] += 1
        y[:] = steps[0] + x

    return tick


COUNT = 0


def in_global(x: Any, y: Any) -> Callable[[], None]:
    def tick() -> None:
        global COUNT
        COUNT += 1
        y[:] = COUNT

    return tick


class OfClass:
    total = 0.0

    def __init__(self, x: Any, y: Any) -> None:
        self.x, self.y = x, y

    def __call__(self) -> None:
        type(self).total += 1.0
        self.y[:] = self.total


def in_generator(x: Any, y: Any) -> Callable[[], None]:
    steps = (i * i for i in range(1000))

    def tick() -> None:
        y[:] = next(steps)

    return tick


def in_iterator(x: Any, y: Any) -> Callable[[], None]:
    counter = itertools.count()

    def tick() -> None:
        y[:] = next(counter)

    return tick


class Cached:
    """Remembers the input of its first tick; each restart of the property counts."""

    memory = ()

    def __init__(self, x: Any, y: Any) -> None:
        self.x, self.y = x, y

    @cached_property
    def first(self) -> list[float]:
        return [float(self.x[0])]

    def __call__(self) -> None:
        self.first.append(float(self.x[0]))
        self.y[:] = sum(self.first)


class InArray:
    memory = ()

    def __init__(self, x: Any, y: Any) -> None:
        self.x, self.y, self.filtered = x, y, np.zeros(2)

    def __call__(self) -> None:
        self.filtered *= 0.9
        self.filtered += self.x
        self.y[:] = self.filtered


@pytest.mark.parametrize(
    ("make", "path"),
    [
        (Hides, "count"),
        (in_closure, "total"),
        (in_closed_list, "steps[0]"),
        (in_global, "global COUNT"),
        (OfClass, "OfClass.total"),
        (in_generator, "steps"),
        (in_iterator, "counter"),
        (Cached, "first"),
        (InArray, "filtered"),
    ],
)
def test_memory_that_a_block_hides_is_named(make: Callable[..., Any], path: str) -> None:
    states = States({"x": StateSpec((2,)), "y": StateSpec((2,))})
    proof = prove(Block("it", make(states["x"], states["y"]), ("x",), ("y",)), states)
    assert not proof.trouble
    assert any(each.startswith(path) for each in proof.hidden), proof


def test_scratch_and_constants_are_no_memory() -> None:
    class Scratch:
        memory = ()

        def __init__(self, x: Any, y: Any) -> None:
            self.x, self.y, self.work, self.gain = x, y, np.zeros(2), 3.0

        def __call__(self) -> None:
            np.multiply(self.x, self.gain, out=self.work)
            self.y[:] = self.work

    states = States({"x": StateSpec((2,)), "y": StateSpec((2,))})
    before = states.buffer.tobytes()
    proof = prove(Block("it", Scratch(states["x"], states["y"]), ("x",), ("y",)), states)
    assert (proof.hidden, proof.undeclared, proof.trouble) == ((), (), "")
    assert states.buffer.tobytes() == before


def test_a_function_of_states_alone_needs_no_declaration_and_others_do() -> None:
    states = States({"x": StateSpec((2,)), "y": StateSpec((2,))})
    x, y = states["x"], states["y"]

    def plain() -> None:
        y[:] = 2.0 * x

    def later(seen: list[float] = []) -> None:  # noqa: B006
        seen.append(float(x[0]))

    ticks = {"plain": plain, "closure": in_closure(x, y), "list": in_closed_list(x, y)}
    ticks |= {"default": later, "partial": partial(later, [0.0])}
    memory = Memory({**ticks, "object": OfClass(x, y), "declared": Hides(x, y)}, states.buffer)
    assert memory.unproven == dict.fromkeys(
        ["closure", "list", "default", "partial", "object"], "declares no memory"
    )

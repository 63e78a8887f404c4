"""Fused maps against the same maps as separate blocks: same bytes, fewer operations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_base.errors import StateError
from unicon_core.blocks.maps import copy, linear_map
from unicon_core.flow import Block, Chain, Deferred, Every, Loop, When, Zip, as_block, compile_graph
from unicon_core.flow.block import LinearMap
from unicon_core.flow.fuse import fuse
from unicon_core.states import States, StateSpec

DTYPES = ("float32", "float64", "int64")


def make_states(num_robots: int | None) -> States:
    specs = {f"{dtype}_{i}": StateSpec((6,), dtype) for dtype in DTYPES for i in range(5)}
    states = States(specs, num_robots)
    random = np.random.default_rng(1)
    for name in states:
        states[name][...] = np.round(random.normal(0, 9, states[name].shape))
    states["float32_0"][..., 0] = -0.0
    return states


maps = st.fixed_dictionaries(
    {
        "dtype": st.sampled_from(DTYPES),
        "source": st.tuples(st.integers(0, 4), st.integers(0, 5), st.sampled_from([1, 2, -1])),
        "target": st.tuples(st.integers(0, 4), st.integers(0, 5), st.sampled_from([1, 2, -1])),
        "length": st.integers(1, 3),
        "index": st.none() | st.lists(st.integers(0, 2), min_size=3, max_size=3),
        "scale": st.none() | st.sampled_from([0.5, -3.0]),
        "offset": st.none() | st.sampled_from([0.0, 1.25]),
        "other": st.sampled_from([None, None, None, "reset", "plain"]),
    }
)


def view(states: States, dtype: str, place: tuple[int, int, int], length: int) -> Any:
    number, start, step = place
    start = min(start, 6 - length * 2) if step == 2 else start
    whole = states[f"{dtype}_{number}"]
    cut = whole[..., ::-1] if step == -1 else whole
    return cut[..., min(start, 6 - length) :: abs(step)][..., :length]


def make_block(states: States, given: dict[str, Any]) -> Block:
    dtype = given["dtype"]
    target = view(states, dtype, given["target"], given["length"])
    source = view(states, dtype, given["source"], given["length"])
    linear = dtype != "int64"
    index = given["index"]
    if index is not None:
        index = [i % given["length"] for i in index[: given["length"]]]
    scale = given["scale"]
    if scale is not None and given["length"] > 1:
        scale = np.linspace(scale, 2.0, given["length"])
    made = LinearMap(
        source, target, index, scale if linear else None, given["offset"] if linear else None
    )
    block = Block("map", made, linear=made, endless=True)
    if given["other"] == "reset":
        block.reset = lambda: None
    if given["other"] == "plain":
        block.linear = None
    return block


@settings(max_examples=400)
@given(st.lists(maps, min_size=1, max_size=9), st.sampled_from([None, 1, 3]))
def test_fused_maps_leave_the_same_bytes(described: list[Any], num_robots: int | None) -> None:
    one, other = make_states(num_robots), make_states(num_robots)
    plain = Zip(*[make_block(one, each) for each in described])
    fused = fuse(Zip(*[make_block(other, each) for each in described]), other)
    slow, fast = compile_graph(plain), compile_graph(fused)
    assert isinstance(fused, Zip)
    for _ in range(3):
        slow.step()
        fast.step()
        assert one.buffer.tobytes() == other.buffer.tobytes()
        for block in fused.children:  # the interpreted form does the same as the inlined one
            assert isinstance(block, Block)
            assert not block.tick()
        slow.step()
        assert one.buffer.tobytes() == other.buffer.tobytes()


def copies(states: States, pairs: list[tuple[str, str]], **options: Any) -> list[Block]:
    made = [
        LinearMap(states[source], states[target], source_name=source, **options)
        for source, target in pairs
    ]
    return [
        Block(f"to_{pair[1]}", m, (pair[0],), (pair[1],), linear=m, endless=True)
        for pair, m in zip(pairs, made)
    ]


def many(number: int = 16, size: int = 20) -> States:
    return States({f"{s}{i}": StateSpec((size,)) for s in "ab" for i in range(number)})


def test_sixteen_neighbouring_copies_become_one_slice_copy() -> None:
    states = many()
    blocks = copies(states, [(f"a{i}", f"b{i}") for i in range(16)])
    fused = fuse(Zip(*blocks), states)
    assert isinstance(fused, Zip)
    (block,) = fused.children
    assert isinstance(block, Block)
    assert block.inline.count("\n") == 0
    assert block.inline.count("[:] =") == 1
    assert block.name == "to_b0 … to_b15 (16 fused)"
    assert block.reads == tuple(f"a{i}" for i in range(16))
    assert block.writes == tuple(f"b{i}" for i in range(16))


def test_neighbouring_linear_maps_become_one_gather() -> None:
    states = many()
    blocks = copies(
        states,
        [(f"a{15 - i}", f"b{i}") for i in range(16)],
        scale=2.0,
        offset=1.0,
        index=np.arange(20)[::-1],
    )
    fused = fuse(Zip(*blocks), states)
    assert isinstance(fused, Zip)
    (block,) = fused.children
    assert isinstance(block, Block)
    assert [line.split("0")[0][:3] for line in block.inline.splitlines()] == ["tak", "mul", "add"]
    states.buffer_of("float32")[:320] = np.arange(320)
    compile_graph(fused).step()
    assert states.b0.tolist() == [2.0 * x + 1.0 for x in range(319, 299, -1)]


def test_nested_zips_of_maps_are_fused_with_their_neighbours() -> None:
    states = many(4)
    a, b, c, d = copies(states, [(f"a{i}", f"b{i}") for i in range(4)])
    fused = fuse(Zip(a, Zip(b, c), d), states)
    assert isinstance(fused, Zip)
    assert len(fused.children) == 1


def test_a_block_between_two_maps_keeps_them_apart() -> None:
    states = many(2)
    a, b = copies(states, [("a0", "b0"), ("a1", "b1")])
    tree = Zip(a, lambda: False, b)
    assert fuse(tree, states) is tree


def test_a_map_that_reads_what_the_one_before_writes_stays_behind_it() -> None:
    states = many(3)
    a, b = copies(states, [("a0", "b0"), ("b0", "b1")])
    states.a0 = 3.0
    tree = Zip(a, b)
    assert fuse(tree, states) is tree
    compile_graph(tree).step()
    assert (states.b1 == 3.0).all()


def test_maps_are_fused_wherever_a_zip_stands() -> None:
    states = many(2)
    pair = copies(states, [("a0", "b0"), ("a1", "b1")])
    inner = Zip(*pair)
    tree = Chain(Loop(inner), Every(2, When(lambda: True, inner)), Deferred(inner), lambda: True)
    fused = fuse(tree, states)
    assert isinstance(fused, Chain)
    (loop, every, deferred, _) = fused.children
    assert isinstance(loop, Loop)
    assert isinstance(every, Every)
    assert isinstance(every.child, When)
    assert isinstance(deferred, Deferred)
    assert isinstance(loop.child, Zip)
    assert len(loop.child.children) == 1
    assert loop.child is every.child.child is deferred.child  # shared nodes stay shared
    assert len(inner.children) == 2  # the given tree stays as it is


def test_maps_outside_the_states_stay_alone() -> None:
    states = many(2)
    outside = LinearMap(np.zeros(20, np.float32), states["b1"])
    (a,) = copies(states, [("a0", "b0")])
    tree = Zip(a, Block("in", outside, linear=outside, endless=True))
    assert fuse(tree, states) is tree


def test_a_map_is_a_block_that_says_what_it_is() -> None:
    states = many(2)
    block = as_block(LinearMap(states["a0"], states["b0"], np.arange(20), source_name="a0"))
    assert block.linear is block.tick
    assert block.linear.is_copy
    assert block.linear.index is None
    assert block.endless
    assert (block.reads, block.writes) == (("a0",), ())


def test_maps_of_other_types_are_cast_and_stay_alone() -> None:
    states = make_states(None)
    whole, real = states["int64_0"], states["float32_0"]
    cast = as_block(LinearMap(real, whole, source_name="float32_0", target_name="int64_0"))
    halved = as_block(LinearMap(whole, whole, scale=0.5, offset=1.0))
    tree = Zip(cast, halved)
    assert fuse(tree, states) is tree
    real[...] = [4, -6, 8.5, 0, 2, 10]
    cast()
    assert whole.tolist() == [4, -6, 8, 0, 2, 10]
    halved()
    assert whole.tolist() == [3, -2, 5, 1, 2, 6]


def test_a_map_of_scalars() -> None:
    one, two = np.array(3.0, np.float32), np.array(0.0, np.float32)
    LinearMap(one, two, scale=[2.0], offset=1.0)()
    assert two == 7.0


def test_the_built_in_maps_of_a_workflow_are_fused() -> None:
    states = many(3)
    blocks = [
        as_block(copy(states=states, source="a0", target="b0")),
        as_block(linear_map(states=states, source="a1", target="b1", scale=2.0)),
        as_block(copy(states=states, source="a2", target="b2", index=list(range(19, -1, -1)))),
    ]
    states.buffer_of("float32")[:60] = np.arange(60)
    fused = fuse(Zip(*blocks), states)
    assert isinstance(fused, Zip)
    assert len(fused.children) == 1
    compile_graph(fused).step()
    once = states.buffer.tobytes()
    for block in blocks:
        block()
    assert states.buffer.tobytes() == once
    assert states.b1[3] == 46.0
    assert states.b2[0] == 59.0


S = make_states(None)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: LinearMap(S["int64_0"], S["int64_1"], index=np.array([[1]])),
            "target from source: the index must be a list of whole numbers",
        ),
        (
            lambda: LinearMap(S["int64_0"], S["int64_1"], index=np.array([0, 6, 1])),
            "target from source: no element 6; there are 0 to 5",
        ),
        (
            lambda: LinearMap(S["int64_0"], S["int64_1"][:2]),
            "target from source: shape (6,) into (2,); give an index of as many elements",
        ),
        (
            lambda: LinearMap(S["float32_0"], S["float32_1"], scale=np.ones(3)),
            "target from source: scale has 3 values for 6 elements; give one, or one for each",
        ),
    ],
)
def test_wrong_maps_get_a_clear_line(make: object, message: str) -> None:
    assert callable(make)
    with pytest.raises(StateError) as caught:
        make()
    assert str(caught.value) == message

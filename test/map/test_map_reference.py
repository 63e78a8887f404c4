"""Encoders and decoders against rosbags' codec, on random message types, values and lengths."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from map_helpers import (
    REFERENCE,
    FlatLeaf,
    get,
    leaves,
    publish,
    random_types,
    serialize,
    subscribe,
    values,
    wire_dtype,
)

from unicon_msgs_map import Decoder, Encoder
from unicon_msgs_map.codec.careful import apply
from unicon_msgs_map.layout.messages import Array, Primitive, Struct

quick = settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[
        HealthCheck.too_slow,
        HealthCheck.data_too_large,
        HealthCheck.large_base_example,
    ],
)


class Storage:
    """Where states live: one shared buffer, as States lays them out, or arrays of their own."""

    def __init__(self, data: st.DataObject) -> None:
        self.data = data
        self.shared = np.zeros(1 << 16, np.uint8)
        self.used = 0

    def state(self, kind: Primitive, wire: Any) -> np.ndarray:
        """Return a state that holds wire values exactly, of a drawn dtype."""
        wire = np.asarray(wire, wire_dtype(kind))
        dtypes = [wire.dtype]
        if kind.code in "fd":
            dtypes += [np.dtype(np.float32), np.dtype(np.float64)]
        elif np.can_cast(wire.dtype, np.int64):
            dtypes.append(np.dtype(np.int64))
        dtype = self.data.draw(st.sampled_from(dtypes))
        if self.data.draw(st.booleans()):
            self.used += -self.used % 8
            size = wire.size * dtype.itemsize
            view = self.shared[self.used : self.used + size].view(dtype).reshape(wire.shape)
            self.used += size
        else:
            view = np.zeros(wire.shape, dtype)
        view[...] = wire
        return view


def states_and_constants(
    data: st.DataObject, message: Struct, value: Any
) -> tuple[dict[str, object], dict[str, np.ndarray]]:
    """Map every leaf of a message: numbers to states, texts to constants."""
    mapping: dict[str, object] = {}
    arrays: dict[str, np.ndarray] = {}
    storage = Storage(data)
    for leaf in leaves(message, value):
        held = get(value, leaf.at)
        kind = leaf.kind.item if isinstance(leaf.kind, Array) else leaf.kind
        if isinstance(kind, Primitive):
            if leaf.kind is kind and data.draw(st.integers(0, 9)) == 0:
                mapping[leaf.path] = held
                continue
            name = f"s{len(arrays)}"
            arrays[name] = storage.state(kind, held)
            mapping[leaf.path] = name
        else:
            mapping[leaf.path] = held if isinstance(held, list) else "=" + held
    return mapping, arrays


@quick
@given(data=st.data())
def test_encoded_bytes_equal_those_of_rosbags(data: st.DataObject) -> None:
    full = data.draw(random_types()).register(REFERENCE)
    message = REFERENCE.struct(full)
    value = data.draw(values(message, REFERENCE))
    mapping, arrays = states_and_constants(data, message, value)
    encoder = Encoder.build(publish(full, mapping, REFERENCE), arrays)
    for _ in range(2):  # the template must survive a use
        assert encoder.encode() == serialize(value, REFERENCE), encoder.source


@quick
@given(data=st.data())
def test_encoded_bytes_follow_the_states(data: st.DataObject) -> None:
    full = data.draw(random_types()).register(REFERENCE)
    message = REFERENCE.struct(full)
    value = data.draw(values(message, REFERENCE))
    mapping, arrays = states_and_constants(data, message, value)
    encoder = Encoder.build(publish(full, mapping, REFERENCE), arrays)
    encoder.encode()
    for leaf in leaves(message, value):  # new numbers of the same lengths
        kind = leaf.kind.item if isinstance(leaf.kind, Array) else leaf.kind
        name = mapping[leaf.path]
        if isinstance(kind, Primitive) and isinstance(name, str):
            held = np.asarray(get(value, leaf.at))
            new = np.roll(held, 1) if held.ndim else np.asarray(not held if kind.code == "?" else 1)
            arrays[name][...] = new
            put(value, leaf, new.astype(held.dtype) if held.ndim else new.item())
    assert encoder.encode() == serialize(value, REFERENCE)


def put(value: Any, leaf: FlatLeaf, new: Any) -> None:
    owner = get(value, leaf.at[:-1])
    last = leaf.at[-1]
    if isinstance(last, int):
        owner[last] = new
    else:
        object.__setattr__(owner, last, new)


def number_leaves(message: Struct, value: Any) -> list[FlatLeaf]:
    """Return the numbers and the arrays of at least one number."""
    return [
        leaf
        for leaf in leaves(message, value)
        if isinstance(leaf.kind.item if isinstance(leaf.kind, Array) else leaf.kind, Primitive)
        and np.size(get(value, leaf.at))
    ]


class Reader:
    """A decoder of all numbers of a type, and what rosbags says its states must hold."""

    def __init__(self, data: st.DataObject, full: str, first: Any) -> None:
        self.message = REFERENCE.struct(full)
        self.mapping: dict[str, object] = {}
        self.leaves: dict[str, FlatLeaf] = {}
        self.arrays: dict[str, np.ndarray] = {}
        numbers = number_leaves(self.message, first)
        left_out = data.draw(st.sets(st.integers(0, len(numbers) - 1), max_size=len(numbers) - 1))
        for number, leaf in enumerate(numbers):
            if number in left_out:
                continue
            kind = leaf.kind.item if isinstance(leaf.kind, Array) else leaf.kind
            assert isinstance(kind, Primitive)
            name = f"s{len(self.arrays)}"
            dtype = wire_dtype(kind)
            if kind.code in "fd" and data.draw(st.booleans()):
                dtype = np.dtype(np.float32)
            self.arrays[name] = np.zeros(np.size(get(first, leaf.at)), dtype)
            self.mapping[leaf.path] = name
            self.leaves[name] = leaf
        self.decoder = Decoder.build(
            subscribe(full, self.mapping, REFERENCE, nonfinite="accept"), self.arrays
        )

    def expected(self, value: Any) -> dict[str, np.ndarray]:
        """Return what the states must hold after a message."""
        found = {}
        for name, leaf in self.leaves.items():
            state = self.arrays[name].copy()
            try:
                held = np.atleast_1d(np.asarray(get(value, leaf.at)))
            except IndexError:  # an element that this message lacks
                held = state[:0]
            count = min(len(held), len(state))
            state[:count] = held[:count].astype(state.dtype)
            found[name] = state
        return found

    def check(self, raw: bytes) -> None:
        """Decode and compare with rosbags' values."""
        value = REFERENCE.store.deserialize_cdr(raw, self.message.name)
        expected = self.expected(value)
        accepted = self.decoder.decode(raw)
        if accepted:
            for name, state in self.arrays.items():
                np.testing.assert_array_equal(state, expected[name], self.leaves[name].path)
        else:
            assert "none of the mapped" in self.decoder.last_error


def drawn(data: st.DataObject, little: bool) -> tuple[Reader, bytes]:
    """Return a reader of a random type, and a message that it is built for."""
    full = data.draw(random_types()).register(REFERENCE)
    message = REFERENCE.struct(full)
    first = data.draw(values(message, REFERENCE))
    assume(number_leaves(message, first))
    return Reader(data, full, first), serialize(first, REFERENCE, little=little)


@quick
@given(data=st.data(), little=st.booleans())
def test_decoded_values_equal_those_of_rosbags(data: st.DataObject, little: bool) -> None:
    reader, raw = drawn(data, little)
    reader.check(raw)
    reader.check(raw)  # the same layout: fast
    for other in data.draw(
        st.lists(values(reader.message, REFERENCE), max_size=3)
    ):  # other lengths
        reader.check(serialize(other, REFERENCE, little=data.draw(st.booleans())))
    reader.check(raw)


@quick
@given(data=st.data(), little=st.booleans())
def test_fast_and_careful_path_write_the_same(data: st.DataObject, little: bool) -> None:
    reader, raw = drawn(data, little)
    assert reader.decoder.decode(raw)
    kept = reader.decoder.kept[0]
    for state in reader.arrays.values():
        state[...] = 0
    assume(kept.fast(raw))  # infinities are for the careful path alone
    fast = {name: state.copy() for name, state in reader.arrays.items()}
    for state in reader.arrays.values():
        state[...] = 0
    apply(raw, kept.runs, "accept")
    for name, state in reader.arrays.items():
        np.testing.assert_array_equal(state, fast[name])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3.4028235677973366e38, 1e300])
def test_floats_that_are_not_plain_numbers_encode_like_rosbags(value: float) -> None:
    text = "float64 a\nfloat32[3] b\nfloat64[] c\nfloat32[] d\n"
    REFERENCE.register({"reference_msgs/msg/Floats": text})
    arrays = {"a": np.array(value), "b": np.full(3, value, np.float64)}
    arrays |= {"c": np.full(20, value), "d": np.full(20, value)}
    spec = publish("reference_msgs/msg/Floats", {k: k for k in "abcd"}, REFERENCE)
    raw = Encoder.build(spec, arrays).encode()
    found = REFERENCE.store.deserialize_cdr(raw, "reference_msgs/msg/Floats")
    with np.errstate(over="ignore"):
        single = np.float32(value)
    np.testing.assert_array_equal(found.a, value)
    np.testing.assert_array_equal(found.b, np.full(3, single))
    np.testing.assert_array_equal(found.c, np.full(20, value))
    np.testing.assert_array_equal(found.d, np.full(20, single))

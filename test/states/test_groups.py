"""Groups: copies hold to copying each state alone; descriptions come back; differences by name."""

from __future__ import annotations

import dataclasses
import json
import math
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_base.errors import StateError
from unicon_core.states import Layout, States, StateSpec
from unicon_core.states.groups import (
    Copies,
    difference,
    groups_from_json,
    groups_hash,
    groups_json,
    subset,
)

DTYPES = ["float32", "float64", "int8", "int64", "uint16", "bool"]

specs = st.builds(
    lambda shape, dtype, unit, frame, initial: StateSpec(
        tuple(shape), dtype, unit, frame, initial=initial if dtype.startswith("f") else 0
    ),
    st.lists(st.integers(1, 5), max_size=3),
    st.sampled_from(DTYPES),
    st.sampled_from(["", "rad", "m/s²", "°"]),
    st.sampled_from(["", "base"]),
    st.sampled_from([0.0, 0, 1.5, math.nan, math.inf]),
)
names = st.from_regex(r"x[a-z0-9_]{0,6}", fullmatch=True)
states_of = st.dictionaries(names, specs, min_size=1, max_size=8)
layouts = st.builds(Layout, states_of, st.none() | st.integers(1, 4))


@st.composite
def layouts_and_groups(draw: st.DrawFn) -> tuple[Layout, Layout]:
    """A layout, and the layout of some of its states, perhaps in another order."""
    layout = draw(layouts)
    chosen = draw(st.lists(st.sampled_from(sorted(layout.specs)), unique=True))
    group = subset(layout, chosen)
    order = draw(st.permutations(list(group.specs)))
    return layout, Layout({name: group.specs[name] for name in order}, layout.num_robots)


@settings(deadline=None)
@given(layouts_and_groups(), st.randoms(use_true_random=False))
def test_copies_are_those_of_each_state_alone(both, chance):
    layout, group = both
    states, there = States(layout), States(layout)
    for each in (states, there):
        each.buffer[:] = np.frombuffer(chance.randbytes(layout.nbytes), np.uint8)
    before = chance.randbytes(group.nbytes)
    packed, slow = bytearray(before), bytearray(before)
    copies = Copies(states, group, memoryview(packed))
    copies.pack()
    for name, slot in group.slots.items():
        slow[slot.offset : slot.offset + slot.nbytes] = states[name].tobytes()
    assert packed == slow
    assert len(copies.pairs) <= len(group.specs)

    wanted = {
        name: (states if name in group.specs else there)[name].tobytes() for name in layout.specs
    }
    for bytes_, state in Copies(there, group, memoryview(packed)).pairs:
        state[:] = bytes_
    assert {name: there[name].tobytes() for name in layout.specs} == wanted


def test_states_that_stand_together_are_one_copy():
    layout = Layout({f"x{i}": StateSpec((i + 1,)) for i in range(5)})
    group = subset(layout, ["x1", "x2", "x4"])
    assert len(Copies(States(layout), group, memoryview(bytearray(group.nbytes))).pairs) == 2


@settings(deadline=None)
@given(st.dictionaries(st.text(max_size=8), layouts, max_size=3))
def test_a_description_comes_back(groups):
    text = groups_json(groups)
    again = groups_from_json(text)
    assert groups_json(again) == text
    assert groups_hash(again) == groups_hash(groups)
    assert again == groups
    assert list(again) == list(groups)
    assert {name: layout.slots for name, layout in again.items()} == {
        name: layout.slots for name, layout in groups.items()
    }


@settings(deadline=None)
@given(st.recursive(st.none() | st.booleans() | st.floats() | st.text(), st.lists), st.data())
def test_a_description_with_anything_in_it_is_refused_or_read(value, data):
    good = json.loads(groups_json({"g": Layout({"x": StateSpec((2,))})}))
    key = data.draw(st.sampled_from(["g", "num_robots", "states", "name", "shape", "dtype"]))
    if key == "g":
        good["g"] = value
    elif key in ("num_robots", "states"):
        good["g"][key] = value
    else:
        good["g"]["states"][0][key] = value
    with suppress(StateError):  # and nothing else
        groups_json(groups_from_json(json.dumps(good)))


@pytest.mark.parametrize(
    "text", ["", "[]", "nul", "[" * 100_000, '{"g": {"states": "x"}}', "1e400"]
)
def test_what_is_not_json_of_groups_is_refused(text):
    with pytest.raises(StateError, match="not a"):
        groups_from_json(text)


def test_half_a_robot_is_refused():
    text = groups_json({"g": Layout({"x": StateSpec()}, 2)}).replace(":2,", ":2.5,")
    with pytest.raises(StateError, match=r"num_robots is 2.5; give a whole number or null"):
        groups_from_json(text)


CHANGES = {
    "shape": (7,),
    "dtype": "float16",
    "unit": "furlong",
    "frame": "attic",
    "description": "other",
    "initial": 1,
}


@settings(deadline=None)
@given(states_of, st.data(), st.sampled_from(sorted(CHANGES)))
def test_the_first_state_that_differs_is_named(mine, data, key):
    names = list(mine)
    changed = data.draw(st.lists(st.sampled_from(names), min_size=1, unique=True))
    theirs = {
        name: dataclasses.replace(spec, **{key: CHANGES[key]}) if name in changed else spec
        for name, spec in mine.items()
    }
    first = next((n for n in names if repr(mine[n]) != repr(theirs[n])), None)
    told = difference(Layout(mine), Layout(theirs))
    if first is None:
        assert told == ""
    else:
        assert told.startswith(f"state {first!r}: {key} is ")
    absent = data.draw(st.sampled_from(names))
    rest = {name: spec for name, spec in mine.items() if name != absent}
    assert difference(Layout(mine), Layout(rest)) == f"state {absent!r} is only here"
    assert difference(Layout(rest), Layout(mine)) == f"state {absent!r} is only there"


@given(layouts, layouts)
@settings(deadline=None)
def test_there_is_a_difference_exactly_where_layouts_are_not_equal(one, other):
    assert (difference(one, other) == "") == (one == other)
    assert difference(one, one) == ""


def test_orders_and_batches_differ():
    one = {"x": StateSpec(initial=math.nan), "y": StateSpec()}
    other = {"y": StateSpec(), "x": StateSpec(initial=math.nan)}
    assert difference(Layout(one), Layout(other)) == "the states stand in another order"
    assert difference(Layout(one), Layout(one, 3)) == "num_robots is none here and 3 there"


@pytest.mark.parametrize(
    ("here", "told"),
    [
        ({"x": StateSpec((2,)), "y": StateSpec()}, "state 'z' is only there"),
        ({"x": StateSpec((3,)), "z": StateSpec()}, r"state 'x': shape is \[3\] here and \[2\]"),
        (
            {"x": StateSpec((2,), "int32"), "z": StateSpec()},
            "'x': dtype is 'int32' here and 'float32' there",
        ),
        ({"x": StateSpec((2,), unit="°"), "z": StateSpec()}, "'x': unit is '°' here and '' there"),
        ({"x": StateSpec((2,), frame="w"), "z": StateSpec()}, "'x': frame is 'w' here and '' "),
        ({"x": StateSpec((2,), names=("b", "a")), "z": StateSpec()}, "'x': names is"),
    ],
)
def test_states_that_mean_something_else_are_refused(here, told):
    group = Layout({"x": StateSpec((2,)), "z": StateSpec()})
    with pytest.raises(StateError, match=f"the group does not fit: .*{told}"):
        Copies(States(here), group, memoryview(bytearray(group.nbytes)))


def test_descriptions_and_initial_values_may_differ():
    group = Layout({"x": StateSpec((2,), description="elsewhere", initial=1.0)})
    Copies(States({"x": StateSpec((2,))}), group, memoryview(bytearray(group.nbytes)))

"""States: one aligned buffer, views that stay, snapshots, files; and each message."""

from __future__ import annotations

import json
import multiprocessing
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_base.errors import StateError
from unicon_core.states import Layout, States, StateSpec, standard_states

DTYPES = ["float32", "float64", "int8", "int32", "int64", "uint16", "bool"]

specs = st.builds(
    lambda shape, dtype: StateSpec(tuple(shape), dtype),
    st.lists(st.integers(1, 5), max_size=3),
    st.sampled_from(DTYPES),
)
layouts = st.builds(
    Layout,
    st.dictionaries(
        st.from_regex(r"[a-z][a-z0-9_]{0,6}", fullmatch=True).filter(
            lambda n: n not in dir(States)
        ),
        specs,
        max_size=8,
    ),
    st.none() | st.integers(1, 4),
)


def go2_like() -> States:
    return States(standard_states([f"joint{i}" for i in range(12)]))


@settings(deadline=None)
@given(layouts)
def test_every_state_is_an_aligned_piece_of_one_buffer(layout: Layout) -> None:
    states = States(layout)
    assert states.buffer.ctypes.data % 64 == 0
    assert states.buffer.size == layout.nbytes
    assert layout.nbytes % 64 == 0
    low, high = states.buffer.ctypes.data, states.buffer.ctypes.data + layout.nbytes
    used = np.zeros(layout.nbytes, dtype=int)
    for name, view in states._views.items():
        slot = layout.slots[name]
        assert low <= view.ctypes.data == low + slot.offset <= high - view.nbytes
        assert view.ctypes.data % view.itemsize == 0
        assert view.dtype == layout.specs[name].dtype
        batch = () if layout.num_robots is None else (layout.num_robots,)
        assert view.shape == batch + layout.specs[name].shape
        used[slot.offset : slot.offset + slot.nbytes] += 1
    assert used.max(initial=0) <= 1


@settings(deadline=None)
@given(layouts)
def test_states_of_one_dtype_stand_back_to_back(layout: Layout) -> None:
    states = States(layout)
    for dtype, (start, count) in layout.sections.items():
        assert start % 64 == 0
        names = [name for name in states if layout.specs[name].dtype == dtype]
        assert [states.offset(name) for name in names] == np.cumsum(
            [0, *(states[name].size for name in names)]
        ).tolist()[: len(names)]
        assert states.buffer_of(dtype).size == count == sum(states[n].size for n in names)
        for name in names:
            at = states.offset(name)
            states[name][...] = 1
            assert (states.buffer_of(dtype)[at : at + states[name].size] == 1).all()


@settings(deadline=None)
@given(layouts, layouts)
def test_layouts_are_equal_exactly_when_their_hashes_are(one: Layout, other: Layout) -> None:
    assert Layout.from_json(one.to_json()) == one
    assert Layout.from_json(one.to_json()).hash == one.hash
    assert (one == other) == (one.hash == other.hash) == (one.to_json() == other.to_json())
    assert hash(Layout.from_json(one.to_json())) == hash(one)


def test_the_hash_is_the_same_in_another_process() -> None:
    code = (
        "from unicon_core.states import Layout, standard_states;"
        "print(Layout(standard_states([f'joint{i}' for i in range(12)])).hash)"
    )
    printed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.strip()
    assert printed == go2_like().layout.hash


@pytest.mark.parametrize(
    "changed",
    [
        {"shape": (4,)},
        {"dtype": "float64"},
        {"unit": "deg"},
        {"frame": "base"},
        {"names": ("a", "b", "c")},
        {"description": "x"},
        {"initial": 1.0},
    ],
)
def test_any_change_of_a_specification_changes_the_hash(changed: dict[str, object]) -> None:
    plain = StateSpec((3,), unit="rad")
    other = StateSpec.from_dict({**plain.to_dict(), **changed})
    assert Layout({"q": plain}).hash != Layout({"q": other}).hash


def test_order_and_batch_are_part_of_the_layout() -> None:
    a, b = StateSpec((2,)), StateSpec((3,))
    assert Layout({"a": a, "b": b}).hash != Layout({"b": b, "a": a}).hash
    assert Layout({"a": a}).hash != Layout({"a": a}, 1).hash


def test_writing_by_item_and_attribute_goes_into_the_view() -> None:
    states = go2_like()
    view = states.joint_pos
    states.joint_pos = np.arange(12)
    states["joint_vel"] = 2.0
    assert view is states["joint_pos"]
    assert view.tolist() == list(range(12))
    assert (states.joint_vel == 2.0).all()
    assert "joint_pos" in states
    assert hasattr(states, "joint_pos")
    assert not hasattr(states, "joint_poz")
    assert "joint_pos" in dir(states)
    assert len(states) == len(list(states)) == len(states.layout.specs)


def test_views_stay_valid_through_reset_restore_and_the_loss_of_states() -> None:
    states = go2_like()
    view = states.joint_pos
    snapshot = states.snapshot()
    view[3] = 7.0
    states.restore(snapshot)
    assert view[3] == 0.0
    view[3] = 7.0
    states.reset()
    assert view[3] == 0.0
    assert states.joint_pos is view
    del states
    view[:] = 1.0
    assert view.sum() == 12.0


def test_initial_values_come_at_start_and_after_reset_for_each_robot() -> None:
    spec = {"quat": StateSpec((4,), initial=(1.0, 0.0, 0.0, 0.0)), "n": StateSpec(initial=3.0)}
    for num_robots, batch in ((None, ()), (3, (3,))):
        states = States(spec, num_robots)
        states.buffer[:] = 0xFF
        states.reset()
        assert states.quat.shape == (*batch, 4)
        assert (states.quat == np.array([1, 0, 0, 0], np.float32)).all()
        assert (states.n == 3.0).all()


def test_a_given_buffer_is_used_as_it_is() -> None:
    layout = go2_like().layout
    memory = np.full(layout.nbytes, 7, np.uint8)
    one, other = States(layout, buffer=memory), States(layout, buffer=memory)
    assert (memory == 7).all()
    one.joint_pos = 4.0
    assert (other.joint_pos == 4.0).all()


def test_snapshot_and_restore_carry_every_byte() -> None:
    states = go2_like()
    random = np.random.default_rng(5)
    states.buffer[:] = random.integers(0, 256, states.buffer.size, dtype=np.uint8)
    before = states.buffer.tobytes()
    snapshot = states.snapshot()
    states.reset()
    states.restore(snapshot)
    assert states.buffer.tobytes() == before
    assert snapshot.layout_hash == states.layout.hash


def test_a_saved_file_is_read_without_the_program(tmp_path: Path) -> None:
    states = States({"q": StateSpec((3,), unit="rad", names=("a", "b", "c"))}, 2)
    states.q = [[1, 2, 3], [4, 5, 6]]
    states.save(tmp_path / "moment.states")
    code = (
        "import sys; from unicon_core.states import States;"
        "s = States.load(sys.argv[1]); print(s.to_json())"
    )
    printed = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "moment.states")],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    told = json.loads(printed)
    assert told["layout"] == states.layout.hash
    assert told["states"]["q"]["value"] == [[1, 2, 3], [4, 5, 6]]
    assert told["states"]["q"]["unit"] == "rad"
    assert told["states"]["q"]["names"] == ["a", "b", "c"]


@settings(max_examples=30)
@given(layouts, st.integers(0, 2**32 - 1))
def test_save_and_load_carry_every_byte(
    tmp_path_factory: pytest.TempPathFactory, layout: Layout, seed: int
) -> None:
    path = tmp_path_factory.mktemp("states") / "file"
    states = States(layout)
    states.buffer[:] = np.random.default_rng(seed).integers(0, 256, layout.nbytes, dtype=np.uint8)
    states.save(path)
    loaded = States.load(path)
    assert loaded.layout == layout
    assert loaded.buffer.tobytes() == states.buffer.tobytes()


@pytest.mark.parametrize("cut", [0, 5, 17, 60, -1])
def test_a_cut_file_is_refused(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "f"
    go2_like().save(path)
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(StateError, match=r"is not a state file|is truncated"):
        States.load(path)


def _child(name: str, nbytes: int, layout_json: str) -> None:
    from multiprocessing.shared_memory import SharedMemory

    memory = SharedMemory(name)
    states = States(
        Layout.from_json(layout_json), buffer=np.frombuffer(memory.buf, np.uint8, nbytes)
    )
    states.joint_pos = states.joint_pos + 1.0
    del states
    memory.close()


def test_two_processes_share_one_buffer_by_layout() -> None:
    from multiprocessing.shared_memory import SharedMemory

    layout = go2_like().layout
    memory = SharedMemory(create=True, size=layout.nbytes)
    try:
        states = States(layout, buffer=np.frombuffer(memory.buf, np.uint8, layout.nbytes))
        states.reset()
        states.joint_pos = 2.0
        child = multiprocessing.get_context("spawn").Process(
            target=_child, args=(memory.name, layout.nbytes, layout.to_json())
        )
        child.start()
        child.join(30)
        assert child.exitcode == 0
        assert (states.joint_pos == 3.0).all()
        del states
    finally:
        memory.close()
        memory.unlink()


def test_stamps_are_int64_and_float32_is_the_rule() -> None:
    states = go2_like()
    assert states.stamp_ns.dtype == np.int64
    states.stamp_ns = 2**62 + 1
    assert int(states.stamp_ns) == 2**62 + 1
    for name in states:
        assert states[name].dtype == (np.int64 if name in ("stamp_ns", "tick") else np.float32)


def test_repr_says_how_many_and_how_large() -> None:
    assert repr(States({"q": StateSpec((3,))}, 2)) == "States(1 states x 2 robots, 64 bytes)"


def test_an_unknown_buffer_dtype_is_an_empty_view() -> None:
    assert States({"q": StateSpec((3,))}).buffer_of("int16").size == 0


UNKNOWN = "no state 'joint_poz'; did you mean 'joint_pos'? known: joint_pos, joint_vel"
SMALL = {"joint_pos": StateSpec((2,)), "joint_vel": StateSpec((2,))}


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: States(SMALL)["joint_poz"], UNKNOWN),
        (lambda: States(SMALL).joint_poz, UNKNOWN),
        (lambda: setattr(States(SMALL), "joint_poz", 1), UNKNOWN),
        (lambda: States(SMALL).spec("joint_poz"), UNKNOWN),
        (lambda: States(SMALL).offset("joint_poz"), UNKNOWN),
        (
            lambda: States(SMALL, buffer=np.zeros(10, np.uint8)),
            "the buffer has 10 elements of uint8 and the layout needs 64 of uint8; build both "
            "sides from one layout (compare Layout.hash)",
        ),
        (
            lambda: Layout({"joint pos": StateSpec()}),
            "state name 'joint pos' is not an identifier; use letters, digits and '_', letter "
            "first",
        ),
        (
            lambda: Layout(SMALL, 0),
            "num_robots is 0; give a number >= 1, or leave it out",
        ),
        (
            lambda: Layout.from_json("{}"),
            "not a state layout: 'states'; write it with Layout.to_json",
        ),
        (
            lambda: StateSpec(dtype="float31"),
            "state dtype 'float31' is not a NumPy type; use float32, int64, bool, …",
        ),
        (
            lambda: StateSpec(dtype="complex64"),
            "state dtype 'complex64' cannot be shared; use a bool, integer or float type",
        ),
        (
            lambda: StateSpec((3, 0)),
            "state shape (3, 0) has an empty axis; every axis needs >= 1",
        ),
        (lambda: StateSpec((3,), names=("a", "b")), "2 element names for a last axis of 3"),
        (lambda: StateSpec((), names=("a", "b")), "2 element names for a last axis of 1"),
        (
            lambda: StateSpec((2,), names=("a", "a")),
            "element name 'a' stands twice; names must be unique",
        ),
        (lambda: StateSpec((2,), initial=(1.0, 2.0, 3.0)), "3 initial values for 2 elements"),
        (
            lambda: StateSpec.from_dict({"shape": 3, "units": "rad"}),
            "state: unknown key 'units'; did you mean 'unit'? known: description, dtype, frame, "
            "initial, names, shape, unit",
        ),
        (
            lambda: StateSpec.from_dict({"shape": "three"}),
            "state.shape is 'three'; give a list of whole numbers, such as [3]",
        ),
        (
            lambda: States({"reset": StateSpec((3,))}),
            "a state cannot be named 'reset', which is a member of States; rename it",
        ),
    ],
)
def test_wrong_states_get_a_clear_line(make: object, message: str) -> None:
    assert callable(make)
    with pytest.raises(StateError) as caught:
        make()
    assert str(caught.value) == message


def test_a_snapshot_of_another_layout_is_refused_with_both_hashes() -> None:
    one, other = States(SMALL), go2_like()
    with pytest.raises(StateError) as caught:
        one.restore(other.snapshot())
    assert str(caught.value) == (
        f"the snapshot is of layout {other.layout.hash[:12]} and these states are of "
        f"{one.layout.hash[:12]}; restore it where it was taken"
    )


def test_files_that_are_no_state_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(StateError) as caught:
        States.load(tmp_path / "none")
    assert str(caught.value) == (
        f"cannot read states from {tmp_path / 'none'}: No such file or directory"
    )
    (tmp_path / "text").write_text("hello")
    with pytest.raises(StateError) as caught:
        States.load(tmp_path / "text")
    assert str(caught.value) == (
        f"{tmp_path / 'text'} is not a state file; write one with States.save"
    )


def test_a_thousand_snapshots_and_writes_leave_nothing() -> None:
    import tracemalloc

    states = go2_like()
    value = np.ones(12, np.float32)

    def tick() -> None:
        states["joint_pos"][...] = value
        states.joint_vel = value

    tick()
    tracemalloc.start()
    try:
        for _ in range(100):
            tick()
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(1000):
            tick()
        assert tracemalloc.get_traced_memory()[0] - before < 1024
    finally:
        tracemalloc.stop()

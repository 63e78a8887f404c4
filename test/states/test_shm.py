"""Shared memory: whole values, one writer of a name, and what is left by a killed one."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
import pytest
from ring_processes import start

from unicon_base.errors import StateError
from unicon_core.states import States, StateSpec
from unicon_core.states.backends.shm import Segment, ShmReader, ShmWriter, clean, segments
from unicon_core.states.groups import subset

SPECS = {
    "joint_pos": StateSpec((12,)),
    "joint_vel": StateSpec((12,)),
    "base_quat": StateSpec((4,)),
    "stamp_ns": StateSpec((), "int64"),
}
NAME = f"test-{os.getpid()}"


@pytest.fixture
def segment() -> Iterator[tuple[Segment, States]]:
    states = States(SPECS)
    made = Segment.create(NAME, {"measured": subset(states.layout, ("joint_pos", "stamp_ns"))})
    yield made, states
    made.close()
    assert NAME not in [found.name for found in segments()]


def test_a_value_arrives_whole_and_once(segment):
    made, states = segment
    writer, there = ShmWriter(made, "measured", states), States(SPECS)
    reader = ShmReader(NAME, "measured", there)
    assert not reader.take()
    states.joint_pos = np.arange(12)
    states.stamp_ns = 7
    writer.publish()
    assert reader.wait(0.0)
    assert reader.take()
    assert not reader.take()
    np.testing.assert_array_equal(there.joint_pos, np.arange(12))
    assert there.stamp_ns == 7
    assert (reader.number, reader.skipped) == (1, 0)
    for _ in range(5):
        writer.publish()
    assert reader.take()
    assert (reader.number, reader.skipped) == (6, 4)
    reader.close()


def test_a_value_that_could_not_be_had_whole_does_not_stand_in_for_the_last_one(segment):
    made, states = segment
    writer, there = ShmWriter(made, "measured", states), States(SPECS)
    reader = ShmReader(NAME, "measured", there)
    states.joint_pos = 1.0
    writer.publish()
    assert reader.take()
    states.joint_pos = 2.0
    writer.publish()
    (head, _) = reader._slots[2]
    reader._fence = lambda: head.__setitem__(0, 0)  # overwritten while it is copied, each time
    assert not reader.take()
    assert reader.starved == 1
    reader.restore()
    assert (there.joint_pos == 1.0).all()
    reader.close()


def test_one_writer_has_a_name(segment):
    made, _ = segment
    with pytest.raises(StateError, match=f"is written by process {os.getpid()}"):
        Segment.create(NAME, made.groups)


def test_absent_and_wrong_groups_are_named(segment):
    _, states = segment
    with pytest.raises(StateError, match=f"no segment 'nowhere'.*known: .*{NAME}"):
        ShmReader("nowhere", "measured", states)
    with pytest.raises(StateError, match="no group 'commands'; there are measured"):
        ShmReader(NAME, "commands", states)
    other = States(SPECS | {"joint_pos": StateSpec((29,))})
    with pytest.raises(StateError, match="state 'joint_pos': shape is"):
        ShmReader(NAME, "measured", other)


def test_what_a_dead_writer_left_is_taken_over_and_followed():
    states = States(SPECS)
    groups = {"measured": subset(states.layout, SPECS)}
    dying = start(lambda: ShmWriter(Segment.create(NAME, groups), "measured", states).publish())
    os.waitpid(dying, 0)  # it has not closed
    there = States(SPECS)
    reader = ShmReader(NAME, "measured", there)
    assert reader.take()  # its last value is whole
    assert not reader.alive()
    made = Segment.create(NAME, groups)
    states.joint_pos = 3.0
    ShmWriter(made, "measured", states).publish()
    assert reader.alive()
    assert reader.take()
    assert there.joint_pos[0] == 3.0
    made.close()
    assert not reader.alive()
    reader.close()


def test_clean_removes_the_dead_alone(folder):
    groups = {"measured": subset(States(SPECS).layout, SPECS)}
    living = Segment.create("living", groups)
    os.waitpid(start(lambda: Segment.create("dead", groups)), 0)
    assert clean() == ["dead"]
    assert living.alive()
    living.close()
    assert not list(folder.iterdir())


def test_what_was_taken_is_restored_until_a_new_writer_publishes():
    states, there = States(SPECS), States(SPECS)
    made = Segment.create(NAME, {"measured": states.layout})
    there.joint_pos = 1.0
    reader = ShmReader(NAME, "measured", there)
    reader.restore()  # nothing was taken yet: nothing changes
    assert there.joint_pos[0] == 1.0
    states.joint_pos = 2.0
    ShmWriter(made, "measured", states).publish()
    assert reader.take()
    made.close()
    made = Segment.create(NAME, {"measured": states.layout})
    assert reader.alive()
    there.joint_pos = 3.0
    reader.restore()
    assert there.joint_pos[0] == 2.0
    made.close()
    reader.close()


def test_who_comes_late_has_skipped_nothing(segment):
    made, states = segment
    writer = ShmWriter(made, "measured", states)
    for _ in range(7):
        writer.publish()
    reader = ShmReader(NAME, "measured", States(SPECS))
    assert reader.take()
    assert (reader.number, reader.skipped) == (7, 0)
    reader.close()

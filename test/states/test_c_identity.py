"""The example in C answers with the very bits of the same law in Python."""

from __future__ import annotations

import os

import c_peers
import c_round_trip
import numpy as np
import pytest

from unicon_core.states import Layout, States
from unicon_core.states.backends.shm import Segment, ShmWriter
from unicon_core.states.groups import groups_of

NAME = f"test-c-identity-{os.getpid()}"


@pytest.mark.parametrize("standard", ["c99", "c++11"])
def test_identity_in_c_answers_with_the_very_bits(tmp_path, standard):
    states = States(c_round_trip.LAYOUT)
    program = c_peers.build(c_peers.IDENTITY, groups_of(states.layout), tmp_path, standard)
    random_bits = np.random.default_rng(14)
    with c_round_trip.identity(program, NAME, states) as peer:
        for step in range(1, 2001):
            states.joint_pos = random_bits.normal(size=29)
            states.joint_vel = random_bits.normal(size=29) * 10.0 ** random_bits.integers(-40, 30)
            if step == 7:
                states.joint_pos[:4] = [np.nan, -0.0, np.inf, 1e-45]
            peer.step()
            assert peer.reader.number == step
            assert states.joint_pos_target.tobytes() == states.joint_pos.tobytes()
            half = np.float32(0.5) * states.joint_vel
            assert states.joint_vel_target.tobytes() == half.tobytes()
        assert peer.reader.skipped == 0
        assert (states.joint_stiffness == 40.0).all()
        assert (states.joint_damping == 1.0).all()
        assert peer.close() == "2000 values taken, 0 passed over\n"


def test_identity_serves_many_robots(tmp_path):
    states = States(Layout(c_round_trip.LAYOUT.specs, num_robots=3))
    program = c_peers.build(c_peers.IDENTITY, groups_of(states.layout), tmp_path)
    with c_round_trip.identity(program, NAME, states) as peer:
        states.joint_pos = np.arange(87).reshape(3, 29)
        peer.step()
        np.testing.assert_array_equal(states.joint_pos_target, states.joint_pos)


def test_identity_follows_a_writer_that_begins_anew(tmp_path):
    states = States(c_round_trip.LAYOUT)
    program = c_peers.build(c_peers.IDENTITY, groups_of(states.layout), tmp_path)
    with c_round_trip.identity(program, NAME, states) as peer:
        peer.step()
        peer.segment.close()
        peer.segment = Segment.create(NAME, groups_of(states.layout))
        peer.writer = ShmWriter(peer.segment, "measured", states)
        states.joint_pos = 2.0
        peer.step()
        assert (states.joint_pos_target == 2.0).all()

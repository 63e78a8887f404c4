"""Apart: which capsules are kept apart, how far they are, and what joints change about it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_capsules import between, placed
from welder import write_arm

from unicon_core.models.loaded import import_mujoco
from unicon_core.robots import Robot, load_robot
from unicon_manipulation.ik.differential import Apart

Build = Callable[..., Any]

points = st.lists(st.floats(-1, 1), min_size=12, max_size=12).map(
    lambda x: np.reshape(x, (2, 2, 3))
)


@given(points)
@settings(max_examples=50)
def test_the_twin_is_no_farther_than_any_two_points(ends: Any) -> None:
    one, other = ends
    share = np.linspace(0, 1, 30)[:, None]
    a, b = (end[0] + share * (end[1] - end[0]) for end in (one, other))
    by_points = np.linalg.norm(a[:, None] - b, axis=-1).min()
    found = between(one, other)
    assert found <= by_points + 1e-5
    assert found >= by_points - 0.12  # half of the spacing of the points, twice


@pytest.fixture
def hands(g1: Robot, solved: Build) -> Any:
    return solved(g1, ("left_hand", "right_hand"), ("arms",))


def test_distances_are_those_of_the_twin(hands: Any) -> None:
    apart, rng = Apart(hands.chain, 10.0, 0.0), np.random.default_rng(0)
    pairs = hands.reaching.pairs
    for _ in range(20):
        hands.at(hands.random_pose(rng, 1.0))
        hands.chain.differentiate()
        distance, _ = apart.rows()
        at = {name: placed(hands.robot, hands.chain, name) for pair in pairs for name in pair}
        wanted = [between(at[a][0], at[b][0]) - at[a][1] - at[b][1] for a, b in pairs]
        found = np.full(len(pairs), np.inf)
        model, contact = hands.reaching.loaded.model, hands.chain.data.contact
        names = [model.geom(g).name.removeprefix("unicon_capsule_") for g in range(model.ngeom)]
        for (one, other), d in zip(contact.geom, distance):
            pair = (names[one], names[other])
            i = pairs.index(pair if pair in pairs else pair[::-1])
            found[i] = min(found[i], d)
        np.testing.assert_allclose(found, wanted, atol=1e-6)


def test_rows_are_those_of_finite_differences(hands: Any) -> None:
    apart, rng = Apart(hands.chain, 0.3, 0.0), np.random.default_rng(1)
    mujoco, data, compared = import_mujoco(), hands.chain.data, 0
    model = hands.reaching.loaded.model

    def distances(pose: Any) -> Any:
        hands.at(pose)
        mujoco.mj_collision(model, data)
        return data.contact.geom.tolist(), data.contact.dist.copy()

    for _ in range(15):
        pose = hands.random_pose(rng, 1.0)
        hands.at(pose)
        hands.chain.differentiate()
        change = apart.rows()[1].copy()
        geoms = data.contact.geom.tolist()
        for joint in range(14):
            step = np.eye(14)[joint] * 1e-6
            (one, ahead), (other, behind) = distances(pose + step), distances(pose - step)
            if one == other == geoms:  # nothing came near, nothing became parallel
                compared += len(geoms)
                np.testing.assert_allclose(change[:, joint], (ahead - behind) / 2e-6, atol=1e-4)
    assert compared > 1000


def test_neighbours_and_what_nothing_moves_are_no_pairs(arm: Robot, solved: Build) -> None:
    assert solved(arm).reaching.pairs == (
        ("pillar", "forearm"),
        ("pillar", "hand"),
        ("upper_arm", "hand"),
    )
    assert solved(arm, moves=("hand",)).reaching.pairs == (
        ("pillar", "hand"),
        ("upper_arm", "hand"),
    )
    assert solved(arm, apart=0.0).reaching.pairs == ()


def test_what_is_nearer_at_the_default_pose_is_left_out_and_told(
    tmp_path: Any, solved: Build
) -> None:
    thick = write_arm(tmp_path, **{"to: [0, 0, 0.1], radius: 0.06": "to: [0, 0, 0.1], radius: 0.5"})
    reaching = solved(load_robot(thick)).reaching
    assert reaching.pairs == (("upper_arm", "hand"),)
    assert [pair[:2] for pair in reaching.left_out] == [("pillar", "forearm"), ("pillar", "hand")]
    assert all(distance < 0.02 for *_, distance in reaching.left_out)


@pytest.mark.parametrize("name", ["g1_29dof", "g1_23dof", "h1_2", "t1"])
def test_no_robot_of_ours_is_too_near_itself_at_its_default_pose(
    name: str, assets: Any, solved: Build
) -> None:
    it = solved(load_robot(name), ("left_hand", "right_hand"), ("arms",))
    assert it.reaching.left_out == ()
    assert {"left_hand", "right_hand"} <= {each for pair in it.reaching.pairs for each in pair}

"""A Go2 on ground that is not flat: what it feels, and that nothing else changes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from unicon_base.errors import UniconError
from unicon_core.check import check_workflow
from unicon_core.platforms.platform import info_of
from unicon_core.runtime import Runner
from unicon_core.runtime.rollouts import Rollouts
from unicon_core.workflow import Program, load_document

pytest.importorskip("mujoco")

WALK: dict[str, Any] = {
    "flow": {"policy": "walk"},
    "scene.initial_pose": "policy:walk",
    "commands": [{"velocity_command": {"constant": [0.6, 0.0, 0.0]}}],
}


def walked(said, ticks, **more):
    """Return the states behind each tick of a walk at 0.6 m/s, name to array."""
    program = Program(load_document("go2_walk", WALK | {"scene.terrain": said} | more))
    try:
        rows = Rollouts(program).run(ticks).states
        layout = {name: program.states.offset(name) for name in ("base_pos_w", "projected_gravity")}
        return {name: rows[:, at : at + 3] for name, at in layout.items()}
    finally:
        program.close()


def test_a_slope_tilts_what_the_robot_feels():
    up, down = (walked({"slope": {"angle": a, "flat": 1.0}}, 150) for a in (0.1, -0.1))
    for told, way in ((up, -1.0), (down, 1.0)):
        assert told["base_pos_w"][-1, 0] > 1.2  # all four feet are on it
        assert told["projected_gravity"][-25:, 0].mean() == pytest.approx(way * 0.1, abs=0.04)
    assert up["base_pos_w"][-1, 2] > 0.33 > 0.25 > down["base_pos_w"][-1, 2]


def test_a_robot_that_stands_across_a_slope_leans_to_its_side():
    changed = {"flow": "hold", "policies": {}, "commands": [], "scene.initial_pose": "default"}
    changed |= {"scene.terrain.slope": {"angle": 0.1}}
    program = Program(load_document("go2_walk", changed))
    half = np.sqrt(0.5)
    rollouts = Rollouts(program)
    program.platform.put(  # type: ignore[attr-defined]
        {"base_pos_w": np.array([3.0, 0.0, 0.5]), "base_quat": np.array([half, 0.0, 0.0, half])}
    )
    rollouts.run(100)
    gravity = np.array(program.states["projected_gravity"])
    program.close()
    assert gravity == pytest.approx([0.0, np.sin(0.1), -np.cos(0.1)], abs=0.02)


def test_patches_without_friction_make_it_slip():
    ways = [
        walked({"patches": {"friction": f, "flat": 1.0, "extent": 8.0}}, 200)["base_pos_w"]
        for f in (0, 1)
    ]
    plain = walked("flat", 200)["base_pos_w"]
    assert abs(ways[1][-1] - plain[-1]).max() < 0.1
    assert abs(ways[0][-1] - plain[-1]).max() > 0.2


@pytest.mark.slow
def test_rough_ground_without_height_is_walked_as_flat_ground_is():
    even, plain = (walked(said, 200) for said in ({"rough": {"height": 0, "extent": 10.0}}, "flat"))
    assert even["base_pos_w"][-1] == pytest.approx(plain["base_pos_w"][-1], abs=0.15)
    for told in (even, plain):
        assert abs(told["projected_gravity"][50:, 0]).mean() < 0.03
    rough = walked({"rough": {"height": 0.06, "extent": 10.0}}, 200)
    shaken = [np.ptp(told["base_pos_w"][100:, 2]) for told in (rough, plain)]
    assert shaken[0] > 1.5 * shaken[1]


@pytest.mark.parametrize("kind", ["rough", "patches"])
def test_it_begins_as_on_flat_ground(kind):
    one, other = (walked(said, 1)["base_pos_w"][0] for said in (kind, "flat"))
    assert one == pytest.approx(other, abs=1e-4)


def test_robots_of_a_batch_stand_on_the_same_ground():
    said = {"rough": {"height": 0.1, "flat": 1.0, "extent": 8.0}}
    alone = walked(said, 40)
    document = load_document("go2_walk", WALK | {"scene.terrain": said, "num_robots": 2})
    program = Program(document)
    Rollouts(program).run(40)
    places = np.array(program.states["base_pos_w"])
    program.close()
    assert (places == alone["base_pos_w"][-1]).all()


@pytest.mark.slow
def test_a_simulator_in_a_process_of_its_own_has_the_ground_too():
    said = {"stairs": {"rise": 0.05, "flat": 1.0}}
    own = walked(said, 60)
    child = walked(said, 60, platform={"child": "mujoco"})
    assert (own["base_pos_w"] == child["base_pos_w"]).all()


def test_reports_tell_it():
    program = Program(load_document("go2_stand", {"scene.terrain.slope.angle": 0.2}))
    told = info_of(program.platform)["terrain"]
    program.close()
    assert told == {
        "kind": "slope",
        "figures": {"angle": 0.2, "extent": 40.0, "flat": 2.0},
        "seed": 0,
    }


STAIRS = {"scene.terrain": {"stairs": {"rise": 0.08}}}


@pytest.mark.parametrize(
    ("workflow", "platform"),
    [("go2_stand", "unitree"), ("go2_stand", "fake_robot"), ("go2_stairs", "fake")],
)
def test_what_lays_no_ground_leaves_it_to_the_world_and_the_check_notes_it(workflow, platform):
    said = ["scene.terrain={stairs: {rise: 0.08}}", f"platform={platform}"]
    result = check_workflow(workflow, said)
    assert result.clean, result.text()
    (note,) = (note for note in result.notes if note.code == "scene.ground")
    assert f"platform {platform!r} lays none" in note.evidence
    for others in (["scene.terrain=flat", said[1]], [said[0], "platform=mujoco"]):
        notes = check_workflow(workflow, others).notes
        assert "scene.ground" not in {note.code for note in notes}


def test_a_robot_runs_with_a_terrain_and_a_wrong_one_stays_an_error():
    there = {"platform": "fake_robot", "duration": 0.2, "start": "none"}
    report = Runner(Program(load_document("go2_stand", there | STAIRS))).run()
    assert (report.ended, report.faults) == ("duration", [])
    with pytest.raises(UniconError, match="'stair'; did you mean 'stairs'"):
        Program(load_document("go2_stand", there | {"scene.terrain": "stair"}))


def test_fake_sees_the_stairs_before_its_base():
    said = {"platform": "fake", "scene.terrain.stairs.flat": 1.0, "flow": {"policy": "walk"}}
    program = Program(load_document("go2_stairs", said))
    Rollouts(program).run(3)
    assert np.ptp(program.states["height_scan"]) == pytest.approx(0.16)
    program.close()


def test_a_simulator_that_cannot_lay_it_refuses():
    with pytest.raises(UniconError, match=r"'pybullet' cannot be told scene\.terrain"):
        Program(load_document("go2_stand", STAIRS | {"platform": "pybullet"}))

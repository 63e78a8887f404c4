"""`unicon bench diagnose`: its table of faults, how it judges a finding, and how it continues."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import diagnose
from benchmarks.diagnose import judged, rates_of, run
from benchmarks.injected import HEALTHY, SETUP, SIZES, Case, cases, made, mistake
from unicon_base.errors import UniconError
from unicon_core.models.find import pick_model
from unicon_core.models.load import load_model
from unicon_core.platforms.kit.base import rotation
from unicon_core.robots import load_robot
from unicon_core.workflow import load_document
from unicon_core.workflow.members import load_robot_of
from unicon_core.workflow.policies import load_policies
from unicon_lab.diagnose import Cause

PLANTS = SETUP["plants"]


def test_the_table_has_forty_kinds_of_five_sizes() -> None:
    assert len(SIZES) >= 40
    for kind, known in SIZES.items():
        assert set(known) in ({"all"}, {"go2", "go1", "g1"}), kind
        for five in known.values():
            assert len(five) == 5
            assert sorted(set(five)) == five, kind
            assert five[0] > 0.0


def test_each_kind_meets_each_robot_and_plant_that_has_it() -> None:
    every = cases()
    assert len({case.name for case in every}) == len(every)
    assert sum(case.kind != HEALTHY for case in every) >= 600
    assert sum(case.kind == HEALTHY for case in every) == 60
    for kind in SIZES:
        mine = [case for case in every if case.kind == kind]
        assert {(case.size, case.seed) for case in mine} == {
            (size, seed) for size in range(1, 6) for seed in range(3)
        }
        assert {case.robot for case in mine if case.plant == "mujoco"} == {*PLANTS["mujoco"]}
    quick = [every[i] for i in np.linspace(0, len(every) - 1, 40).round().astype(int)]
    assert {(case.robot, case.plant) for case in quick} == {
        (robot, plant) for plant, robots in PLANTS.items() for robot in robots
    }
    assert len({case.kind for case in quick}) > 35


def test_a_turned_imu_turns_attitude_gravity_and_rates_alike(assets: Path, tmp_path: Path) -> None:
    """At a heading, too: an attitude that is turned about the world's axes is a slope's."""
    case = next(one for one in cases() if one.name.startswith("go1/mujoco/attitude x/4"))
    record, name = made(case, 1, str(tmp_path), 6.0)
    assert name == "attitude x"
    quats = np.array(record.states("base_quat"), np.float64)
    ups = rotation(quats)[:, 2]
    off = np.abs(ups + record.states("projected_gravity"))
    assert np.abs(quats[:, 3]).max() > 0.1  # it has turned
    assert off.mean() < 0.004  # noise


def test_a_mistake_changes_the_contract_of_each_robot(assets: Path) -> None:
    for robot, file in (("go2", "go2"), ("go1", "go1"), ("g1", "g1_29dof")):
        names = load_robot(file).joint_names
        document = load_document(f"{robot}_walk")
        contract = load_policies(document, load_robot(file))["walk"]
        for case in cases():
            if (case.robot, case.plant) == (robot, "mujoco") and np.isnan(case.change):
                changed, name = mistake(contract, case, names[case.joint])
                same = case.kind in (HEALTHY, "late sensors")
                assert (repr(changed) == repr(contract)) == same or changed != contract, case
                assert bool(name) == (case.kind != HEALTHY), case


def test_pybullet_has_no_joints_that_its_explicit_damping_shakes(assets: Path) -> None:
    """From c = 2 M / step on, joints change the signs of their velocities in each physics step."""
    mujoco = pytest.importorskip("mujoco")
    step, known = 0.0005, {}
    for name in PLANTS["pybullet"]:
        document = load_document(f"{name}_walk")
        robot = load_robot_of(document)
        contract = load_policies(document, robot)["walk"]
        loaded = load_model(pick_model(robot), robot)
        model, data = loaded.model, mujoco.MjData(loaded.model)
        model.dof_armature[:] = 0.0
        order = [contract.joints.index(joint) for joint in robot.joint_names]
        data.qpos[model.jnt_qposadr[loaded.joints]] = contract.default_joint_pos[order]
        mujoco.mj_forward(model, data)
        inverse = np.zeros((model.nv, model.nv))
        mujoco.mj_solveM(model, data, inverse, np.eye(model.nv))
        known[name] = inverse[np.ix_(loaded.dofs, loaded.dofs)], contract.damping[order]
    for case in cases():
        if case.plant == "pybullet" and case.kind.startswith("viscous"):
            inverse, damping = (each[case.joints] for each in known[case.robot])
            most = 2.0 / step / np.linalg.eigvalsh(inverse[:, case.joints]).max()
            assert case.amount + damping.max() < most, case


def cause(name: str, probability: float = 0.9, *alike: str, layer: Any = "plant") -> Cause:
    kind, _, where = name.partition(" of ")
    return Cause(kind, where, layer, probability, 1.0, 0.5, 1.5, alike=alike)


@pytest.mark.parametrize(
    ("causes", "rank", "wrong", "covers"),
    [
        ([], None, False, None),
        ([cause("payload")], 1, False, True),
        ([cause("payload", layer="contract")], None, True, None),
        ([cause("inertia", 0.9, "payload", "delay")], 1, False, None),
        ([cause("inertia", 0.9, "payload", "delay", "damping")], None, False, None),
        ([cause("delay", 0.4), cause("payload")], 2, False, True),
        ([cause("delay", 0.6), cause("payload")], 2, True, True),
        ([cause("payload"), cause("strength of RL_calf_joint", 0.8)], 1, True, True),
    ],
)
def test_a_group_is_right_with_two_others(
    causes: list[Cause], rank: int | None, wrong: bool, covers: bool | None
) -> None:
    assert judged(causes, "payload", 1.2) == {
        "rank": rank,
        "wrong": wrong,
        "covers": covers,
    }
    assert judged(causes, "payload", 2.0)["covers"] in (False, None)


def row(case: Case, folder: str, references: Any) -> dict[str, Any]:
    """Stand for a diagnosis that finds all but what is wrong with a Go1."""
    found = case.robot != "go1"
    said: dict[str, Any] = {
        "rank": 1 if found else None,
        "wrong": not found,
        "covers": found,
        "found": [],
        "note": "",
    }
    return {"case": case.name, **asdict(case), **said}


def test_a_run_continues_where_it_was_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = Counter[str]()

    def counted(case: Case, *rest: Any) -> dict[str, Any]:
        made[case.name] += 1
        return row(case, *rest)

    monkeypatch.setattr(diagnose, "_examined", counted)
    path = tmp_path / "rows.jsonl"
    bench = run(only="/payload/", rows=str(path))
    assert len(made) == 15
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:10]) + "\n" + lines[10][:20])  # a kill in a write
    again = run(only="/payload/", rows=str(path))
    assert sorted(made.values()) == [1] * 10 + [2] * 5
    assert [json.loads(line)["case"] for line in path.read_text().splitlines()] == [*made]
    rates = again.facts["rates"]
    assert rates == bench.facts["rates"]
    assert rates["first"] == pytest.approx(1.0 - rates["wrong"])
    assert not again.holds
    assert json.loads(again.to_json())["facts"]["rates"]["fits"] == 15


def test_rates_of_nothing_are_no_numbers(tmp_path: Path) -> None:
    assert np.isnan(rates_of([])["first"])
    with pytest.raises(UniconError, match="no record is called so"):
        run(only="nothing")
    (tmp_path / "other").write_text("words\n")
    with pytest.raises(UniconError, match="holds no rows of this bench"):
        run(quick=True, rows=str(tmp_path / "other"))

"""`unicon robots new MODEL` writes what a model knows, and says what it does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from unicon_core.robots import Robot, load_robot
from unicon_ros.cli.main import main

pytest.importorskip("mujoco", reason="models are read by mujoco")

ROOT = Path(__file__).resolve().parents[2]
URDF = """\
<robot name="cart">
  <link name="base"/>
  <link name="tip"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial></link>
  <joint name="swing" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="2" effort="30" velocity="7"/></joint>
  <transmission name="t"><joint name="swing"/></transmission>
</robot>
"""


def written(model: str, folder: Path, name: str = "mine") -> Robot:
    path = folder / f"{name}.yaml"
    assert main(["robots", "new", model, "--out", str(path)]) == 0
    return load_robot(path)


def test_our_go2_is_written_as_its_robot_file_has_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new = written(str(ROOT / "config/models/go2/go2.xml"), tmp_path)
    told = capsys.readouterr().out
    shipped = load_robot("go2")
    assert new.kind == shipped.kind
    assert set(new.joint_names) == set(shipped.joint_names)
    own = [new.joint_names.index(name) for name in shipped.joint_names]
    for key in ("lower", "upper"):
        np.testing.assert_allclose(new.joint_fact(key)[own], shipped.joint_fact(key), atol=0.01)
    assert "joint_order" in new.unknown
    assert f"not known: {', '.join(new.unknown)}" in told
    assert "let the workflow name it, scene: {model: " in told  # it does not lie beside the file
    assert new.missing_facts()  # never driven before somebody has looked


@pytest.mark.parametrize(
    ("model", "robot"),
    [
        ("go1/go1.xml", "go1"),
        ("go2/go2.xml", "go2"),
        ("g1_29dof/g1_29dof.xml", "g1_29dof"),
        ("g1_29dof/g1_29dof_rev_1_0.urdf", "g1_29dof"),
        ("h1/h1.xml", "h1"),
        ("t1/T1_23dof.xml", "t1"),
        ("adam_lite/adam_lite.xml", "adam_lite"),
        ("a1/a1.urdf", "a1"),
        ("dex3_left/dex3_1_l.urdf", "dex3_left"),
    ],
)
def test_joints_and_kind_are_those_of_the_shipped_file(
    model: str, robot: str, tmp_path: Path, assets: Path
) -> None:
    new, shipped = written(f"assets:models/{model}", tmp_path), load_robot(robot)
    assert new.kind == shipped.kind
    others = set(new.joint_names) - set(shipped.joint_names)
    assert others == ({"wristYaw_Left", "wristYaw_Right"} if robot == "adam_lite" else set())
    own = [new.joint_names.index(name) for name in shipped.joint_names]
    both = ~np.isnan(new.lower[own])
    assert both.any()
    assert np.median(np.abs(new.lower[own] - shipped.lower)[both]) < 0.05  # of variants some differ
    for fact in ("imu", "feet"):
        if fact not in new.unknown and new.walks:
            assert getattr(new, fact)


def test_urdf_gives_its_speeds_and_names_the_model_beside_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "cart.urdf").write_text(URDF, "utf-8")
    new = written(str(tmp_path / "cart.urdf"), tmp_path, "cart")
    assert new.models == {"urdf": "cart.urdf"}
    assert (new.kind, new.joint_names) == ("arm", ("swing",))
    assert [float(new.joint_fact(key)[0]) for key in ("lower", "upper", "velocity", "effort")] == [
        -1.0,
        2.0,
        7.0,
        30.0,
    ]
    assert "joints.default" in capsys.readouterr().out


def test_nothing_is_overwritten_and_mistakes_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "cart.urdf"
    model.write_text(URDF, "utf-8")
    there = tmp_path / "there.yaml"
    there.write_text("mine", "utf-8")
    empty = tmp_path / "empty.xml"
    empty.write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>", "utf-8")
    for arguments, told in (
        ([str(model), "--out", str(there)], f"{there} exists; remove it"),
        ([str(model), "--out", str(tmp_path / "x.txt")], "x.txt is not a .yaml file"),
        ([str(model), "--out", str(tmp_path / "no/x.yaml")], "cannot write"),
        ([str(empty), "--out", str(tmp_path / "e.yaml")], "no joint that turns or slides"),
        ([str(tmp_path / "none.xml")], "none.xml"),
        ([], "robots new: give the model"),
    ):
        assert main(["robots", "new", *arguments]) == 1
        error = capsys.readouterr().err
        assert told in error
        assert error.count("\n") == 1
    assert there.read_text("utf-8") == "mine"
    assert not (tmp_path / "e.yaml").exists()
    assert main(["robots", "go2", "model"]) == 1

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
    assert new.sources["joints"] == "cart.urdf: names, limits, effort, velocity; order: its joints"


LIMB = """\
<body name="{limb}_upper" pos="{place} 0"><joint name="{joint}_1" {limits}/>
  <geom size=".03" mass="1"/>
  <body name="{limb}_lower" pos="0 0 {down}"><joint name="{joint}_2" {limits}/>
    <geom size=".03" mass="1"/>
    <body name="{limb}_end" pos="0 0 {down}">{end}<geom size=".04" mass=".1"/></body>
  </body>
</body>
"""
LIMITS = 'axis="0 1 0" range="-1 1"'
WHEEL = '<joint name="{joint}_3" axis="0 1 0" {limits}/>'


def body(limbs: str, *, free: bool) -> str:
    """Return an MJCF of a trunk with limbs, on a free joint or fixed."""
    joint = "<freejoint/>" if free else ""
    return (
        '<mujoco><compiler angle="radian"/><worldbody><body name="trunk" pos="0 0 1">'
        f'{joint}<geom size=".1" mass="5"/>{limbs}</body></worldbody></mujoco>'
    )


def limbs(number: int, called: str, end: str = "", down: float = -0.2) -> str:
    """Return limbs at the trunk's corners; `called` names their joints."""
    return "".join(
        LIMB.format(
            limb=f"{called}{i}",
            joint=f"{called}{i}",
            place=f"{(-1) ** (i // 2) * 0.2} {(-1) ** i * 0.1}",
            down=down,
            limits=LIMITS,
            end=end.format(joint=f"{called}{i}"),
        )
        for i in range(number)
    )


ENDLESS, WIDE = WHEEL.replace("{limits}", ""), WHEEL.replace("{limits}", 'range="-1e3 1e3"')
HANDS = limbs(2, "a", down=-0.1)
GRIPPER = "".join(
    f'<body name="l{i}"><joint name="j{i}" {LIMITS}/><geom size=".1"/>' for i in "123"
)
GRIPPER += limbs(2, "finger_", down=0.1) + "</body>" * 3


@pytest.mark.parametrize(
    ("model", "kind"),
    [
        (body(limbs(4, "x"), free=True), "quadruped"),  # names say nothing, as a Spot's in MJCF
        (body(limbs(2, "x"), free=True), "humanoid"),  # a biped, as Berkeley's
        (body(limbs(2, "x") + HANDS, free=True), "humanoid"),  # the hands hang higher
        (body(limbs(4, "LF_HAA_"), free=False), "quadruped"),  # fixed, as in an ANYmal's URDF
        (body(limbs(2, "LL_HFE_"), free=False), "humanoid"),
        (body(limbs(2, "joint_left_leg_", ENDLESS), free=True), "wheeled"),  # as TITA's
        (body(limbs(2, "knee_", WIDE), free=False), "wheeled"),  # as TRON1's
        (body(limbs(1, "x"), free=False), "arm"),
        (body(limbs(2, "shoulder_"), free=False), "arm"),
        (body(limbs(4, "finger_"), free=False), "hand"),
        (body(GRIPPER, free=False), "arm"),  # as Franka's, whose gripper has fingers
    ],
)
def test_kind_is_told_by_the_free_joint_and_the_limbs(
    model: str, kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.xml").write_text(model, "utf-8")
    new = written(str(tmp_path / "mine.xml"), tmp_path)
    assert new.kind == kind
    assert new.floats == (kind not in ("arm", "hand"))
    wheels = [name for name in new.joint_names if name.endswith("_3")]
    assert [n for n, wheel in zip(new.joint_names, new.endless) if wheel] == wheels
    assert not np.isnan(new.lower).any()
    told = capsys.readouterr().out
    assert f"mine.yaml: {kind} (" in told
    hangs = new.floats and "<freejoint/>" not in model
    assert ("write <freejoint/> into body 'trunk'" in told) == hangs


@pytest.mark.parametrize(
    "model",
    [
        body(limbs(4, "x"), free=False),  # a hand or a quadruped
        body(limbs(1, "x"), free=True),
        body(limbs(3, "hip_"), free=True),
    ],
)
def test_a_model_that_does_not_say_its_kind_is_asked_for(
    model: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "mine.xml", tmp_path / "mine.yaml"
    path.write_text(model, "utf-8")
    assert main(["robots", "new", str(path), "--out", str(out)]) == 1
    error = capsys.readouterr().err
    assert "does not say what it is" in error
    assert "give --kind, one of quadruped, humanoid, wheeled, hand, arm" in error
    assert not out.exists()
    assert main(["robots", "new", str(path), "--out", str(out), "--kind", "quadruped"]) == 0
    assert load_robot(out).kind == "quadruped"


def actuators(joints: list[str]) -> str:
    return f"<actuator>{''.join(f'<motor joint={name!r}/>' for name in joints)}</actuator>"


DRIVEN = [f"x{leg}_{number}" for leg in range(4) for number in (1, 2)]


def corners(*names: str) -> str:
    """Return a robot whose last geoms are called as a Spot's in MuJoCo Playground."""
    text = body(limbs(4, "x"), free=True)
    for i, name in enumerate(names):
        end = f'<body name="x{i}_end" pos="0 0 -0.2"><geom'
        text = text.replace(end, f'{end} name="{name}"')
    return text


@pytest.mark.parametrize(
    ("model", "feet", "told"),
    [
        (corners("FL", "FR", "HL", "HR"), ("FL", "FR", "HL", "HR"), None),
        (corners("FL", "FR"), tuple(f"x{i}_lower" for i in range(4)), None),
        (
            body(limbs(4, "x"), free=True).replace('<body name="x0_lower"', "<body"),
            ("x1_lower", "x2_lower", "x3_lower"),
            "3 feet were found for the 4 legs of a quadruped (x1_lower, x2_lower, x3_lower): ",
        ),
        (  # a camera of the base that is called by the feet it sees
            body(limbs(2, "x") + '<site name="foot_camera"/>', free=True),
            ("x0_lower", "x1_lower"),
            None,
        ),
        (
            body(limbs(2, "x"), free=True).replace("_end", "_foot"),
            ("x0_foot", "x1_foot"),
            None,
        ),
    ],
)
def test_feet_lie_at_the_ends_of_the_legs(
    model: str,
    feet: tuple[str, ...],
    told: str | None,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "mine.xml").write_text(model, "utf-8")
    assert written(str(tmp_path / "mine.xml"), tmp_path).feet == feet
    out = capsys.readouterr().out
    assert told in out if told else "feet were found" not in out


def test_joints_without_an_actuator_are_left_out_where_others_have_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    play = '<joint name="{joint}_play" axis="0 1 0" range="-.01 .01"/>'  # as Open Duck's backlash
    plain = body(limbs(4, "x", end=play), free=True)
    pulled = '<tendon><fixed name="t"><joint joint="x0_play" coef="1"/></fixed></tendon>'
    pulled += actuators(DRIVEN).replace("</", '<motor tendon="t"/></')
    for model, number in (
        (plain.replace("</mujoco>", actuators(DRIVEN) + "</mujoco>"), 8),
        (plain.replace("</mujoco>", pulled + "</mujoco>"), 9),
        (plain, 12),  # a model without actuators: all of its joints
    ):
        (tmp_path / "mine.xml").write_text(model, "utf-8")
        (tmp_path / "mine.yaml").unlink(missing_ok=True)
        new = written(str(tmp_path / "mine.xml"), tmp_path)
        assert (new.kind, len(new.joint_names)) == ("quadruped", number)
        told = f"{12 - number} joints are left out, since the model has no actuator for them: "
        assert (told in capsys.readouterr().out) == (number < 12)


@pytest.mark.parametrize(
    ("said", "name"), [('model="my dog"', "my_dog"), ("", "file"), ('model=""', "file")]
)
def test_a_robot_is_called_as_its_model(
    said: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = body(limbs(2, "x"), free=True).replace("<mujoco", f"<mujoco {said}", 1)
    Path("file.xml").write_text(text, "utf-8")
    assert main(["robots", "new", "file.xml"]) == 0
    new = load_robot(tmp_path / f"{name}.yaml")
    assert new.name == name
    assert new.sources["joints"] == "file.xml: names, limits; order: its joints"


def test_a_scene_is_called_as_the_model_that_it_includes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("dog.xml").write_text(body(limbs(4, "x"), free=True), "utf-8")
    for k, said in enumerate(("", 'model="dog scene"')):
        Path("scene.xml").write_text(f'<mujoco {said}><include file="dog.xml"/></mujoco>', "utf-8")
        assert main(["robots", "new", "scene.xml"]) == 0
        assert load_robot(tmp_path / "dog.yaml").models == {"mjcf": "scene.xml"}, k
        Path("dog.yaml").unlink()


def test_joints_that_damp_themselves_are_told_where_actuators_do_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = body(limbs(1, "x"), free=False).replace('range="-1 1"', 'range="-1 1" damping="0.56"')
    for kv, told in (("", True), ('kv="2"', False)):
        actuators = "".join(f'<position joint="x0_{i}" kp="17" {kv}/>' for i in (1, 2))
        (tmp_path / "x.xml").write_text(
            text.replace("</mujoco>", f"<actuator>{actuators}</actuator></mujoco>"), "utf-8"
        )
        new = written(str(tmp_path / "x.xml"), tmp_path, f"x{told}")
        assert np.isnan(new.joint_damping).all() == told
        assert ("by 0.56 N·m·s/rad at most: damping: 0.0" in capsys.readouterr().out) == told


def test_the_rover_is_wheeled(tmp_path: Path) -> None:
    new = written(str(ROOT / "examples/rover/rover.xml"), tmp_path)
    shipped = load_robot(ROOT / "examples/rover/rover.yaml")
    assert (new.kind, new.feet) == ("wheeled", ())
    own = [new.joint_names.index(name) for name in shipped.joint_names]
    np.testing.assert_allclose(new.lower[own], shipped.lower, atol=0.01)


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
        ([str(model), "--out", str(there)], f"{there} exists; move it away"),
        ([str(model), "--out", str(tmp_path / "x.txt")], "x.txt is not a .yaml file"),
        ([str(model), "--out", str(tmp_path / "no/x.yaml")], "cannot write"),
        ([str(empty), "--out", str(tmp_path / "e.yaml")], "no joint that turns or slides"),
        ([str(tmp_path / "none.xml")], "none.xml"),
        ([str(model), "--kind", "dog"], "--kind dog is none of quadruped, humanoid, wheeled, hand"),
    ):
        assert main(["robots", "new", *arguments]) == 1
        error = capsys.readouterr().err
        assert told in error
        assert error.count("\n") == 1
    assert there.read_text("utf-8") == "mine"
    assert not (tmp_path / "e.yaml").exists()

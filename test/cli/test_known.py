"""`unicon robots`, `policies`, `platforms`, `faces`, `blocks`, `workflows`, `policies import`."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
from pathlib import Path

import policy_folders
import pytest
import yaml

from unicon_core.policies import load_policy
from unicon_core.robots import load_robot, robot_names
from unicon_core.workflow import workflow_names
from unicon_core.workflow.registry import known
from unicon_ros.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT / "test" / "cli" / "golden"
KINDS = ("robots", "policies", "platforms", "faces", "blocks", "workflows")


def unicon(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that succeeds; return what it prints."""
    status = main(list(arguments))
    told = capsys.readouterr()
    assert (status, told.err) == (0, "")
    return told.out


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that is refused; return its one line."""
    status = main(list(arguments))
    told = capsys.readouterr()
    assert (status, told.out) == (1, "")
    assert told.err.count("\n") == 1
    return told.err.removeprefix("unicon: error: ").rstrip("\n")


def check_golden(name: str, told: str) -> None:
    """Compare with a golden file; UNICON_WRITE_GOLDEN=1 writes it anew."""
    golden = GOLDEN / f"{name}.txt"
    told = told.replace(str(ROOT), "ROOT")
    if os.environ.get("UNICON_WRITE_GOLDEN"):
        GOLDEN.mkdir(exist_ok=True)
        golden.write_text(told, encoding="utf-8")
    assert told == golden.read_text(encoding="utf-8")


def test_what_a_terminal_cannot_show_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    told = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr("sys.stdout", told)
    assert main(["robots", "go2"]) == 0
    assert b"N?m" in told.buffer.getvalue()  # type: ignore[attr-defined]


# -- lists ---------------------------------------------------------------------------------------


def test_every_robot_is_listed_with_what_is_missing_to_drive_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows, below = unicon(capsys, "robots").split("\n\n")
    assert [line.split()[0] for line in rows.splitlines()[1:]] == robot_names()
    assert max(map(len, rows.splitlines())) <= 120
    missing = {name: ", ".join(load_robot(name).missing_facts()) for name in robot_names()}
    assert below.splitlines() == [
        f"to drive {name}, set {each}" for name, each in missing.items() if each
    ]


def test_every_policy_is_listed_with_its_terms(capsys: pytest.CaptureFixture[str]) -> None:
    lines = unicon(capsys, "policies").splitlines()
    contract = load_policy("go2_velocity")
    row = next(line for line in lines if line.startswith("go2_velocity"))
    assert row.split()[1:4] == ["go2", "50", "12"]
    assert row.endswith(" ".join(term.name for term in contract.terms))


@pytest.mark.parametrize("kind", ["platforms", "faces", "blocks"])
def test_every_factory_is_listed_with_where_it_is(
    kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [line.split() for line in unicon(capsys, kind).splitlines()]
    listed = {
        row[0]: row[1] for row in rows if len(row) > 1 and re.fullmatch(r"[\w.]+:\w+", row[1])
    }
    assert listed == dict(known(kind))


def test_every_workflow_is_listed_with_its_description(capsys: pytest.CaptureFixture[str]) -> None:
    lines = unicon(capsys, "workflows").splitlines()
    assert [line.split()[0] for line in lines] == workflow_names()
    assert all(len(line.split()) > 3 for line in lines)


def test_a_broken_workflow_hides_no_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "workflows").mkdir()
    (tmp_path / "workflows" / "broken.yaml").write_text("robot: go2\n")
    monkeypatch.setenv("UNICON_PATH", str(tmp_path))
    told = unicon(capsys, "workflows")
    assert "missing key 'platform'" in told
    assert "go2_walk" in told


# -- one in full ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [
        ("robots", "go2"),
        ("robots", "aliengo"),
        ("robots", "dex3_left"),
        ("platforms", "fake"),
        ("blocks", "tilt_stop"),
        ("blocks", "pose"),
    ],
    ids=" ".join,
)
def test_one_in_full_is_as_its_golden_file(
    arguments: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    check_golden("_".join(arguments), unicon(capsys, *arguments))


@pytest.mark.parametrize("name", robot_names())
def test_every_robot_is_shown_with_joints_sources_and_unknowns(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    told, robot = unicon(capsys, "robots", name), load_robot(name)
    assert all(f" {joint} " in told for joint in robot.joint_names)
    assert all(f"  {group}" in told for group in robot.sources)
    assert ("CANNOT BE DRIVEN" in told) == bool(robot.missing_facts())


def test_a_policy_is_shown_with_joints_and_observation(capsys: pytest.CaptureFixture[str]) -> None:
    told, contract = unicon(capsys, "policies", "go2_velocity"), load_policy("go2_velocity")
    assert "period       0.02 s (50 Hz)" in told
    assert all(f" {joint} " in told for joint in contract.joints)
    assert f"{45} values, no history" in told


def test_a_policy_is_shown_beside_a_robot(capsys: pytest.CaptureFixture[str]) -> None:
    told = unicon(capsys, "policies", "go2_velocity", "--robot", "g1_29dof")
    rows = [line.split() for line in told.splitlines() if "_joint " in line]
    shown = {row[1]: row[2] for row in rows if row[0].isdigit() or row[0] == "-"}
    assert shown["FR_hip_joint"] == "missing"
    assert shown["left_knee_joint"] == "3"


def test_a_platform_is_shown_with_its_options(capsys: pytest.CaptureFixture[str]) -> None:
    told = unicon(capsys, "platforms", "mujoco")
    for option in ("timestep",):
        assert f"  {option} " in told
        assert f"    {option}: " in told
    assert "states  " not in told.split("\n\n")[0]  # given by the builder, no option


def test_a_block_of_ones_own_is_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "my_wave.py").write_text(
        "from unicon_core.flow import Amends, Reads\n"
        "def wave(joint_pos: Reads, joint_pos_target: Amends, height: float, speed: float = 1.0):\n"
        '    """Wave."""\n'
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    assert unicon(capsys, "blocks", "my_wave:wave") == (
        "my_wave:wave\n"
        "  joint_pos         state, reads\n"
        "  joint_pos_target  state, amends\n"
        "  height            option, to be given\n"
        "  speed             option, 1.0\n"
        "\n"
        "Wave.\n"
    )


def test_a_workflow_is_shown_as_it_is_written(capsys: pytest.CaptureFixture[str]) -> None:
    written = (ROOT / "config" / "workflows" / "go2_walk.yaml").read_text(encoding="utf-8")
    assert unicon(capsys, "workflows", "go2_walk") == written


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("robots", "go3"), "unknown robot 'go3'; did you mean 'go"),
        (("policies", "go2_veloc"), "unknown policy 'go2_veloc'; did you mean 'go2_velocity'?"),
        (("platforms", "mujco"), "unknown platform 'mujco'; did you mean 'mujoco'? known: "),
        (("blocks", "tiltstop"), "unknown block 'tiltstop'; did you mean 'tilt_stop'? known: "),
        (("workflows", "go2_wal"), "unknown workflow 'go2_wal'; did you mean 'go2_walk'? known: "),
        (("blocks", "os:nothing"), "block 'os:nothing': module 'os' has no 'nothing'; "),
    ],
)
def test_an_unknown_name_is_told_with_the_known_ones(
    arguments: tuple[str, str], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert refused(capsys, *arguments).startswith(line)


@pytest.mark.parametrize("kind", KINDS)
def test_too_many_arguments_are_wrong_usage(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main([kind, "a", "b", "c"])
    assert stopped.value.code == 2


# -- policies import -----------------------------------------------------------------------------


def test_a_complete_policy_is_imported_and_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = policy_folders.write_policy(tmp_path / "good")
    out = tmp_path / "out"
    told = unicon(capsys, "policies", "import", str(good), "--out", str(out))
    assert told == f"{out}/policy.yaml  (from policy.yaml)\n"
    run = ["run", "go2_walk", "--no-ros", "--speed", "max", "--quiet", "--duration", "0.2"]
    run += ["--set", "platform=fake", "--set", f"policies.walk={out}"]
    run += ["--set", "flow={policy: walk}"]
    assert main(run) == 0


def test_a_bare_network_is_imported_and_what_must_be_given_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = policy_folders.write_policy(tmp_path / "good")
    (good / "policy.yaml").rename(tmp_path / "contract.yaml")
    out = tmp_path / "out"
    told = unicon(capsys, "policies", "import", f"{good}/policy.onnx", "--out", str(out))
    head, says, *facts = told.splitlines()
    assert head == f"{out}/policy.yaml  (from ONNX file (no metadata))"
    assert says == "not said by the source, add to the file or under 'given':"
    names = [fact.strip().split(":")[0] for fact in facts]
    assert names == [
        "period",
        "joints",
        "default_joint_pos",
        "stiffness",
        "damping",
        "action.scale",
        "observation.terms",
    ]
    assert main(["policies", str(out)]) == 1
    known, refusal = capsys.readouterr()
    assert known.startswith(f"{out}/policy.yaml  (from policy.yaml, incomplete)\nschema: ")
    assert "onnx: policy.onnx" in known
    assert all(name in refusal for name in names)
    # What was asked for is enough: added to the file that was written, the policy is whole.
    values = yaml.safe_load((out / "policy.yaml").read_text())
    contract = yaml.safe_load((tmp_path / "contract.yaml").read_text())
    values |= {name.split(".")[0]: contract[name.split(".")[0]] for name in names}
    (out / "policy.yaml").write_text(yaml.safe_dump(values))
    assert "45 values" in unicon(capsys, "policies", str(out))


def test_an_import_replaces_no_policy_unless_it_is_told_to(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, out = policy_folders.write_policy(tmp_path / "good"), tmp_path / "out"
    words = ("policies", "import", str(good), "--out", str(out))
    unicon(capsys, *words)
    (out / "policy.yaml").write_text("edited")
    assert refused(capsys, *words) == (
        f"{out}/policy.yaml is there; give another --out, or replace it: --force"
    )
    assert (out / "policy.yaml").read_text() == "edited"
    unicon(capsys, *words, "--force")
    assert load_policy(out).name == "good"


def test_a_bare_name_that_lies_there_is_imported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    policy_folders.write_policy(tmp_path / "good")
    monkeypatch.chdir(tmp_path)
    unicon(capsys, "policies", "import", "good", "--out", "out")
    line = refused(capsys, "policies", "good")
    assert line.startswith("unknown policy 'good'; there is ./good here: write ./good; ")
    (tmp_path / "walk.yaml").write_text("robot: go2\nplatform: fake\nflow: pose\n")
    line = refused(capsys, "run", "walk.yml")
    assert line.startswith("unknown workflow 'walk.yml'; there is ./walk.yaml here: write ./walk")


def test_a_file_of_another_kind_is_no_policy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot, out = ROOT / "config" / "robots" / "go2.yaml", tmp_path / "out"
    line = refused(capsys, "policies", "import", str(robot), "--out", str(out))
    assert "this file is a robot, not a policy; name it as `robot: FILE` in a workflow" in line
    assert not out.exists()
    line = refused(capsys, "sweep", str(robot))
    assert "this file is a robot, not a sweep; " in line


JOINTS_FILE = "- a_hip\n- a_knee\n- b_hip\n- b_knee\n"


@pytest.mark.parametrize("joints", ["a_hip,a_knee,b_hip,b_knee", "FILE"])
def test_patterns_are_resolved_when_they_are_imported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], joints: str
) -> None:
    params = tmp_path / "flat" / "2025-06-01_12-00-00" / "params"
    params.mkdir(parents=True)
    policy_folders.write_network(params / "policy.onnx", 21, 4)
    robot = {
        "init_state": {"joint_pos": {".*_hip": 0.1, ".*_knee": -1.5}},
        "actuators": {"all": {"joint_names_expr": [".*"], "stiffness": 25.0, "damping": 0.5}},
    }
    action = {"class_type": "m:JointPositionAction", "joint_names": [".*"], "scale": 0.25}
    asset = {"name": "robot", "joint_names": [".*_knee"]}
    seen = {"func": "m:joint_pos_rel", "params": {"asset_cfg": asset}}
    values = {
        "sim": {"dt": 0.005}, "decimation": 4, "scene": {"robot": robot},
        "observations": {"policy": {"knees": seen}}, "actions": {"joint_pos": action},
    }  # fmt: skip
    (params / "env.yaml").write_text(yaml.safe_dump(values))
    words = ["policies", "import", str(params.parent), "--out", str(tmp_path / "out")]
    assert refused(capsys, *words) == (
        f"{params}/env.yaml: pose and gains stand there by patterns of joint names, and it does "
        "not say joints (the joint names in policy order); name them: --joints NAME,NAME… or "
        "--joints FILE, or of a robot's model: --robot ROBOT --joints '{from: model}'"
    )
    assert not (tmp_path / "out").exists()
    if joints == "FILE":
        joints = str(tmp_path / "joints.yaml")
        Path(joints).write_text(JOINTS_FILE)
    unicon(capsys, *words, "--joints", joints)
    contract = load_policy(tmp_path / "out")
    assert contract.name == "flat"
    assert contract.default_joint_pos.tolist() == pytest.approx([0.1, -1.5, 0.1, -1.5])
    assert contract.stiffness.tolist() == [25.0] * 4
    assert contract.terms[0].index == (1, 3)


def test_the_assets_policies_are_imported(
    tmp_path: Path, assets: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = "assets:policies/g1_velocity_mjlab"
    out = str(tmp_path / "out")
    told = unicon(capsys, "policies", "import", source, "--out", out, "--robot", "g1_29dof")
    assert told == (
        f"{out}/policy.yaml  (from deploy.yaml)\n"
        "note: deploy.yaml: numbers are rounded to 3 significant digits by its exporter\n"
    )
    assert (tmp_path / "out" / "policy.onnx.data").is_file()
    imported, original = load_policy(out + "/"), load_policy(source, robot=load_robot("g1_29dof"))
    assert imported.joints == original.joints
    assert imported.stiffness.tolist() == original.stiffness.tolist()
    assert [t.name for t in imported.terms] == [t.name for t in original.terms]
    told = unicon(
        capsys, "policies", "import", "assets:policies/g1_holosoma_ppo", "--out", f"{out}2"
    )
    facts = [line.strip().split(":")[0] for line in told.splitlines()[2:]]
    assert facts == ["period", "default_joint_pos", "action.scale", "observation.terms"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("policies import", "unicon policies import: error: the following arguments are required"),
        ("policies import go2_velocity", "are required: --out"),
        ("policies fetch --out x", "unicon policies fetch: error: the following arguments"),
        ("policies go2_velocity --out x", "unrecognized arguments: --out x"),
        ("policies imprt go2_velocity", "unrecognized arguments: go2_velocity"),
        ("robots new", "are required: MODEL"),
        ("robots go2 x.xml", "unrecognized arguments: x.xml"),
    ],
)
def test_a_wrong_use_is_told_with_the_usage(
    words: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words.split())
    assert ended.value.code == 2
    told = capsys.readouterr().err
    assert said in told
    assert told.startswith("usage: unicon")


@pytest.mark.parametrize("kind", KINDS)
def test_every_list_is_had_as_json(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    rows = json.loads(unicon(capsys, kind, "--json"))
    names = [row["name"] for row in rows]
    assert names == sorted(names)
    listed = unicon(capsys, kind).splitlines()
    assert all(any(line.startswith(name) for line in listed) for name in names)
    assert "leave out x" in refused(capsys, kind, "x", "--json")


def test_the_json_of_robots_says_what_is_missing(capsys: pytest.CaptureFixture[str]) -> None:
    rows = {row["name"]: row for row in json.loads(unicon(capsys, "robots", "--json"))}
    assert rows["go2"]["missing"] == list(load_robot("go2").missing_facts())
    assert (rows["go2"]["kind"], rows["go2"]["joints"]) == ("quadruped", 12)


def test_an_import_to_where_nothing_can_be_written_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    line = refused(
        capsys, "policies", "import", "go2_velocity", "--out", str(tmp_path / "file" / "out")
    )
    assert str(tmp_path / "file") in line


def test_an_import_of_broken_policies_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy_folders.write_all(tmp_path / "policies")
    for name, part in (("no_network", "policy.onnx"), ("no_external_data", "policy.onnx.data")):
        source, out = str(tmp_path / "policies" / name), str(tmp_path / "out" / name)
        assert part in refused(capsys, "policies", "import", source, "--out", out)
        assert not Path(out).exists()
    shutil.rmtree(tmp_path / "policies")

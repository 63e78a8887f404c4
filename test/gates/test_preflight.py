"""`unicon preflight`: looks at the live robot, names what fails, and sends nothing; `--wiggle`."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable
from functools import partialmethod
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gate_robots
import pytest

from unicon_core.robots import load_robot
from unicon_core.runtime.ticker import Ticker
from unicon_ros.cli.main import main

ROBOT = "gate_robots:make"
JOINTS = ("FR_calf_joint", "FL_calf_joint")

WORKFLOW = """\
schema: unicon.workflow/1
name: tried
robot: {robot}
platform: gate_robots:make
rate: 100
pacing: {{hang: 20}}
{policies}
flow: {flow}
safety: [finite, joint_limits, tilt_stop]
"""


@pytest.fixture(autouse=True)
def nothing_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin anew; a look takes 0.2 s here."""
    gate_robots.SENT.clear()
    monkeypatch.setattr("unicon_ros.cli.preflight.SHORTEST", 0.2)
    monkeypatch.setattr("unicon_core.gates.data.Rate.WINDOW", 0.1)


@pytest.fixture
def preflight(tmp_path: Path) -> Callable[..., tuple[int, dict[str, Any]]]:
    """Runs the command; returns its exit status and what it wrote as JSON."""

    def run(
        *arguments: str, robot: str = "go2", policy: bool = False, **options: Any
    ) -> tuple[int, dict[str, Any]]:
        path, told = tmp_path / "tried.yaml", tmp_path / "told.json"
        policies = "policies: {walk: go2_velocity}" if policy else ""
        flow = "{policy: walk}" if policy else "hold"
        path.write_text(WORKFLOW.format(robot=robot, policies=policies, flow=flow))
        keys = [f"--set=platforms.{ROBOT}.{key}={value}" for key, value in options.items()]
        seconds = "--seconds=0.2"
        status = main(["preflight", str(path), seconds, f"--json={told}", *keys, *arguments])
        return status, json.loads(told.read_text()) if told.exists() else {}

    return run


def rows(told: dict[str, Any], ok: bool | None) -> dict[str, str]:
    """Return the rows of a kind: name to what was told."""
    return {row["name"]: row["told"] for row in told["rows"] if row["ok"] is ok}


def test_a_robot_in_order_passes_and_is_sent_nothing(
    preflight: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    status, told = preflight()
    assert status == 0
    assert gate_robots.SENT == []
    assert told["ok"]
    assert rows(told, False) == {}
    names = {"data", "rate", "changing", "imu", "posture", "tilt", "first command", "disk", "check"}
    assert names <= set(rows(told, True))
    assert "times a second, longest gap" in rows(told, True)["rate"]
    assert "accelerometer 9.8" in rows(told, True)["imu"]
    assert "calf_joint 0.76 rad" in rows(told, True)["posture"]
    assert "no joint was commanded" in capsys.readouterr().out


def test_who_does_not_tell_of_others_is_not_said_to_be_alone(
    preflight: Callable[..., Any],
) -> None:
    _, told = preflight("--set=platform=gate_robots:secretive")
    assert "see that no other program does" in rows(told, None)["commanders"]
    _, told = preflight("--set=platform=gate_robots:prepared")
    assert "1 others send to rt/command" in rows(told, False)["commanders"]


def test_the_size_of_the_first_command_is_told_joint_by_joint(
    preflight: Callable[..., Any],
) -> None:
    _, told = preflight("--set=check.accept=[pose.start]", policy=True, pose=0.3)
    assert gate_robots.SENT == []
    assert "the default pose of 'go2_velocity', 0.30 rad away" in rows(told, None)["begins at"]
    assert "an approach of 0.6 s at 0.5 rad/s" in rows(told, None)["begins at"]
    assert set(told["first_command"]) >= set(JOINTS)
    assert max(told["first_command"].values()) > 0.1
    assert "; from where it begins: 0." in rows(told, True)["first command"]
    assert max(told["first_step"].values()) < max(told["first_command"].values())


@pytest.mark.parametrize(
    ("wrong", "row"),
    [("in units of g", "imu"), ("slow", "rate"), ("beyond its limit", "posture")],
)
def test_what_fails_is_named_with_its_remedy(
    preflight: Callable[..., Any], capsys: pytest.CaptureFixture[str], wrong: str, row: str
) -> None:
    status, told = preflight(wrong=wrong)
    assert status == 1
    assert not told["ok"]
    assert ";" in rows(told, False)[row]
    assert f"FAIL  {row}" in capsys.readouterr().out
    assert gate_robots.SENT == []


def test_another_variant_fails(preflight: Callable[..., Any]) -> None:
    status, told = preflight(robot="g1_29dof", wrong="variant")
    assert status == 1
    assert "mode_machine 4" in rows(told, False)["variant"]
    assert rows(told, None)["reported"] == "mode_machine 4"
    assert gate_robots.SENT == []


def test_what_a_run_would_refuse_fails(preflight: Callable[..., Any]) -> None:
    status, told = preflight("--set=start=none", policy=True)  # at once, from wherever it is
    assert status == 1
    assert "[pose.start" in rows(told, False)["check"]


def test_a_full_disk_fails(preflight: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    usage = SimpleNamespace(free=5_000_000)
    monkeypatch.setattr("unicon_core.preflight.look.shutil.disk_usage", lambda _: usage)
    status, told = preflight()
    assert status == 1
    assert "0.0 GB free in this folder, 1.1 GB are advised; make room" in rows(told, False)["disk"]


def test_whatever_the_flow_raises_is_a_reason(preflight: Callable[..., Any]) -> None:
    status, told = preflight("--set=flow={call: gate_robots:broken}")
    assert status == 1
    assert rows(told, False)["first command"] == "ValueError: broken; nothing would be sent"
    assert gate_robots.SENT == []


def test_a_fault_of_the_platform_is_told_and_nothing_is_sent(
    preflight: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    def silent(robot: Any, states: Any) -> None:
        from unicon_base.errors import Fault

        if robot.ticks > 5:
            raise Fault("topic /joint_states: no message for 0.5 s")

    monkeypatch.setitem(gate_robots.WRONG, "gone", silent)
    status, told = preflight("--wiggle", "--yes", wrong="gone")
    assert status == 3
    assert told["fault"] == "topic /joint_states: no message for 0.5 s"
    assert gate_robots.SENT == []


# -- wiggle -------------------------------------------------------------------------------------


def moved(told: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return what each joint's move showed."""
    return {each["joint"]: each for each in told["wiggle"]}


@pytest.fixture
def quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Moves at full speed."""
    monkeypatch.setattr(Ticker, "run", partialmethod(Ticker.run, full_speed=True))


@pytest.mark.usefixtures("quickly")
def test_each_joint_moves_a_little_and_its_own_encoder_follows(
    preflight: Callable[..., Any],
) -> None:
    status, told = preflight("--wiggle", "--yes")
    assert status == 0
    assert len(moved(told)) == 12
    for joint, each in moved(told).items():
        assert each["follower"] == joint
        assert 0.8 < each["share"] < 1.1
        assert each["wrong"] == ""
    assert gate_robots.SENT[-1] == "damping"
    assert gate_robots.SENT.count("damping") <= 2


@pytest.mark.usefixtures("quickly")
def test_a_robot_is_asked_to_let_go_before_a_joint_is_moved(
    preflight: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    limp = "FR_calf_joint"
    text = load_robot("go2").path.read_text("utf-8").replace("name: go2\n", "name: limp\n")
    lines = text.splitlines()
    (line,) = (k for k, line in enumerate(lines) if limp in line)
    lines[line] = lines[line].replace("stiffness: 60.0", "stiffness: 0.0")
    robot = tmp_path / "limp.yaml"
    robot.write_text("\n".join(lines), "utf-8")
    status, told = preflight(
        "--wiggle", "--yes", "--set=platform=gate_robots:secretive", robot=str(robot)
    )
    assert status == 0
    assert gate_robots.SENT[:2] == ["prepared", "command"]
    assert gate_robots.SENT.count("prepared") == 1
    assert moved(told)[limp]["follower"] == moved(told)[limp]["wrong"] == ""
    assert "not moved: the robot file gives it no stiffness" in capsys.readouterr().out
    assert len([each for each in moved(told).values() if each["follower"]]) == 11


@pytest.mark.usefixtures("quickly")
def test_a_simulated_robot_on_the_floor_moves_each_joint() -> None:
    pytest.importorskip("mujoco")
    from unicon_core.preflight.wiggle import wiggle
    from unicon_core.workflow import load_workflow

    showed = wiggle(load_workflow("go2_walk"))
    assert [each.follower for each in showed] == [each.joint for each in showed]
    assert not any(each.wrong for each in showed)


@pytest.mark.usefixtures("quickly")
def test_swapped_inverted_and_stuck_joints_are_named(preflight: Callable[..., Any]) -> None:
    status, told = preflight("--wiggle", "--yes", swapped=f"[{JOINTS[0]},{JOINTS[1]}]")
    assert status == 1
    each = moved(told)[JOINTS[0]]
    assert each["follower"] == JOINTS[1]
    assert f"{JOINTS[1]} moved instead of {JOINTS[0]}: they are swapped" in each["wrong"]
    assert [name for name, each in moved(told).items() if each["wrong"]] == list(JOINTS)


@pytest.mark.usefixtures("quickly")
def test_a_joint_that_goes_away_while_it_is_held_ends_it(preflight: Callable[..., Any]) -> None:
    """Exchanged encoders of joints that are far apart: each is held at the other's place."""
    status, told = preflight("--wiggle", "--yes", swapped="[FR_hip_joint,RR_thigh_joint]")
    assert status == 3
    assert told["fault"].startswith("FR_hip_joint and RR_thigh_joint moved by up to 0.")
    assert "swapped or inverted" in told["fault"]
    assert "wiggle" not in told
    assert gate_robots.SENT[-1] == "damping"


@pytest.mark.usefixtures("quickly")
@pytest.mark.parametrize(
    ("option", "words"), [("inverted", "moved the other way"), ("stuck", "no joint followed")]
)
def test_an_inverted_or_stuck_joint_is_named(
    preflight: Callable[..., Any], option: str, words: str
) -> None:
    joint = "FL_hip_joint"  # whose range is the same on both sides
    status, told = preflight("--wiggle", "--yes", **{option: joint})
    assert status == 1
    assert words in moved(told)[joint]["wrong"]
    assert [name for name, each in moved(told).items() if each["wrong"]] == [joint]


def test_nothing_moves_without_a_yes(
    preflight: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("yes\n"))  # no terminal
    assert preflight("--wiggle")[0] == 1
    assert "standard input is none; give --yes" in capsys.readouterr().err

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    for answer in ("\n", "y\n", "no\n"):
        monkeypatch.setattr("sys.stdin", Terminal(answer))
        assert preflight("--wiggle")[0] == 1
    assert gate_robots.SENT == []


def test_nothing_moves_where_something_fails(
    preflight: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    assert preflight("--wiggle", "--yes", wrong="in units of g")[0] == 1
    assert "no joint is moved before all of this passes" in capsys.readouterr().out
    assert gate_robots.SENT == []


def test_a_move_is_small_and_a_short_look_is_refused(
    preflight: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for angle in ("0.5", "1e-300"):  # which proves nothing
        assert preflight("--wiggle", "--yes", f"--angle={angle}")[0] == 1
        assert f"--angle {angle}: give 0.01 to 0.2" in capsys.readouterr().err
    assert preflight("--set=num_robots=2", "--set=platform=fake")[0] == 1
    assert "preflight looks at one robot; leave num_robots out" in capsys.readouterr().err
    monkeypatch.undo()
    assert preflight("--seconds=0.2")[0] == 1
    assert "--seconds 0.2: give 1 to 600" in capsys.readouterr().err
    assert "command" not in gate_robots.SENT


def test_a_share_that_is_not_a_number_is_no_pass() -> None:
    from unicon_core.preflight.wiggle import Moved

    assert "no joint followed" in Moved("hip", "hip", math.nan).wrong

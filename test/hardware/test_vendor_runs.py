"""Runs on vendors' platforms before their emulated robots: printed commands, kills, reports."""

from __future__ import annotations

import shlex
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from emulated_runs import FIRST, UNICON, Served, ended
from peer import Peer
from test_one_word import needed
from vendor_robots import DRIVES, completed, serve

from unicon_base.errors import UniconError

pytestmark = pytest.mark.timeout(300)

QUICK = ("go1", "rohand")
# Robots behind DDS to the arguments of their emulator.
ALONE = ("--model=fake", "--posture=default")
DDS = {"adam_lite": ALONE, "go2": (), "t1": ALONE}


@pytest.mark.parametrize(
    "name",
    [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in DRIVES],
)
def test_the_printed_command_reaches_it(
    processes: Callable[..., Peer], tmp_path: Path, name: str
) -> None:
    needed(name)
    generation = "legged_sdk_3.8.4" if name == "aliengo" else ""
    file = completed(name, tmp_path)
    robot = serve(processes, name, file, "--model=fake", "--posture=default", generation=generation)
    command = robot.of("ready")[0]["command"]
    words = [word for word in shlex.split(command) if not word.startswith("ROS_DOMAIN_ID=")]
    assert words[:3] == ["unicon", "run", "h1_stand"]
    # On top of what is printed: patience with a busy machine.
    patient = ["--set=pacing.hang=20", f"--set=safety={robot.safety}"]
    if DRIVES[name] != "ros":
        patient += [
            f"--set=platforms.{DRIVES[name]}.{limit}" for limit in ("silence=5", "connect=20")
        ]
    run = subprocess.run(
        [*UNICON, *words[1:], *patient, "--duration=1", "--quiet"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=90,
    )
    assert run.returncode == 0, (command, run.stdout, run.stderr)
    assert robot.wait_for("first")["distance"] < FIRST


@pytest.fixture(params=DDS)
def served(request: pytest.FixtureRequest, processes: Callable[..., Peer]) -> Served:
    name = request.param
    needed(name)
    pytest.importorskip("mujoco")
    made = serve(processes, name, name, *DDS[name])
    made.options["silence"] = 1.0
    made.name = name
    return made


def begun(served: Served, folder: Path, *more: str, **sets: str) -> subprocess.Popen[str]:
    return served.run("h1_stand", folder, f"--set=robot={served.name}", *more, **sets)


@pytest.mark.slow
def test_a_killed_run_is_followed_by_another_through_all_gates(
    served: Served, tmp_path: Path
) -> None:
    ended(begun(served, tmp_path, "--dry", "--duration=2"), tmp_path)
    assert served.of("first") == []  # nothing was sent
    killed = begun(served, tmp_path)
    served.wait_for("commands")
    killed.kill()
    killed.wait(10)
    served.wait_for("silence")
    damped = len(served.of("damping"))
    ended(begun(served, tmp_path, "--duration=3"), tmp_path)
    served.wait_for("damping", damped + 1)
    assert [first["distance"] <= FIRST for first in served.of("first")] == [True, True]
    assert served.of("refused") == []


@pytest.mark.slow
def test_a_robot_that_dies_is_a_fault(served: Served, tmp_path: Path) -> None:
    left = begun(served, tmp_path)
    served.wait_for("commands")
    served.peer.kill()
    assert left.wait(60) == 3
    assert "the robot is silent" in (tmp_path / "run.txt").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("served", ["t1"], indirect=True)
def test_a_child_damps_a_robot_whose_run_is_killed(served: Served, tmp_path: Path) -> None:
    run = begun(served, tmp_path, platform=f"{{child: {served.platform}}}")
    served.wait_for("commands")
    run.kill()
    run.wait(10)
    served.wait_for("damping", timeout=30.0)


@pytest.mark.slow
def test_an_emulated_robot_is_no_hardware(processes: Callable[..., Peer], tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    from unicon_lab.evidence_report.report import report_of

    robot = serve(processes, "a1", "a1", "--model=fake", "--posture=random", "--seed=3")
    bag = tmp_path / "run.mcap"
    run = robot.run("h1_stand", tmp_path, "--set=robot=a1", "--duration=2", f"--record={bag}")
    told = ended(run, tmp_path)
    report = report_of(bag)
    assert (report["level"], report["robots"]) == ("stand_in", {"a1": "unitree_legged"})
    assert report["options"] == {"connect": 20, "silence": 5, "watchdog": 5.0}
    assert report["overruns"] == told["overruns"]
    assert "motor_temperature_c" in report
    assert "observation_age_us" in report
    assert "127.0" not in str(report)
    with pytest.raises(UniconError, match=r"run\.mcap was not on hardware: an address is loopback"):
        report_of(bag, hardware=True)

"""Preflight before emulated robots of vendors: it finds what is wrong, and passes what is not."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-unitree]'")

from emulated_runs import UNICON, Served, failed, looked
from legged_peer import free_port
from peer import Peer
from vendor_robots import serve, stepped

from unicon_core.robots import load_robot
from unicon_hardware.emulate.body import Defects
from unicon_hardware.unitree.face import face as unitree_face
from unicon_hardware.unitree_legged.platform import face as legged_face
from unicon_ros.bench.report import free_domain
from unicon_ros.cli.main import main

# A busy machine starves an emulated robot, whose frames are then fewer than they were to be.
TRIES = 3
LEGGED = ("a1", "go1")
HUNG = ("--hang", "--posture=default")
BODIES: dict[str, tuple[str, ...]] = {
    "go2": HUNG,
    "g1_29dof": (*HUNG, "--model=fake"),
    "a1": HUNG,
    "go1": HUNG,
    "adam_lite": (*HUNG, "--model=fake"),
}
JOINTS = dict.fromkeys(BODIES, ("FL_thigh_joint", "FR_thigh_joint", "RL_calf_joint"))
JOINTS["g1_29dof"] = ("left_knee_joint", "right_knee_joint", "left_elbow_joint")
# Two to swap, and one to die.
JOINTS["adam_lite"] = ("kneePitch_Left", "kneePitch_Right", "elbow_Left")
FILES = Path(__file__).resolve().parents[2] / "config" / "robots"


def file_of(name: str, folder: Path) -> str:
    """Return a robot; an Adam of 250 frames a second, which a busy machine still keeps."""
    if name != "adam_lite":
        return name
    path = folder / f"{name}.yaml"
    text = (FILES / path.name).read_text("utf-8")
    assert "rate_hz: 1000" in text
    path.write_text(text.replace("rate_hz: 1000", "rate_hz: 250"), "utf-8")
    return str(path)


def served(processes: Callable[..., Peer], name: str, folder: Path, *more: str) -> Served:
    """Serve a robot that may be looked at."""
    robot = serve(processes, name, file_of(name, folder), *BODIES[name], *more)
    if name in LEGGED:
        robot.options["poll"] = True
    return robot


def larger_adam(folder: Path) -> str:
    """Return an Adam with six joints more, as the SP has."""
    lines = Path(file_of("adam_lite", folder)).read_text("utf-8").splitlines()
    (last,) = (k for k, line in enumerate(lines) if "elbow_Right" in line and "stiffness" in line)
    more = [lines[last].replace("elbow_Right", f"wrist{k}") for k in range(6)]
    text = "\n".join((*lines[: last + 1], *more, *lines[last + 1 :], ""))
    text = text.replace("name: adam_lite", "name: adam_sp")
    text = text.replace("21, 22]", "21, 22, 23, 24, 25, 26, 27, 28]")
    path = folder / "adam_sp.yaml"
    path.write_text(text, "utf-8")
    return str(path)


def seen(robot: Served, name: str, folder: Path, *more: str) -> Any:
    """Look at it as `h1_stand` would drive it; return exit status and what was told."""
    file = file_of(name, folder)
    return looked(robot, folder, f"--set=robot={file}", *more, workflow="h1_stand")


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", BODIES)
def test_a_robot_in_order_passes(
    processes: Callable[..., Peer], tmp_path: Path, assets: Path, name: str
) -> None:
    robot = served(processes, name, tmp_path)
    for _ in range(TRIES):
        status, told = seen(robot, name, tmp_path)
        if not status:
            break
    assert (status, failed(told)) == (0, {})
    if name not in LEGGED:  # those are asked by commands that do nothing
        assert robot.of("first") == robot.of("ignored") == []


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize(
    ("defect", "row", "words"),
    [
        ("--imu-upside-down", "tilt", "set the robot upright, or correct the IMU's axes"),
        ("--rate=50", "frames", "are promised; see whether the robot is in another mode"),
    ],
)
def test_a_wrong_mounting_and_few_frames_are_found(
    processes: Callable[..., Peer],
    tmp_path: Path,
    assets: Path,
    name: str,
    defect: str,
    row: str,
    words: str,
) -> None:
    robot = served(processes, name, tmp_path, defect)
    status, told = seen(robot, name, tmp_path)
    assert status == 1
    assert words in failed(told)[row]


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", BODIES)
def test_wiggle_finds_swapped_encoders_and_a_dead_motor_at_once(
    processes: Callable[..., Peer], tmp_path: Path, assets: Path, name: str
) -> None:
    one, other, dead = JOINTS[name]
    robot = served(processes, name, tmp_path, "--swap", one, other, f"--dead={dead}")
    for _ in range(TRIES):
        status, told = seen(robot, name, tmp_path, "--wiggle", "--yes")
        if "wiggle" in told:
            break
    assert status == 1, told
    wrong = {each["joint"]: each["wrong"] for each in told["wiggle"] if each["wrong"]}
    assert set(wrong) == {one, other, dead}
    assert f"{other} moved instead of {one}: they are swapped" in wrong[one]
    assert f"no joint followed {dead}" in wrong[dead]


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", BODIES)
def test_another_who_commands_it_is_found(
    processes: Callable[..., Peer], tmp_path: Path, assets: Path, name: str
) -> None:
    robot = served(processes, name, tmp_path)
    run = robot.run("h1_stand", tmp_path, f"--set=robot={file_of(name, tmp_path)}")
    try:
        robot.wait_for("commands")
        if name in LEGGED:  # its first commands do nothing
            moved = "a command that moves it"
            robot.peer.wait_for(lambda: robot.of("commands")[-1]["worst"] > 0.005, moved, 60.0)
            robot.options["local_port"] = free_port()  # as of another machine
        status, told = seen(robot, name, tmp_path)
    finally:
        run.kill()
        run.wait(10)
    assert status == 1
    assert "1 others send to" in failed(told)["commanders"]


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("name", "emulated", "row", "words"),
    [
        ("g1_29dof", ("g1_29dof", "--variant=9"), "variant", "mode_machine 9"),
        ("g1_29dof", ("g1_23dof",), "variant", "mode_machine 4"),
        ("go2", ("h1",), "posture", "FR_calf_joint"),  # one protocol, which has no variants
    ],
)
def test_another_variant_that_tells_is_found(
    processes: Callable[..., Peer],
    tmp_path: Path,
    name: str,
    emulated: tuple[str, ...],
    row: str,
    words: str,
) -> None:
    other, *more = emulated
    robot = serve(processes, other, other, "--model=fake", *more)
    status, told = seen(robot, name, tmp_path)
    assert status == 1
    assert words in failed(told)[row]


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("name", "other", "words"),
    [
        ("go1", "a1", "no frame that it understands"),
        ("a1", "go1", "no frame that it understands"),
        ("adam_lite", "adam_sp", "29"),
    ],
)
def test_another_layout_of_frames_is_not_opened(
    processes: Callable[..., Peer], tmp_path: Path, name: str, other: str, words: str
) -> None:
    file = other
    if other == "adam_sp":
        file = larger_adam(tmp_path)
    robot = serve(processes, name, file, "--model=fake")
    robot.options |= {"connect": 3} | ({"poll": True} if name in LEGGED else {})
    command = [*UNICON, "preflight", "h1_stand", f"--set=robot={name}", *robot.sets()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 1
    (error,) = (line for line in done.stderr.splitlines() if "error" in line)
    assert "no frame that it understands" in error
    assert words in error
    assert f"the robot file {name}.yaml" in error


def quickly(folder: Path, name: str, platform: str, options: dict[str, Any]) -> Any:
    """Look in this process; return exit status and the rows that fail."""
    path = folder / "told.json"
    given = json.dumps({platform: {"address": "127.0.0.1", "silence": 5, **options}})
    arguments = [f"--set=robot={name}", f"--set=platform={platform}", f"--set=platforms={given}"]
    told = [f"--json={path}", "--seconds=1"]
    status = main(["preflight", "h1_stand", *arguments, *told])
    return status, failed(json.loads(path.read_text()))


def test_a_g1_of_another_variant_on_its_head_is_found_quickly(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    g1, domain = load_robot("g1_29dof"), free_domain()
    robot = replace(g1, transport={**g1.transport, "mode_machine": 9})
    defects = Defects(imu_upside_down=True)
    with stepped(robot, unitree_face, {"domain": domain}, defects=defects) as said:
        status, rows = quickly(tmp_path, "g1_29dof", "unitree", {"domain": domain})
    assert status == 1
    assert "mode_machine 9" in rows["variant"]
    assert "set the robot upright" in rows["tilt"]
    assert not [line for line in said if line["kind"] in ("first", "ignored")]


def test_a_slow_go1_is_found_quickly(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    port, local = free_port(), free_port()
    options = {"port": port, "local_port": local, "poll": True, "watchdog": 5}
    with stepped(load_robot("go1"), legged_face, {"port": port}, defects=Defects(rate=50.0)):
        status, rows = quickly(tmp_path, "go1", "unitree_legged", options)
    assert status == 1
    assert "frames a second, 500 are promised" in rows["frames"]

"""A motor that leaves the commanded mode in mid-run, behind every protocol that reports modes."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from emulated import Emulated
from legged_peer import free_port
from peer import Peer
from stepping import stepping
from unitree_helpers import until
from vendor_robots import completed, serve

from unicon_base.errors import Fault
from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states
from unicon_core.workflow.registry import known
from unicon_hardware.modes import UNDOCUMENTED, ModeGuard
from unicon_ros.bench.report import free_domain

PERIOD = 0.004
JOINT = 5
NAMES = ("a", "b", "c")


def dds() -> tuple[dict[str, Any], dict[str, Any]]:
    domain = free_domain()
    return {"domain": domain}, {"domain": domain, "address": "127.0.0.1"}


def unitree() -> tuple[dict[str, Any], dict[str, Any]]:
    face, driver = dds()
    return face | {"mode": ""}, driver


def dobot() -> tuple[dict[str, Any], dict[str, Any]]:
    face, driver = dds()
    return face, driver | {"layout": "sdk", "fsm_id": 2}


def legged(generation: str | None = None) -> tuple[dict[str, Any], dict[str, Any]]:
    face = {"port": free_port(), "generation": generation}
    more = {"address": "127.0.0.1", "local_port": free_port(), "watchdog": 5.0}
    return face, face | more


def arx() -> tuple[dict[str, Any], dict[str, Any]]:
    options = {"channel": f"modes{random.random()}", "interface": "virtual"}
    return options, options | {"unverified": True}


# Robot to the protocol's folder, what it needs, options of both ends, and the mode of a motor that
# has left: 8 is too hot, 0xA an overcurrent, 0x85 has the bit of a time-out.
CASES: dict[str, tuple[str, str, Callable[[], Any], int]] = {
    "go2": ("unitree", "cyclonedds", unitree, 0),
    "h1": ("unitree", "cyclonedds", unitree, 0),
    "g1_29dof": ("unitree", "cyclonedds", unitree, 0),
    "h1_2": ("unitree", "cyclonedds", unitree, 0),
    "dex3_left": ("unitree_dex3", "cyclonedds", dds, 0x85),
    "atom": ("dobot", "cyclonedds", dobot, 0),
    "adam_lite": ("pnd", "cyclonedds", dds, 0),
    "go1": ("unitree_legged", "", legged, 8),
    "a1": ("unitree_legged", "", legged, 0),
    "aliengo": ("unitree_legged", "", lambda: legged("legged_sdk_3.8.4"), 0),
    "arx_x5": ("arx", "can", arx, 0xA),
}


@contextmanager
def stepped(robot: Emulated) -> Iterator[Emulated]:
    def step() -> None:
        time.sleep(0.001)
        robot.step()

    with stepping(step, robot.face.close):
        yield robot


@contextmanager
def driven(name: str, folder: Path) -> Iterator[tuple[Emulated, Any, States]]:
    """Yield an emulated robot, its driver, which has prepared it, and the driver's states."""
    module, needs, options, _ = CASES[name]
    if needs:
        pytest.importorskip(needs, reason=f"needs {needs}")
    module = f"unicon_hardware.{module}"
    make = pytest.importorskip(f"{module}.platform").make
    file = load_robot(completed(name, folder))
    theirs, ours = options()
    states = States(standard_states(file.joint_names))
    with stepped(Emulated(file, known("faces")[file.transport["protocol"]], **theirs)) as robot:
        platform = make(states, file, PERIOD, silence=5.0, connect=10.0, **ours)
        try:
            until(lambda: not platform.prepare(), platform.recv)
            yield robot, platform, states
        finally:
            platform.close()


@pytest.mark.parametrize("name", CASES)
def test_a_motor_that_leaves_its_mode_is_a_fault_in_the_next_tick(
    name: str, tmp_path: Path
) -> None:
    with driven(name, tmp_path) as (robot, platform, states):
        modes, joint = platform._wire.modes, platform._robot.joint_names[JOINT]
        left = CASES[name][3]

        def tick() -> None:
            platform.wait(PERIOD)
            platform.recv()
            platform.send()

        def stiff() -> None:
            states["joint_pos_target"][...] = states["joint_pos"]
            states["joint_stiffness"][...], states["joint_damping"][...] = 5.0, 0.5
            tick()

        robot.face.modes.leave(JOINT, left)
        until(lambda: modes.reported[JOINT] == left, tick)
        robot.face.modes._away.clear()  # commands have been limp: it may
        until(lambda: not modes.other(), tick)
        for _ in range(10):
            stiff()
        info, mode = platform.info(), f"{modes.commanded[JOINT]:#04x}"
        assert info["unguarded_modes"] == []
        assert f"{mode} (commanded {mode})" in info["notes"][0]
        until(lambda: robot.states["joint_stiffness"].all())

        robot.face.modes.leave(JOINT, left)
        wrong = f"motor {joint} is in mode {left:#04x}, not in .* {modes.commanded[JOINT]:#04x}"
        with pytest.raises(Fault, match=f"{wrong} since it takes commands"):
            until(lambda: False, lambda: (modes.other() and pytest.fail("a tick late"), stiff()))
        until(lambda: not robot.states["joint_stiffness"].any(), stiff)
        robot.face.modes._away.clear()
        until(lambda: not modes.other(), stiff)  # it is back, and nothing stiff reaches it
        for _ in range(10):
            stiff()
            assert not robot.states["joint_stiffness"].any()
            assert not states["joint_stiffness"].any()


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", ["go1", "a1", "go2", "h1", "g1_29dof", "adam_lite", "atom"])
def test_a_run_ends_within_0_3_s_and_its_commands_are_limp(
    processes: Callable[..., Peer], tmp_path: Path, name: str
) -> None:
    if needs := CASES[name][1]:
        pytest.importorskip(needs, reason=f"needs {needs}")
    file = completed(name, tmp_path)
    joint = load_robot(file).joint_names[JOINT]
    wrong = f"--leave={joint}", "--leave-after=2.5"
    served = serve(processes, name, file, "--model=fake", "--posture=default", "--each", *wrong)
    run = served.run("h1_stand", tmp_path, f"--set=robot={file}", "--duration=20")
    left = served.wait_for("left its mode")
    assert left["joint"] == joint
    status, said = run.wait(60.0), (tmp_path / "run.txt").read_text()
    assert status == 3, said
    assert f"motor {joint} is in mode 0x00, not in" in said
    commands = [line for line in served.of("command") if line["stamp"] > left["after"]]
    stiff = [line["stamp"] for line in commands if line["stiffness"] > 0.0]
    assert max(stiff, default=0.0) - left["after"] < 0.3
    assert len(commands) - len(stiff) > 10  # limp ones, up to the end


def guard(*reported: int, settles: float = UNDOCUMENTED, commanded: Any = 1) -> ModeGuard:
    made = ModeGuard("platform 'x'", NAMES, commanded, settles=settles)
    made.reported[...] = reported
    return made


STIFF, LIMP = 2.0, 0.0


def sent(modes: ModeGuard, stiffness: float, torque: float) -> str:
    """Ask the guard before a command; once a motor has left its mode, it lets go of all."""
    pushing = np.full(3, stiffness, np.float32), np.full(3, torque, np.float32)
    told = modes(*pushing)
    pushes = any(values.any() for values in pushing)
    assert pushes == (bool(stiffness or torque) and not modes.left)
    return told


def test_a_motor_is_guarded_from_where_it_reports_its_mode_under_commands_that_push() -> None:
    modes = guard(1, 1, 1)
    assert sent(modes, LIMP, LIMP) == ""
    modes.reported[1] = 0
    assert sent(modes, LIMP, LIMP) == ""
    assert sent(modes, STIFF, LIMP) == ""  # a frame of before the command
    modes.reported[1] = 1
    assert sent(modes, LIMP, STIFF) == ""  # torque pushes too
    assert modes.unguarded == []
    modes.reported[2] = 7
    told = "platform 'x': motor c is in mode 0x07, not in the commanded mode 0x01 since it takes"
    assert sent(modes, LIMP, LIMP).startswith(told)
    assert sent(modes, STIFF, LIMP) == ""  # once
    modes.reported[2] = 1
    assert sent(modes, STIFF, LIMP) == ""
    assert modes.left.startswith(told)


def test_firmware_that_reports_something_else_is_not_taken_for_a_fault() -> None:
    for settles in (0.0, UNDOCUMENTED):
        modes = guard(0, 0, 0, settles=settles)
        for value in range(256):
            modes.reported[...] = value if value != 1 else 2
            assert sent(modes, STIFF, STIFF) == ""
        assert modes.unguarded == [*NAMES]


def test_a_motor_that_never_gets_into_the_mode_of_the_others_is_a_fault_after_a_while() -> None:
    modes = guard(1, 0, 1, settles=0.05)
    assert sent(modes, STIFF, LIMP) == ""
    assert sent(modes, STIFF, LIMP) == ""
    time.sleep(0.06)
    assert "motor b is in mode 0x00" in sent(modes, STIFF, LIMP)
    modes = guard(0, 0, 0, settles=0.05)
    assert sent(modes, STIFF, LIMP) == ""
    time.sleep(0.06)  # it takes long until the first one is there
    modes.reported[0] = modes.reported[2] = 1
    assert sent(modes, STIFF, LIMP) == ""
    modes.reported[1] = 1
    time.sleep(0.06)
    assert sent(modes, STIFF, LIMP) == ""
    # Of an H1 some motors are commanded 10 and some 1; whether it reports 10 is not known.
    modes = guard(1, 1, 1, settles=0.0, commanded=(10, 1, 1))
    for _ in range(3):
        assert sent(modes, STIFF, LIMP) == ""
    assert modes.unguarded == ["a"]

"""SIGKILL and SIGSTOP of a run on platform `unitree`, and of its child, at random moments.

What a real robot does when LowCmd stops is not public. So one that goes on with its last command
has to be damped by what is left of us, the child; and one with a dead man, which is assumed, has to
damp by itself where nobody is left.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest
from emulated_runs import FIRST, ROOM, EmulatedUnitree, ended
from peer import Peer

from unicon_core.platforms.kit.command import BLEND

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-unitree]'")
pytest.importorskip("mujoco")

# Of each case, of which each robot has three.
MOMENTS = int(os.environ.get("UNICON_KILLS", "20")) // 5

pytestmark = [pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(200 + 60 * MOMENTS)]

DEAD_MAN = 0.2
# Behind the first command, [s]: it lies, goes to where its flow begins, stands up, stands.
LONGEST = 5.0
# Of the child in [s]: patient with a busy machine; unless said it is 0.1.
WATCHDOG = 0.3
# Limp legs swing on a gantry, which a busy machine would see late, [s].
SETTLED = 3.0
CHILD = f"{{child: unitree, silence: 2, watchdog: {WATCHDOG}}}"
# Workflow, arguments of the emulator, arguments of the run.
ROBOTS = {
    "go2": ("go2_stand", ("go2",), ()),
    "g1": ("h1_stand", ("g1_29dof", "--hang", "--posture=default"), ("--set=robot=g1_29dof",)),
}


def child_of(pid: int) -> psutil.Process:
    """Return the process of the platform."""
    (child,) = psutil.Process(pid).children(recursive=True)
    return child


def gone(process: psutil.Process) -> bool:
    return not process.is_running() or process.status() == psutil.STATUS_ZOMBIE


@pytest.mark.parametrize("victim", ["run with child", "child", "run"])
@pytest.mark.parametrize("name", ROBOTS)
def test_it_damps_in_time_and_is_driven_again_through_the_gates(
    processes: Callable[..., Peer],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    assets: Path,
    name: str,
    victim: str,
) -> None:
    workflow, begun_as, sets = ROBOTS[name]
    monkeypatch.setenv("UNICON_ASSETS", str(assets))
    holds = victim == "run with child"  # its last command, for ever
    robot = EmulatedUnitree(processes, *begun_as, **({} if holds else {"dead_man": DEAD_MAN}))
    platform = "unitree" if victim == "run" else CHILD
    allowed = (WATCHDOG + BLEND if holds else DEAD_MAN) + ROOM
    dice, took = np.random.default_rng(2), []
    for k in range(2 * MOMENTS):
        if len(took) == MOMENTS:
            break
        number = (signal.SIGKILL, signal.SIGSTOP)[k % 2]
        heard, damped = len(robot.of("first")), len(robot.of("damping"))
        run = robot.run(workflow, tmp_path, *sets, platform=platform)
        try:
            assert robot.wait_for("first", heard + 1)["distance"] <= FIRST
            child = None if victim == "run" else child_of(run.pid)
            time.sleep(dice.uniform(0.0, LONGEST))
            if "command" in {each["by"] for each in robot.of("damping")[damped:]}:
                continue  # a busy machine: the child's watchdog was first
            killed = time.monotonic()
            os.kill(child.pid if victim == "child" and child else run.pid, number)
            while True:  # a busy machine may have let its dead man act before
                damped += 1
                damping = robot.wait_for("damping", damped)
                if damping["after"] > killed:
                    break
            took.append(damping["after"] - killed)
            assert damping["by"] == ("command" if holds else "dead man")
            assert took[-1] < allowed
            if victim == "child":
                assert run.wait(60) == 3, (tmp_path / "run.txt").read_text()
                assert "platform 'unitree'" in (tmp_path / "run.txt").read_text()
            end = time.monotonic() + 20.0
            while child is not None and not gone(child):
                assert time.monotonic() < end, "the child goes on"
                time.sleep(0.05)
        finally:
            run.kill()
            run.wait(10)
    print(
        f"{name}, {victim}: {MOMENTS} moments, damping after {min(took):.3f} to {max(took):.3f} s"
    )
    heard, damped = len(robot.of("first")), len(robot.of("damping"))
    driven = robot.run(workflow, tmp_path, *sets, "--duration=8", platform=platform)
    assert ended(driven, tmp_path)["faults"] == []
    assert robot.of("first")[heard]["distance"] <= FIRST
    assert "command" in {damping["by"] for damping in robot.of("damping")[damped:]}

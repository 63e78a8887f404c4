"""A child of a platform or its parent dies or hangs: the other one notices in time, and nothing is
left running."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
from runs import Run

from unicon_core.states.backends.shm import segments

SILENCE, WATCHDOG = 0.3, 0.4
ROOM = 2.0
"""Beyond a declared time, on a busy machine, in [s]."""

CHILD = f'platform={{child: "recording_robot:make", silence: {SILENCE}, watchdog: {WATCHDOG}}}'


def run(folder: Path) -> Run:
    alone = "safety={only: [finite, joint_limits]}"  # stale_stop would tell of it before
    attacked = Run(folder, arguments=["--quiet", "--set", CHILD, "--set", alone])
    attacked.start().until_sent(5)
    return attacked


def until(condition, timeout=20.0):
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, "it did not come to that"
        time.sleep(0.002)


def child_of(pid: int) -> int:
    return int(Path(f"/proc/{pid}/task/{pid}/children").read_text().split()[0])


def gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except OSError:
        return True


def attack(folder: Path, victim: str, number: int) -> None:
    folder.mkdir(exist_ok=True)
    attacked = run(folder)
    parent, child = attacked.process.pid, child_of(attacked.process.pid)
    begin = time.monotonic()
    os.kill(child if victim == "child" else parent, number)
    try:
        if victim == "child":
            status, _, error = attacked.wait()
            took = time.monotonic() - begin
            assert status == 3
            said = attacked.report["faults"][0]
            assert f"its process {child}" in said, error
            assert ("was killed by SIGKILL" if number == signal.SIGKILL else "hangs") in said
            assert took < SILENCE + 0.5 + ROOM
        else:
            until(lambda: attacked.times("close"))
            damped = attacked.times("close")[0] * 1e-9 - begin
            assert damped < (0.1 if number == signal.SIGKILL else WATCHDOG + 0.1) + ROOM
    finally:
        if victim == "parent":
            os.kill(parent, signal.SIGKILL)
            attacked.process.communicate()
        until(lambda: gone(child))
    assert not [found.name for found in segments() if f"-{parent}-" in found.name]


CASES = [(v, n) for v in ("child", "parent") for n in (signal.SIGKILL, signal.SIGSTOP)]


@pytest.mark.parametrize(("victim", "number"), CASES)
def test_the_other_one_ends_in_time(tmp_path, victim, number):
    attack(tmp_path / "run", victim, number)


@pytest.mark.slow
@pytest.mark.parametrize(("victim", "number"), CASES)
def test_a_hundred_times(tmp_path, victim, number):
    for k in range(100):
        attack(tmp_path / f"run{k}", victim, number)


def test_a_parent_that_goes_on_after_the_watchdog_is_at_fault(tmp_path):
    attacked = run(tmp_path)
    attacked.process.send_signal(signal.SIGSTOP)
    until(lambda: attacked.times("close"))
    attacked.process.send_signal(signal.SIGCONT)
    status, _, _ = attacked.wait()
    assert status == 3
    assert attacked.report["faults"]


@pytest.mark.parametrize(
    "fault",
    [
        *("exit", "interrupt"),  # what is not an Exception is missed first
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("value", "memory", "recursion")),
    ],
)
def test_whatever_the_platform_raises_damps_and_is_told(tmp_path, fault):
    attacked = Run(
        tmp_path,
        options=f"fault: {fault}, where: recv, at: 5",
        arguments=["--quiet", "--set", CHILD],
    )
    attacked.start()
    status, _, error = attacked.wait()
    assert status == 3, error
    assert attacked.closed
    assert "platform 'recording' raised" in attacked.report["faults"][0]
    assert error == ""


@pytest.mark.parametrize(
    ("fault", "said"),
    [("exit", "SystemExit: 7"), ("leave", "ended with status 0 and has not closed")],
)
def test_a_death_while_it_closes_is_told(tmp_path, fault, said):
    attacked = Run(
        tmp_path,
        options=f"fault: {fault}, where: close",
        arguments=["--quiet", "--duration", "0.2", "--set", CHILD],
    )
    attacked.start()
    status, _, _ = attacked.wait()
    assert status == 3
    assert said in attacked.report["faults"][0]


def test_ctrl_c_ends_the_parent_and_it_its_child(tmp_path):
    attacked = run(tmp_path)
    child = child_of(attacked.process.pid)
    attacked.process.send_signal(signal.SIGINT)
    status, _, error = attacked.wait()
    assert status == 128 + signal.SIGINT or status == 0, error
    assert gone(child)
    assert attacked.closed


def test_a_child_that_is_asked_to_end_damps(tmp_path):
    attacked = run(tmp_path)
    os.kill(child_of(attacked.process.pid), signal.SIGTERM)
    status, _, _ = attacked.wait()
    assert status == 3
    assert attacked.closed

"""A platform in a process of its own does what it does in this one."""

from __future__ import annotations

import os
import pkgutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from unicon_base.errors import (
    Fault,
    MissingDependencyError,
    ModelError,
    PlatformError,
    WorkflowError,
)
from unicon_core.check import check_workflow
from unicon_core.platforms.child.platform import _place
from unicon_core.platforms.platform import (
    CountsArrivals,
    Pausable,
    Prepares,
    Pushable,
    ReportsVariant,
    Resettable,
    SeesCommanders,
    WaitsForData,
)
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states.backends.shm import segments
from unicon_core.workflow import load_workflow
from unicon_core.workflow.registry import find_factory, known


def left():
    return [found.name for found in segments() if f"-{os.getpid()}-" in found.name]


def commands(platform, *more):
    program = load_workflow("go2_walk", [f"platform={platform}", *more])
    options = RunOptions(duration=3.0, speed="max", warn=lambda _: None)
    return Runner(program, options).run().sha256_commands


def test_the_commands_are_the_same_to_the_bit():
    pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")
    disturbed = "scene={noise: {joint_vel: 0.1}, push: {every: 1.0, velocity: 0.3}, delay: 1}"
    for more in ((), (disturbed,)):
        assert commands("{child: mujoco, silence: 10}", *more) == commands("mujoco", *more)
    assert left() == []


@pytest.mark.parametrize("name", sorted(set(known("platforms")) - {"child", "joined"}))
def test_a_child_can_import_the_factory_of_every_platform(name):
    try:
        factory = find_factory("platforms", name, PlatformError)
    except MissingDependencyError as error:
        pytest.skip(str(error))
    module, _, attribute = _place(factory).partition(":")
    assert pkgutil.resolve_name(f"{module}:{attribute}") is factory


def test_it_can_do_what_the_platform_can():
    program = load_workflow("go2_stand", ["platform={child: mujoco, silence: 10}"])
    platform = program.platform
    try:
        assert (platform.facts.name, platform.facts.simulated) == ("mujoco", True)
        assert isinstance(platform, Resettable)
        assert isinstance(platform, Pushable)
        assert not isinstance(platform, WaitsForData)
        assert platform.info()["process"] == platform.process.pid
        assert platform.model_path.is_file()
        platform.recv()
        first = program.states.joint_pos.copy()
        for _ in range(20):
            platform.send()
            platform.recv()
        assert program.states.stamp_ns == 20 * 20_000_000
        assert not np.array_equal(first, program.states.joint_pos)
        platform.reset()
        platform.recv()
        assert program.states.stamp_ns == 0
        np.testing.assert_array_equal(first, program.states.joint_pos)
        program.states.joint_pos[:] = 7.0  # a second look in one tick brings the robot's again
        platform.recv()
        np.testing.assert_array_equal(first, program.states.joint_pos)
    finally:
        program.close()
        program.close()
    assert platform.process.returncode == 0
    assert left() == []


def test_a_command_that_is_not_finite_never_leaves():
    program = load_workflow("go2_stand", ["platform={child: fake, silence: 10}"])
    program.platform.recv()
    program.states.joint_pos_target[3] = np.nan
    with pytest.raises(Fault, match=r"joint_pos_target of joint .* is nan"):
        program.platform.send()
    program.close()


def test_errors_of_the_build_are_those_of_the_platform():
    with pytest.raises(WorkflowError, match=r"scene\.initial_pose|initial_pose is 'sleeping'"):
        load_workflow("go2_stand", ["platform={child: mujoco}", "scene.initial_pose=sleeping"])
    with pytest.raises(ModelError, match="a physics step of 1e-09 s is too short"):
        load_workflow(
            "go2_stand", ["platform={child: mujoco}", "platforms={mujoco: {timestep: 1e-9}}"]
        )
    assert left() == []


def test_a_child_that_dies_is_a_fault_that_names_it():
    program = load_workflow("go2_stand", ["platform={child: fake, silence: 10}"])
    platform = program.platform
    platform.recv()
    platform.process.kill()
    platform.process.wait()
    platform.send()
    begin = time.monotonic()
    with pytest.raises(Fault, match=rf"'fake': its process {platform.process.pid} was killed by"):
        platform.recv()
    assert time.monotonic() - begin < 5.0  # not the 10 s of its silence
    program.close()
    assert left() == []


@pytest.mark.timeout(30)
def test_a_simulator_that_hangs_is_a_fault_that_names_it():
    program = load_workflow("go2_stand", ["platform={child: fake, silence: 0.5}"])
    platform = program.platform
    try:
        platform.recv()
        os.kill(platform.process.pid, signal.SIGSTOP)
        os.waitpid(platform.process.pid, os.WUNTRACED)
        platform.send()
        pattern = rf"process {platform.process.pid} has not answered for 0\.5 s"
        with pytest.raises(Fault, match=pattern):
            platform.recv()
    finally:
        os.kill(platform.process.pid, signal.SIGCONT)
        program.close()
    assert left() == []


def test_how_long_a_robot_and_its_run_wait_for_each_other():
    """Without a word of the workflow: a busy machine lets both run out, in the same words."""
    for changes, waited in (([], "0\\.04 s"), (["rate=4"], "0\\.5 s")):  # at least two periods
        program = load_workflow("go2_stand", ["platform={child: fake_robot}", *changes])
        platform = program.platform
        os.kill(platform.process.pid, signal.SIGSTOP)
        os.waitpid(platform.process.pid, os.WUNTRACED)
        try:
            with pytest.raises(Fault, match=f"has not answered for {waited}"):
                until_raised(platform.recv)
        finally:
            os.kill(platform.process.pid, signal.SIGCONT)
            program.close()
    program = load_workflow("go2_stand", ["platform={child: fake_robot, silence: 10}"])
    program.platform.recv()
    program.platform.send()
    with pytest.raises(Fault, match=r"no command came for 0\.1 s"):
        until_raised(program.platform.recv)
    program.close()


def until_raised(recv):
    while True:
        recv()
        time.sleep(0.01)


ORPHANED = """
import os, time
from unicon_core.workflow import load_workflow

program = load_workflow("go2_stand", ["platform={child: fake_robot, silence: 10}"])
program.platform.recv()
fork = os.fork()
if fork:
    print(program.platform.process.pid, fork, flush=True)
time.sleep(600)
"""


def test_a_robot_ends_with_its_parent_though_a_fork_of_that_lives():
    """The fork keeps the pipe open, and no command has come that could fail to come."""
    parent = subprocess.Popen([sys.executable, "-c", ORPHANED], stdout=subprocess.PIPE, text=True)
    child, fork = map(int, parent.stdout.readline().split())
    try:
        parent.kill()
        parent.wait()
        end = time.monotonic() + 30.0
        while cmdline(child):
            assert time.monotonic() < end
            time.sleep(0.01)
        os.kill(fork, 0)
    finally:
        os.kill(fork, signal.SIGKILL)
        parent.stdout.close()


def cmdline(pid):
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()  # a zombie's is empty
    except OSError:
        return b""


def test_a_reset_comes_behind_the_last_command():
    """Else the robot would be a tick ahead of its commands from there on, now and then."""
    program = load_workflow("go2_stand", ["platform={child: fake, silence: 10}"])
    platform = program.platform
    states = program.states
    for _ in range(50):
        platform.recv()
        platform.send()
        platform.reset()
        platform.recv()
        assert states.stamp_ns == 0
        platform.send()
        platform.recv()
        assert states.stamp_ns == 20_000_000
    program.close()


def test_a_pause_stops_the_watchdog():
    program = load_workflow("go2_stand", ["platform={child: fake, silence: 10, watchdog: 0.2}"])
    platform = program.platform
    assert isinstance(platform, Pausable)
    for pause in (True, False):
        platform.recv()
        platform.send()
        if pause:
            platform.pause()
        time.sleep(0.5)
    platform.recv()  # the answer to the last command came before
    platform.send()
    with pytest.raises(Fault, match=r"no command came for 0\.2 s"):
        platform.recv()
    program.close()


def test_a_child_that_died_after_the_last_tick_is_told():
    program = load_workflow("go2_stand", ["platform={child: fake, silence: 10}"])
    platform = program.platform
    platform.recv()
    platform.process.kill()
    with pytest.raises(Fault, match="was killed by SIGKILL"):
        program.close()
    assert left() == []


def test_a_robot_does_not_tell_when_its_data_arrive():
    changes = ["platform={child: fake_robot, silence: 10}", "pacing={trigger: state}"]
    assert "timing.trigger" in [
        found.code for found in check_workflow("go2_stand", changes).findings
    ]
    program = load_workflow("go2_stand", changes)
    with pytest.raises(PlatformError, match=r"set pacing\.trigger: deadline"):
        Runner(program, RunOptions())
    program.close()


ASKED = ["platform={child: 'asked_robot:make', silence: 10, watchdog: 10}"]


def test_a_robot_in_a_child_is_asked_by_gates_and_preflight():
    program = load_workflow("go2_stand", ASKED)
    try:
        platform = program.platform
        for protocol in (CountsArrivals, Prepares, ReportsVariant, SeesCommanders):
            assert isinstance(platform, protocol)
        assert {"rate", "variant"} <= {gate.name for gate in program.gates}
        assert platform.variant() == {"mode_machine": 4}
        assert platform.commanders() == {"rt/lowcmd": 2}
        assert [platform.prepare() for _ in range(3)] == ["step 1", "step 2", ""]
        before = platform.arrivals()
        while platform.arrivals() < before + 3:  # it takes data without being asked
            time.sleep(0.001)
    finally:
        program.close()
    assert left() == []


def test_what_a_robot_in_a_child_refuses_is_the_fault_of_the_run():
    changes = [*ASKED, "platforms={'asked_robot:make': {refuses: true}}", "pacing={hang: 20}"]
    runner = Runner(load_workflow("go2_stand", changes), RunOptions(operator=False))
    report = runner.run()
    assert report.faults == ["its own controller does not let go"]
    assert report.ticks == 0
    assert left() == []


def test_a_robot_in_a_child_that_has_gone_is_told_by_who_asks():
    program = load_workflow("go2_stand", ASKED)
    platform = program.platform
    platform.process.terminate()  # it closes in order, and answers no more
    with pytest.raises((Fault, PlatformError), match=r"has gone while|its process ended"):
        until_raised(platform.prepare)
    program.close()
    assert left() == []

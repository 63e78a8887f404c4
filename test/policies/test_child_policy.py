"""A policy whose network runs in a process of its own: in step, at real rate, and when it fails."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from slow_network import TERMS, workflow, write_slow

from unicon_base.errors import MissingDependencyError, PolicyError, UniconError, WorkflowError
from unicon_base.resources import same_modules
from unicon_core.policies.child_policy import ChildPolicy
from unicon_core.policies.networks import child
from unicon_core.runtime import Runner, RunOptions
from unicon_core.runtime.report import Report
from unicon_core.states.backends.shm import segments
from unicon_core.workflow import Program

pytest.importorskip("onnxruntime", reason="the networks are ONNX")

RISING = [{"velocity_command": {"schedule": [[0.0, 0.2, 0.0, 0.0], [0.2, 0.8, 0.0, 0.0]]}}]


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_slow(tmp_path_factory.mktemp("quick"))


@pytest.fixture(autouse=True)
def nothing_left() -> Iterator[None]:
    yield
    assert [found.name for found in segments() if f"-{os.getpid()}-" in found.name] == []


def run(values: dict[str, Any], duration: float, speed: Any = "max") -> Report:
    program = Program(**values)
    options = RunOptions(duration=duration, speed=speed, warn=lambda _: None)
    return Runner(program, options).run()


def policy_of(program: Program) -> ChildPolicy:
    (found,) = {b.tick.network.process.pid: b.tick for b in program.blocks if is_child(b)}.values()
    assert isinstance(found, ChildPolicy)
    return found


def is_child(block: Any) -> bool:
    return isinstance(block.tick, ChildPolicy)


def test_the_hash_is_the_same_twice_and_at_real_rate(quick: Path):
    values = workflow(quick, {"delay": 3})
    first, second = (run(values, 0.3).sha256_commands for _ in range(2))
    assert first == second
    assert run(workflow(quick, None), 0.3).sha256_commands != first
    # A core may be taken away for longer than the 60 ms that the action has: then it is late.
    paced = (run(values, 0.3, "real").sha256_commands for _ in range(5))
    assert first in paced


@pytest.mark.parametrize(
    ("rate", "delay"),
    [
        (50, 1),
        pytest.param(50, 3, marks=pytest.mark.slow),
        pytest.param(200, 3, marks=pytest.mark.slow),
        (200, 6),
    ],
)
def test_each_action_is_that_of_the_observation_so_many_ticks_before(
    quick: Path, rate: int, delay: int
):
    """Bit-equal to a plain loop: onnxruntime on recorded observations, memory by hand."""
    import onnxruntime

    session = onnxruntime.InferenceSession(str(quick / "policy.onnx"))
    program = Program(**workflow(quick, {"delay": delay}, rate=rate))
    states, every = program.states, rate // 50
    memory = np.zeros((1, 12), np.float32)
    held, asked, pending = None, -1, None
    runner = Runner(program, RunOptions(speed="max", warn=lambda _: None))
    offset = program.robot.default_joint_pos.astype(np.float32)
    try:
        for tick in range(60):
            before = np.concatenate([states[name] for name in TERMS])
            runner.tick(0)
            if pending is not None and tick - asked == delay:
                held, memory = session.run(None, {"obs": pending, "h_in": memory})
                held, of, pending = held[0], asked, None
            if held is None:
                assert not states["action"].any()
                assert states["action_age"] == np.float32(tick / rate)
            else:
                np.testing.assert_array_equal(states["action"], held)
                assert states["action_age"] == np.float32((tick - of) / rate)
                target = held * np.float32(0.1) + offset
                np.testing.assert_array_equal(states["joint_pos_target"], target)
            if tick % every == 0:
                seen = states["observation"].copy()
                # The newest action is what it sees, and the newest of all else.
                np.testing.assert_array_equal(seen[27:], states["action"])
                if tick:
                    np.testing.assert_array_equal(seen[24:27], before[24:27])
                if pending is None:
                    asked, pending = tick, seen[None]
    finally:
        program.close()


def test_before_its_first_action_it_holds_what_was_sent(quick: Path):
    flow = {"chain": [{"pose": {"to": "rest", "duration": 0.2}}, {"policy": "slow"}]}
    lagging = {"fake": {"time_constant": 0.5}}
    program = Program(**workflow(quick, {"delay": 4}, flow=flow, platforms=lagging))
    runner = Runner(program, RunOptions(speed="max", warn=lambda _: None))
    states = program.states
    try:
        for _ in range(10):
            runner.tick(0)
        posed = states["joint_pos_target"].copy()
        np.testing.assert_allclose(posed, program.robot.rest_joint_pos, atol=1e-5)
        for _ in range(4):
            runner.tick(0)
            np.testing.assert_array_equal(states["joint_pos_target"], posed)
            assert np.abs(states["joint_pos"] - posed).max() > 0.05
            assert states["joint_stiffness"].tolist() == [40.0] * 12
        runner.tick(0)
        assert np.abs(states["joint_pos_target"] - posed).max() > 0.1
    finally:
        program.close()


@pytest.mark.slow
def test_a_slow_network_delays_no_tick(tmp_path: Path):
    write_slow(tmp_path, turns=60_000)  # some 60 ms and more: several ticks
    ages: list[float] = []
    actions: set[bytes] = set()
    values = workflow(tmp_path, {"timeout": 5.0}, deferred=[lambda: look()])
    program = Program(**values)
    states = program.states

    def look() -> None:
        ages.append(float(states["action_age"]))
        actions.add(states["action"].tobytes())

    report = Runner(program, RunOptions(duration=1.5, warn=lambda _: None)).run()
    assert report.faults == []
    assert len(actions) > 3
    assert max(ages) >= 0.06
    assert report.blocks["policy"]["p50"] < 5_000.0


@pytest.mark.parametrize(
    ("failing", "told"),
    [
        ("nan", "policy slow: the action is not finite: joint 'FR_hip_joint' is nan; no target"),
        ("raise", "policy 'slow': its process raised "),
    ],
)
@pytest.mark.parametrize("speed", ["max", pytest.param("real", marks=pytest.mark.slow)])
def test_what_goes_wrong_there_is_told_here(tmp_path: Path, failing: Any, told: str, speed: str):
    write_slow(tmp_path, failing=failing)
    report = run(workflow(tmp_path, True, commands=RISING), 1.0, speed)
    assert report.ended == "fault"
    assert told in report.faults[0]
    assert len(report.faults) == 1
    assert 10 <= report.ticks < 25


@pytest.mark.slow
def test_a_child_that_hangs_is_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    write_slow(tmp_path, failing="hang")
    report = run(workflow(tmp_path, {"timeout": 0.2}, commands=RISING), 2.0, "real")
    assert report.ended == "fault"
    assert "policy slow: its newest action is 0.22 s old, at most 0.2 s" in report.faults[0]
    assert 18 <= report.ticks <= 25
    monkeypatch.setattr(child, "PATIENCE", 0.3)
    report = run(workflow(tmp_path, True, commands=RISING), 2.0)
    assert "has not answered for 0.3 s: it hangs or was stopped" in report.faults[0]


@pytest.mark.parametrize("speed", ["real", pytest.param("max", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("number", "told"),
    [
        (signal.SIGKILL, "was killed by SIGKILL"),
        (signal.SIGSTOP, "hangs or was stopped"),
    ],
)
def test_a_child_that_is_killed_or_stopped_is_a_fault(
    quick: Path, monkeypatch: pytest.MonkeyPatch, speed: Any, number: Any, told: str
):
    monkeypatch.setattr(child, "PATIENCE", 0.3)
    monkeypatch.setattr(child, "_CLOSING", 0.1)
    program = Program(**workflow(quick, {"timeout": 0.1}, deferred=[lambda: kill()]))
    process = policy_of(program).network.process

    def kill() -> None:
        if program.states["tick"] == 20:
            os.kill(process.pid, number)

    options = RunOptions(duration=3.0, speed=speed, warn=lambda _: None)
    report = Runner(program, options).run()
    assert report.ended == "fault"
    assert told in report.faults[0]
    assert str(process.pid) in report.faults[0]
    assert process.returncode is not None
    assert report.ticks < 30


def test_all_mentions_share_one_process_and_begin_anew(quick: Path):
    flow = {
        "chain": [
            {"loop": {"do": {"policy": "slow"}, "until": {"elapsed": 0.1}}},
            {"loop": {"do": "hold", "until": {"elapsed": 0.04}}},
            {"policy": "slow"},
        ]
    }
    program = Program(**workflow(quick, {"delay": 2}, flow=flow))
    runner = Runner(program, RunOptions(speed="max", warn=lambda _: None))
    states = program.states
    try:
        policy_of(program)
        actions = []
        for _ in range(12):
            runner.tick(0)
            actions.append(states["action"].copy())
        assert actions[3].any()
        assert not actions[7].any()
        assert not actions[8].any()
        assert actions[9].any()
    finally:
        program.close()


def test_an_answer_that_nobody_awaits_any_more_is_dropped(quick: Path, tmp_path: Path):
    """A flow enters the policy anew while the network is at work on the last observation."""
    write_slow(tmp_path, turns=20_000)
    first = {"loop": {"do": {"policy": "slow"}, "until": {"elapsed": 0.1}}}
    again = {"chain": [first, {"policy": "slow"}]}
    one, other = (run(workflow(f, {"delay": 2}, flow=again), 0.2) for f in (quick, tmp_path))
    assert one.sha256_commands == other.sha256_commands


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ({"delay": 0}, "child.delay is 0; write a whole number from 1 to 1000 [ticks]"),
        ({"delay": 1.5}, "child.delay is 1.5"),
        ({"timeout": float("nan")}, "child.timeout is nan"),
        ({"cores": 2}, "child: unknown key 'cores'"),
        ("yes", "child is 'yes'; write true or false or a mapping"),
        ({"delay": 5, "timeout": 0.1}, "child.timeout is 0.1 s, and by its delay"),
    ],
)
def test_what_is_said_wrong_is_refused(quick: Path, said: Any, told: str):
    with pytest.raises((WorkflowError, PolicyError), match="slow") as caught:
        Program(**workflow(quick, said))
    assert told in str(caught.value)


def test_errors_of_the_build_are_those_of_the_network(tmp_path: Path):
    write_slow(tmp_path)
    provider = {"provider": "cuda"}
    values = workflow(tmp_path, True)
    values["policies"]["slow"]["given"] = provider
    with pytest.raises(MissingDependencyError, match="CUDAExecutionProvider"):
        Program(**values)
    values = workflow(tmp_path, True, num_robots=2)
    with pytest.raises(UniconError, match="in a child it drives one robot"):
        Program(**values)
    (tmp_path / "policy.onnx").write_bytes(b"no network")
    with pytest.raises(PolicyError):
        Program(**workflow(tmp_path, True))


@pytest.mark.slow
def test_a_core_that_is_refused_is_told(quick: Path, capsys: pytest.CaptureFixture[str]):
    Program(**workflow(quick, {"cpu": 4000})).close()
    assert "policy 'slow': core 4000 refused" in capsys.readouterr().out


def started(folder: Path, where: Path, *more: str) -> tuple[subprocess.Popen[str], int]:
    """Start a run at real rate; return it and its child's process."""
    path = where / "slow.yaml"
    path.write_text(yaml.safe_dump(workflow(folder, {"timeout": 1.0})), "utf-8")
    command = [sys.executable, "-m", "unicon_ros", "run", str(path), "--duration", "20", *more]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=same_modules(),
        start_new_session=True,
    )
    end = time.monotonic() + 20.0
    while time.monotonic() < end:
        for pid in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split():
            if b"policies.networks.child" in Path(f"/proc/{pid}/cmdline").read_bytes():
                time.sleep(3.0)  # the ticks begin, on a busy machine too
                return process, int(pid)
        time.sleep(0.02)
    raise AssertionError(process.communicate()[0])


def gone(pid: int, patience: float = 5.0) -> bool:
    end = time.monotonic() + patience
    while time.monotonic() < end:
        try:
            if Path(f"/proc/{pid}/stat").read_text().split(") ")[1][0] == "Z":
                return True
        except OSError:
            return True
        time.sleep(0.01)
    return False


@pytest.mark.slow
def test_no_child_is_left_whatever_ends_the_parent(quick: Path, tmp_path: Path):
    (one, other), children = zip(*(started(quick, tmp_path) for _ in range(2)))
    third, third_child = started(quick, tmp_path)
    os.kill(one.pid, signal.SIGKILL)
    os.killpg(other.pid, signal.SIGINT)
    os.kill(third_child, signal.SIGKILL)
    assert gone(children[0])
    said = other.communicate(timeout=10)[0]
    assert (other.returncode, "ended         SIGINT" in said) == (0, True), said
    assert gone(children[1])
    said = third.communicate(timeout=10)[0]
    assert third.returncode == 3, said
    assert f"its process {third_child} was killed by SIGKILL" in said
    one.communicate(timeout=10)

"""Runs of several processes that begin at one moment; each is asked for what its flow saw."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path

import pytest
from peer import Peer

from unicon_base.errors import UniconError
from unicon_core.runtime import Runner, RunOptions
from unicon_core.runtime.phases import describe
from unicon_core.states.backends.shm import segments
from unicon_core.workflow import load_workflow
from unicon_ros.bench.report import free_domains

pytestmark = pytest.mark.usefixtures("short_damping")

GROUP = f"runs-{os.getpid()}"
HERE = Path(__file__).resolve().parent
APART = 0.02  # s: what is claimed

WORKFLOW = """\
name: synchronised
robot: go2
platform: fake_robot
rate: 50
duration: 0.2
pacing: {hang: 20}
start: {operator: false, gates: false, approach: 10.0, fade_in: 0.2}
flow: {zip: [{"robot_process:note": {}}, {pose: {to: stand, duration: 1.0}}]}
safety: {only: [finite, joint_limits, range_stop]}
"""


@pytest.fixture
def workflow(tmp_path: Path) -> Path:
    path = tmp_path / "synchronised.yaml"
    path.write_text(WORKFLOW)
    return path


def together(me: str, robots: str = "left, right", more: str = "") -> str:
    return f"start.together={{robots: [{robots}], me: {me}, group: {GROUP}{more}}}"


def begin(workflow: Path, runs: int, *overrides: str) -> subprocess.Popen[str]:
    command = [sys.executable, str(HERE / "robot_process.py"), str(workflow), str(runs)]
    environment = os.environ | {"PYTHONPATH": str(HERE)}
    return subprocess.Popen(
        [*command, *overrides], stdout=subprocess.PIPE, text=True, env=environment
    )


def ended(process: subprocess.Popen[str], timeout: float = 50.0) -> list[list[str]]:
    """Return the words of each run's line."""
    out, _ = process.communicate(timeout=timeout)
    assert process.returncode == 0, out
    return [line.split(maxsplit=3) for line in out.splitlines() if not line.startswith("#")]


def in_time(*processes: subprocess.Popen[str], runs: int, apart: float | None = APART) -> None:
    """Check that the flows began together each time.

    Args:
        processes: of the robots.
        runs: of each.
        apart: how far apart first ticks may be in the median of all runs in [s]; None for as late
            as a busy machine lets them come, while they are due at one moment.
    """
    said = [ended(process, 60.0 + 10.0 * runs) for process in processes]
    assert [len(each) for each in said] == [runs] * len(processes)
    began, due = [], []
    for lines in zip(*said):
        assert [line[3] for line in lines] == ["-"] * len(lines)
        assert all(float(line[2]) < 0.15 for line in lines), "a target jumped"
        for column, found in enumerate((began, due)):
            times = [int(line[column]) for line in lines]
            assert all(times)
            found.append((max(times) - min(times)) * 1e-9)
    print(f"apart: {', '.join(f'{value * 1e3:.2f}' for value in began)} ms")
    assert max(due) < 2e-3
    # A tick that the machine lets come late is late: told in the report, and not what is claimed.
    assert apart is None or sorted(began)[len(began) // 2] < apart


@pytest.mark.slow
@pytest.mark.alone
def test_two_robots_begin_together_three_times_in_a_row(workflow: Path) -> None:
    left, right = (begin(workflow, 3, together(me)) for me in ("left", "right"))
    in_time(left, right, runs=3, apart=None)
    assert not [found.name for found in segments() if GROUP in found.name]


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.timeout(400)
@pytest.mark.parametrize("platform", ["fake_robot", "mujoco"])
@pytest.mark.parametrize("when", ["together", "over zmq", "at"])
def test_two_robots_begin_together_twenty_times(
    workflow: Path, platform: str, when: str, free_ports: list[int]
) -> None:
    if when == "over zmq":
        pytest.importorskip("zmq", reason="store zmq needs pyzmq")
    if platform == "mujoco":
        pytest.importorskip("mujoco")
    said = {}
    for me in ("left", "right"):
        over = (
            "{"
            + ", ".join(
                f"{name}: 'tcp://127.0.0.1:{port}'"
                for name, port in zip(("left", "right"), free_ports)
            )
            + "}"
        )
        said[me] = {
            "together": together(me),
            "over zmq": f"start.together={{robots: {over}, me: {me}}}",
            "at": "start.at={every: 5}",
        }[when]
    runs = 20
    while when == "at" and not 0.1 < time.time() % 5.0 < 0.5:  # both mean the same one
        time.sleep(0.1)
    left, right = (begin(workflow, runs, said[me], f"platform={platform}") for me in said)
    in_time(left, right, runs=runs)


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.timeout(400)
@pytest.mark.parametrize("when", ["together", "at"])
def test_two_emulated_go2_begin_together_twenty_times(
    workflow: Path, processes: Callable[..., Peer], when: str
) -> None:
    """Each behind Unitree's DDS, in a domain of its own: four processes."""
    pytest.importorskip("cyclonedds", reason="needs cyclonedds: 'unicon_ros[hw-unitree]'")
    said = []
    for me, domain in zip(("left", "right"), free_domains(2)):
        emulate = ["-m", "unicon_ros", "emulate", "go2", "--model=fake", "--posture=default"]
        peer = processes(sys.executable, *emulate, f"--set=domain={domain}")
        peer.wait_for(lambda peer=peer: bool(peer.of("ready")), "the robot", timeout=60.0)
        options = f"{{address: 127.0.0.1, domain: {domain}, connect: 30, silence: 5}}"
        start = together(me) if when == "together" else "start.at={every: 10}"
        said.append((start, "platform=unitree", f"platforms.unitree={options}"))
    while when == "at" and not 0.1 < time.time() % 10.0 < 0.5:  # both mean the same one
        time.sleep(0.1)
    left, right = (
        begin(workflow, 20, *each, "start.approach=2.0", "pacing.priority=20") for each in said
    )
    in_time(left, right, runs=20)


@pytest.mark.slow
@pytest.mark.alone
def test_three_at_once(workflow: Path) -> None:
    three = [begin(workflow, 3, together(me, "a, b, c")) for me in "abc"]
    in_time(*three, runs=3)


@pytest.mark.slow
@pytest.mark.alone
def test_who_is_killed_while_it_waits_is_named_and_may_come_again(workflow: Path) -> None:
    # The third one is missing, so that both wait.
    robots = "left, right, third"
    left = begin(workflow, 1, together("left", robots, ", timeout: 25"))
    right = begin(workflow, 1, together("right", robots, ", timeout: 25"))
    assert left.stdout is not None
    told = ""
    while "waiting for 'third'" not in told:  # right is ready then
        told = left.stdout.readline()
    right.send_signal(signal.SIGKILL)
    right.wait()
    while "'right', which has gone: it ended or was killed" not in told:
        told = left.stdout.readline()
        assert told
    others = [begin(workflow, 1, together(me, robots)) for me in ("right", "third")]
    in_time(left, *others, runs=1)


@pytest.mark.slow
def test_who_is_killed_leaves_a_fault_that_names_it(workflow: Path) -> None:
    left = begin(workflow, 1, together("left", more=", timeout: 6"))
    third = "left, right, third"
    right = begin(workflow, 1, together("right", third))
    assert right.stdout is not None
    said = [""]
    while "waiting for 'third'" not in said[-1]:  # it has never begun
        said.append(right.stdout.readline())
        assert said[-1], said
    right.send_signal(signal.SIGKILL)
    right.communicate()
    ((began, _, _, faults),) = ended(left)
    assert began == "0"
    # Their lists differ, so that right never was ready for left's moment.
    assert faults.startswith("not started, waited 6 s for 'right', which ")


@pytest.mark.alone
def test_a_moment_of_the_clock_is_kept_and_told_in_the_report(workflow: Path) -> None:
    when = datetime.fromtimestamp(time.time() + 2.5, timezone.utc).isoformat()
    program = load_workflow(workflow, {"start.at": when, "flow": "hold"})
    assert dict(describe(program))["approach"].endswith(f"; then {when} is waited for")
    report = Runner(program).run()
    assert not report.faults
    began = report.to_dict()["start"]
    expected = datetime.fromisoformat(when).timestamp()
    wall = time.time() - (time.perf_counter_ns() - began["first_tick_ns"]) * 1e-9
    assert abs(wall - expected) < 0.5  # a busy machine may be late, and says so
    assert began["late_us"] > 0.0


@pytest.mark.alone
def test_a_simulator_waits_with_nothing_sent_and_its_commands_are_the_same(workflow: Path) -> None:
    hashes = []
    when = datetime.fromtimestamp(time.time() + 2.5, timezone.utc).isoformat()
    for start in ({"start.at": when}, {}):
        changed = {"platform": "fake", "flow": "hold", "scene.initial_pose": "rest"} | start
        report = Runner(load_workflow(workflow, changed)).run()
        assert not report.faults
        hashes.append(report.sha256_commands)
    assert hashes[0] == hashes[1]


def test_a_moment_that_has_passed_is_refused_before_anything_is_sent(workflow: Path) -> None:
    program = load_workflow(workflow, {"start.at": "2020-01-01T00:00:00Z", "flow": "hold"})
    with pytest.raises(UniconError, match=r"start: at 2020-01-01T00:00:00Z has passed"):
        Runner(program).run()
    assert not program.gate.sent.any
    assert program.gate.closed


def test_full_speed_waits_for_nobody_and_says_so(workflow: Path) -> None:
    told: list[str] = []
    changed = {"platform": "fake", "flow": "hold", "start.at": "2020-01-01T00:00:00Z"}
    report = Runner(load_workflow(workflow, changed), RunOptions(speed="max", warn=told.append))
    assert not report.run().faults
    assert told == ["start: at is not waited for with --speed max"]


def test_a_run_that_sends_nothing_lets_nobody_else_begin(workflow: Path) -> None:
    from unicon_core.workflow import Program, load_document

    told: list[str] = []
    document = load_document(workflow, [together("left"), "flow=hold"])
    program = Program(document, silent=True)
    report = Runner(program, RunOptions(warn=told.append)).run()
    assert report.dry
    assert "start: together is not waited for by a run that sends nothing" in told


def test_who_waits_may_be_stopped(workflow: Path) -> None:
    import threading

    program = load_workflow(workflow, [together("left"), "flow=hold"])
    runner = Runner(program)
    reasons: list[str] = []

    def stop() -> None:
        while "right" not in runner.waits_for:
            time.sleep(0.01)
        reasons.append(runner.waits_for)
        runner.stop()

    thread = threading.Thread(target=stop)
    thread.start()
    report = runner.run()
    thread.join()
    assert (report.ended, report.ticks, report.faults) == ("stopped", 0, [])
    assert reasons == ["'right', which is not there"]

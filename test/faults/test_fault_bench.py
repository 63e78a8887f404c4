"""`unicon bench faults`: what is measured of runs that go wrong, and a few that are made to."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from faults import bench_faults, cases_simulated
from faults.blocks import swing
from faults.case import AS_THEY_ARE, TICKS, Case, Measured, Wants
from faults.command_log import CLOSE, FAULT, RECV, SEND, CommandLog
from faults.fault_report import FaultBench
from faults.fault_run import FaultRun
from faults.judge import judge
from faults.measure import measure
from faults.on_disk import recorded_span
from faults.peers.noise import garbage, random_bits
from faults.simulated_case import ROBOTS
from unicon_base.resources import find_config, same_modules
from unicon_core.robots import load_robot
from unicon_msgs_map import Decoder, load_map
from unicon_ros.cli.main import main

CASES = {case.row: case for case in bench_faults.CASES}
POSE = np.tile([0.0, 0.8, -1.6], 4)
WRITER = """\
import os, signal, sys
from pathlib import Path
from faults.command_log import SEND, CommandLog
log = CommandLog(Path(sys.argv[1]))
for tick in range(100):
    log.add(SEND, tick, target=0.5)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_command_log_outlives_the_sigkill_of_its_writer(tmp_path: Path) -> None:
    log = CommandLog(tmp_path / "commands.log", 12)
    done = subprocess.run(
        [sys.executable, "-c", WRITER, str(log.path)], check=False, timeout=60, env=same_modules()
    )
    assert done.returncode == -signal.SIGKILL
    sent = log.of(SEND)
    assert sent["tick"].tolist() == list(range(100))
    assert (sent["target"] == 0.5).all()
    assert (np.diff(sent["time"]) > 0).all()


def run_of(tmp_path: Path, name: str = "exceptions: ValueError in recv") -> FaultRun:
    return FaultRun(CASES[name], tmp_path)


def test_commands_are_counted_from_the_fault_on_and_damping_is_none(tmp_path: Path) -> None:
    run = run_of(tmp_path)
    for tick in range(3):
        run.log.add(RECV, tick)
        run.log.add(SEND, tick, target=POSE, stiffness=20.0)
    run.log.add(FAULT, 3)
    for stiffness in (20.0, 0.0):
        run.log.add(RECV, 3)
        run.log.add(SEND, 3, target=POSE, stiffness=stiffness)
    run.log.add(CLOSE, 4)
    got = measure(run, 3)
    assert (got.commands, got.ticks, got.wild) == (1, 2, 0)
    assert got.ms is not None
    assert judge(Wants(most=1, ms=None, report=False), got) == []
    assert judge(Wants(most=0, ms=None, report=False), got) == ["1 commands, wanted at most 0"]


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30])
def test_a_command_that_no_joint_can_follow_is_never_as_wanted(
    tmp_path: Path, value: float
) -> None:
    run = run_of(tmp_path)
    run.log.add(FAULT)
    run.log.add(SEND, 1, target=POSE, stiffness=20.0)
    run.log.add(SEND, 2, target=value, stiffness=0.0)
    run.log.add(CLOSE, 2)
    got = measure(run, 3)
    assert got.wild == 1
    assert judge(Wants(most=None, report=False), got) == [
        "1 commands not finite or outside of the limits"
    ]


def test_each_thing_that_is_not_as_wanted_is_named() -> None:
    got = Measured(commands=30, status=0, gap_ms=700.0, speed=(50.0, 0.0, 0.0))
    wants = Wants(
        most=1, reason="NaN", gap_ms=400.0, speed=(1.0, 0.4, 1.0), zero_ms=650.0, lost_s=1.0
    )
    assert judge(wants, got) == [
        "30 commands, wanted at most 1",
        "never damped",
        "velocity command zero never, wanted within 650 ms",
        "status 0, wanted 3",
        "reason '' lacks 'NaN'",
        "no report",
        "700 ms between two commands",
        "velocity command 50, 0, 0",
        "no recording",
    ]


def test_commands_as_ever_are_those_of_the_motion_with_gains_of_their_own(tmp_path: Path) -> None:
    run = run_of(tmp_path)
    robot = load_robot("go2")
    run.log.add(FAULT)

    def send(tick: int, off: float = 0.0, scale: float = 1.0) -> None:
        target = robot.default_joint_pos + swing(tick) + off
        gains = {"stiffness": scale * robot.joint_stiffness, "damping": robot.joint_damping}
        run.log.add(SEND, tick, target=target, **gains)

    send(1)
    send(2, scale=1.5)
    wants = Wants(most=None, ms=None, closed=False, report=False, status=(), gains=(1.5, 1.0))
    assert judge(wants, measure(run, 0)) == []
    assert judge(replace(wants, gains=AS_THEY_ARE), measure(run, 0)) == ["gains times 1.5, 1"]
    send(3, off=0.01, scale=1.5)
    assert judge(wants, measure(run, 0)) == ["1 commands were changed"]


def test_a_robot_stands_once_its_targets_have_not_moved_for_a_while(tmp_path: Path) -> None:
    run = run_of(tmp_path)
    run.log.add(FAULT)
    for tick in range(20):
        run.log.add(SEND, tick, target=POSE + max(0, 5 - tick), stiffness=20.0)
    rows = run.log.of(SEND)
    since = (rows["time"][5] - run.log.of(FAULT)["time"][0]) * 1e-6
    assert measure(run, 0).stands_ms == pytest.approx(since)
    run.log.add(SEND, 20, target=POSE + 1.0, stiffness=20.0)
    assert measure(run, 0).stands_ms is None


def test_noise_is_taken_for_no_message_and_random_bits_are_a_whole_one() -> None:
    pytest.importorskip("rosbags")
    rng = np.random.default_rng(0)
    state = np.zeros(3, np.float32)
    mapping = load_map(find_config("maps", "default"))
    [spec] = [each for each in mapping.subscribe if each.topic == "cmd_vel"]
    decoder = Decoder.build(spec, {"velocity_command": state})
    whole = b"\0\1\0\0" + bytes(48)
    assert decoder.decode(whole)
    assert not any(decoder.decode(garbage(rng, whole)) for _ in range(2000))
    assert decoder.rejected == 2000
    assert sum(decoder.decode(random_bits(rng, whole, 6)) for _ in range(100)) > 10


def test_some_faults_come_over_ros_and_in_a_child_with_mujoco() -> None:
    marked = [case.marks for case in CASES.values() if case.mujoco]
    assert marked.count(["mujoco", "child"]) >= 5
    assert marked.count(["mujoco", "ros"]) >= 10
    for robot in ("go2", "g1"):
        of = [case.marks for case in CASES.values() if case.mujoco and case.robot == robot]
        assert {"ros", "child"} <= {mark for marks in of for mark in marks}


def test_a_command_log_is_as_wide_as_its_robot_and_says_so_itself(tmp_path: Path) -> None:
    case = next(case for case in CASES.values() if case.robot == "g1")
    run = FaultRun(case, tmp_path)
    CommandLog(run.log.path).add(SEND, 7, target=np.arange(29.0), velocity=[1.0, 2.0, 3.0])
    [row] = run.log.of(SEND)
    assert row["target"].tolist() == list(range(29))
    assert (row["tick"], row["velocity"].tolist()) == (7, [1.0, 2.0, 3.0])


def test_ticks_of_a_fault_in_processes_are_random_and_the_same_for_a_seed() -> None:
    case = CASES["exceptions: ValueError in recv"]
    ticks = [each.at for each in case.drawn()]
    assert len(set(ticks)) == TICKS
    assert ticks == [each.at for each in case.drawn()]
    assert ticks != [each.at for each in case.drawn(1)]
    assert len(case.drawn(0, 1)) == 1
    for each in CASES.values():
        assert all(
            each.ticks[0] <= one.at <= each.ticks[1] or not each.spread for one in each.drawn()
        )


def test_a_fault_without_a_record_that_can_be_read_is_told() -> None:
    got = Measured(ms=1.0, status=3, disk=["report"])
    assert judge(Wants(), got) == ["no record of the fault that can be read"]
    assert judge(Wants(), replace(got, lost_s=0.0)) == []


def test_a_recording_that_was_cut_off_is_read_as_far_as_it_is_whole(tmp_path: Path) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    folder = tmp_path / "bag"
    with rosbag2.Writer(folder, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        channel = writer.add_connection("/a", "std_msgs/msg/UInt8", typestore=store)
        for second in range(1, 6):
            writer.write(channel, second * 1_000_000_000, b"\0" * (1 << 20))
    assert recorded_span(folder) == (1_000_000_000, 5_000_000_000)
    [file] = folder.glob("*.mcap")
    file.write_bytes(file.read_bytes()[: 3 << 20])
    span = recorded_span(folder)
    assert span is not None
    assert 1_000_000_000 <= span[1] < 5_000_000_000
    file.write_bytes(file.read_bytes()[:20])
    assert recorded_span(folder) is None


def fault_bench() -> FaultBench:
    bench = FaultBench("faults", seed=0, rounds=1)
    wants = Wants(most=7, report=False)
    late = Measured(commands=7, ms=12.34, status=3, reason="late")
    assert bench.fault(Case("time", "a | b", wants), late) == []
    assert bench.fault(Case("time", "c", wants), Measured(status=3)) == ["never damped"]
    bench.conclude(["time: a | b", "time: c"])
    return bench


def test_the_tables_have_a_row_for_each_fault_that_was_run() -> None:
    text = fault_bench().markdown()
    assert "| **time** |" in text
    assert "| a \\| b | 7 |  | damped after 12.3 ms | 3 | late |  | yes |" in text
    assert "| c | 0 |  | never damped | 3 |  |  | **no** |" in text
    assert "cases that hold: 1 of 2" in text


def test_a_fault_that_does_not_hold_fails_the_assertion() -> None:
    bench = fault_bench()
    assert not bench.holds
    told = json.loads(bench.to_json())["cases"]["time: c"]
    assert told["missed"] == ["never damped"]
    assert (told["outcome"], told["declared"]["ms"], told["with"]) == ("damp", 250.0, [])
    assert "MISSED: never damped" in bench.table()


def test_a_run_that_ends_before_its_fault_is_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    left = [Measured(reached=False), Measured(commands=3)]
    monkeypatch.setattr(FaultRun, "run", lambda run: 0)
    monkeypatch.setattr(bench_faults, "measure", lambda run, status: left.pop(0))
    assert bench_faults.measured(Case("time", "c", Wants())).commands == 3
    left = [Measured(reached=False)]
    assert not bench_faults.measured(Case("time", "c", Wants(closed=False))).reached
    stood = "no tick ran for 0.41 s: more than 0.25 s are a fault (pacing.hang)"
    left = [Measured(reason=stood), Measured(reason="'joint_pos' is not finite")]
    got = bench_faults.measured(Case("time", "c", Wants(reason="joint_pos")))
    assert got.reason == "'joint_pos' is not finite"
    for reason in ("", "pacing.hang"):  # this is what the case asks for
        left = [Measured(reason=stood)]
        assert bench_faults.measured(Case("time", "c", Wants(reason=reason))).reason == stood
    left = [Measured(reason=stood)] * bench_faults.ATTEMPTS  # not without end
    assert bench_faults.measured(Case("time", "c", Wants(reason="joint_pos"))).reason == stood


def test_a_case_that_does_not_exist_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "faults", "--only", "nothing of ours"]) == 1
    assert "--only 'nothing of ours': no such case" in capsys.readouterr().err
    assert main(["bench", "faults", "--ticks", "0"]) == 1
    assert "--ticks 0: give a number from 1 to 5" in capsys.readouterr().err


def test_names_of_cases_are_unique() -> None:
    assert len(CASES) == len(bench_faults.CASES)
    assert len({case.row for case in cases_simulated.CASES}) == len(cases_simulated.CASES)


TURNING = (
    *("base_quat is the identity", "base_quat stands still"),
    "the gyroscope has the other sign",
)
"""Faults that nothing shows before the base has turned."""


def test_sensors_have_to_be_found_within_the_times_that_the_document_promises() -> None:
    document = Path(__file__).parents[2] / "docs" / "explanation" / "safety.md"
    found = re.findall(r"^\| ([\d.]+) s \|", document.read_text("utf-8"), re.MULTILINE)
    one, several, turning = (float(seconds) for seconds in found)
    for case in cases_simulated.SENSORS:
        walks = several if case.ticks == cases_simulated.WALKING else one
        promised = turning if case.name in TURNING else walks
        assert max(case.detection(robot) for robot in ROBOTS) / 50 <= promised, case.name


@pytest.mark.slow
@pytest.mark.ros
def test_a_handful_of_faults_ends_as_it_must(tmp_path: Path) -> None:
    assert told(tmp_path, "--quick") == {}


GROUPS = dict.fromkeys(case.group for case in (*cases_simulated.CASES, *bench_faults.CASES))


@pytest.mark.slow
@pytest.mark.ros
@pytest.mark.parametrize("group", GROUPS)
def test_every_fault_ends_as_it_must(tmp_path: Path, group: str) -> None:
    assert told(tmp_path, "--ticks", "2", "--only", f"{group}: ") == {}


def told(tmp_path: Path, *arguments: str) -> dict[str, list[str]]:
    """Return what the benchmark says is not as wanted; as a process, since it signals itself."""
    file = tmp_path / "faults.json"
    command = [sys.executable, "-m", "unicon_ros", "bench", "faults", "--json", str(file)]
    environment = dict(os.environ)
    subprocess.run([*command, *arguments], check=True, timeout=3600, env=environment)
    cases = json.loads(file.read_text())["cases"]
    assert cases
    return {name: case["missed"] for name, case in cases.items() if not case["holds"]}

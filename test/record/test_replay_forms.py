"""Replay as platform, as command source and as player; and records that do not fit."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rosbags")

from replaying import replay
from test_recorded_runs import noise, recorded, written

from unicon_base.errors import UniconError
from unicon_base.resources import find_config
from unicon_core.flow import Block, Stage
from unicon_core.gates.build import beginning
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.workflow import HookBlocks, Program, load_workflow
from unicon_lab.recording import open_record
from unicon_lab.recording.info import info_of, info_text
from unicon_lab.replay import verify, workflow_of
from unicon_lab.replay.platform import TARGET, ReplayPlatform
from unicon_lab.replay.player import LEFT, RIGHT, play, press
from unicon_lab.replay.workflow import others, versions
from unicon_ros.cli.main import main

BLOCK = "unicon_lab.replay.series:recorded"


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 2 s on the fake go2, at 50 Hz."""
    folder = tmp_path_factory.mktemp("bag")
    path = folder / "run.mcap"
    recorded(written(folder), path, (noise,))
    return path


def replayed(workflow: Path, bag: Path, **options: Any) -> Program:
    platforms = {TARGET: {"bag": str(bag), **options}}
    return load_workflow(workflow, {"platform": TARGET, "platforms": platforms})


def ran(program: Program) -> tuple[Report, Program]:
    return Runner(program, RunOptions(speed="max", warn=str)).run(), program


def driving(folder: Path, bag: Path, platform: str = "fake", **options: Any) -> Path:
    """Write a workflow whose flow is what was recorded."""
    flow = {"call": {"function": BLOCK, "bag": str(bag), **options}}
    return written(folder, flow=flow, platform=platform, duration=9.0)


# -- as platform --------------------------------------------------------------------------------


def test_the_same_workflow_sends_the_same_commands(bag: Path, tmp_path: Path) -> None:
    record = open_record(bag)
    program = replayed(written(tmp_path), bag)
    target = program.states["joint_pos_target"]
    report, _ = ran(program)
    assert report.ended in ("done", "duration")
    assert report.ticks == len(record.ticks) == 100
    assert report.platform == "replay"
    assert target.tobytes() == record.states("joint_pos_target")[-1].tobytes()


def test_other_rates_hold_the_newest(bag: Path, tmp_path: Path) -> None:
    recorded_pos = open_record(bag).states("joint_pos", "received")
    for rate, each in ((100, 0.5), (25, 2.0)):
        program = replayed(written(tmp_path, rate=rate, duration=None), bag)
        rows = program.platform.series.rows  # type: ignore[attr-defined]
        assert np.abs(rows - np.arange(len(rows)) * each).max() < 1.0
        for row in rows[:20]:
            program.platform.recv()
            assert program.states["joint_pos"].tobytes() == recorded_pos[row].tobytes()
        program.close()


def test_loop_start_and_reset(bag: Path, tmp_path: Path) -> None:
    stamps = open_record(bag).states("stamp_ns", "received")
    program = replayed(written(tmp_path), bag, start=1.9, loop=True)
    platform, stamp = program.platform, program.states["stamp_ns"]
    assert isinstance(platform, ReplayPlatform)
    seen = []
    for _ in range(12):
        assert not platform.recv()
        seen.append(int(stamp))
    assert seen == [*stamps[95:], *stamps[95:], *stamps[95:97]]
    platform.reset()
    platform.seek(3)
    platform.recv()
    assert int(stamp) == stamps[98]
    platform.seek(-99)
    platform.recv()
    assert int(stamp) == stamps[95]
    program.close()


def test_every_workflow_runs_on_it_that_needs_what_was_measured(bag: Path, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    report, _ = ran(replayed(Path("go2_walk"), bag, loop=True))
    assert report.ticks == 1150
    assert report.faults == []


def test_a_recording_of_a_replay_to_its_end_replays_to_the_bit(bag: Path, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    platforms = {TARGET: {"bag": str(bag)}}
    flow = {"flow.chain.0.pose.duration": 0.4, "wind_down": None, "safety": ["finite"]}
    path = tmp_path / "again.mcap"
    record, _ = recorded("go2_walk", path, platform=TARGET, platforms=platforms, **flow)
    assert record.done.tolist() == [False] * 99 + [True]
    assert not record.states("action")[-1].any()  # the policy began anew
    assert replay(record) == []


# -- as command source --------------------------------------------------------------------------


def test_recorded_commands_drive_a_simulator_and_end(bag: Path, tmp_path: Path) -> None:
    record = open_record(bag)
    report, program = ran(load_workflow(driving(tmp_path, bag)))
    assert (report.ended, report.ticks) == ("done", 100)
    for name in ("joint_pos_target", "joint_stiffness", "joint_damping"):
        assert program.states[name].tobytes() == record.states(name)[-1].tobytes()


def test_targets_alone_get_the_robots_gains_and_an_approach(bag: Path, tmp_path: Path) -> None:
    first = open_record(bag).states("joint_pos_target")[0]
    workflow = driving(tmp_path, bag, take=["joint_pos_target"], approach=0.5)
    program = load_workflow(workflow)
    runner = Runner(program, RunOptions(speed="max", warn=str))
    measured = program.robot.default_joint_pos.astype(np.float32)
    for tick in range(25):
        runner.tick(0)
        way = (tick + 1) / 26
        wanted = measured + way * (first - measured)
        assert np.allclose(program.states["joint_pos_target"], wanted, atol=1e-6)
    runner.tick(0)
    assert program.states["joint_pos_target"].tobytes() == first.tobytes()
    assert (program.states["joint_stiffness"] == program.robot.joint_stiffness).all()
    program.close()


def test_a_robot_approaches_where_the_commands_begin(bag: Path, tmp_path: Path) -> None:
    program = load_workflow(driving(tmp_path, bag, platform="fake_robot"))
    program.platform.recv()
    where = beginning(program)
    record = open_record(bag)
    assert where.joint_pos.tobytes() == record.states("joint_pos_target")[0].tobytes()
    assert where.stiffness.tobytes() == record.states("joint_stiffness")[0].tobytes()
    again = beginning(program)  # it is fresh again
    assert again.joint_pos.tobytes() == where.joint_pos.tobytes()
    program.close()


# -- as player ----------------------------------------------------------------------------------


def test_a_player_gives_every_state_as_it_was(bag: Path) -> None:
    report = play(bag, rate=20.0, start=1.0, warn=str)
    assert report.ticks == 50
    assert report.faults == []
    assert report.workflow == "play_workflow"


def test_a_player_finds_a_robot_that_the_workflow_named_by_its_path(tmp_path: Path) -> None:
    robot = tmp_path / "robots" / "mine.yaml"
    robot.parent.mkdir()
    text = find_config("robots", "go2").read_text("utf-8")
    robot.write_text(text.replace("name: go2", "name: mine", 1), "utf-8")
    path = tmp_path / "run.mcap"
    recorded(written(tmp_path, robot="robots/mine.yaml", duration=0.5), path, ())
    assert play(path, rate=20.0, warn=str).faults == []
    robot.rename(tmp_path / "moved.yaml")
    gone = r"run\.mcap: its robot 'mine' is not here \(robots/mine.yaml was in .*\): no file"
    with pytest.raises(UniconError, match=gone):
        play(path, rate=20.0, warn=str)


def test_keys_pause_seek_and_step() -> None:
    done: list[object] = []

    class Controls:
        paused = False

        def __getattr__(self, name: str) -> Callable[[], None]:
            return lambda: done.append(name)

    controls = Controls()
    take = partial(press, controls, done.append, 250)
    for pressed in (b" ", RIGHT, b"x", b"r", b"q"):
        take(pressed)
    assert done == ["pause", 250, "reset", "stop"]
    controls.paused = True
    done.clear()
    for pressed in (LEFT, b"s", b" "):
        take(pressed)
    assert done == [-250, "step", "step", "start"]


# -- what does not fit --------------------------------------------------------------------------


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["replay", *arguments]) == 1
    told = capsys.readouterr()
    assert told.err.count("\n") == 1, told.err
    return told.err


@pytest.mark.parametrize("form", [["--verify"], ["--play", "--no-ros"], ["--speed", "max"]])
@pytest.mark.parametrize("content", [None, b"", b"\x89MCAP0\r\n", b"garbage" * 99])
def test_what_is_no_record(
    form: list[str], content: bytes | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bag.mcap"
    if content is not None:
        path.write_bytes(content)
    told = refused(capsys, str(path), *form)
    assert "bag.mcap" in told


@pytest.mark.parametrize(
    ("told", "arguments"),
    [
        ("--speed does not go with --verify; leave it out", ["--verify", "--speed", "max"]),
        ("--loop does not go with --verify", ["--verify", "--loop"]),
        ("--record does not go with --play; it takes --start", ["--play", "--record", "x.mcap"]),
        ("WORKFLOW does not go with --play", ["go2_walk", "--play"]),
        ("--set does not go with --play", ["--play", "--set", "rate=5"]),
        ("--rate goes with --play", ["--rate", "2"]),
    ],
)
def test_options_that_would_be_left_alone(
    told: str, arguments: list[str], bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert told in refused(capsys, str(bag), *arguments)


@pytest.mark.parametrize("form", [["--verify"], ["--speed", "max"]])
def test_another_robots_bag(
    form: list[str], bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    values = yaml.safe_load(written(tmp_path).read_text("utf-8"))
    other = tmp_path / "other.yaml"
    other.write_text(yaml.safe_dump(values | {"robot": "g1_29dof", "flow": "hold"}), "utf-8")
    assert "the record is of robot go2" in refused(capsys, str(bag), str(other), *form)


def test_other_rates_are_refused_where_bits_are_compared(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = refused(capsys, str(bag), "--verify", "--set", "rate=100")
    assert "ticks at 50 Hz and workflow workflow at 100 Hz" in told


def test_other_states_and_a_missing_policy_are_told(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = ["--set", "states.extra={shape: [3]}", "--set", "safety=[finite, joint_limits]"]
    assert main(["replay", str(bag), "--verify", *more]) == 0
    told = capsys.readouterr().out
    assert "state 'extra' is not in the record" in told
    assert "0 of 100 ticks differ" in told
    told = refused(capsys, str(bag), "--verify", "--set", "policies.walk=./gone")
    assert "policy './gone': no such file" in told


def test_a_record_that_is_cut_off_is_compared_as_far_as_it_is_whole(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(bag.read_bytes()[:-9000])
    status = main(["replay", str(path), "--verify"])
    told = capsys.readouterr()
    assert (status == 0 and "0 of " in told.out) or "holds no tick" in told.err


def test_nan_in_a_record_is_compared_too_and_never_sent(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def blind(program: Program) -> HookBlocks:
        effort = program.states["joint_effort"]

        def damage() -> None:
            effort[2] = np.nan

        return {Stage.RECV: [Block("damage", damage, amends=("joint_effort",))]}

    path = tmp_path / "nan.mcap"
    record, _ = recorded(written(tmp_path), path, (blind,))
    assert np.isnan(record.states("joint_effort")[50, 2])
    assert main(["replay", str(path), "--verify"]) == 0
    assert "0 of 100 ticks differ" in capsys.readouterr().out

    class Broken:
        def __getattr__(self, name: str) -> Any:
            return getattr(record, name)

        def states(self, name: str, moment: str) -> Any:
            values = record.states(name, moment).copy()
            values[60:, 4] = np.nan
            return values

    monkeypatch.setattr("unicon_lab.replay.series.opened", lambda *_: Broken())
    with pytest.raises(UniconError, match=r"not finite \(FL_thigh_joint, row 60"):
        load_workflow(driving(tmp_path, path))


def test_the_wait_and_the_approach_of_a_robot_are_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    workflow = written(
        tmp_path,
        platform="fake_robot",
        start={"fade_in": 0.1, "approach": 6.0},
        duration=0.2,
        wind_down={"pose": {"to": "rest", "duration": 0.3}},
    )
    bag = tmp_path / "robot.mcap"
    assert main(["run", str(workflow), "--yes", "--quiet", "--record", str(bag)]) == 0
    phases = set(open_record(bag).phases)
    assert phases == {"wait", "approach", "run", "soft", "damp"}
    capsys.readouterr()
    assert main(["replay", str(bag), "--verify"]) == 0
    told = capsys.readouterr().out
    assert "25 ticks of phase damp cannot be replayed" in told
    assert " 0 of " in f" {told.splitlines()[-1]}"


def test_a_fault_that_is_found_behind_send_comes_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stuck = {"encoder_stop": {"timeout": 0.1, "motion": 0.05}}
    workflow = written(tmp_path, platform="fake", safety=["finite", stuck])

    def still(program: Program) -> HookBlocks:
        pos, tick = program.states["joint_pos"], program.states["tick"]

        def hold() -> None:
            if tick.flat[0] > 3:
                pos[4] = 0.5

        return {Stage.RECV: [Block("still", hold, amends=("joint_pos",))]}

    flow = {"chain": [{"pose": {"to": "rest", "duration": 1.0}}, "hold"]}
    path = tmp_path / "run.mcap"
    record, _ = recorded(workflow, path, (still,), flow=flow)
    assert not record.ended[-1]
    assert main(["replay", str(path), "--verify"]) == 0
    told = capsys.readouterr().out
    assert "the fault came again: joint FL_thigh_joint is stuck" in told
    assert f"0 of {len(record.ticks) - 1} ticks differ" in told


@pytest.mark.parametrize("said", ["0.00", " nan", "abcd"])
def test_a_record_that_does_not_say_its_period_is_named(
    said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, bag = tmp_path / "good.mcap", tmp_path / "bag.mcap"
    recorded(written(tmp_path, duration=0.2), good)
    text = b"period_s\x04\0\0\0"
    raw = good.read_bytes()
    assert text + b"0.02" in raw
    bag.write_bytes(raw.replace(text + b"0.02", text + said.encode()))
    told = f"bag.mcap does not say its period: period_s is {said!r}"
    for command in (
        ["replay", str(bag), "--speed", "max"],
        ["replay", str(bag), "--play"],
        ["analyze", str(bag), "--fit", "--out", str(tmp_path / "out")],
    ):
        assert main(command) == 1, command
        assert told in capsys.readouterr().err, command
    for command in (["replay", str(bag), "--verify"], ["bag", "info", str(bag)]):
        assert main(command) == 0, command


@pytest.mark.parametrize("said", ["[", "7", '[1, {"a": 1}]', '{"a": 1, "reads": 7}', "[" * 9999])
def test_facts_that_are_damaged_are_as_if_they_were_not_there(
    said: str, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = open_record(bag)
    document = workflow_of(record)
    for fact in ("platform_facts", "policies", "versions", "overridden", "imported_states"):
        record.facts[fact] = said  # type: ignore[index]
    monkeypatch.setattr("unicon_lab.recording.info.open_record", lambda *_: record)
    assert "100 at 50 Hz" in info_text(info_of(bag))
    assert not others(record, Program(document, dry=True))
    assert versions(record) == []
    assert verify(record, document).ticks == len(record.ticks)
    monkeypatch.setattr("unicon_lab.replay.series.open_record", lambda path: record)
    assert ran(replayed(written(tmp_path), bag))[0].ended == "done"
    if not record.told("imported_states", list):  # else it says that no command was imported
        load_workflow(driving(tmp_path, bag)).close()
    record.facts["outside"] = said  # type: ignore[index]
    assert verify(record, document).ticks == len(record.ticks)

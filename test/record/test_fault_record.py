"""The record of a fault: what is in it, who reads it, and that nothing is lost by writing it."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from replaying import cut_off, replay

from unicon_base.errors import StateError, UniconError
from unicon_core import Zip, pose
from unicon_core.flow import Block, Stage
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.workflow import HookBlocks, Program, load_workflow
from unicon_lab import fault_record
from unicon_lab.fault_record import KEPT, FaultRecord, fault_folder
from unicon_lab.recording import McapFile, mcap_file, open_record
from unicon_lab.recording.run_recording import network_hash
from unicon_lab.recording.ticks import from_json
from unicon_ros.cli.main import main

HOLD = {
    "schema": "unicon.workflow/1",
    "robot": "go2",
    "platform": "fake",
    "rate": 50,
    "duration": 60,
    "safety": ["finite", "range_stop"],
}
FLOW = {"chain": [{"pose": {"duration": 1.0}}, "hold"]}


def written(folder: Path, **more: Any) -> Path:
    path = folder / "workflow.yaml"
    path.write_text(yaml.safe_dump({**HOLD, "flow": FLOW, **more}), "utf-8")
    return path


def faulty(workflow: Path, folder: Path, at: int, **options: Any) -> tuple[Report, Path | None]:
    """Run it, and let NaN stand in a joint's position from a tick on."""
    warnings: list[str] = options.pop("warnings", [])
    record = FaultRecord(str(folder), warn=warnings.append)

    def outside(program: Program) -> HookBlocks:
        pos, tick = program.states["joint_pos"], program.states["tick"]

        def damage() -> None:
            if tick.flat[0] >= at:
                pos[..., 3] = np.nan

        return {Stage.RECV: [Block("damage", damage)]}

    program = load_workflow(workflow, options, hooks=[outside, record.hook])
    runner = Runner(program, RunOptions(speed="max", warn=str))
    record.attach(runner)
    report = runner.run()
    return report, record.write(report)


def test_the_record_of_nan_says_what_where_and_why(tmp_path: Path) -> None:
    workflow = written(tmp_path, safety=["finite", "range_stop"])
    report, path = faulty(workflow, tmp_path / "faults", 40, **{"flow.chain.0.pose.duration": 0.6})
    assert path is not None
    record = open_record(path)
    assert record.facts["reason"] == report.faults[0]
    assert "joint_pos" in record.facts["reason"]
    assert record.ticks.tolist() == list(range(41))
    assert record.ended.tolist() == [True] * 40 + [False]
    pos = record.states("joint_pos", "received")
    assert np.isnan(pos[40, 3])
    assert np.isfinite(np.delete(pos.reshape(-1), 40 * 12 + 3)).all()
    assert set(record.phases) == {"run"}
    assert record.facts["workflow_file"] == workflow.read_text("utf-8")
    assert yaml.safe_load(record.facts["workflow_effective"])["flow"]["chain"][0] == {
        "pose": {"duration": 0.6}
    }
    assert json.loads(record.facts["overridden"]) == ["flow.chain.0.pose.duration"]
    assert yaml.safe_load(record.facts["robot_file"])["name"] == "go2"
    assert json.loads(record.facts["versions"])["numpy"] == np.__version__
    assert json.loads(record.files["report.json"])["faults"] == report.faults
    events = json.loads(record.files["trace.json"])["traceEvents"]
    assert {"finite … range_stop (2 fused)", "recv"} <= {event["name"] for event in events}
    assert record.facts["layout_hash"] == record.layout.hash
    with pytest.raises(StateError, match="has no state 'nope' at 'sent'; known: base_"):
        record.states("nope")


def test_a_replay_tells_whether_the_fault_comes_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report, path = faulty(written(tmp_path), tmp_path / "faults", 40)
    assert main(["replay", str(path), "--verify"]) == 0
    told = capsys.readouterr().out
    assert f"the fault came again: {report.faults[0]}" in told
    assert "0 of 40 ticks differ" in told
    other = ["--set", "safety=[range_stop]", "--set", "robot=go2"]
    assert main(["replay", str(path), "--verify", *other]) == 0
    assert "the fault came again" in capsys.readouterr().out
    assert main(["replay", str(path), "--verify", "--set", "safety=[joint_limits]"]) == 0
    assert f"the recorded fault did not come again: {report.faults[0]}" in capsys.readouterr().out


def test_policies_are_named_with_the_hash_of_their_network(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    record = cut_off("go2_walk", tmp_path, 3, overrides={"safety": "none"}).record
    policies = json.loads(record.facts["policies"])
    assert [len(each["sha256"]) for each in policies.values()] == [64]


def test_readers_of_others_find_every_state_by_name_and_bit(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    make_reader = pytest.importorskip("mcap.reader").make_reader
    decoder = pytest.importorskip("mcap_ros2.decoder").DecoderFactory()
    from recordings import flat
    from rosbags.highlevel import AnyReader

    states = {
        "Odd__Name": {"shape": [2], "dtype": "float64"},
        "padding7": {"dtype": "bool"},
        "half": {"shape": [3], "dtype": "float16"},
        "long": {"shape": [2, 2], "dtype": "int16"},
        "grid": {"shape": [2, 3], "unit": "m"},
    }
    workflow = written(tmp_path, states=states, safety=["finite"], num_robots=2)
    told = cut_off(workflow, tmp_path / "faults", 30, overrides={})
    record, path = told.record, told.path
    fields = {
        "joint_pos": "joint_pos",
        "Odd__Name": "odd_name",
        "grid": "grid",
        "padding7": "state_padding7_2",
        "stamp_ns": "stamp_ns",
    }
    with AnyReader([path]) as reader:
        (connection,) = reader.connections
        assert connection.msgcount == len(record.ticks) == 31
        for row, (_, stamp, raw) in enumerate(reader.messages()):
            message = reader.deserialize(raw, connection.msgtype)
            assert (message.tick, message.stamp_ns) == (record.ticks[row], record.stamps[row])
            assert stamp == max(record.stamps[row], 0)
            for moment in record.moments:
                for name, field in fields.items():
                    expected = record.states(name, moment)[row]
                    there = flat(getattr(getattr(message, moment), field), expected.dtype)
                    assert there.tobytes() == expected.tobytes(), (row, moment, name)
    with path.open("rb") as stream:
        other = make_reader(stream, validate_crcs=True, decoder_factories=[decoder])
        summary = other.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.attachment_count == 3
        rows = [message for *_, message in other.iter_decoded_messages()]
        for row, message in enumerate(rows):
            there = flat(message.sent.joint_pos, np.float32)
            assert there.tobytes() == record.states("joint_pos")[row].tobytes()
            calf = record.states("joint_pos")[row, 1, 2]
            assert message.sent.joint_pos[1].fr_calf_joint == calf
        names = {each.name: each.data for each in other.iter_attachments()}
        assert names == dict(record.files)
        (facts,) = other.iter_metadata()
        assert facts.metadata == dict(record.facts)


def test_the_ring_goes_round_and_keeps_the_newest(short_ring: None, tmp_path: Path) -> None:
    workflow = written(tmp_path, safety=["finite"])
    for ticks in (74, 75, 76, 149, 400):
        record = cut_off(workflow, tmp_path / "faults", ticks).record
        assert 50 <= len(record.ticks) <= 76 or ticks < 75
        assert record.ticks.tolist() == list(range(ticks + 1 - len(record.ticks), ticks + 1))
        assert record.memories[0]["before"] == 0


@pytest.mark.parametrize("error", [ValueError("in recv"), SystemExit(7), MemoryError()])
def test_a_fault_in_the_first_tick_and_in_recv(error: BaseException, tmp_path: Path) -> None:
    program = load_workflow(written(tmp_path))
    program.close()
    record = FaultRecord(str(tmp_path / "faults"))

    def outside(program: Program) -> HookBlocks:
        def broken() -> None:
            program.states["joint_pos"][0] = 1.25
            raise error

        return {Stage.RECV: [Block("broken", broken)]}

    program = load_workflow(written(tmp_path), hooks=[outside, record.hook])
    runner = Runner(program, RunOptions(speed="max", warn=str))
    record.attach(runner)
    path = record.write(runner.run())
    assert path is not None
    found = open_record(path)
    assert found.ended.tolist() == [False]
    assert found.states("joint_pos")[0, 0] == 1.25
    assert found.memories


def test_a_run_without_a_fault_leaves_nothing(tmp_path: Path) -> None:
    report, path = faulty(written(tmp_path, duration=0.2), tmp_path / "faults", 99)
    assert (report.faults, path) == ([], None)
    assert not (tmp_path / "faults").exists()


def test_two_runs_of_a_process_that_end_at_once(tmp_path: Path) -> None:
    workflow, folder = written(tmp_path), tmp_path / "faults"
    paths: list[Path | None] = []
    runs = [
        threading.Thread(target=lambda: paths.append(faulty(workflow, folder, 60)[1]))
        for _ in range(4)
    ]
    for run in runs:
        run.start()
    for run in runs:
        run.join(30)
    assert len(set(paths)) == 4
    assert all(path is not None and len(open_record(path).ticks) == 61 for path in paths)


def test_a_name_that_another_run_takes_at_that_moment_is_left_to_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    others: list[Path] = []

    def late(path: Path) -> McapFile:
        if not others:  # it finished its own since we looked
            others.append(path)
            path.write_bytes(b"another's")
        return McapFile(path)

    monkeypatch.setattr(fault_record, "McapFile", late)
    path = faulty(written(tmp_path), tmp_path / "faults", 60)[1]
    assert path is not None
    assert len(open_record(path).ticks) == 61
    assert others[0].read_bytes() == b"another's"
    assert {each.name for each in path.parent.iterdir()} == {path.name, others[0].name}


def test_a_file_that_another_run_clears_away_before_it_is_locked_is_made_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cleared: list[Path] = []

    def late(descriptor: int, name: Path) -> None:
        if not cleared:  # what is empty counts as a killed run's
            cleared.append(Path(os.readlink(f"/proc/self/fd/{descriptor}")))
            cleared[0].unlink()
        mcap_file_lock(descriptor, name)

    mcap_file_lock = mcap_file.lock
    monkeypatch.setattr(mcap_file, "lock", late)
    path = faulty(written(tmp_path), tmp_path / "faults", 60)[1]
    assert path is not None
    assert len(open_record(path).ticks) == 61
    assert len(cleared) == 1


def test_a_robot_has_the_time_of_the_wall(short_damping: None, tmp_path: Path) -> None:
    before = time.time_ns()
    record = FaultRecord(str(tmp_path / "faults"))
    options = {"platform": "fake_robot", "safety": "none", "flow": "hold", "duration": 0.3}
    options["start"] = {"approach": 10.0, "fade_in": 0.1}

    def outside(program: Program) -> HookBlocks:
        def broken() -> None:
            if program.states["tick"] >= 10:
                raise ValueError("the fault")

        return {Stage.SAFETY: [Block("broken", broken)]}

    program = load_workflow(written(tmp_path), options, hooks=[outside, record.hook])
    runner = Runner(program, RunOptions(warn=str))
    record.attach(runner)
    path = record.write(runner.run())
    assert path is not None
    stamps = open_record(path).stamps
    assert before < stamps[0] < stamps[10] < time.time_ns()


@pytest.mark.slow
def test_a_second_fault_keeps_the_first_ones_record_and_old_ones_make_room(tmp_path: Path) -> None:
    workflow, folder = written(tmp_path), tmp_path / "faults"
    paths = [faulty(workflow, folder, 2)[1] for _ in range(KEPT + 3)]
    (folder / "mine.mcap").write_text("kept")
    kept = sorted(folder.glob("fault-*.mcap"))
    assert len(kept) == KEPT
    assert paths[-1] in kept
    assert paths[-2] in kept
    assert (folder / "mine.mcap").exists()


def test_a_reset_in_the_middle_is_replayed(short_ring: None, tmp_path: Path) -> None:
    workflow = written(tmp_path, safety=["finite"])

    def resets(program: Program, rng: Any) -> Callable[[], object]:
        tick = program.states["tick"]

        def ask() -> None:
            if tick.flat[0] in (33, 47):
                runners[-1].call_soon(runners[-1].reset)

        return ask

    runners: list[Runner] = []
    attach = FaultRecord.attach
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            FaultRecord,
            "attach",
            lambda self, runner: runners.append(runner) or attach(self, runner),
        )
        record = cut_off(workflow, tmp_path / "faults", 60, inputs=resets).record
    anew = [each["before"] for each in record.memories if each["anew"]]
    assert record.ticks[anew].tolist() == [34, 48]
    assert replay(record) == []


def test_states_that_are_too_large_are_told_and_the_rest_is_written(tmp_path: Path) -> None:
    warnings: list[str] = []
    states = {"huge": {"shape": [1 << 21]}}
    _, path = faulty(written(tmp_path, states=states), tmp_path / "f", 3, warnings=warnings)
    assert path is not None
    assert [w.split(":")[1] for w in warnings] == [" the fault record will hold no ticks"]
    record = open_record(path)
    assert len(record.ticks) == 0
    assert record.facts["reason"]


def test_a_block_that_cannot_be_looked_into_is_no_fault(tmp_path: Path) -> None:
    class Trap:
        def save(self) -> object:
            raise RuntimeError("a trap")

        def load(self, saved: object) -> None: ...

        def __call__(self) -> bool:
            return False

    block = Trap()

    warnings: list[str] = []
    record = FaultRecord(str(tmp_path), warn=warnings.append)

    def broken() -> bool:
        raise ValueError("the fault")

    program = Program(
        robot="go2",
        platform="fake",
        rate=50,
        flow=Zip(block, pose("stand")),
        safety=[broken],
        hooks=[record.hook],
    )
    runner = Runner(program, RunOptions(speed="max", warn=str))
    record.attach(runner)
    report = runner.run()
    path = record.write(report)
    assert report.faults[0].startswith("ValueError: the fault")
    assert path is not None
    (memory,) = open_record(path).memories
    assert list(memory["unproven"].values()) == ["a trap"]
    assert set(from_json(memory["blocks"])) == {"pose", "sent", "run"}
    assert warnings == []


def test_a_medium_that_takes_nothing_holds_nobody_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    let_go = threading.Event()
    monkeypatch.setattr("unicon_lab.fault_record.PATIENCE", 0.2)
    monkeypatch.setattr(McapFile, "finish", lambda self: let_go.wait(60) and 0)
    warnings: list[str] = []
    report, path = faulty(written(tmp_path), tmp_path / "faults", 3, warnings=warnings)
    assert report.faults
    assert path is None
    assert [text.split(": ")[1] for text in warnings] == ["the medium took nothing for 0.2 s"]
    let_go.set()


# -- the medium ------------------------------------------------------------------------------------


def test_a_folder_that_cannot_be_written_is_one_warning(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    warnings: list[str] = []
    report, path = faulty(written(tmp_path), tmp_path / "file", 2, warnings=warnings)
    assert report.faults
    assert path is None
    assert len(warnings) == 1
    assert warnings[0].startswith(f"no fault record in {tmp_path / 'file'}: File exists; give a")


@pytest.mark.parametrize("limit", [0, 10, 5_000, 200_000])
def test_a_full_disk_is_one_warning_and_leaves_no_rubble(limit: int, tmp_path: Path) -> None:
    warnings: list[str] = []
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    workflow = written(tmp_path)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        report, path = faulty(workflow, tmp_path / "faults", 200, warnings=warnings)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert report.faults
    assert path is None
    assert len(warnings) == 1
    assert "File too large; give a folder with room" in warnings[0]
    assert list((tmp_path / "faults").iterdir()) == []


def test_kill_9_while_writing_leaves_what_the_next_record_finishes(tmp_path: Path) -> None:
    folder = tmp_path / "faults"
    _, path = faulty(written(tmp_path), folder, 600)
    assert path is not None
    raw = path.read_bytes()
    whole = open_record(path)
    path.unlink()
    found = set()
    for cut in range(0, len(raw), len(raw) // 9):
        torn = folder / "fault-19700101T000000-torn-1-1.mcap.partial"
        torn.write_bytes(raw[:cut])
        if cut > len(raw) // 2:
            assert open_record(torn).facts == whole.facts  # as it is
        assert faulty(written(tmp_path), folder, 2)[1] is not None
        for recovered in folder.glob("fault-*torn*"):
            if recovered.suffix == ".partial":
                assert cut < 100  # not even its head was there
                recovered.unlink()
                continue
            record = open_record(recovered)
            assert record.facts == whole.facts
            assert record.ticks.tolist() == whole.ticks[: len(record.ticks)].tolist()
            found.add(len(record.ticks))
            recovered.unlink()
        for each in folder.iterdir():
            each.unlink()
    assert len(found) > 1
    assert max(found) == len(whole.ticks)


def test_a_damaged_file_is_refused_or_read_and_never_more(tmp_path: Path) -> None:
    _, path = faulty(written(tmp_path), tmp_path / "faults", 20)
    assert path is not None
    raw = path.read_bytes()
    rng = np.random.default_rng(3)
    said: list[str] = []
    for _ in range(60):
        broken = bytearray(raw)
        at = int(rng.integers(len(raw)))
        broken[at : at + 8] = rng.bytes(8)
        path.write_bytes(broken[: len(raw) if rng.random() < 0.7 else int(rng.integers(len(raw)))])
        try:
            open_record(path)
        except UniconError as error:
            said.append(str(error))
    assert 0 < len(said) < 60
    assert all("is not a record of ticks" in text for text in said)
    with pytest.raises(UniconError, match="cannot read"):
        open_record(tmp_path / "nope.mcap")


# -- unicon run and the folder ---------------------------------------------------------------------

TRIP = """
from unicon_core.flow import Tick

def trip(*, at: int) -> Tick:
    count = 0
    def tick():
        nonlocal count
        count += 1
        if count > at:
            raise RuntimeError("tripped")
    return tick
"""


def run_of(folder: Path, at: int) -> list[str]:
    (folder / "tripping.py").write_text(TRIP)
    path = written(folder, safety=["finite", {"tripping:trip": {"at": at}}])
    return ["run", str(path), "--no-ros", "--speed", "max", "--quiet"]


def test_unicon_run_prints_where_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("UNICON_FAULTS", str(tmp_path / "here"))
    assert main(run_of(tmp_path, 20)) == 3
    (path,) = (tmp_path / "here").iterdir()
    assert f"fault record  {path}\n" in capsys.readouterr().out
    record = open_record(path)
    assert record.facts["reason"].startswith("RuntimeError: tripped")
    assert "raise RuntimeError" in record.facts["traceback"]
    assert main([*run_of(tmp_path, 20), "--faults", str(tmp_path / "there")]) == 3
    assert len(list((tmp_path / "there").iterdir())) == 1
    assert main([*run_of(tmp_path, 20), "--faults", "off"]) == 3
    assert len(list((tmp_path / "here").iterdir())) == 1
    assert "fault record" in capsys.readouterr().out.split("faults")[1]


def test_where_it_goes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("UNICON_FAULTS", "/there")
    assert fault_folder("/here") == Path("/here")
    assert fault_folder() == Path("/there")
    assert fault_folder("off") is None
    monkeypatch.setenv("UNICON_FAULTS", "off")
    assert fault_folder() is None
    monkeypatch.delenv("UNICON_FAULTS")
    assert fault_folder() == tmp_path / "unicon" / "faults"
    monkeypatch.delenv("XDG_STATE_HOME")
    assert fault_folder() == tmp_path / "home" / ".local" / "state" / "unicon" / "faults"


@pytest.mark.slow
def test_two_runs_at_once_and_one_that_is_killed(tmp_path: Path) -> None:
    folder = tmp_path / "faults"
    environment = os.environ | {"UNICON_FAULTS": str(folder), "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-m", "unicon_ros", *run_of(tmp_path, 700)]
    runs = [subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL) for _ in range(3)]
    end = time.monotonic() + 60.0
    while not list(folder.glob("*.partial")) and time.monotonic() < end:
        if all(run.poll() is not None for run in runs):
            break
        time.sleep(0.001)
    runs[0].send_signal(signal.SIGKILL)
    statuses = [run.wait(60) for run in runs]
    assert statuses[1:] == [3, 3]
    records = [open_record(path) for path in folder.glob("*.mcap")]
    assert len(records) >= 2
    assert faulty(written(tmp_path), folder, 2)[1] is not None
    assert not list(folder.glob("*.partial"))


def test_the_hash_of_a_network_is_of_its_weights_beside_it_too(tmp_path: Path) -> None:
    network = tmp_path / "walk.onnx"
    network.write_bytes(b"\x00location\x12walk.onnx.data\x00")
    (tmp_path / "another.onnx.data").write_bytes(b"not its own")
    alone = network_hash(network)
    (tmp_path / "walk.onnx.data").write_bytes(b"weights")
    whole = network_hash(network)
    assert whole != alone
    (tmp_path / "walk.onnx.data").write_bytes(b"Weights")
    assert network_hash(network) not in (alone, whole)
    (tmp_path / "another.onnx.data").write_bytes(b"changed")
    (tmp_path / "walk.onnx.data").write_bytes(b"weights")
    assert network_hash(network) == whole

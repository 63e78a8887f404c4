"""Recordings open in rerun and in Foxglove as they are: their own readers find the same values."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("rosbags")

from rosbags.highlevel import AnyReader
from test_recorded_runs import recorded, written

from unicon_core.flow import Block, Stage
from unicon_core.workflow import HookBlocks, Program
from unicon_lab.recording import open_record
from unicon_lab.recording.read import files_of
from unicon_lab.recording.ticks import TOPIC
from unicon_ros.cli.main import main

pytestmark = pytest.mark.slow

PACKAGES = "@mcap/core @mcap/nodejs @mcap/support @foxglove/rosmsg @foxglove/rosmsg2-serialization"
WORKFLOW = """\
schema: unicon.workflow/1
robot: go2
platform: mujoco
rate: 50
duration: 2.0
flow: {chain: [{pose: {duration: 1.0}}, hold]}
"""
ODD = (np.nan, np.inf, -np.inf, -0.0, 1e-45, np.finfo(np.float32).max)

Messages = dict[str, list[tuple[int, Any]]]
"""Topic to when each message was logged, [ns], and its fields."""


def odd(program: Program) -> HookBlocks:
    """Numbers that text does not have, and the smallest and largest ones."""
    view = program.states["joint_effort"]
    return {
        Stage.RECV: [
            Block("odd", lambda: view.__setitem__(slice(6), ODD), amends=("joint_effort",))
        ]
    }


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One file, a folder of several, and a file with odd numbers."""
    folder = tmp_path_factory.mktemp("recordings")
    workflow = folder / "simulated.yaml"
    workflow.write_text(WORKFLOW)
    always = ("--no-ros", "--speed", "max", "--quiet", "--faults", "off")
    for options in (("run.mcap",), ("split/", "--record-split", "100KB")):
        path = f"{folder}/{options[0]}"
        assert main(["run", str(workflow), "--record", path, *options[1:], *always]) == 0
    recorded(written(folder), folder / "odd.mcap", (odd,))
    found = {path.stem: path for path in (folder / "run.mcap", folder / "odd.mcap")}
    assert len(files_of(folder / "split")) > 2
    return found | {"split": folder / "split"}


def plain(value: Any) -> Any:
    """Return a message as dicts and lists, as the others tell theirs."""
    if is_dataclass(value):
        names = (f.name for f in fields(value) if not f.name.startswith("__"))
        return {name: plain(getattr(value, name)) for name in names}
    if isinstance(value, list):
        return [plain(each) for each in value]
    return value


def ours(path: Path) -> Messages:
    """What rosbags finds in a file; other tests hold it against our own reader."""
    found: Messages = {}
    with AnyReader([path]) as reader:
        for connection, stamp, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((stamp, plain(message)))
    return found


def assert_equal(here: Any, there: Any, where: str) -> None:
    """Two values are the same; numbers in the type that they have here, NaN as NaN."""
    if isinstance(here, Mapping):
        there = {name: value for name, value in there.items() if not name.startswith("padding")}
        here = {name: value for name, value in here.items() if not name.startswith("padding")}
        assert here.keys() == there.keys(), where
        for name, value in here.items():
            assert_equal(value, there[name], f"{where}.{name}")
    elif isinstance(here, list):
        assert len(here) == len(there), where
        for row, (one, other) in enumerate(zip(here, there)):
            assert_equal(one, other, f"{where}[{row}]")
    elif isinstance(here, str):
        assert here == there, where
    else:
        dtype = np.asarray(here).dtype
        np.testing.assert_array_equal(np.asarray(here), np.array(there).astype(dtype), where)


# -- Foxglove --X


@pytest.fixture(scope="module")
def foxglove() -> Callable[[Path], Messages]:
    """Reads a file with the libraries of Foxglove's application."""
    node, npm = shutil.which("node"), shutil.which("npm")
    install = f"npm install --global {PACKAGES}"
    if node is None or npm is None:
        pytest.skip(f"no node: apt-get install nodejs npm; {install}")
    path = os.environ.get("NODE_PATH", "")
    if not path:
        asked = subprocess.run(
            [npm, "root", "--global"], capture_output=True, text=True, timeout=60
        )
        path = asked.stdout.strip()
    environment = {**os.environ, "NODE_PATH": path}
    here = ";".join(f"require.resolve('{package}')" for package in PACKAGES.split())
    if subprocess.run(
        [node, "-e", here], env=environment, capture_output=True, timeout=60
    ).returncode:
        pytest.skip(f"no reader of Foxglove: {install}")

    def read(file: Path) -> Messages:
        script = Path(__file__).with_name("foxglove_reader.cjs")
        done = subprocess.run(
            [node, script, file], env=environment, capture_output=True, text=True, timeout=120
        )
        assert (done.returncode, done.stderr) == (0, "")
        found: Messages = {}
        for line in done.stdout.splitlines():
            topic, stamp, value = json.loads(line)
            found.setdefault(topic, []).append((int(stamp), value))
        return found

    return read


@pytest.mark.parametrize("name", ["run", "split", "odd"])
def test_foxglove_reads_every_message(
    recordings: Mapping[str, Path], foxglove: Callable[[Path], Messages], name: str
) -> None:
    ticks = 0
    for file in files_of(recordings[name]):
        here, there = ours(file), foxglove(file)
        assert here.keys() == there.keys()
        for topic, messages in here.items():
            assert [stamp for stamp, _ in messages] == [stamp for stamp, _ in there[topic]]
            for (_, one), (stamp, other) in zip(messages, there[topic]):
                assert_equal(one, other, f"{topic} at {stamp}")
        ticks += len(there[TOPIC])
    assert ticks == 100


# -- rerun -----X


@pytest.fixture(scope="module")
def rerun(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """rerun's reader of MCAP."""
    return pytest.importorskip("rerun.chunk", reason="pip install rerun-sdk").McapReader


def columns(reader: Any, entity: str, *names: str) -> Iterator[tuple[int, list[Any]]]:
    """Yield when each row of an entity was logged, [ns], and its values."""
    for chunk in reader.stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path != entity or not {*names} <= {*batch.schema.names}:
            continue
        stamps = batch.column("message_log_time").cast("int64").to_pylist()
        rows = zip(*(batch.column(name).to_pylist() for name in names))
        for stamp, row in zip(stamps, rows):
            yield stamp, [values[0] if len(values) == 1 else values for values in row]


@pytest.mark.parametrize("name", ["run", "split", "odd"])
def test_rerun_reads_every_state_of_every_tick(
    recordings: Mapping[str, Path], rerun: Any, name: str
) -> None:
    record = open_record(recordings[name])
    row = 0
    for file in files_of(recordings[name]):
        reader = rerun(file)
        (channel,) = (c for c in reader.info().channels if c.topic == TOPIC)
        kept = f"{channel.schema.name.replace('/', '.')}:message"
        ticks = sorted(columns(reader, TOPIC, kept), key=lambda tick: tick[0])
        assert len(ticks) == channel.message_count
        for _, (tick,) in ticks:
            assert tick["tick"] == record.ticks[row]
            for moment in ("received", "sent"):
                for state in record.layout.slots:
                    if moment == "sent" or state in record.kept[moment]:
                        value = record.states(state, moment)[row]
                        found = tick[moment][state]
                        named = [*found.values()] if isinstance(found, Mapping) else found
                        there = np.array(named).astype(value.dtype)
                        np.testing.assert_array_equal(there.reshape(value.shape), value, state)
            row += 1
    assert row == len(record.ticks) == 100


def test_rerun_draws_the_robot_and_its_joints(recordings: Mapping[str, Path], rerun: Any) -> None:
    file = recordings["run"]
    reader, here = rerun(file), ours(file)
    for part in ("position", "velocity", "effort"):
        names = ("SeriesLines:names", "Scalars:scalars")
        there = sorted(columns(reader, f"/joint_states/{part}", *names), key=lambda row: row[0])
        assert len(there) == 100
        for (stamp, message), (logged, (joints, values)) in zip(here["/joint_states"], there):
            assert (stamp, message["name"]) == (logged, joints)
            assert message[part].tolist() == values
    names = ("Transform3D:child_frame", "Transform3D:translation", "Transform3D:quaternion")
    placed = {(at, frame): (p, q) for at, (frame, p, q) in columns(reader, "/tf", *names)}
    count = 0
    for stamp, message in here["/tf"]:
        for each in message["transforms"]:
            position, turn = placed[stamp, each["child_frame_id"]]
            at, rotation = each["transform"]["translation"], each["transform"]["rotation"]
            np.testing.assert_allclose(position, [at[axis] for axis in "xyz"], atol=1e-6)
            np.testing.assert_allclose(turn, [rotation[axis] for axis in "xyzw"], atol=1e-6)
            count += 1
    assert count == len(placed) > 100 * 13
    # What the robot looks like is in the bag too: its description, which rerun draws by itself.
    drawn = {chunk.entity_path for chunk in reader.stream()}
    for link in ("base_link", "FL_calf", "RR_foot"):
        assert any(path.startswith(f"/go2/visual_geometries/{link}/") for path in drawn), drawn

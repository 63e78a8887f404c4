"""The bridge's reference and its how-tos: maps build, workflows run, names exist."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
from talkers import ROOT, clean_environment

from unicon_base.errors import UniconError
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow
from unicon_msgs_map import Decoder, Encoder, MessageMap, parse_map
from unicon_ros.bridge.bindings import arrays_of, names_of, robot_variables

pytestmark = [pytest.mark.timeout(120)]

PAGES = ("reference/bridge.md", "howto/robot_behind_topics.md", "howto/images.md")
TEXT = "\n".join((ROOT / "docs" / page).read_text(encoding="utf-8") for page in PAGES)
BLOCKS = re.findall(r"^```yaml\n# ([^\n]+)\n(.*?)^```", TEXT, re.M | re.S)
MAPS = [text for title, text in BLOCKS if title == "map"]
PLAIN = "schema: unicon.workflow/1\nrobot: go2\nplatform: fake\nrate: 100\nflow: {hold: {}}\n"


def workflow(title: str, folder: Path) -> Path:
    path = folder / "documented.yaml"
    path.write_text(dict(BLOCKS)[title])
    return path


def test_every_block_of_yaml_says_what_it_is() -> None:
    assert len(BLOCKS) == len(re.findall(r"^```yaml", TEXT, re.M)) == 5
    assert len(MAPS) == 3


@pytest.fixture
def built(tmp_path: Path) -> list[tuple[MessageMap, list[Encoder], list[Decoder]]]:
    """The maps of the documents, compiled against a Go2."""
    path = tmp_path / "plain.yaml"
    path.write_text(PLAIN)
    loaded = load_workflow(path)
    Runner(loaded, RunOptions(duration=0.1, speed="max")).run()
    bindings = arrays_of(loaded), names_of(loaded), robot_variables(loaded.robot)
    found = []
    for text in MAPS:
        mapping = parse_map(text)
        encoders = [Encoder.build(spec, *bindings) for spec in mapping.publish]
        decoders = [Decoder.build(spec, *bindings) for spec in mapping.subscribe]
        found.append((mapping, encoders, decoders))
    return found


def test_the_maps_build_and_their_messages_are_whole(
    built: list[tuple[MessageMap, list[Encoder], list[Decoder]]],
) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    messages = {}
    for _, encoders, _ in built:
        for encoder in encoders:
            message = store.deserialize_cdr(encoder.encode(), encoder.spec.type)
            messages.setdefault(encoder.spec.topic, message)
    joints = messages["joint_states"]
    assert joints.header.frame_id == "base_link"
    assert joints.name[0] == "FR_hip_joint"
    degrees = np.degrees(joints.position[:3]) * [1, -1, -1]
    np.testing.assert_allclose(messages["leg_degrees"].data, degrees, rtol=1e-6)


def test_a_workflow_behind_topics_asks_for_its_robot(tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    path = workflow("workflow behind topics", tmp_path)
    with pytest.raises(UniconError, match=r"no message on /joint_states within 0\.2 s"):
        load_workflow(path, ["platforms.ros.connect=0.2"])


def test_a_workflow_with_a_camera_runs(tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    path = workflow("workflow with a camera", tmp_path)
    try:
        loaded = load_workflow(path)
    except UniconError as error:
        if "no offscreen OpenGL" in str(error):
            pytest.skip(str(error))
        raise
    report = Runner(loaded, RunOptions(duration=0.5)).run()
    assert report.faults == []


def test_the_variables_are_those_of_a_workflow(tmp_path: Path) -> None:
    path = tmp_path / "plain.yaml"
    path.write_text(PLAIN)
    (row,) = [line for line in TEXT.splitlines() if line.startswith("| `$joint_names`")]
    named = re.findall(r"`([a-z_]+)`", row.split("|")[2])
    assert named == list(robot_variables(load_workflow(path).robot))


def test_files_and_commands_that_it_names_exist() -> None:
    for path in re.findall(r"`?((?:config|unicon_core|unicon_ros|test)/[\w/.]+\.\w+)`?", TEXT):
        assert (ROOT / path).is_file(), path
    environment = clean_environment() | {"PYTHONPATH": os.pathsep.join([str(ROOT)])}
    done = subprocess.run(
        [sys.executable, "-m", "unicon_ros", "bench", "--help"],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    for bench in re.findall(r"`unicon bench (\w+)`", TEXT):
        assert bench in done.stdout

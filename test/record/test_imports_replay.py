"""A bag written by rosbags alone, and UniCon's npz: they drive workflows and simulators."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from rosbags.rosbag2 import StoragePlugin
from test_bag_command import unicon_npz, written_by_rosbags
from test_recorded_runs import written
from test_replay_forms import driving, ran, replayed

from unicon_base.errors import UniconError, WorkflowError
from unicon_base.resources import find_config
from unicon_core.workflow import load_workflow
from unicon_lab.recording import open_record
from unicon_lab.replay.player import play
from unicon_lab.view.recorded import shown_in
from unicon_ros.cli.main import main


def imported(source: Path, folder: Path, robot: str = "go2") -> Path:
    path = folder / "imported.mcap"
    assert main(["bag", "import", str(source), str(path), "--robot", robot]) == 0
    return path


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_bag_by_rosbags_alone_drives_a_workflow(storage: StoragePlugin, tmp_path: Path) -> None:
    bag = imported(written_by_rosbags(tmp_path / "plain", storage), tmp_path)
    report, program = ran(replayed(written(tmp_path, flow="hold"), bag))
    assert (report.ended, report.ticks, report.faults) == ("done", 40, [])
    with pytest.raises(
        WorkflowError, match="gives no joint_pos_target for the joints of robot go2"
    ):
        load_workflow(driving(tmp_path, bag))
    last = (np.arange(12.0) + 0.01 * 39).astype(np.float32)
    assert program.states["joint_pos"].tobytes() == last.tobytes()


def test_the_keys_of_unicon_drive_a_workflow_and_a_simulator(tmp_path: Path) -> None:
    bag = imported(unicon_npz(tmp_path / "x.npz"), tmp_path)
    record = open_record(bag)
    report, program = ran(replayed(written(tmp_path, flow="hold"), bag, also=["velocity_command"]))
    assert (report.ticks, report.faults) == (30, [])
    assert np.allclose(program.states["velocity_command"], [0.5, 0.0, 0.1])
    report, program = ran(load_workflow(driving(tmp_path, bag)))
    assert (report.ended, report.ticks) == ("done", 30)
    robot = program.robot  # 12 rad are beyond every limit: safety sees recorded commands, too
    wanted = np.clip(record.states("joint_pos_target")[-1], robot.lower, robot.upper)
    assert np.allclose(program.states["joint_pos_target"], wanted)
    assert (program.states["joint_stiffness"] == robot.joint_stiffness).all()


def test_an_imported_bag_finds_a_robot_that_was_given_by_its_path(tmp_path: Path) -> None:
    robot = tmp_path / "mine.yaml"
    text = find_config("robots", "go2").read_text("utf-8")
    robot.write_text(text.replace("name: go2", "name: mine", 1), "utf-8")
    bag = imported(unicon_npz(tmp_path / "x.npz"), tmp_path, str(robot))
    warned: list[str] = []
    assert play(bag, rate=20.0, warn=warned.append).faults == []
    assert warned == []
    assert shown_in(open_record(bag))[0].robot.path == robot
    robot.rename(tmp_path / "moved.yaml")
    with pytest.raises(
        UniconError,
        match=r"imported\.mcap: its robot 'mine' is not here \(.*mine\.yaml is gone\): unknown",
    ):
        play(bag, rate=20.0, warn=str)


def test_what_holds_no_workflow_is_verified_with_one_that_is_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = imported(unicon_npz(tmp_path / "x.npz"), tmp_path)
    capsys.readouterr()
    assert main(["replay", str(bag), "--verify"]) == 1
    assert "the record holds no workflow" in capsys.readouterr().err
    assert main(["replay", str(bag), str(written(tmp_path, flow="hold")), "--verify"]) == 1
    told = capsys.readouterr().out
    assert "state          joint_pos_target" in told
    assert "30 of 30 ticks differ" in told

"""A silent run: the whole graph runs and nothing leaves for the motors, at the end either."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import PlatformError, WorkflowError
from unicon_core import Chain, Program, Zip, block, policy, pose
from unicon_core.platforms.fake import FakeRobot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import States
from unicon_core.workflow.uses import on
from unicon_ros.cli.main import main

pytestmark = pytest.mark.usefixtures("short_damping")

SENT: list[str] = []
SOON = {"approach": 10.0, "fade_in": 0.1}
"""A start whose phases are short."""


class Counting(FakeRobot):
    """A robot that counts what it is sent; without `silent` it cannot be quiet."""

    def send(self) -> None:
        """Count."""
        self.note("command")
        super().send()

    def close(self) -> None:
        """Damp."""
        self.note("damping")

    def note(self, what: str) -> None:
        """Keep it, in a file too, where another process is to see it."""
        SENT.append(what)
        if log := os.environ.get("UNICON_TEST_SENT"):
            with open(log, "a") as file:
                file.write(f"{what}\n")


class Quiet(Counting):
    """One that can."""

    silent = False

    def close(self) -> None:
        """Damp, unless nothing is to be sent."""
        if not self.silent:
            super().close()


def loud(states: States, robot: Any, period: float) -> Counting:
    """Build a robot that damps at its end, come what may."""
    from unicon_core.platforms.kit.scene import Scene

    return Counting(states, robot, period, Scene(), 0.0)


def quiet(states: States, robot: Any, period: float, *, silent: bool = False) -> Quiet:
    """Build a robot that can be opened to receive only."""
    from unicon_core.platforms.kit.scene import Scene

    built = Quiet(states, robot, period, Scene(), 0.0)
    built.silent = silent
    return built


@pytest.fixture(autouse=True)
def nothing_sent() -> None:
    """Begin anew."""
    SENT.clear()


def program_of(platform: str, **described: Any) -> Program:
    """Build a workflow on a platform of this module."""
    keys = {"flow": Chain(pose("rest", duration=0.4), block("hold"))} | described
    pacing = {"hang": 20}  # a busy machine is not a fault here
    return Program(robot="go2", platform=platform, rate=100, pacing=pacing, start=SOON, **keys)


def test_a_robot_is_sent_nothing_while_the_whole_graph_runs() -> None:
    program = program_of("test_silent:quiet", silent=True, wind_down=pose("rest", duration=0.1))
    before = program.robot.default_joint_pos
    report = Runner(program, RunOptions(duration=0.5)).run()
    assert SENT == []
    assert report.faults == []
    assert report.dry
    assert "nothing was sent" in report.summary()
    assert program.states.joint_pos.tolist() == before.tolist()
    target = program.states.joint_pos_target
    assert np.abs(target - before).max() > 0.1  # what would have been sent


def test_the_same_robot_is_sent_commands_and_damping_otherwise() -> None:
    report = Runner(program_of("test_silent:quiet"), RunOptions(duration=0.1)).run()
    assert SENT.count("command") >= 10
    assert SENT[-1] == "damping"
    assert not report.dry


def test_a_robot_that_cannot_be_quiet_is_not_opened() -> None:
    with pytest.raises(PlatformError, match="its factory has no parameter `silent`"):
        program_of("test_silent:loud", silent=True)
    assert SENT == []


def test_silent_is_no_option_of_a_workflow() -> None:
    with pytest.raises(WorkflowError, match="has no option 'silent'"):
        program_of("fake_robot", platforms={"fake_robot": {"silent": True}})


@pytest.mark.parametrize("when", ["build", "tick", "signal"])
def test_whatever_goes_wrong_nothing_is_sent(when: str) -> None:
    def hook(program: Program) -> dict[Any, list[Any]]:
        if when == "build":
            raise ValueError("made by the test")
        return {}

    def broken() -> None:
        if when == "tick":
            raise ValueError("made by the test")
        runner.stop()
        assert runner._damp_now()

    flow = Zip(block("hold"), broken)
    keys = {"flow": flow, "safety": "none", "hooks": [hook], "silent": True}
    if when == "build":
        with pytest.raises(ValueError, match="made by the test"):
            program_of("test_silent:quiet", **keys)
    else:
        runner = Runner(program_of("test_silent:quiet", **keys))
        assert runner.run().faults
    assert SENT == []


@pytest.mark.parametrize("silent", [True, False])
def test_a_robot_in_a_child_process_is_silent_too(
    silent: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "sent"
    log.touch()
    monkeypatch.setenv("UNICON_TEST_SENT", str(log))
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    platform: Any = {"child": "test_silent:quiet", "silence": 20.0, "watchdog": 20.0}
    program = program_of(platform, silent=silent)
    report = Runner(program, RunOptions(duration=0.2)).run()
    assert report.faults == []
    sent = log.read_text().split()
    if silent:
        assert sent == []
    else:
        assert sent.count("command") >= 5
        assert sent[-1] == "damping"


def test_a_closed_workflow_passes_nothing_silently_either() -> None:
    program = program_of("test_silent:quiet", silent=True)
    program.close()
    runner_sends = [b for b in program.critical if b.name == "send"]
    with pytest.raises(Exception, match="is closed and sends nothing any more"):
        runner_sends[0].tick()


def test_a_divided_workflow_cannot_be_silent() -> None:
    with pytest.raises(WorkflowError, match="cannot be run silently"):
        Program(
            robot="go2",
            platform="fake",
            rate=50,
            commands=[on("desk", block("velocity_command", constant=[0.0, 0.0, 0.0]))],
            flow=block("hold"),
            store="shm",
            parts={
                "body": {"publishes": ["joint_pos"], "silent": {"after": 0.2}},
                "desk": {"publishes": ["velocity_command"], "silent": {"after": 0.2}},
            },
            silent=True,
        )


@pytest.mark.parametrize("platform", ["fake", "mujoco"])
def test_a_simulation_goes_on_with_limp_joints(platform: str) -> None:
    flow = policy("walk")
    keys = {"policies": {"walk": "go2_velocity"}, "flow": flow, "safety": ["finite", "stale_stop"]}
    if platform == "mujoco":
        pytest.importorskip("mujoco")
    program = Program(robot="go2", platform=platform, rate=50, silent=True, **keys)
    report = Runner(program, RunOptions(speed="max", duration=1.0)).run()
    assert report.faults == []
    assert report.ticks == 50
    assert report.dry
    if platform == "fake":  # nothing pulls at its joints
        assert program.states.joint_pos.tolist() == program.robot.default_joint_pos.tolist()
    else:  # it sinks down
        assert program.states.base_pos_w[2] < 0.2
    assert program.states.joint_stiffness.any()  # what would have been sent stands there


def test_run_dry_reports_what_would_have_been_sent(tmp_path: Path) -> None:
    told = {}
    for name, extra in (("dry", ["--dry"]), ("wet", [])):
        report = tmp_path / f"{name}.json"
        arguments = ["--set", "platform=fake", "--speed", "max", "--duration", "0.5", "--quiet"]
        status = main(["run", "go2_stand", *arguments, *extra, "--report", str(report)])
        assert status == 0
        told[name] = json.loads(report.read_text())
    assert told["dry"]["dry"] is True
    assert told["wet"]["dry"] is False
    assert len(told["dry"]["sha256_commands"]) == 64


def test_run_dry_records_what_would_have_been_sent(tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap.reader")
    path = tmp_path / "dry.mcap"
    platform = ["--set", "platform=fake_robot", "--set", "pacing.hang=20"]
    platform += ["--set", "start={approach: 10, fade_in: 0.1}"]
    assert (
        main(
            [
                "run",
                "go2_stand",
                *platform,
                "--duration=0.4",
                "--quiet",
                "--dry",
                "--record",
                str(path),
            ]
        )
        == 0
    )
    with path.open("rb") as stream:
        topics = [channel.topic for _, channel, _ in reader.make_reader(stream).iter_messages()]
    assert topics.count("/joint_states") >= 10


@pytest.mark.parametrize("safety", [["finite"], {"only": ["finite", "encoder_stop"]}])
def test_what_awaits_that_the_robot_follows_is_left_out_and_told(safety: Any) -> None:
    keys = {"robot": "go2", "platform": "fake_robot", "rate": 50, "safety": safety}
    silent = Program(flow=block("hold"), silent=True, **keys)
    assert "encoder_stop" in Program(flow=block("hold"), **keys).safety
    assert "encoder_stop" not in silent.safety
    assert "does not follow" in silent.safety_left_out["encoder_stop"]

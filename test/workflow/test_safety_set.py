"""A robot has the strict set of safety blocks unless its workflow says so, and then it is told."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from unicon_base.errors import WorkflowError
from unicon_base.resources import find_config
from unicon_core.check import check_workflow
from unicon_core.check.check import refuse_errors
from unicon_core.platforms.platform import Facts, Platform
from unicon_core.robots import Robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import States
from unicon_core.states.standard import BASE_STATES, JOINT_STATES
from unicon_core.workflow import Program, load_workflow
from unicon_core.workflow.tick_tree import ROBOT_SAFETY, TELLS
from unicon_ros.cli.main import main

pytestmark = pytest.mark.usefixtures("short_damping")

HERE = __name__
MEASURED = (*JOINT_STATES, *BASE_STATES[:4], "stamp_ns")
STRICT = [name for name in ROBOT_SAFETY if name not in TELLS]


class Blind:
    """A robot that tells of some states only."""

    def __init__(self, states: States, robot: Robot, writes: tuple[str, ...]) -> None:
        self.facts = Facts("blind", writes=writes)
        states["joint_pos"][...] = robot.default_joint_pos
        self.states = states

    def recv(self) -> None: ...

    def send(self) -> None: ...

    def close(self) -> None: ...


def blind(states: States, robot: Robot, period: float, *, writes: list[str]) -> Platform:
    return Blind(states, robot, tuple(writes))


class Hot(Blind):
    """A robot that tells how hot its motors are."""

    facts = Facts("hot", writes=("joint_pos", "motor_temperature", "motor_error"))

    def __init__(self, states: States, robot: Robot) -> None:
        super().__init__(states, robot, self.facts.writes)
        states["motor_temperature"][...] = 40.0


def hot(states: States, robot: Robot, period: float) -> Hot:
    return Hot(states, robot)


def document(folder: Path, **values: Any) -> Path:
    path = folder / "safe.yaml"
    values = {"robot": "go2", "platform": "fake_robot", "rate": 50, "flow": "hold"} | values
    path.write_text(yaml.safe_dump(values), encoding="utf-8")
    return path


def built(folder: Path, **values: Any) -> Program:
    program = load_workflow(document(folder, **values))
    program.close()
    return program


def behind(writes: tuple[str, ...], **options: Any) -> dict[str, Any]:
    name = f"{HERE}:blind"
    return {"platform": name, "platforms": {name: {"writes": list(writes)}}, **options}


@pytest.mark.parametrize(
    ("safety", "labels"),
    [
        (None, STRICT),
        (["finite", "joint_limits"], STRICT),
        (
            ["finite", "joint_limits", "tilt_stop"],
            [
                *("finite", "command_stop", "range_stop", "velocity_stop"),
                *(
                    "joint_limits",
                    "tilt_stop",
                    "stale_stop",
                    "imu_stop",
                    "joint_sensor_stop",
                    "encoder_stop",
                ),
            ],
        ),
        (
            ["fade_in", {"tilt_stop": {"angle": 0.5, "name": "upright"}}],
            [
                *("finite", "command_stop", "range_stop", "velocity_stop", "fade_in", "upright"),
                *("joint_limits", "stale_stop", "imu_stop", "joint_sensor_stop", "encoder_stop"),
            ],
        ),
        (
            [{"call": {"function": "unicon_core.blocks.safety.stops:Finite", "name": "all"}}],
            ["all", *STRICT[1:]],
        ),
    ],
)
def test_a_robot_has_what_its_workflow_does_not_list(
    tmp_path: Path, safety: Any, labels: list[str]
) -> None:
    values = {} if safety is None else {"safety": safety}
    program = built(tmp_path, **values)
    assert list(program.safety) == labels
    assert program.safety_left_out == {}
    child = built(tmp_path, **values, platform={"child": "fake_robot"})
    assert child.safety == program.safety
    simulated = built(tmp_path, **values, platform="fake")
    said = safety or ["finite", "joint_limits"]
    assert len(simulated.safety) == len(said)
    assert simulated.safety_left_out == {}


@pytest.mark.parametrize(
    "safety", [pytest.param("none", marks=pytest.mark.slow), {"only": ["finite", "joint_limits"]}]
)
def test_what_is_left_out_is_told_at_every_start_and_in_the_report(
    tmp_path: Path, safety: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    path = document(tmp_path, safety=safety, start={"approach": 10.0, "fade_in": 0.1})
    report = tmp_path / "report.json"
    kept = [] if safety == "none" else ["finite", "joint_limits"]
    words = "safety: none" if safety == "none" else "safety: only"
    for _ in range(2):
        assert main(["run", str(path), "--yes", "--duration=0.06", "--report", str(report)]) == 0
        said = capsys.readouterr()
        assert ("warning: safety: this robot does not have command_stop, " in said.err) == bool(
            kept
        )
        assert words in said.err
        assert "safety        without " in said.out
    told = json.loads(report.read_text(encoding="utf-8"))
    assert told["safety"] == kept
    left = dict.fromkeys([name for name in STRICT if name not in kept], words)
    assert told["safety_left_out"] == left
    codes = {note.code for note in check_workflow(path).notes}
    assert ("safety.none" if safety == "none" else "safety.less") in codes
    simulated = document(tmp_path, safety=safety, platform="fake")
    assert "safety.less" not in {note.code for note in check_workflow(simulated).notes}


def test_a_block_that_sees_nothing_is_left_out_and_told(tmp_path: Path) -> None:
    program = load_workflow(document(tmp_path, **behind(("joint_pos", "joint_vel"))))
    assert list(program.safety) == [
        *("finite", "command_stop", "range_stop", "velocity_stop"),
        *("joint_limits", "encoder_stop"),
    ]
    (line,) = refuse_errors(program)
    program.close()
    assert line == (
        "safety: this robot does not have tilt_stop (nothing measures projected_gravity); "
        "stale_stop, joint_sensor_stop (nothing measures stamp_ns); "
        "imu_stop (nothing measures base_quat, base_ang_vel, projected_gravity, stamp_ns)"
    )


def test_a_message_map_without_an_imu_is_one_line_and_no_refusal(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="maps are read with rosbags")
    values = yaml.safe_load(find_config("maps", "ros_robot").read_text(encoding="utf-8"))
    values["subscribe"] = [each for each in values["subscribe"] if each["topic"] != "imu/data"]
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(values), encoding="utf-8")
    options = {"platform": "ros", "platforms": {"ros": {"map": "./map.yaml"}}}
    result = check_workflow(document(tmp_path, **options))
    assert result.clean
    (note,) = [note.evidence for note in result.notes if note.code == "safety.less"]
    assert note == (
        "this robot does not have tilt_stop (nothing measures projected_gravity); "
        "imu_stop (nothing measures base_quat, base_ang_vel, projected_gravity)"
    )


def test_what_an_estimator_writes_is_measured(tmp_path: Path) -> None:
    writes = ("joint_pos", "base_quat", "base_ang_vel", "stamp_ns")
    program = built(tmp_path, **behind(writes, estimate=["projected_gravity"]))
    assert {"tilt_stop", "imu_stop"} <= {*program.safety}
    assert program.safety_left_out["velocity_stop"] == "nothing measures joint_vel"


def test_a_robot_file_without_an_imu_has_no_blocks_that_look_at_it(tmp_path: Path) -> None:
    robot = {"robot": "arx_x5"}
    facts = check_workflow(document(tmp_path, **robot, **behind(MEASURED)))
    (note,) = [note.evidence for note in facts.notes if note.code == "safety.less"]
    assert "tilt_stop (nothing measures projected_gravity)" in note
    assert "imu_stop (nothing measures base_quat, base_ang_vel, projected_gravity)" in note


def test_states_of_hardware_are_there_where_the_platform_writes_them(tmp_path: Path) -> None:
    plain = built(tmp_path)
    assert "motor_temperature" not in plain.states
    program = load_workflow(document(tmp_path, platform=f"{HERE}:hot", start="none"))
    assert "hardware_stop" in program.safety
    assert "battery_charge" not in program.states
    assert program.states.motor_temperature.shape == (12,)
    assert program.states.motor_error.dtype == np.int32
    assert list(program.states)[:5] == list(plain.states)[:5]
    program.states.motor_temperature[2] = 95.0
    report = Runner(program, RunOptions()).run()
    assert report.faults == ["motor_temperature of FR_calf_joint is 95 °C, allowed are -40 to 90"]


def test_a_workflow_may_name_a_state_of_hardware_for_its_map(tmp_path: Path) -> None:
    program = built(tmp_path, states={"battery_voltage": None, "motor_temperature": {}})
    assert program.states.spec("battery_voltage").unit == "V"
    assert program.states.motor_temperature.shape == (12,)
    with pytest.raises(WorkflowError, match="'motor_error' is a standard one of shape"):
        built(tmp_path, states={"motor_error": {"shape": [3]}})


def test_a_healthy_robot_trips_nothing(tmp_path: Path) -> None:
    """Rest, stand, lie down on a robot whose joints follow at once, and whose base never moves."""
    moves = [{"pose": {"to": to, "duration": 0.4}} for to in ("rest", "stand", "rest")]
    report = Runner(load_workflow(document(tmp_path, flow={"chain": moves})), RunOptions()).run()
    assert report.faults == []
    assert report.ticks == 60
    assert report.safety == STRICT


@pytest.mark.parametrize(("timeout", "after"), [(0.1, True), (0.08, False)])
def test_what_compares_five_ticks_looks_behind_send(
    tmp_path: Path, timeout: float, after: bool
) -> None:
    patient = ["stale_stop", "imu_stop", "encoder_stop"]
    safety = [{name: {"timeout": timeout}} for name in patient]
    runner = Runner(load_workflow(document(tmp_path, safety=safety)), RunOptions(warn=str))
    names = [block.name for block in runner.graph.blocks]
    late = [names[i] for i in sorted(runner.graph.deferred_blocks)]
    runner.close()
    late.remove("joint_sensor_stop")  # always
    assert late[-3:] == patient if after else not {*patient} & {*late}
    if not after:
        assert max(map(names.index, patient)) < names.index("send")


@pytest.mark.parametrize("name", ["go2_walk", "go1_walk", "g1_walk", "g1_holosoma"])
def test_in_a_simulator_the_set_of_a_robot_changes_no_command(
    name: str, request: pytest.FixtureRequest
) -> None:
    if name != "go2_walk":
        request.getfixturevalue("assets")
    digests = set()
    for changes in ({}, {"safety": STRICT}):
        report = Runner(load_workflow(name, changes), RunOptions(duration=4.0, speed="max")).run()
        assert report.faults == []
        assert report.ticks == 200
        digests.add(report.sha256_commands)
    assert len(digests) == 1


@pytest.mark.parametrize(
    "safety", [[], {"only": []}, {"only": "none"}, {"only": ["finite"], "more": 1}, {"finite": {}}]
)
def test_other_forms_are_refused(tmp_path: Path, safety: Any) -> None:
    with pytest.raises(WorkflowError, match=r"safety(.only)?(:| is) .*(write|known: only)"):
        built(tmp_path, safety=safety)


def test_a_wrong_block_of_only_is_found_in_its_line(tmp_path: Path) -> None:
    path = document(tmp_path)
    path.write_text(path.read_text(encoding="utf-8") + "safety:\n  only:\n    - finit\n")
    with pytest.raises(WorkflowError, match=r"safe\.yaml:7: unknown block 'finit'"):
        load_workflow(path)

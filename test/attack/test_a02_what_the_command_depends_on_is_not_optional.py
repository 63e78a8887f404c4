"""Platform `ros`: a state that the critical path reads is needed, whatever the map calls it."""

from __future__ import annotations

from pathlib import Path

import pytest
from ros_attack import Run, behind_topics, robot, wait_for

from unicon_base.errors import PlatformError
from unicon_core.robots import load_robot
from unicon_core.workflow import load_workflow

pytestmark = [
    pytest.mark.ros,
    pytest.mark.alone,  # a peer that another test starves for 0.5 s is silent
    pytest.mark.usefixtures("domain", "short_damping"),
    pytest.mark.timeout(90),
]

TILT = "finite, tilt_stop"


@pytest.mark.parametrize(
    "lie",
    [
        "no orientation",
        *(pytest.param(lie, marks=pytest.mark.slow) for lie in ("no imu", "zero quat")),
    ],
)
def test_an_optional_imu_that_tells_no_orientation_any_more_is_a_fault(
    lie: str, tmp_path: Path
) -> None:
    with robot(lie, 0.2) as peer:
        run = Run(behind_topics(tmp_path, TILT)).start()
        try:
            wait_for(lambda: bool(peer.lines) and peer.lines[-1]["lies"], "the lies")
            sent = run.runner.statistics.count
            wait_for(lambda: not run.alive, "the fault", 8.0)
        finally:
            report = run.end()
    (fault,) = report.faults
    silent = "message" if lie == "no imu" else "accepted message"
    assert fault.startswith(f"topic /imu/data: no {silent} for 0.5 s, ")
    assert report.ticks - sent < 200  # of 100 Hz
    # What was refused is not in the states: the last orientation that was one is.
    assert run.program.states.base_quat.tolist() == [1.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("lie", "said"),
    [
        pytest.param("no imu", "", marks=pytest.mark.slow),
        pytest.param("zero quat", "the quaternion's norm is 0, not 1", marks=pytest.mark.slow),
        ("no orientation", "orientation_covariance[0] is -1: it has no orientation"),
    ],
)
def test_the_start_waits_for_an_optional_imu_that_the_safety_reads(
    lie: str, said: str, tmp_path: Path
) -> None:
    with robot(lie, -1.0) as peer:
        wait_for(lambda: bool(peer.lines), "the robot")
        with pytest.raises(PlatformError) as error:
            load_workflow(behind_topics(tmp_path, TILT, connect=2.5)).close()
    assert "no message on /imu/data within 2.5 s" in str(error.value)
    assert said in str(error.value)


def test_an_imu_that_nobody_reads_stays_optional(tmp_path: Path) -> None:
    with robot("no imu", -1.0) as peer:
        run = Run(behind_topics(tmp_path, "finite")).start()
        try:
            wait_for(lambda: peer.lines[-1]["commands"] > 70 if peer.lines else False, "0.7 s")
        finally:
            report = run.end()
    assert report.faults == []
    platform = run.program.platform
    assert [topic.topic for topic in platform._needed] == ["/joint_states"]
    assert [topic.topic for topic in platform.incoming] == ["/joint_states", "/imu/data"]


def test_a_map_that_writes_half_of_what_is_read_is_refused(tmp_path: Path) -> None:
    half = tmp_path / "half.yaml"
    half.write_text(
        "subscribe:\n"
        "  - topic: joint_states\n"
        "    type: sensor_msgs/msg/JointState\n"
        "    extra: ignore\n"
        "    fields: {position: 'joint_pos[0:6]'}\n"
        "publish:\n"
        "  - topic: joint_commands\n"
        "    type: sensor_msgs/msg/JointState\n"
        "    fields: {position: joint_pos_target}\n"
    )
    limits = "finite, {rate_limit: {max_rate: 1.0}}"
    with robot("none", 0.0), pytest.raises(PlatformError) as error:
        load_workflow(behind_topics(tmp_path, limits, map=half)).close()
    assert "writes 6 of 12 elements of joint_pos, which block 'rate_limit' reads" in str(
        error.value
    )


def test_silence_is_a_fault_where_the_map_gives_no_time_out(tmp_path: Path) -> None:
    endless = tmp_path / "endless.yaml"
    endless.write_text(
        "subscribe:\n"
        "  - {topic: joint_states, type: sensor_msgs/msg/JointState,\n"
        "     fields: {name: $joint_names, position: joint_pos}}\n"
        "publish:\n"
        "  - {topic: joint_commands, type: sensor_msgs/msg/JointState,\n"
        "     fields: {position: joint_pos_target}}\n"
    )
    with robot("none", 0.0) as peer:
        run = Run(behind_topics(tmp_path, "finite", map=endless)).start()
        try:
            wait_for(lambda: bool(peer.lines) and peer.lines[-1]["commands"] > 0, "commands")
            peer.kill()
            wait_for(lambda: not run.alive, "the fault", 8.0)
        finally:
            report = run.end()
    assert report.faults[0].startswith("topic /joint_states: no message for 0.5 s")


def test_a_joint_that_no_message_tells_is_not_taken_for_zero(tmp_path: Path) -> None:
    held = tmp_path / "held.yaml"  # `missing: hold` is the default
    held.write_text(
        "subscribe:\n"
        "  - {topic: joint_states, type: sensor_msgs/msg/JointState, timeout: 0.5,\n"
        "     fields: {name: $joint_names, position: joint_pos}}\n"
        "publish:\n"
        "  - {topic: joint_commands, type: sensor_msgs/msg/JointState,\n"
        "     fields: {position: joint_pos_target}}\n"
    )
    limits = "finite, {rate_limit: {max_rate: 1.0}}"
    with robot("few joints", -1.0) as peer:
        wait_for(lambda: bool(peer.lines), "the robot")
        with pytest.raises(PlatformError) as error:
            load_workflow(behind_topics(tmp_path, limits, map=held, connect=2.5)).close()
    told = load_robot("go2").joint_names[:5]
    untold = load_robot("go2").joint_names[5]
    assert untold not in told
    assert f"no message tells joint_pos of {untold} within 2.5 s" in str(error.value)

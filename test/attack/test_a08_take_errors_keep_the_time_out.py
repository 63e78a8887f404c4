"""A topic whose messages cannot be taken is silent: its time-out stays, and it is tried again."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
from ros_attack import REACT, behind_topics, robot, running, wait_for

from unicon_base.errors import Fault
from unicon_core.runtime import Runner
from unicon_core.workflow import load_workflow

pytestmark = [
    pytest.mark.ros,
    pytest.mark.usefixtures("domain", "short_damping"),
    pytest.mark.timeout(60),
]


class Broken:
    """A take that fails until it is mended."""

    def __init__(self) -> None:
        self.calls = 0
        self.mended: Any = None

    def __call__(self) -> Any:
        self.calls += 1
        if self.mended is not None:
            return self.mended()
        raise RuntimeError("failed to take: the middleware is gone")


def test_a_command_that_cannot_be_taken_any_more_goes_to_zero(tmp_path: Path) -> None:
    from geometry_msgs.msg import Twist

    path = tmp_path / "react.yaml"
    path.write_text(REACT)
    with running(path) as run:
        (topic,) = run.session.incoming
        publisher = run.session.node.create_publisher(Twist, "cmd_vel", 10)
        twist = Twist()
        twist.linear.x = 0.75

        def driven() -> bool:
            publisher.publish(twist)
            return topic.heard

        wait_for(driven, "a command")
        broken, take = Broken(), topic._take
        topic._take = broken
        begun = run.runner.statistics.count
        wait_for(lambda: topic.stale, "the time-out", 5.0)
        assert run.session.incoming == [topic]
        ticks = run.runner.statistics.count
        wait_for(lambda: run.runner.statistics.count > ticks + 50, "ticks")
        assert run.program.states.velocity_command.tolist() == [0.0, 0.0, 0.0]
        assert broken.calls < 0.2 * (run.runner.statistics.count - begun)  # a slow pace
        broken.mended = take
        wait_for(lambda: driven() and not topic.stale, "the next command", 5.0)
        report = run.end()
    assert report.faults == []
    told = [warning for warning in run.warnings if "/cmd_vel" in warning]
    assert told == [
        "topic /cmd_vel: messages cannot be taken (failed to take: the middleware is gone)",
        "topic /cmd_vel: no accepted message for 0.5 s, velocity_command zero "
        "(the last: they cannot be taken: failed to take: the middleware is gone)",
        "topic /cmd_vel: messages can be taken again",
        "topic /cmd_vel: messages come again",
    ]


@pytest.mark.parametrize(("number", "topic"), [(0, "/joint_states"), (1, "/imu/data")])
def test_sensors_that_cannot_be_taken_any_more_are_a_fault(
    number: int, topic: str, tmp_path: Path
) -> None:
    with robot("none", 0.0):
        workflow = load_workflow(behind_topics(tmp_path, "finite, tilt_stop"))
        runner = Runner(workflow)
        try:
            for _ in range(20):
                runner.tick(0)
            workflow.platform.incoming[number]._take = Broken()
            end = time.monotonic() + 5.0
            with pytest.raises(Fault) as fault:  # noqa: PT012
                while time.monotonic() < end:
                    runner.tick(0)
                    time.sleep(0.01)
        finally:
            runner.close()
    assert str(fault.value).startswith(f"topic {topic}: no accepted message for 0.5 s")
    assert "the middleware is gone" in str(fault.value)

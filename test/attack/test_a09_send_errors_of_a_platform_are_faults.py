"""Commands that cannot be published are a fault of platform `ros`; a dead mirror never is."""

from __future__ import annotations

from pathlib import Path

import pytest
from ros_attack import behind_topics, robot, running, wait_for

from unicon_base.errors import Fault
from unicon_core.runtime import Runner
from unicon_core.workflow import load_workflow

pytestmark = [
    pytest.mark.ros,
    pytest.mark.usefixtures("domain", "short_damping"),
    pytest.mark.timeout(60),
]


def refused(raw: bytes) -> None:
    raise RuntimeError("failed to publish: the publisher is invalid")


def test_five_commands_in_a_row_that_are_not_published_are_a_fault(tmp_path: Path) -> None:
    with robot("none", 0.0):
        workflow = load_workflow(behind_topics(tmp_path, "finite"))
        runner = Runner(workflow)
        try:
            (out,) = workflow.platform.outgoing
            publish = out._publish
            runner.tick(0)
            out._publish = refused
            for _ in range(4):
                runner.tick(0)
            out._publish = publish
            runner.tick(0)  # one that passes: they are counted anew
            out._publish = refused
            for _ in range(4):
                runner.tick(0)
            with pytest.raises(Fault) as fault:
                runner.tick(0)
        finally:
            runner.close()
    assert str(fault.value) == (
        "topic /joint_commands: 5 commands in a row were not published "
        "(failed to publish: the publisher is invalid)"
    )


def test_a_dead_mirror_is_told_and_stops_nothing(tmp_path: Path) -> None:
    path = tmp_path / "mirrored.yaml"
    path.write_text(
        "schema: unicon.workflow/1\nrobot: go2\nplatform: fake\nrate: 200\nflow: {hold: {}}\n"
    )
    with running(path) as run:
        wait_for(lambda: run.runner.statistics.count > 10, "ticks")
        for out in run.session.outgoing:
            out._publish = refused
        dead = run.session.outgoing[0]
        ticks = run.runner.statistics.count
        wait_for(lambda: run.runner.statistics.count > ticks + 150, "ticks")
        assert dead.failed == 100  # then it costs nothing any more
        report = run.end()
    assert report.faults == []
    assert len([line for line in run.warnings if dead.topic in line]) == 2

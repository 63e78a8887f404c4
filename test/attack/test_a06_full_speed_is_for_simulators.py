"""A robot is not sent commands as fast as the processor can."""

from __future__ import annotations

from pathlib import Path

import pytest

from unicon_base.errors import PlatformError
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow

STAND = """\
robot: go2
platform: {platform}
rate: 50
flow: {{hold: {{}}}}
"""


def test_full_speed_is_refused_on_a_robot(tmp_path: Path) -> None:
    path = tmp_path / "stand.yaml"
    path.write_text(STAND.format(platform="fake_robot"))
    workflow = load_workflow(path)
    with pytest.raises(PlatformError, match=r"is a robot.*leave out speed max"):
        Runner(workflow, RunOptions(speed="max", duration=1.0))
    workflow.close()


def test_full_speed_is_given_to_a_simulator(tmp_path: Path) -> None:
    path = tmp_path / "stand.yaml"
    path.write_text(STAND.format(platform="fake"))
    assert Runner(load_workflow(path), RunOptions(speed="max", duration=1.0)).run().ticks == 50

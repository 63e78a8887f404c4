"""A run on an emulated robot is reported as one on a stand-in, whatever its user says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from emulated_runs import ended
from peer import Peer
from vendor_robots import serve

from unicon_base.errors import UniconError
from unicon_lab.evidence_report.report import report_of

pytest.importorskip("rosbags")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


def test_an_emulated_robot_is_no_hardware(processes: Callable[..., Peer], tmp_path: Path) -> None:
    robot = serve(processes, "a1", "a1", "--model=fake", "--posture=random", "--seed=3")
    bag = tmp_path / "run.mcap"
    run = robot.run("h1_stand", tmp_path, "--set=robot=a1", "--duration=2", f"--record={bag}")
    told = ended(run, tmp_path)
    report = report_of(bag)
    assert (report["level"], report["robots"]) == ("stand_in", {"a1": "unitree_legged"})
    assert report["options"] == {"connect": 20, "silence": 5, "watchdog": 5.0}
    assert report["overruns"] == told["overruns"]
    assert "motor_temperature_c" in report
    assert "observation_age_us" in report
    assert "127.0" not in str(report)
    with pytest.raises(UniconError, match=r"run\.mcap was not on hardware: an address is loopback"):
        report_of(bag, hardware=True)

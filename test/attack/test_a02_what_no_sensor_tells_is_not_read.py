"""An upright base that nobody measured, and half a state that a map tells: errors of check."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

pytest.importorskip("rosbags", reason="maps are read with rosbags")

from unicon_base.resources import find_config
from unicon_core.check import check_workflow

WORKFLOW = """
robot: go2
platform: ros
platforms: {ros: {map: ./map.yaml}}
rate: 50
flow: {loop: {do: hold, until: UNTIL}}
safety: [finite, joint_limits, tilt_stop]
"""


def findings(folder: Path, until: str = "tick > 9", **fields: object) -> list[str]:
    values = yaml.safe_load(find_config("maps", "ros_robot").read_text(encoding="utf-8"))
    for entry in list(values["subscribe"]):
        for field, state in fields.items():
            if field in entry["fields"]:
                entry["fields"].pop(field)
                entry["fields"] |= state or {}  # type: ignore[operator]
    (folder / "map.yaml").write_text(yaml.safe_dump(values), encoding="utf-8")
    path = folder / "attack.yaml"
    path.write_text(WORKFLOW.replace("UNTIL", until), encoding="utf-8")
    return [str(found) for found in check_workflow(path).findings]


def test_a_map_with_an_imu_is_clean(tmp_path: Path) -> None:
    assert findings(tmp_path) == []


def test_tilt_stop_without_an_imu_is_refused(tmp_path: Path) -> None:
    (found,) = findings(tmp_path, orientation=None)
    assert "'tilt_stop' reads 'projected_gravity', which no block writes" in found


def test_a_condition_over_an_orientation_that_nobody_tells_is_refused(tmp_path: Path) -> None:
    found = findings(tmp_path, "'base_quat[0] > 0.5'", orientation=None)
    assert "which no block writes" in found[0]


def test_half_a_state_is_refused_by_check_as_by_run(tmp_path: Path) -> None:
    half = {f"orientation.{axis}": f"base_quat[{i}]" for i, axis in enumerate("wx")}
    (found,) = findings(tmp_path, orientation=half)
    assert "writes 2 of 4 elements of base_quat, which block 'imu_stop' reads" in found


def test_half_a_state_that_nobody_reads_is_fine(tmp_path: Path) -> None:
    half = {"linear_acceleration.x": "base_lin_acc[0]"}
    assert findings(tmp_path, linear_acceleration=half) == []

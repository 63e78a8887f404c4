"""Rules that look at live data: preflight names the broken one by its code, and no other."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from unicon_core.check.rules import LIVE
from unicon_core.preflight.look import PreflightResult, look
from unicon_core.workflow import Program

ROBOT = "gate_robots:make"
SAFETY = ["finite", "joint_limits", "range_stop"]

BROKEN: dict[str, dict[str, Any]] = {
    "gate.data": {"wrong": "never joint_vel"},
    "gate.rate": {"wrong": "slow"},
    "gate.changing": {"wrong": "frozen IMU"},
    "gate.imu": {"wrong": "in units of g"},
    "gate.posture": {"wrong": "beyond its limit"},
    "gate.tilt": {"wrong": "leaning"},
    "gate.stop": {"wrong": "beyond its limit", "safety": SAFETY},
    "gate.variant": {"wrong": "variant", "robot": "g1_29dof"},
    "gate.commanders": {"platform": "gate_robots:prepared"},
    "gate.command": {"command": 0.4},
    "preflight.frames": {"seen": ("frames", "12 frames a second, 500 are promised")},
    "preflight.first_command": {"seen": ("first command", "joint_pos_target is nan")},
    "preflight.disk": {"free": 5_000_000},
}
"""Code to what is broken; `seen` are rows whose making has tests of its own."""


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """A look takes less than a second."""
    monkeypatch.setattr("unicon_core.gates.data.Rate.WINDOW", 0.1)
    monkeypatch.setattr("unicon_core.gates.data.Changing.FROZEN", 0.2)


def looked(
    platform: str = ROBOT,
    wrong: str = "",
    robot: str = "go2",
    safety: Any = ("finite", "joint_limits"),
    command: float = 0.0,
    seen: tuple[str, str] | None = None,
) -> PreflightResult:
    named: dict[str, Any] = {"policies": {"walk": "go2_velocity"}, "flow": {"policy": "walk"}}
    program = Program(
        robot=robot,
        platform=platform,
        platforms={platform: {"wrong": wrong} if wrong else {}},
        rate=50,
        safety={"only": [*safety]},
        check={"accept": ["pose.start"]},
        silent=True,
        **(named if robot == "go2" else {"flow": "hold"}),
    )
    program.states["velocity_command"][...] = command
    try:
        result = look(program, 0.4)
    finally:
        program.close()
    if seen is not None:
        result.add(seen[0], False, seen[1])
    return result


def codes(result: PreflightResult) -> set[str]:
    return {row.code for row in result.rows if row.ok is False}


@pytest.mark.parametrize("code", BROKEN)
def test_preflight_names_the_rule_that_is_broken(
    code: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = dict(BROKEN[code])
    if "free" in broken:
        usage = SimpleNamespace(free=broken.pop("free"))
        monkeypatch.setattr("unicon_core.preflight.look.shutil.disk_usage", lambda _: usage)
    result = looked(**broken)
    assert code in codes(result)
    assert f"[{code}]" in result.text()
    assert codes(result) <= LIVE


def test_a_robot_in_order_breaks_no_rule(tmp_path: Path) -> None:
    result = looked()
    assert codes(result) == set()
    assert "[gate." not in result.text()


def test_every_rule_on_live_data_is_here() -> None:
    assert set(BROKEN) == LIVE

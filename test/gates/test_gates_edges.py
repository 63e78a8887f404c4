"""Each gate's own figures: what is just plausible holds, what is just beyond does not."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import Fault
from unicon_core import Program, block
from unicon_core.gates.data import Changing, Imu, Rate
from unicon_core.gates.gate import Heeding

PERIOD = 0.02
LEVEL = {
    "base_quat": (1.0, 0.0, 0.0, 0.0),
    "projected_gravity": (0.0, 0.0, -1.0),
    "base_ang_vel": (0.0, 0.0, 0.0),
    "base_lin_acc": (0.0, 0.0, 9.81),
}


def imu(changes: dict[str, Any], stop: Callable[[], str] | None = None) -> str:
    views = {name: np.array(value, np.float32) for name, value in (LEVEL | changes).items()}
    gate = Imu(views, tuple(views), PERIOD, stop)  # type: ignore[arg-type]
    return [gate() for _ in range(100)][-1]


def leaning(angle: float) -> tuple[float, ...]:
    return 0.0, 9.81 * math.sin(angle), 9.81 * math.cos(angle)


@pytest.mark.parametrize(
    ("state", "holds", "does_not", "words"),
    [
        ("base_lin_acc", (0, 0, 11.2), (0, 0, 11.5), "at rest, gravity is 9.81"),
        ("base_lin_acc", (0, 0, 8.4), (0, 0, 8.2), "at rest, gravity is 9.81"),
        ("base_lin_acc", leaning(0.19), leaning(0.21), "rad away from projected_gravity"),
        ("base_ang_vel", (0, 0, 0.49), (0, 0, 0.51), "the base turns at"),
        ("base_ang_vel", (0, 0, 0), (0, np.nan, 0), "the base turns at nan"),
        ("base_quat", (1.009, 0, 0, 0), (1.011, 0, 0, 0), "base_quat has length"),
        ("base_quat", (0.991, 0, 0, 0), (0.989, 0, 0, 0), "base_quat has length"),
    ],
)
def test_the_imu_at_rest(state: str, holds: Any, does_not: Any, words: str) -> None:
    assert imu({state: holds}) == ""
    assert words in imu({state: does_not})


def test_the_imu_heeds_a_stop_that_looks_for_contradictions() -> None:
    assert imu({}, lambda: "frozen; mend it") == "frozen; mend it"


@pytest.mark.parametrize(("of", "holds"), [(5, True), (4, False)])
def test_four_fifths_of_the_promised_rate_are_enough(of: int, holds: bool) -> None:
    """Of so many ticks one has no new data: 40 Hz are enough at 50, 37.5 are not."""
    seen = 0
    gate = Rate(lambda: seen, PERIOD, 200.0, "a test")
    said = []
    for k in range(200):
        seen += k % of > 0
        said.append(gate())
    assert said[20] != ""
    assert (said[-1] == "") == holds


def test_data_that_never_get_newer_come_at_no_rate() -> None:
    gate = Rate(lambda: 7, PERIOD, None, "a test")
    said = [gate() for _ in range(60)]
    assert said[0].startswith("the rate of the data is being measured")
    assert said[-1].startswith("new data come at 0 Hz, needed are 40 Hz")


def test_a_sensor_is_frozen_after_a_second() -> None:
    still, noisy = np.ones(3, np.float32), np.ones(12, np.float32)
    gate = Changing([still], [noisy], noisy, PERIOD)
    said = []
    for k in range(60):
        noisy += 0.001 * (k + 1)
        said.append(gate())
    assert said.index(next(filter(None, said))) == 50
    assert said[-1].startswith("the IMU sent the same bytes for")


def test_a_stop_that_counts_keeps_its_reason_and_begins_anew() -> None:
    told: list[str] = []

    def stop() -> None:
        if len(told) < 2:
            raise Fault("stuck")

    gate = Heeding("stop", "", stop, "mend it", lambda: told.append("reset"), lasting=3)
    assert [gate() for _ in range(6)] == ["stuck; mend it"] * 2 + ["stuck; mend it"] * 2 + [""] * 2
    assert told == ["reset", "reset"]


@pytest.mark.parametrize(("lean", "holds"), [(0.99, True), (1.01, False)])
def test_a_robot_that_walks_starts_upright_without_a_tilt_stop_of_its_own(
    lean: float, holds: bool
) -> None:
    program = Program(
        robot="go2", platform="fake_robot", rate=50, flow=block("hold"), safety={"only": ["finite"]}
    )
    gate = next(gate for gate in program.gates if gate.name == "tilt")
    program.states.projected_gravity[...] = (0.0, math.sin(lean), -math.cos(lean))
    assert (gate() == "") == holds
    program.close()


@pytest.mark.parametrize(("beyond", "holds"), [(0.049, True), (0.051, False)])
def test_an_encoder_may_be_off_a_little(beyond: float, holds: bool) -> None:
    program = Program(
        robot="go2", platform="fake_robot", rate=50, flow=block("hold"), safety={"only": ["finite"]}
    )
    gate = next(gate for gate in program.gates if gate.name == "posture")
    for limit, sign in ((program.robot.upper, 1.0), (program.robot.lower, -1.0)):
        program.states.joint_pos = program.robot.default_joint_pos
        program.states.joint_pos[4] = limit[4] + sign * beyond
        assert (gate() == "") == holds
    program.close()


def test_a_platform_that_counts_arrivals_is_asked_for_them() -> None:
    def arrivals(program: Program) -> dict[Any, Any]:
        program.platform.arrivals = lambda: 7  # type: ignore[attr-defined]
        return {}

    program = Program(
        robot="go2", platform="fake_robot", rate=50, flow=block("hold"), hooks=[arrivals]
    )
    rates = [gate for gate in program.gates if isinstance(gate, Rate)]
    program.close()
    assert [gate.count() for gate in rates] == [7]

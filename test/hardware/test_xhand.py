"""The XHand's adapter against a stand-in that minds each call, its arguments and their order."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_peers import hand_states, until

from unicon_base.errors import Fault, MissingDependencyError, PlatformError, RobotError
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import Program
from unicon_hardware.xhand import platform as wire
from unicon_hardware.xhand.platform import make

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "stand_in"

ROBOT = load_robot("xhand1_left")
MODULES = Path(__file__).parent / "vendor_modules"


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The stand-in, fresh."""
    monkeypatch.syspath_prepend(str(MODULES))
    for name in [name for name in sys.modules if name.startswith("xhand_controller")]:
        monkeypatch.delitem(sys.modules, name)
    from xhand_controller import xhand_control

    yield xhand_control
    for name in [name for name in sys.modules if name.startswith("xhand_controller")]:
        del sys.modules[name]


@pytest.mark.usefixtures("time_passes")
def test_calls_come_in_order_with_what_the_robot_file_says(module: Any) -> None:
    states = hand_states(ROBOT)
    platform = make(states, ROBOT, 0.01, device="/dev/ttyUSB7")
    opened = [("XHandControl",), ("open_serial", "/dev/ttyUSB7", 3_000_000), ("list_hands_id",)]
    assert opened == module.CALLS  # nothing is sent unasked
    np.testing.assert_allclose(states["joint_pos"], 0.1, atol=1e-6)
    assert states["motor_temperature"].tolist() == [30.0 + joint for joint in range(12)]
    goal = ROBOT.lower + 0.5 * (ROBOT.upper - ROBOT.lower)
    states["joint_pos_target"][...] = goal
    states["joint_stiffness"][...] = 1.0
    platform.send()
    name, hand, told = module.CALLS[-1]
    assert (name, hand) == ("send_command", 5)
    assert [row[0] for row in told] == list(range(12))
    facts = ROBOT.transport
    gains = [facts["kp"], facts["ki"], facts["kd"]]
    assert all([*row[1:4], *row[5:]] == [*gains, facts["max_torque"], 3] for row in told)
    np.testing.assert_allclose([row[4] for row in told], goal, atol=1e-6)
    platform.recv()
    np.testing.assert_allclose(states["joint_pos"], goal, atol=1e-6)
    assert platform.info()["clamped"] == 0
    states["joint_pos_target"][...] = 99.0
    states["joint_stiffness"][3] = 0.0
    platform.send()
    assert platform.info()["clamped"] == 1
    told = module.CALLS[-1][2]
    np.testing.assert_allclose([row[4] for row in told], ROBOT.upper, atol=1e-6)
    assert [row[6] for row in told] == [3] * 3 + [0] + [3] * 8
    platform.close()
    assert module.CALLS[-1] == ("close_device",)
    assert all(row[6] == 0 for row in module.CALLS[-2][2])  # limp at the end
    platform.close()
    assert module.CALLS.count(("close_device",)) == 1


def test_without_a_device_it_is_ethercat(module: Any) -> None:
    platform = make(hand_states(ROBOT), ROBOT, 0.01, silent=True)
    assert module.CALLS[1:3] == [("enumerate_devices", "EtherCAT"), ("open_ethercat", "eth9")]
    platform.send()
    platform.close()
    assert not [call for call in module.CALLS if call[0] == "send_command"]


@pytest.mark.parametrize(
    ("trouble", "options", "told"),
    [
        ("closed", {"device": "/dev/x"}, "cannot open /dev/x: trouble 7 (error 7)"),
        ("no_ethercat", {}, "give its serial line: device: /dev/ttyUSB0"),
        ("no_hand", {}, "no hand at eth9; give hand_id"),
        ("two_hands", {}, "hands 0, 5 at eth9; give hand_id"),
        ("", {"hand_id": 4}, "hands 5 at eth9; hand_id 4 is not there"),
        ("mute", {"connect": 0.1}, "error 3; the last one: error 3 (trouble 3)"),
        ("nan", {"connect": 0.1}, "not a number (of joint 4)"),
        ("swapped", {"connect": 0.1}, "other joints ([1, 0, 2,"),
    ],
)
def test_what_is_wrong_at_the_start_is_told(
    module: Any, trouble: str, options: dict[str, Any], told: str
) -> None:
    module.TROUBLE.add(trouble)
    with pytest.raises(PlatformError) as raised:
        make(hand_states(ROBOT), ROBOT, 0.01, **options)
    assert told in str(raised.value)
    if trouble not in ("closed", "no_ethercat"):
        assert module.CALLS[-1] == ("close_device",)


def test_a_module_that_is_not_there_is_named() -> None:
    with pytest.raises(MissingDependencyError, match="needs xhand_controller: install the wheel"):
        make(hand_states(ROBOT), ROBOT, 0.01)


@pytest.mark.parametrize("trouble", ["mute", "frozen", "nan"])
def test_a_hand_that_falls_silent_is_a_fault(
    module: Any, trouble: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(wire, "FROZEN", 0.1)
    platform = make(hand_states(ROBOT), ROBOT, 0.01, silence=0.05)
    module.TROUBLE.add(trouble)

    def tick() -> bool:
        platform.recv()
        return False

    with pytest.raises(Fault, match="the robot is silent"):
        until(tick)
    platform.close()


def test_a_command_that_is_not_taken_is_a_fault_and_errors_are_told(module: Any) -> None:
    states = hand_states(ROBOT)
    platform = make(states, ROBOT, 0.01)
    module.TROUBLE.update(("deaf", "board"))
    platform.recv()
    assert states["motor_error"].tolist() == [0, 0, 1, *[0] * 9]
    with pytest.raises(Fault, match=r"does not take a command: trouble 9 \(error 9\)"):
        platform.send()
    platform.close()


@pytest.mark.slow
def test_it_runs_beside_a_body_in_a_process_of_its_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    calls = tmp_path / "calls"
    monkeypatch.syspath_prepend(str(MODULES))
    monkeypatch.setenv("XHAND_CALLS", str(calls))
    child = {"child": "unicon_hardware.xhand.platform:make", "silence": 5.0, "watchdog": 5.0}
    program = Program(
        robot={"body": "go2", "left_hand": "xhand1_left"},
        platform={"body": "fake_robot", "left_hand": child},
        start={"operator": False, "fade_in": 0.1},
        rate=50,
        flow={"chain": [{"pose": {"to": "rest", "duration": 0.3}}]},
    )
    report = Runner(program, RunOptions(speed="real")).run()
    assert not report.faults, report.faults
    time.sleep(0.1)
    told = [json.loads(line) for line in calls.read_text().splitlines()]
    assert [call[0] for call in told[:4]] == [
        "XHandControl",
        "enumerate_devices",
        "open_ethercat",
        "list_hands_id",
    ]
    assert {call[0] for call in told[4:-1]} == {"send_command"}
    assert told[-1] == ["close_device"]


@pytest.mark.parametrize("key", ["baudrate", "kp", "max_torque", "mode", "module"])
def test_a_fact_that_lacks_is_told(module: Any, key: str) -> None:
    robot = replace(ROBOT, transport={k: v for k, v in ROBOT.transport.items() if k != key})
    with pytest.raises(RobotError, match=f"transport.{key} is None; write"):
        make(hand_states(robot), robot, 0.01, device="/dev/ttyUSB0")

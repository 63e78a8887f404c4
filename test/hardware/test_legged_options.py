"""Options and robot files of `unitree_legged` that are wrong, and what `unicon check` knows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from legged_peer import robot_of, states_of

from unicon_base.errors import PlatformError, RobotError, StateError
from unicon_core import Program, block
from unicon_core.robots import load_robot
from unicon_core.states import States, StateSpec, standard_states
from unicon_hardware.unitree_legged.platform import make

PERIOD = 0.002


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        (
            "aliengo",
            {},
            r"one of 3 protocols.*say the generation.*--set generation=legged_sdk_3\.3\.1",
        ),
        ("aliengo", {"generation": "aliengo_sdk_1.2.2"}, r"structs are not packed.*spoken are leg"),
        ("go1", {"generation": "legged_sdk_3.3.1"}, r"no generation 'legged_sdk_3.3.1'; did you"),
        ("go1", {"generation": 3}, "no generation 3"),
        ("go1", {"address": "go1.local"}, "address is 'go1.local'; give an IPv4"),
        ("go1", {"address": 7}, "address is 7"),
        ("go1", {"port": 0}, "port is 0; give one from 1 to 65535"),
        ("go1", {"port": True}, "port is True"),
        ("go1", {"local_port": 70000}, "local_port is 70000"),
        ("a1", {"encrypted": True}, "known of Go1's datagrams alone"),
        ("go1", {"watchdog": 0.001}, "watchdog is 0.001 s; give more than a tick of 0.002 s"),
        ("go1", {"watchdog": float("nan")}, "watchdog is nan"),
    ],
)
def test_a_wrong_option_is_told(name: str, options: dict[str, Any], message: str) -> None:
    robot = robot_of(name)
    with pytest.raises(PlatformError, match=message):
        make(states_of(robot), robot, PERIOD, connect=0.01, **options)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"motors": [0, 1, 2]}, "write 12 different slots of 0 to 19"),
        ({"motors": [*range(11), 12]}, "write 12 slots in sequence, all below 20"),
        ({"level_flag": 256}, "level_flag is 256"),
        ({"pos_stop": None}, "pos_stop is None"),
        ({"damping_mode": "x"}, "damping_mode is 'x'"),
        ({"generations": {}}, r"generations is \{\}"),
        ({"generations": {"x": 3}}, r"generations is \{'x': 3\}; write \{NAME"),
        ({"generations": {"x": {"command_bytes": [1]}}}, r"has \[1\] and None bytes"),
        (
            {"generations": {"x": {"local_port": 1, "command_bytes": 1}}},
            "has 1 and None bytes; known: 610 and 771, 614 and 807",
        ),
    ],
)
def test_a_robot_file_that_lacks_a_fact_is_told(changes: dict[str, Any], message: str) -> None:
    robot = load_robot("go1")
    robot = replace(robot, transport={**robot.transport, **changes})
    with pytest.raises(RobotError, match=message):
        make(states_of(robot), robot, PERIOD, connect=0.01)


def test_foot_forces_are_four() -> None:
    robot = load_robot("a1")
    specs = standard_states(robot.joint_names) | {"foot_force": StateSpec((2,))}
    with pytest.raises(StateError, match=r"foot_force.*writes four"):
        make(States(specs), robot, PERIOD, address="127.0.0.1", connect=0.01)


@pytest.mark.parametrize(("name", "battery"), [("a1", False), ("go1", True)])
def test_check_knows_what_a_robot_tells_without_opening_it(name: str, battery: bool) -> None:
    described: dict[str, Any] = {
        "robot": name,
        "platform": "unicon_hardware.unitree_legged.platform:make",
        "rate": 50,
        "states": {"foot_force": {"shape": [4]}},
    }
    writes = Program(dry=True, flow=block("hold"), **described).platform.facts.writes
    assert ("battery_charge" in writes) is battery
    assert {"foot_force", "motor_error"} <= set(writes)
    described["robot"] = "aliengo"
    with pytest.raises(PlatformError, match="say the generation"):
        Program(dry=True, flow=block("damp"), **described)

"""What a robot file says of a robot behind Unitree's DDS, checked, and the maps made of it.

For driver and emulator. The names on our side of LowState and LowCmd are states, and a few arrays
of their own: `tick`, `mode_machine`, `mode_pr`, `modes` (of motors), `temperatures` (two of each
motor) and `remote` (40 bytes).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from unicon_base.schema.marks import Key, Size, Within, Write
from unicon_core.robots import Robot
from unicon_hardware.dds.maps import (
    COMMANDS,
    IMU,
    MEASURED,
    DdsFacts,
    Message,
    motors,
)
from unicon_hardware.facts import (
    Octet,
    each,
    fact,
    facts_of,
    joint_number,
    named,
    one_of,
    slots,
    wrong_fact,
)
from unicon_msgs_map.layout.messages import Array, Struct, shared_messages

PROTOCOLS = ("unitree_go", "unitree_hg")
PROTOCOL = Annotated[str, one_of(*PROTOCOLS)]
HEAD = Annotated[list[Octet], Size(2, 2), Write("2 whole numbers from 0 to 255")]
STOP = Annotated[float, Within(1.0, 1e10)]


@dataclass(frozen=True)
class UnitreeFacts(DdsFacts):
    """`transport` of a robot file.

    Attributes:
        protocol: `unitree_go` or `unitree_hg`, which is the messages' package too.
        slots: motor of each joint.
        modes: byte `mode` of each joint's commands, and of its state while its motor works. A
            Go2's working motors report 1, stopped ones 0 (what one reported that stood and sat is
            in hanlinniu/unitree_sdk2_python example/low_level/motor_state_data_example_*.py);
            those of G1 and H1-2 1 enabled, 0 disabled (unitree_sdk2 example/g1/low_level). Of an
            H1 no source says it, and unitree_mujoco leaves 0.
        constants: path in LowCmd to what always stands there.
        release: service and number of what is asked before the controller lets go, or None; and how
            long to wait behind it in [s].
        waist: number of the joint between pelvis and the IMU in the torso, or None.
        battery: LowState tells of the battery.
        mode_machine: the variant that the file is of, or None.
    """

    protocol: PROTOCOL
    slots: list[int]
    modes: list[int]
    constants: Mapping[str, Any]
    release: tuple[tuple[str, int] | None, float]
    waist: Annotated[int | None, Key("waist_joint"), joint_number] = None
    battery: bool = False
    mode_machine: Annotated[int | None, Within(0, 255)] = None

    @property
    def go(self) -> bool:
        """Whether it is the older protocol, which quadrupeds and H1 speak."""
        return self.protocol == "unitree_go"

    def message(self, name: str) -> Struct:
        """Return a message of the protocol, such as `LowCmd`."""
        return shared_messages().struct(f"{self.protocol}/msg/{name}")

    @property
    def state(self) -> Message:
        """LowState."""
        fields: dict[str, Any] = {f"imu_state.{key}": name for key, name in IMU.items()}
        fields |= {"tick": "tick", "wireless_remote": "remote"}
        told = MEASURED | {"mode": "modes"}
        if self.go:
            told["temperature"] = "motor_temperature"
            fields["foot_force"] = "foot_force"
            if self.battery:
                fields["bms_state.soc"] = {"state": "battery_charge", "scale": 0.01}
                fields["power_v"] = "battery_voltage"
        else:
            told["motorstate"] = "motor_error"
            fields["mode_machine"] = "mode_machine"
            fields |= motors("motor_state", self.slots, {"temperature": "temperatures"}, size=2)
        fields |= motors("motor_state", self.slots, told)
        return self._message(self.state_topic, "LowState", fields, orientation="base_quat")

    @property
    def command(self) -> Message:
        """LowCmd; who reads it refuses a command for its modes."""
        fields = motors("motor_cmd", self.slots, COMMANDS)
        taken: dict[str, Any] = motors("motor_cmd", self.slots, {"mode": "modes"})
        if self.go:
            taken["level_flag"] = self.constants["level_flag"]  # required
        else:
            fields["mode_machine"] = "mode_machine"
            taken["mode_pr"] = "mode_pr"
        return self._message(self.command_topic, "LowCmd", fields, sent=self.constants, taken=taken)

    def _message(self, topic: str, kind: str, fields: Mapping[str, Any], **more: Any) -> Message:
        more["sent"] = {**more.get("sent", {}), "crc": {"checksum": "unitree"}}
        return Message(topic, f"{self.protocol}/msg/{kind}", fields, checked=True, **more)

    @classmethod
    def of(cls, robot: Robot) -> UnitreeFacts:
        """Read them.

        Raises:
            RobotError: one lacks, or is not what it must be.
        """
        protocol = fact(robot, "protocol", PROTOCOL)
        array = shared_messages().struct(f"{protocol}/msg/LowCmd").fields["motor_cmd"]
        assert isinstance(array, Array)
        assert array.length is not None
        motors, modes = _motors(robot, array.length), _modes(robot)
        return facts_of(
            cls,
            robot,
            slots=motors,
            modes=modes,
            constants=_constants(robot, array.length, dict(zip(motors, modes))),
            release=_release(robot),
        )


def _motors(robot: Robot, count: int) -> list[int]:
    if robot.transport.get("motors") or robot.num_joints > count:
        found: list[int] = fact(robot, "motors", Annotated[list[int], slots(count)])
        return found
    return [*range(robot.num_joints)]


def _modes(robot: Robot) -> list[int]:
    listed = isinstance(robot.transport.get("motor_mode"), list)
    hint = Annotated[list[int], each(0, 255, whole=True)] if listed else Octet
    said = fact(robot, "motor_mode", hint)
    return said if listed else [said] * robot.num_joints


def _constants(robot: Robot, count: int, modes: Mapping[int, int]) -> dict[str, Any]:
    """Return what always stands in LowCmd; `modes` by slot, of those that have a joint."""
    go = robot.transport["protocol"] == "unitree_go"
    keys = {"head": HEAD, "level_flag": Octet} if go else {"mode_pr": Octet}
    constants = {key: fact(robot, key, hint) for key, hint in keys.items()}
    unused = robot.transport.get("unused_slots") or {}
    if not isinstance(unused, dict):
        raise wrong_fact(robot, "unused_slots", "{slot: mode, …}")
    if unused:
        unused = fact(robot, "unused_slots", Annotated[Any, named(tuple(unused), 0, 255)])
    same = go and not isinstance(robot.transport.get("motor_mode"), list)
    idle = robot.transport["motor_mode"] if same else 0
    for slot in range(count):
        constants[f"motor_cmd[{slot}].mode"] = modes.get(slot, unused.get(slot, idle))
        if go and slot not in modes:
            constants[f"motor_cmd[{slot}].q"] = fact(robot, "pos_stop", STOP)
            constants[f"motor_cmd[{slot}].dq"] = fact(robot, "vel_stop", STOP)
    return constants


def _release(robot: Robot) -> tuple[tuple[str, int] | None, float]:
    """Return how the robot's own controller is asked to let go."""
    said = robot.transport.get("release")
    if not isinstance(said, dict) or not isinstance(said.get("wait"), (int, float)):
        wanted = "{wait: seconds}, with before: [service, number] if any"
        raise wrong_fact(robot, "release", wanted)
    before = said.get("before")
    if before is None:
        return None, float(said["wait"])
    if not isinstance(before, list) or [*map(type, before)] != [str, int]:
        wanted = "before: [service, number], such as [sport, 1005]"
        raise wrong_fact(robot, "release", wanted)
    return (before[0], before[1]), float(said["wait"])

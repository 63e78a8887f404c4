"""What a robot file says of a robot behind Unitree's DDS, checked; for driver and emulator."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from unicon_core.errors import RobotError
from unicon_core.robots import Robot
from unicon_msgs_map.layout.messages import Array, Struct, shared_messages

__all__ = ["PROTOCOLS", "Run", "UnitreeFacts"]

PROTOCOLS = ("unitree_go", "unitree_hg")
OCTET = 255
DOMAIN = 0


@dataclass(frozen=True)
class Run:
    """Neighbouring motor slots of neighbouring joints, with one mode.

    Attributes:
        slots: first slot, and the one behind the last.
        joint: the first joint; -1 of slots without one.
        mode: byte `mode` of their commands.
    """

    slots: tuple[int, int]
    joint: int
    mode: int

    @property
    def joints(self) -> tuple[int, int]:
        """The first joint, and the one behind the last."""
        return self.joint, self.joint + self.slots[1] - self.slots[0]


@dataclass(frozen=True)
class UnitreeFacts:
    """`transport` of a robot file.

    Attributes:
        protocol: `unitree_go` or `unitree_hg`, which is the messages' package too.
        domain: of DDS.
        state_topic: of LowState.
        command_topic: of LowCmd.
        rate: of LowState in [Hz].
        runs: of motors, those without a joint among them; each slot once.
        constants: path in LowCmd to what always stands there.
        waist: number of the joint between pelvis and the IMU in the torso, or None.
        battery: LowState tells of the battery.
        release: service and number of what is asked before the controller lets go, or None; and how
            long to wait behind it in [s].
        mode_machine: the variant that the file is of, or None.
    """

    protocol: str
    domain: int
    state_topic: str
    command_topic: str
    rate: float
    runs: tuple[Run, ...]
    constants: Mapping[str, Any]
    waist: int | None
    battery: bool
    release: tuple[tuple[str, int] | None, float]
    mode_machine: int | None

    @property
    def go(self) -> bool:
        """Whether it is the older protocol, which quadrupeds and H1 speak."""
        return self.protocol == "unitree_go"

    @property
    def driven(self) -> tuple[Run, ...]:
        """The runs that have joints."""
        return tuple(run for run in self.runs if run.joint >= 0)

    def message(self, name: str) -> Struct:
        """Return a message of the protocol, such as `LowCmd`."""
        return shared_messages().struct(f"{self.protocol}/msg/{name}")

    @classmethod
    def of(cls, robot: Robot) -> UnitreeFacts:
        """Read them.

        Raises:
            RobotError: one lacks, or is not what it must be.
        """
        read = _Reading(robot)
        protocol = read.transport.get("protocol")
        if protocol not in PROTOCOLS:
            raise read.wrong("protocol", f"one of {', '.join(PROTOCOLS)}")
        go = protocol == "unitree_go"
        array = shared_messages().struct(f"{protocol}/msg/LowCmd").fields["motor_cmd"]
        assert isinstance(array, Array)
        assert array.length is not None
        constants: dict[str, Any] = {}
        if go:
            head = read.transport.get("head")
            if not isinstance(head, list) or len(head) != 2 or not all(map(_octet, head)):
                raise read.wrong("head", "two bytes")
            constants = {"head": head, "level_flag": read.octet("level_flag")}
        else:
            constants = {"mode_pr": read.octet("mode_pr")}
        runs = tuple(read.runs(array.length, go))
        for run in runs:
            idle = run.joint < 0
            for k in range(*run.slots):
                constants[f"motor_cmd[{k}].mode"] = run.mode
                if idle and go:
                    constants[f"motor_cmd[{k}].q"] = read.number("pos_stop")
                    constants[f"motor_cmd[{k}].dq"] = read.number("vel_stop")
        waist = read.transport.get("waist_joint")
        if waist is not None and waist not in robot.joint_names:
            raise read.wrong("waist_joint", "one of the joints")
        return cls(
            protocol,
            read.whole("domain", DOMAIN),
            read.text("state_topic"),
            read.text("command_topic"),
            read.number("rate_hz"),
            runs,
            constants,
            None if waist is None else robot.joint_names.index(waist),
            read.transport.get("battery") is True,
            read.release(),
            None if read.transport.get("mode_machine") is None else read.octet("mode_machine"),
        )


def _octet(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= OCTET


class _Reading:
    """Reads single facts, with an error that names file and key."""

    def __init__(self, robot: Robot) -> None:
        self.robot, self.transport = robot, robot.transport

    def wrong(self, key: str, wanted: str) -> RobotError:
        value = self.transport.get(key)
        return RobotError(f"{self.robot.path}: transport.{key} is {value!r}; give {wanted}")

    def text(self, key: str) -> str:
        value = self.transport.get(key)
        if not isinstance(value, str) or not value:
            raise self.wrong(key, "the topic's name")
        return value

    def number(self, key: str) -> float:
        value = self.transport.get(key)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.wrong(key, "a number")
        return float(value)

    def whole(self, key: str, default: int) -> int:
        value = self.transport.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.wrong(key, "a whole number")
        return value

    def octet(self, key: str) -> int:
        value = self.transport.get(key)
        if not _octet(value):
            raise self.wrong(key, f"0 to {OCTET}")
        return int(value)  # type: ignore[arg-type]

    def release(self) -> tuple[tuple[str, int] | None, float]:
        """How the robot's own controller is asked to let go."""
        said = self.transport.get("release")
        if not isinstance(said, dict) or not isinstance(said.get("wait"), (int, float)):
            raise self.wrong("release", "{wait: seconds}, with before: [service, number] if any")
        before = said.get("before")
        if before is None:
            return None, float(said["wait"])
        if not isinstance(before, list) or [*map(type, before)] != [str, int]:
            raise self.wrong("release", "before: [service, number], such as [sport, 1005]")
        return (before[0], before[1]), float(said["wait"])

    def runs(self, slots: int, go: bool) -> Iterator[Run]:
        """Return all slots of LowCmd as runs, in their order."""
        joints = self.robot.num_joints
        motors = self.transport.get("motors") or list(range(joints))
        fits = isinstance(motors, list) and len(motors) == joints == len(set(motors))
        if not fits or not all(isinstance(m, int) and 0 <= m < slots for m in motors):
            raise self.wrong("motors", f"{joints} different slots of 0 to {slots - 1}")
        said = self.transport.get("motor_mode")
        modes: list[Any] = said if isinstance(said, list) else [said] * joints
        if len(modes) != joints or not all(map(_octet, modes)):
            raise self.wrong("motor_mode", f"a byte, or {joints} of them")
        unused = self.transport.get("unused_slots") or {}
        if not isinstance(unused, dict) or not all(map(_octet, unused.values())):
            raise self.wrong("unused_slots", "slot: mode")
        idle = int(said) if go and _octet(said) else 0  # type: ignore[arg-type]
        joint_of = {motor: joint for joint, motor in enumerate(motors)}
        joint = [joint_of.get(slot, -1) for slot in range(slots)]
        mode: list[int] = [
            modes[j] if j >= 0 else unused.get(slot, idle) for slot, j in enumerate(joint)
        ]
        start = 0
        for slot in range(1, slots + 1):
            follower = joint[start] + slot - start if joint[start] >= 0 else -1
            if slot == slots or (joint[slot], mode[slot]) != (follower, mode[start]):
                yield Run((start, slot), joint[start], mode[start])
                start = slot

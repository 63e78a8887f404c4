"""What a robot file says of a robot behind Unitree's DDS, checked; for driver and emulator."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from unicon_core.robots import Robot
from unicon_msgs_map.layout.messages import Array, Struct, shared_messages
from unicon_ros.hardware.dds.participant import LARGEST_DOMAIN
from unicon_ros.hardware.facts import TransportFacts

PROTOCOLS = ("unitree_go", "unitree_hg")
OCTET = 255


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

    @property
    def modes(self) -> list[int]:
        """Byte `mode` of each joint's commands, and of its state while its motor works.

        A Go2's working motors report 1, stopped ones 0 (what one reported that stood and sat is in
        hanlinniu/unitree_sdk2_python example/low_level/motor_state_data_example_*.py); those of
        G1 and H1-2 1 enabled, 0 disabled (unitree_sdk2 example/g1/low_level). Of an H1 no source
        says it, and unitree_mujoco leaves 0.
        """
        found = {joint: run.mode for run in self.driven for joint in range(*run.joints)}
        return [found[joint] for joint in sorted(found)]

    def message(self, name: str) -> Struct:
        """Return a message of the protocol, such as `LowCmd`."""
        return shared_messages().struct(f"{self.protocol}/msg/{name}")

    @classmethod
    def of(cls, robot: Robot) -> UnitreeFacts:
        """Read them.

        Raises:
            RobotError: one lacks, or is not what it must be.
        """
        said, facts = robot.transport, TransportFacts(robot)
        protocol = facts.one_of("protocol", PROTOCOLS)
        go = protocol == "unitree_go"
        array = shared_messages().struct(f"{protocol}/msg/LowCmd").fields["motor_cmd"]
        assert isinstance(array, Array)
        assert array.length is not None
        constants: dict[str, Any] = {}
        if go:
            head = list(facts.integers("head", 2, 0, OCTET))
            constants = {"head": head, "level_flag": facts.integer("level_flag", 0, OCTET)}
        else:
            constants = {"mode_pr": facts.integer("mode_pr", 0, OCTET)}
        runs = tuple(_runs(robot, facts, array.length, go))
        for run in runs:
            idle = run.joint < 0
            for k in range(*run.slots):
                constants[f"motor_cmd[{k}].mode"] = run.mode
                if idle and go:
                    constants[f"motor_cmd[{k}].q"] = facts.number("pos_stop", 1.0, 1e10)
                    constants[f"motor_cmd[{k}].dq"] = facts.number("vel_stop", 1.0, 1e10)
        waist = None
        if said.get("waist_joint") is not None:
            waist = robot.joint_names.index(facts.one_of("waist_joint", robot.joint_names))
        known = said.get("mode_machine") is not None
        return cls(
            protocol,
            facts.integer("domain", 0, LARGEST_DOMAIN),
            facts.text("state_topic"),
            facts.text("command_topic"),
            facts.number("rate_hz", 1.0, 10_000.0),
            runs,
            constants,
            waist,
            said.get("battery") is True,
            _release(said, facts),
            facts.integer("mode_machine", 0, OCTET) if known else None,
        )


def _release(
    transport: Mapping[str, Any], facts: TransportFacts
) -> tuple[tuple[str, int] | None, float]:
    """Return how the robot's own controller is asked to let go."""
    said = transport.get("release")
    if not isinstance(said, dict) or not isinstance(said.get("wait"), (int, float)):
        raise facts.wrong("release", "{wait: seconds}, with before: [service, number] if any")
    before = said.get("before")
    if before is None:
        return None, float(said["wait"])
    if not isinstance(before, list) or [*map(type, before)] != [str, int]:
        raise facts.wrong("release", "before: [service, number], such as [sport, 1005]")
    return (before[0], before[1]), float(said["wait"])


def _runs(robot: Robot, facts: TransportFacts, slots: int, go: bool) -> Iterator[Run]:
    """Return all slots of LowCmd as runs, in their order."""
    joints, transport = robot.num_joints, robot.transport
    motors = tuple(range(joints))
    if transport.get("motors") or joints > slots:
        motors = facts.slots("motors", slots)
    if isinstance(transport.get("motor_mode"), list):
        modes = facts.integers("motor_mode", joints, 0, OCTET)
        idle = 0
    else:
        modes = (facts.integer("motor_mode", 0, OCTET),) * joints
        idle = modes[0] if go else 0
    unused = transport.get("unused_slots") or {}
    if not isinstance(unused, dict):
        raise facts.wrong("unused_slots", "{slot: mode, …}")
    if unused:
        unused = facts.mapping("unused_slots", tuple(unused), 0, OCTET)
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

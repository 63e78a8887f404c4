"""What a robot file says of a robot behind Unitree's DDS, checked, and the maps made of it.

For driver and emulator. The names on our side of LowState and LowCmd are states, and a few arrays
of their own: `tick`, `mode_machine`, `mode_pr`, `modes` (of motors), `temperatures` (two of each
motor) and `remote` (40 bytes).
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from unicon_base import AnyDict, AnyMapping, Fault
from unicon_base.schema.marks import Key, Size, Within, Write
from unicon_core.robots import Robot
from unicon_hardware.dds.maps import COMMANDS, IMU, MEASURED, DdsFacts, Message, motors
from unicon_hardware.dds.participant import Participant
from unicon_hardware.dds.service import Procedure, ServiceEnd
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
from unicon_msgs_map.layout.messages import Array, shared_messages

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
    constants: AnyMapping
    release: tuple[tuple[str, int] | None, float]
    waist: Annotated[int | None, Key("waist_joint"), joint_number] = None
    battery: bool = False
    mode_machine: Annotated[int | None, Within(0, 255)] = None
    arrays = (
        "tick u4, mode_machine u1, mode_pr u1, modes u1 {n}, temperatures i2 {twice}, remote u1 40"
    )

    @property
    def go(self) -> bool:
        """Whether it is the older protocol, which quadrupeds and H1 speak."""
        return self.protocol == "unitree_go"

    @property
    def state(self) -> Message:
        """LowState."""
        fields: AnyDict = IMU | {"tick": "tick", "wireless_remote": "remote"}
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
        taken = motors("motor_cmd", self.slots, {"mode": "modes"})
        if self.go:
            taken["level_flag"] = self.constants["level_flag"]  # required
        else:
            fields["mode_machine"] = "mode_machine"
            taken["mode_pr"] = "mode_pr"
        return self._message(self.command_topic, "LowCmd", fields, sent=self.constants, taken=taken)

    def _message(self, topic: str, kind: str, fields: AnyMapping, **more: Any) -> Message:
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


def _constants(robot: Robot, count: int, modes: Mapping[int, int]) -> AnyDict:
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
    said: Any = robot.transport.get("release")
    said = said if isinstance(said, dict) else {}
    wait, before = said.get("wait"), said.get("before")
    named = isinstance(before, list) and [*map(type, before)] == [str, int]
    if not isinstance(wait, int | float) or not (named or before is None):
        wanted = "{wait: seconds}, with before: [service, number], such as [sport, 1005], if any"
        raise wrong_fact(robot, "release", wanted)
    return (before[0], before[1]) if named else None, float(wait)


class _End(ServiceEnd):
    request = "unitree_api/msg/Request", "rt/api/{}/request"
    response = "unitree_api/msg/Response", "rt/api/{}/response"

    def _part(self, name: str, *values: Any) -> Any:
        return self._types[f"unitree_api/msg/{name}"](*values)


class Client(_End):
    """Asks a robot's service, one request at a time, without waiting; as `ServiceEnd`."""

    def prepare(self, number: int) -> None:
        """Make a request that wants a response, which is told by `answer`."""
        part = self._part
        identity = part("RequestIdentity", time.monotonic_ns(), number)
        policy = part("RequestPolicy", 0, False)
        header = part("RequestHeader", identity, part("RequestLease", 0), policy)
        self._asked = part("Request", header, "{}", np.zeros(0, np.uint8))

    def ask(self) -> None:
        """Send the request, or send it once more; the first answer to either counts."""
        self._say(self._asked)

    def answer(self) -> tuple[int, str] | None:
        """Return code and data of the answer, None as long as there is none."""
        for said in self.heard():
            if said.header.identity == self._asked.header.identity:
                return said.header.status.code, said.data
        return None


class Server(_End):
    """Serves requests, for an emulated robot; as `ServiceEnd`."""

    serves = True

    def reply(self, asked: Any, code: int, data: str = "") -> None:
        """Answer a request."""
        status = self._part("ResponseStatus", code)
        header = self._part("ResponseHeader", asked.header.identity, status)
        self._say(self._part("Response", header, data, np.zeros(0, np.uint8)))


SWITCHER = "motion_switcher"
CHECK_MODE, RELEASE_MODE = 1001, 1003
AGAIN = 2.0
"""CheckMode, the first request of all, is repeated after so long, in [s]: a service that has found
the writer of requests, and not the reader of responses, answers nobody."""
TRIES = 5
"""Modes that are released in a row; who takes it again and again is told."""

CODES = {
    3203: "the service does not know the request; its firmware is another generation",
    3204: "the service does not take its parameter",
    **dict.fromkeys((3205, 3207), "another program holds the service's lease; end it"),
    3206: "the lease is not there; end the programs that use the robot",
}
"""What the vendor's services answer, with remedy (unitree_sdk2py/rpc/internal.py)."""


class Release(Procedure):
    """Lets the robot's own controller let go, behind the operator's go.

    Args:
        participant: of the robot's domain.
        before: service and number of a request before each ReleaseMode, or None.
        wait: pause behind it in [s].
        what: in front of messages.
    """

    def __init__(
        self, participant: Participant, before: tuple[str, int] | None, wait: float, what: str
    ) -> None:
        super().__init__(what)
        self._wait = wait
        self._switcher = Client(participant, SWITCHER)
        self._before = (Client(participant, before[0]), before[1]) if before else None

    def _procedure(self) -> Generator[str, None, None]:
        yield from self._found(self._switcher)
        for _ in range(TRIES):
            mode = yield from self._mode()
            if not mode:
                return
            doing = f"its controller, mode {mode!r}, to let go of the motors"
            if self._before is not None:
                client, number = self._before
                yield from self._found(client)
                yield from self._answer(client, number, f"{doing} ({client.service} {number})")
            yield from self._answer(self._switcher, RELEASE_MODE, f"{doing} (ReleaseMode)")
            yield from self._pause(doing, self._wait)
        mode = yield from self._mode()
        if mode:
            raise Fault(
                f"{self._what}: the robot's own controller has mode {mode!r} again after "
                f"ReleaseMode, {TRIES} times; switch it off with the remote or the app"
            )

    def _found(self, client: Client) -> Generator[str, None, bool]:
        return self._until(
            lambda: client.there,
            f"its service {client.service!r}",
            lambda: (
                f"nobody serves {client.service!r} within {self.timeout:g} s, so that its own "
                "controller cannot be asked to let go of the motors; start the robot anew, or for "
                "a simulator without it say peer: unitree_mujoco"
            ),
        )

    def _mode(self) -> Generator[str, None, str]:
        """Return the mode of its own controller, "" for none."""
        data = yield from self._answer(self._switcher, CHECK_MODE, "which controller runs")
        try:
            name = json.loads(data)["name"]
        except (ValueError, LookupError, TypeError):
            name = None
        if not isinstance(name, str):
            raise Fault(
                f"{self._what}: CheckMode of {SWITCHER!r} answers {data[:60]!r}, which names no "
                "mode; its firmware is another generation"
            )
        return name

    def _answer(self, client: Client, number: int, doing: str) -> Generator[str, None, str]:
        """Ask a service and return what it answers."""
        client.prepare(number)
        code, data = yield from self._until(
            client.answer,
            doing,
            lambda: (
                f"service {client.service!r} does not answer request {number} within "
                f"{self.timeout:g} s; start the robot anew"
            ),
            client.ask,
            AGAIN if number == CHECK_MODE else math.inf,  # it does nothing: not as others
        )
        if code:
            why = CODES.get(code, "switch the robot's own controller off with the remote or app")
            raise Fault(
                f"{self._what}: service {client.service!r} refuses request {number} with code "
                f"{code}: {why}"
            )
        return data

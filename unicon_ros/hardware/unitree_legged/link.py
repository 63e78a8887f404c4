"""Link: what a robot file and the options say of the connection, checked, for wire and face."""

from __future__ import annotations

import ipaddress
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from unicon_core.errors import PlatformError, RobotError, alternatives
from unicon_core.robots import Robot
from unicon_ros.hardware.unitree_legged.codec import LAYOUTS, SLOTS, Layout

__all__ = ["NAME", "Link", "link_of"]

NAME = "unitree_legged"


@dataclass(frozen=True)
class Link:
    """Addresses, layout and modes.

    Attributes:
        generation: name of the protocol's.
        layout: its datagrams.
        address: of the robot.
        port: where it takes commands.
        local_port: where it is answered to.
        motors: slots of the joints.
        level_flag: of low-level datagrams.
        servo: mode of a motor that takes commands.
        damping: mode of one that brakes.
        pos_stop: position that says: no position loop.
        vel_stop: velocity that says: no velocity loop.
        rate: of datagrams in [Hz].
        preparation: what a person does so that the robot takes commands.
    """

    generation: str
    layout: Layout
    address: str
    port: int
    local_port: int
    motors: slice
    level_flag: int
    servo: int
    damping: int
    pos_stop: float
    vel_stop: float
    rate: float
    preparation: str


def link_of(
    robot: Robot,
    *,
    generation: str | None = None,
    address: str | None = None,
    port: int | None = None,
    local_port: int | None = None,
) -> Link:
    """Return what the robot file says, with the options in place of it where they are given.

    Args:
        robot: whose `transport` is read.
        generation: a word of its `generations`; None where it has one alone.
        address: IPv4 address.
        port: of the robot.
        local_port: of this machine.

    Raises:
        PlatformError: an option is wrong, or the generation has to be said.
        RobotError: the file lacks a fact, or it is wrong.
    """
    said = _Transport(robot)
    chosen, facts = _generation(robot, generation)
    lengths = [facts.get(key) for key in ("command_bytes", "state_bytes")]
    layout = next((layout for known, layout in LAYOUTS.items() if lengths == [*known]), None)
    if layout is None:
        raise said.wrong(
            f"generations.{chosen}",
            f"has {lengths[0]} and {lengths[1]} bytes",
            f"known: {', '.join(f'{command} and {state}' for command, state in LAYOUTS)}",
        )
    where = said.text("address") if address is None else address
    try:
        ipaddress.IPv4Address(where if isinstance(where, str) else "")
    except ValueError:
        raise PlatformError(
            f"platform {NAME!r}: address is {where!r}; give an IPv4 address such as 127.0.0.1"
        ) from None
    return Link(
        chosen,
        layout,
        where,
        _port("port", said.whole("port", 65535) if port is None else port),
        _port("local_port", facts.get("local_port") if local_port is None else local_port),
        said.motors(),
        said.whole("level_flag", 255),
        said.whole("motor_mode", 255),
        said.whole("damping_mode", 255),
        said.number("pos_stop"),
        said.number("vel_stop"),
        said.number("rate_hz"),
        said.text("preparation", "bring it into its low-level mode as its maker says"),
    )


def _generation(robot: Robot, chosen: str | None) -> tuple[str, Mapping[str, Any]]:
    known = robot.transport.get("generations")
    mapping = isinstance(known, Mapping) and all(isinstance(f, Mapping) for f in known.values())
    if not known or not mapping:
        raise _Transport(robot).wrong("generations", f"is {known!r}", "write {NAME: {…}, …}")
    spoken = [name for name, facts in known.items() if "command_bytes" in facts]
    if chosen is None and len(known) == 1:
        chosen = next(iter(known))
    if chosen is None:
        raise PlatformError(
            f"platform {NAME!r}: robot {robot.name} speaks one of {len(known)} protocols, and "
            "nothing tells which; say the generation by the vendor's SDK that drives yours: "
            f"platforms: {{{NAME}: {{generation: {spoken[0] if spoken else '…'}}}}}, "
            f"known: {', '.join(known)}"
        )
    if not isinstance(chosen, str) or chosen not in known:
        raise PlatformError(
            f"platform {NAME!r}: robot {robot.name} has no generation {chosen!r}; "
            f"{alternatives(str(chosen), known)}"
        )
    if chosen not in spoken:
        raise PlatformError(
            f"platform {NAME!r}: generation {chosen} cannot be spoken: "
            f"{known[chosen].get('refused', 'its layout is not known')}; "
            f"spoken are {', '.join(spoken)}"
        )
    return chosen, known[chosen]


def _port(key: str, value: Any) -> int:
    if type(value) is not int or not 0 < value < 65536:
        raise PlatformError(f"platform {NAME!r}: {key} is {value!r}; give one from 1 to 65535")
    return value


class _Transport:
    """Reads the section, with messages that name file and key."""

    def __init__(self, robot: Robot) -> None:
        self._robot, self._values = robot, robot.transport

    def wrong(self, key: str, what: str, remedy: str) -> RobotError:
        return RobotError(
            f"robot {self._robot.name}: transport.{key} {what}; {remedy} ({self._robot.path})"
        )

    def whole(self, key: str, most: int) -> int:
        value = self._values.get(key)
        if type(value) is not int or not 0 <= value <= most:
            raise self.wrong(key, f"is {value!r}", f"write a whole number from 0 to {most}")
        return value

    def number(self, key: str) -> float:
        value = self._values.get(key)
        if isinstance(value, (int, float)) and 0 < value < math.inf and value is not True:
            return float(value)
        raise self.wrong(key, f"is {value!r}", "write a number above 0")

    def text(self, key: str, default: str | None = None) -> str:
        value = self._values.get(key, default)
        if not isinstance(value, str):
            raise self.wrong(key, f"is {value!r}", "write a text")
        return value

    def motors(self) -> slice:
        motors, count = self._values.get("motors"), self._robot.num_joints
        first = motors[0] if motors else 0
        if motors != list(range(first, first + count)) or first + count > SLOTS:
            raise self.wrong(
                "motors", f"is {motors}", f"write {count} slots in sequence, all below {SLOTS}"
            )
        return slice(first, first + count)

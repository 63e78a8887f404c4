"""LeggedTransport: the connection of robot file and options, checked, for wire and endpoint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from unicon_base.errors import PlatformError, RobotError, alternatives
from unicon_base.schema.marks import Key, Text, Within
from unicon_core.robots import Robot
from unicon_hardware.facts import (
    Octet,
    Port,
    Rate,
    fact,
    facts_of,
    ipv4,
    port_number,
    slots,
    wrong_fact,
)
from unicon_hardware.unitree_legged.codec import LAYOUTS, SLOTS, Layout

NAME = "unitree_legged"


@dataclass(frozen=True)
class LeggedTransport:
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
    level_flag: Octet
    servo: Annotated[Octet, Key("motor_mode")]
    damping: Annotated[Octet, Key("damping_mode")]
    pos_stop: Annotated[float, Within(1.0, 1e10)]
    vel_stop: Annotated[float, Within(1.0, 1e10)]
    rate: Rate
    preparation: Text = "bring it into its low-level mode as its maker says"


def link_of(
    robot: Robot,
    *,
    generation: str | None = None,
    address: str | None = None,
    port: int | None = None,
    local_port: int | None = None,
) -> LeggedTransport:
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
    chosen, spoken = _generation(robot, generation)
    lengths = [spoken.get(key) for key in ("command_bytes", "state_bytes")]
    layout = next((layout for known, layout in LAYOUTS.items() if lengths == [*known]), None)
    if layout is None:
        known = ", ".join(f"{command} and {state}" for command, state in LAYOUTS)
        raise RobotError(
            f"robot {robot.name}: transport.generations.{chosen} has {lengths[0]} and "
            f"{lengths[1]} bytes; known: {known} ({robot.path})"
        )
    motors = fact(robot, "motors", Annotated[list[int], slots(SLOTS)])
    if [*motors] != [*range(motors[0], motors[0] + len(motors))]:
        raise wrong_fact(robot, "motors", f"{len(motors)} slots in sequence, all below {SLOTS},")
    address = fact(robot, "address", Text) if address is None else address
    port = fact(robot, "port", Port) if port is None else port
    local_port = spoken.get("local_port") if local_port is None else local_port
    return facts_of(
        LeggedTransport,
        robot,
        generation=chosen,
        layout=layout,
        address=ipv4(address, NAME),
        port=port_number(port, NAME),
        local_port=port_number(local_port, NAME, "local_port"),
        motors=slice(motors[0], motors[-1] + 1),
    )


def _generation(robot: Robot, chosen: str | None) -> tuple[str, Mapping[str, Any]]:
    known = robot.transport.get("generations")
    mapping = isinstance(known, Mapping) and all(
        isinstance(said, Mapping) for said in known.values()
    )
    if not known or not mapping:
        raise wrong_fact(robot, "generations", "{NAME: {…}, …}")
    spoken = [name for name, said in known.items() if "command_bytes" in said]
    if chosen is None and len(known) == 1:
        chosen = next(iter(known))
    if chosen is None:
        example = spoken[0] if spoken else "…"
        raise PlatformError(
            f"platform {NAME!r}: robot {robot.name} speaks one of {len(known)} protocols, and "
            "nothing tells which; say the generation by the vendor's SDK that drives yours: "
            f"platforms: {{{NAME}: {{generation: {example}}}}}, in `unicon emulate` "
            f"--set generation={example}; known: {', '.join(known)}"
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

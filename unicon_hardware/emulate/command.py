"""`unicon emulate ROBOT`: serves a robot's own protocol on loopback, in front of a simulator.

A workflow then runs against it as against the robot, with all gates. It begins lying, or as
`--posture` and `--hang` say, in real time. On standard output it says what it saw, one JSON line
each: `ready`, `first`, `commands`, `silence`, `damping`.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from unicon_base import AnyDict, Fault, PlatformError, RobotError, UniconError, alternatives
from unicon_ros.cli.console import note, warn
from unicon_ros.cli.options import (
    REPEATED,
    argument,
    command,
    exclusive,
    flag,
    group,
    option,
    positive,
)

if TYPE_CHECKING:
    from unicon_core.robots import Robot
    from unicon_hardware.emulate.body import Defects

LOOPBACK = "127.0.0.1"


def emulate(arguments: argparse.Namespace) -> int:
    """Run the command; exit status 0 ended, 3 the physics blew up."""
    # Imported here so that `unicon --help` stays fast and free of optional packages.
    from unicon_core.robots import load_robot
    from unicon_core.signals import SIGNALS
    from unicon_core.workflow.registry import find_factory, known
    from unicon_hardware.emulate.emulator import emulated

    robot = load_robot(arguments.robot)
    name = arguments.face or robot.transport.get("protocol")
    if name is None:
        raise RobotError(
            f"robot {robot.name}: {robot.path} names no protocol under transport; give --face, "
            f"one of {', '.join(sorted(known('faces')))}, or your own module:function"
        )
    factory = find_factory("faces", name, PlatformError)
    if arguments.variant is not None:
        if "mode_machine" not in robot.transport:
            raise RobotError(
                f"robot {robot.name} does not tell its variant ({robot.path} says no "
                "transport.mode_machine); leave --variant out"
            )
        transport = {**robot.transport, "mode_machine": arguments.variant}
        robot = replace(robot, transport=transport)
    emulator = emulated(
        robot,
        factory,
        _options(arguments, factory, name),
        name=name,
        defects=_defects(arguments, robot),
        let_go=arguments.let_go,
        each=arguments.each,
        warn=warn,
        model=arguments.model,
        posture=arguments.posture,
        hang=arguments.hang,
        seed=arguments.seed,
        still=arguments.still,
    )
    try:
        with SIGNALS.guard(emulator.stop):
            SIGNALS.check()
            emulator.run(arguments.duration or float("inf"))
    except Fault as fault:
        note(f"unicon: fault: {fault}")
        return 3
    finally:
        emulator.close()
    return 0


def _options(arguments: argparse.Namespace, factory: Any, name: str) -> AnyDict:
    """Return the options of the face."""
    from unicon_core.workflow.autowire import option_names
    from unicon_core.workflow.document import split_setting

    options = dict(map(split_setting, arguments.options))
    if "address" in option_names(factory):
        options.setdefault("address", arguments.address or LOOPBACK)
    elif arguments.address:
        raise UniconError(f"face {name!r} has no address; leave --address out")
    return options


def _defects(arguments: argparse.Namespace, robot: Robot) -> Defects:
    from unicon_hardware.emulate.body import Defects

    def number(joint: str) -> int:
        if joint not in robot.joint_names:
            names = alternatives(joint, robot.joint_names)
            raise RobotError(f"robot {robot.name} has no joint {joint!r}; {names}")
        return robot.joint_names.index(joint)

    swapped = tuple(map(number, arguments.swap))
    if len(set(swapped)) == 1:
        raise RobotError(f"--swap {arguments.swap[0]} with itself does nothing; give two joints")
    leaves = None
    if arguments.leave is not None:
        leaves = number(arguments.leave), arguments.leave_after
    return Defects(
        swapped,
        tuple(map(number, arguments.dead)),
        arguments.imu_upside_down,
        arguments.rate,
        leaves,
    )


add = command(
    "emulate",
    emulate,
    "be a robot on loopback, in front of a simulator",
    __doc__,
    argument("robot", "ROBOT", "name in config/robots/, or a path"),
    argument(
        "--model",
        "FILE",
        "MJCF or URDF, or `fake`: joints alone (default: the robot's own, if it is there)",
    ),
    argument(
        "--face",
        "NAME",
        "protocol, or module:function (default: transport.protocol of the robot file)",
    ),
    argument(
        "--set", "OPTION=VALUE", "an option of the face (repeatable)", dest="options", **REPEATED
    ),
    argument("--address", "IP", f"where it is served, of a face with one ({LOOPBACK})"),
    option("--seed", type=int, default=0, help="of posture and noise (0)"),
    option(
        "--posture",
        choices=("rest", "default", "random"),
        default="rest",
        help="it begins lying, on its legs, or in one drawn at random",
    ),
    exclusive(
        flag("--hang", "its base hangs on a gantry"),
        argument(
            "--let-go",
            "S",
            "a gantry holds it where it stands, and lets go S seconds after the first command",
            type=positive,
        ),
    ),
    flag("--still", "its sensors have no noise"),
    argument("--duration", "S", "end after S seconds", type=positive),
    flag("--each", "say every command"),
    group(
        "what is wrong with it, to see it found",
        None,
        argument("--swap", "JOINT", "their encoders", nargs=2, default=()),
        argument("--dead", "JOINT", "its motor does nothing", **REPEATED),
        argument("--leave", "JOINT", "its motor leaves the commanded mode after a while"),
        argument(
            "--leave-after",
            "S",
            "so long after the first command (default %(default)s)",
            type=positive,
            default=3.0,
        ),
        flag("--imu-upside-down", "as it is mounted"),
        argument("--rate", "HZ", "of its frames, less than usual", type=positive),
        argument("--variant", "N", "in place of the robot file's mode_machine", type=int),
    ),
)

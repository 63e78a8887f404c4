"""Which platforms have motors, and which robots may not be driven on them, for the builder."""

from __future__ import annotations

from unicon_core.errors import RobotError
from unicon_core.robots import Robot
from unicon_core.workflow.registry import Factory

__all__ = ["is_simulator", "refuse_incomplete", "refuse_protocol"]

_SIMULATORS = ("mujoco", "fake")


def is_simulator(name: str, factory: Factory) -> bool:
    """Return whether a platform moves no real motors; its factory says so by `simulated`.

    Args:
        name: word that the workflow uses.
        factory: of the platform; without an attribute `simulated` only our own are simulators.
    """
    return bool(getattr(factory, "simulated", name in _SIMULATORS))


def refuse_incomplete(robot: Robot, platform: str) -> None:
    """Refuse to drive a real robot whose file lacks a fact; nothing has been opened yet.

    Raises:
        RobotError: the file lacks motor order, a limit, a gain, the pose, the IMU or the protocol.
    """
    missing = robot.missing_facts()
    if missing:
        raise RobotError(
            f"robot {robot.name} cannot be driven on platform {platform!r}: {robot.path} does not "
            f"say {', '.join(missing)}; find it in the vendor's documents and add it with its "
            "source, or simulate: platform=mujoco"
        )


def refuse_protocol(robot: Robot, platform: str, factory: Factory) -> None:
    """Refuse a robot that speaks another protocol than the platform; nothing has been opened yet.

    A factory says by an attribute `protocols` which ones of robot files it speaks; without it any.

    Raises:
        RobotError: the robot file names another one.
    """
    spoken = getattr(factory, "protocols", None)
    protocol = robot.transport.get("protocol")
    if spoken is not None and protocol is not None and protocol not in spoken:
        raise RobotError(
            f"robot {robot.name} speaks {protocol} ({robot.path}), and platform {platform!r} only "
            f"{', '.join(spoken)}; choose the robot's platform"
        )

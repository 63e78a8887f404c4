"""Emulated robots behind their vendors' protocols, and what drives each, for tests of one word."""

from __future__ import annotations

import random
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from emulated_runs import PATIENT, Served
from legged_peer import free_port
from peer import Peer
from stepping import stepping

from unicon_core.robots import Robot
from unicon_hardware.emulate.emulator import emulated
from unicon_hardware.endpoint import Endpoint
from unicon_ros.bench.report import free_domain

__all__ = ["DRIVES", "UNSEEING", "completed", "serve", "stepped"]

ROBOTS = Path(__file__).resolve().parents[2] / "config" / "robots"
# The platform of each robot that can be served to another process.
DRIVES = {
    "a1": "unitree_legged",
    "adam_lite": "pnd",
    "aliengo": "unitree_legged",
    "atom": "dobot",
    "azureloong": "azureloong",
    "b2": "unitree",
    "dex3_left": "unitree_dex3",
    "g1_23dof": "unitree",
    "g1_29dof": "unitree",
    "go1": "unitree_legged",
    "go2": "unitree",
    "h1": "unitree",
    "h1_2": "unitree",
    "inspire_rh56_dfx_left": "inspire",
    "inspire_rh56_ftp_left": "inspire",
    "inspire_rh56_left": "inspire",
    "n1": "fourier",
    "rohand": "rohand",
    "t1": "booster",
    "x2": "ros",
}
# Platforms that tell of no IMU.
BLIND = ("fourier", "inspire", "rohand", "unitree_dex3")
# Safety of the workflows before a robot without an IMU.
UNSEEING = re.sub(r"tilt_stop, |\{imu_stop[^}]*\}\}, ", "", PATIENT)
# Figures in place of facts that are not public, as somebody would measure them.
STAND_INS: dict[str, tuple[tuple[str, str], ...]] = {
    "aliengo": (
        ("stiffness: null, damping: null", "stiffness: 20.0, damping: 2.0"),
        (r"unknown: \[.*\]", "unknown: [joints.rest]"),
        ("sources:\n", 'sources:\n  gains: "ours, for a test"\n'),
    ),
    "atom": (
        ("velocity: null", "velocity: 5.0"),
        ("effort: null", "effort: 50.0"),
        ("default: null", "default: 0.0"),
        (r"unknown: \[.*\]", "unknown: [joints.rest]"),
        ("sources:\n", 'sources:\n  default: "ours, for a test"\n'),
    ),
    "n1": (
        (r"stiffness_scale: null[^\n]*", f"stiffness_scale: {[0.5] * 23}"),
        (r"damping_scale: null[^\n]*", f"damping_scale: {[0.25] * 23}"),
        (r"timeout_mode: null[^\n]*", "timeout_mode: 3"),
        (r"unknown: \[.*\]", "unknown: [joints.rest]"),
    ),
    "x2": (("default: null", "default: 0.0"), (r"unknown: \[.*\]", "unknown: [joints.rest]")),
}


def completed(name: str, folder: Path) -> str:
    """Return a robot that can be driven: its name, or a file with what its own one lacks."""
    if name not in STAND_INS:
        return name
    text = (ROBOTS / f"{name}.yaml").read_text("utf-8")
    for wrong, right in STAND_INS[name]:
        text, count = re.subn(wrong, right, text)
        assert count, wrong
    path = folder / f"{name}.yaml"
    path.write_text(text, "utf-8")
    return str(path)


def serve(
    processes: Callable[..., Peer],
    name: str,
    robot: str,
    *more: str,
    generation: str = "",
) -> Served:
    """Serve a robot where no other test's is.

    Args:
        processes: starts it.
        name: of the robot, whose platform drives it.
        robot: its name or file.
        more: further arguments of `unicon emulate`.
        generation: of its protocol, where it has several.
    """
    platform, arguments, options = DRIVES[name], list(more), {"silence": 5, "connect": 20}
    given: dict[str, object] = dict(options)
    if platform == "unitree_legged":
        given |= {"address": "127.0.0.1", "port": free_port(), "local_port": free_port()}
        given |= {"watchdog": 5.0}
        arguments.append(f"--set=port={given['port']}")
        if generation:
            given["generation"] = generation
            arguments.append(f"--set=generation={generation}")
    elif platform in ("azureloong", "fourier"):
        given["address"] = f"127.{random.randint(2, 250)}.{random.randint(1, 250)}.1"
        arguments.append(f"--address={given['address']}")
        if platform == "azureloong":
            arguments.append("--set=plan=commands")
    elif platform == "ros":
        given.clear()
        arguments.append("--face=ros")
    elif name == "inspire_rh56_left":
        arguments.append("--set=port=0")
    elif platform != "rohand":
        given |= {"address": "127.0.0.1", "domain": free_domain()}
        arguments.append(f"--set=domain={given['domain']}")
    if platform == "dobot":
        given |= {"layout": "sdk", "fsm_id": 2}
    served = Served(processes, robot, *arguments, platform=platform, options=given)
    if platform == "rohand":
        given["device"] = served.where
    elif name == "inspire_rh56_left":
        address, _, port = served.where.rpartition(":")
        given |= {"address": address, "port": int(port)}
    if platform in BLIND:
        served.safety = UNSEEING
    return served


@contextmanager
def stepped(
    robot: Robot, face: Callable[..., Endpoint], options: dict[str, Any], **more: Any
) -> Iterator[list[dict[str, Any]]]:
    """Step an emulated robot of joints alone in a thread, for quick tests; yield what it says."""
    said: list[dict[str, Any]] = []
    emulator = emulated(
        robot,
        face,
        options,
        model="fake",
        say=lambda kind, **facts: said.append({"kind": kind, **facts}),
        **more,
    )
    period, due = 1.0 / said[0]["rate"], time.monotonic()

    def step() -> None:
        nonlocal due
        emulator.tick(time.monotonic())
        due = max(due + period, time.monotonic() - 0.1)  # a busy machine catches up a little
        time.sleep(max(0.0, due - time.monotonic()))

    with stepping(step, emulator.close):
        yield said

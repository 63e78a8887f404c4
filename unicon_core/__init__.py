"""The core of unicon: states, blocks, flow, robots, policies and platforms, without ROS.

from unicon_core import Chain, Loop, Program, elapsed, policy, pose, run
"""

from __future__ import annotations

import os
import sys
import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

from unicon_base import moved

if TYPE_CHECKING:
    from unicon_base import Fault, UniconError
    from unicon_core.flow import (
        Amends,
        Block,
        Chain,
        Every,
        Loop,
        Reads,
        Stage,
        Switch,
        When,
        Writes,
        Zip,
    )
    from unicon_core.robots import load_robot
    from unicon_core.run_program import run
    from unicon_core.runtime import Report, Runner, RunOptions
    from unicon_core.states import States, StateSpec
    from unicon_core.workflow import Program, load_workflow
    from unicon_core.workflow.uses import block, elapsed, policy, pose

__version__ = "0.4.0"
moved.install()

# onnxruntime 1.32 else queues for its maker what machine this is, in a thread beside the tick.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

if sys.platform != "linux":
    warnings.warn(
        f"unicon_ros runs on Linux alone, and this is {sys.platform!r}: use a container (docs/"
        "howto/install.md), a virtual machine or WSL 2",
        RuntimeWarning,
        stacklevel=2,
    )

_PLACES = {
    "unicon_base.errors": "Fault UniconError",
    "unicon_core.flow": "Amends Block Chain Every Loop Reads Stage Switch When Writes Zip",
    "unicon_core.robots": "load_robot",
    "unicon_core.run_program": "run",
    "unicon_core.runtime": "Report RunOptions Runner",
    "unicon_core.states": "StateSpec States",
    "unicon_core.workflow": "Program load_workflow",
    "unicon_core.workflow.uses": "block elapsed policy pose",
}
_MODULE_OF = {name: module for module, names in _PLACES.items() for name in names.split()}

__all__ = [
    "Amends",
    "Block",
    "Chain",
    "Every",
    "Fault",
    "Loop",
    "Program",
    "Reads",
    "Report",
    "RunOptions",
    "Runner",
    "Stage",
    "StateSpec",
    "States",
    "Switch",
    "UniconError",
    "When",
    "Writes",
    "Zip",
    "block",
    "elapsed",
    "load_robot",
    "load_workflow",
    "policy",
    "pose",
    "run",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is asked for: `unicon --help` stays without NumPy."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'unicon_core' has no attribute {name!r}")
    value = getattr(import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)

"""What recorded ticks mean and where they come from: the facts of recordings and fault records."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import sys
import time
import uuid
from contextlib import suppress
from importlib import metadata as packages
from pathlib import Path

import yaml

from unicon_base import AnyDict
from unicon_core import __version__
from unicon_core.flow import Stage
from unicon_core.robots import Robot, robot_files
from unicon_core.runtime import Runner
from unicon_core.runtime.tick_ring import KeptMemory
from unicon_core.workflow import Program
from unicon_lab.recording.ticks import RecordedSubset, layout_facts, to_json

VERSIONS = (
    *("numpy", "onnxruntime", "torch", "mujoco", "pybullet", "jax", "newton", "rclpy"),
    "cyclonedds",
)


def network_hash(path: Path) -> str:
    """Return the SHA-256 of a network's file, and of those beside it that it names.

    ONNX keeps large weights in files of their own, and their names in the network.
    """
    raw = path.read_bytes()
    digest = hashlib.sha256(raw)
    for beside in sorted(path.parent.iterdir()):
        if beside != path and beside.is_file() and beside.name.encode() in raw:
            digest.update(beside.read_bytes())
    return digest.hexdigest()


def facts_of(runner: Runner, kept: RecordedSubset) -> dict[str, str]:
    """Return the facts of a run; call it before the first tick: files may be others later."""
    program, facts = runner.program, runner.program.platform.facts
    document = program.document
    scene = document.values.get("scene")
    texts = {
        "overridden": document.overridden,
        "options": {"speed": runner.options.speed, "duration": runner.options.duration},
        "dry": program.silent,
        "platform_facts": {  # what a stand-in needs to be built into the same graph
            "simulated": facts.simulated,
            "reads": facts.reads,
            "writes": facts.writes,
            "silent": program.silent,
        },
        "outside": _outside(program),
        "policies": {
            name: {
                "path": str(contract.path),
                "model": str(contract.model),
                "sha256": network_hash(contract.model),
                "networks": {part.name: network_hash(part.model) for part in contract.networks},
            }
            for name, contract in program.policies.items()
        },
        "versions": versions_here(),
        "system": system_here(),
    }
    return layout_facts(program.states.layout, kept) | {
        "run": uuid.uuid4().hex,
        "period_s": repr(program.period),
        "workflow": document.name,
        "workflow_path": str(document.path),
        "workflow_file": _text_of(document.path),
        "workflow_effective": _yaml(document.values),
        "seed": str(scene.get("seed", 0) if isinstance(scene, dict) else 0),
        "part": program.part,
        "platform": facts.name,
        **robot_facts(program.robot),
        **{name: json.dumps(value) for name, value in texts.items()},
        "wall_ns": str(time.time_ns() - time.monotonic_ns()),  # of stamps, to be compared
    }


def robot_facts(robot: Robot) -> dict[str, str]:
    """Return what says which robot it is: its file, and the overlay that extends it or "".

    `robot_path` is the one of both that a workflow would name, "" where there are members.
    """
    overlay = robot.overlay
    return {
        "robot": robot.name,
        "robot_path": "" if robot.members else str((overlay or robot.path).absolute()),
        "robot_file": robot_text(robot),
        "robot_overlay": "" if overlay is None else _text_of(overlay),
    }


def content_of(memory: KeptMemory, row: int) -> AnyDict:
    """Return what was remembered before a tick, for `memory.json`.

    Args:
        memory: it.
        row: index of the tick in the file.
    """
    blocks = to_json(memory.remembered)
    return {"before": row, "anew": memory.anew, "blocks": blocks, "unproven": memory.unproven}


def versions_here() -> dict[str, str]:
    """Return the versions of what is loaded by now."""
    versions = {"unicon_ros": __version__, "python": platform.python_version()}
    for name in VERSIONS:
        if name in sys.modules:
            with suppress(packages.PackageNotFoundError):
                versions[name] = packages.version(name)
    return versions


def system_here() -> dict[str, str]:
    """Return what else a run may depend on: system, ROS, and the commit of our code; "" for none.

    None of it names the machine.
    """
    system, middleware = {"ID": platform.system().lower()}, ""
    with suppress(OSError):
        system = platform.freedesktop_os_release()
    if "rclpy" in sys.modules:
        with suppress(Exception):  # there is none, and nobody uses ROS
            from rclpy.utilities import get_rmw_implementation_identifier

            middleware = str(get_rmw_implementation_identifier())
    return {
        "os": f"{system['ID']} {system.get('VERSION_ID', '')}".rstrip(),
        "architecture": platform.machine(),
        "kernel": platform.release(),
        "ros": os.environ.get("ROS_DISTRO", ""),
        "middleware": middleware,
        "commit": _commit(Path(__file__).resolve().parents[2] / ".git"),
    }


def _commit(git: Path) -> str:
    """Return what is checked out, "" where our code is installed; without starting git."""
    head = _text_of(git / "HEAD").strip()
    name = head.removeprefix("ref: ")
    if name == head:
        return head
    packed = re.search(rf"^(\w+) {re.escape(name)}$", _text_of(git / "packed-refs"), re.MULTILINE)
    return _text_of(git / name).strip() or (packed[1] if packed else "")


def _outside(program: Program) -> dict[str, list[str]]:
    """Return the states that hooks and devices write, by the moment that follows.

    A device behind `send` says by an attribute `outside` that what it tells comes from there.
    """
    moments = {Stage.INPUT: "input", Stage.TUNE: "tuned", Stage.OBSERVE: "sent"}
    given: dict[str, set[str]] = {}
    devices = [each for each in program.blocks if getattr(each.tick, "outside", False)]
    for block in (*program.outside, *devices):
        if block.stage in moments:
            given.setdefault(moments[block.stage], set()).update(block.writes, block.amends)
    return {moment: sorted(states) for moment, states in given.items()}


def robot_text(robot: Robot) -> str:
    """Return what the files of a robot say, one behind the other where it has members."""
    return "\n".join(_text_of(path) for path in robot_files(robot).values())


def _text_of(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except (OSError, UnicodeDecodeError):
        return ""


def _yaml(values: AnyDict) -> str:
    """Return a workflow with all overrides; what was written in Python is not text."""
    try:
        return str(yaml.safe_dump(values, sort_keys=False, allow_unicode=True))
    except yaml.YAMLError:
        return ""

"""FaultRecord: the last ticks of a run that was cut off, as a file; for `unicon run` and the node.

    record = FaultRecord()
    program = load_workflow("go2_walk", hooks=[…, record.hook])     # the last of the hooks
    runner = Runner(program)
    record.attach(runner)
    path = record.write(runner.run())                               # None: there was no fault

Nothing is written before the robot is damped. The file is one of MCAP, which `open_record` reads,
and so does any reader of ROS 2 bags.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from importlib import metadata as packages
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from unicon_core import __version__
from unicon_core.errors import UniconError
from unicon_core.flow import Block, Stage
from unicon_core.runtime.tick_ring import HEAD, PHASES, TickRing
from unicon_ros.recording import McapFile, recover
from unicon_ros.recording.mcap_file import Taken
from unicon_ros.recording.records import (
    MESSAGE,
    MESSAGE_HEAD,
    ROW,
    attachment,
    metadata,
)
from unicon_ros.recording.tick_message import tick_channel

if TYPE_CHECKING:
    from unicon_core.runtime import Report, Runner
    from unicon_core.workflow import Program

__all__ = ["KEPT", "OFF", "SCHEMA", "FaultRecord", "fault_folder", "versions_here"]

SCHEMA = "unicon.record/1"
OFF = "off"
KEPT = 10
"""Records in a folder; older ones make room."""
PATIENCE = 10.0
"""For the medium in [s]: nobody is to wait for ever for the report of a fault."""
CHUNK_BYTES = 1 << 18
VERSIONS = ("numpy", "onnxruntime", "torch", "mujoco", "pybullet", "rclpy")


def fault_folder(given: str | None = None) -> Path | None:
    """Return where fault records go: as given, else `UNICON_FAULTS`, else the user's state folder.

    Args:
        given: a folder, or `off`.
    """
    named = given or os.environ.get("UNICON_FAULTS", "")
    if named == OFF:
        return None
    if named:
        return Path(named).expanduser()
    state = os.environ.get("XDG_STATE_HOME", "")
    with suppress(RuntimeError):  # a user without a home
        return (Path(state) if state else Path.home() / ".local" / "state") / "unicon" / "faults"
    return None


class FaultRecord:
    """Keeps the last ticks, and writes them where a fault cut the run off.

    Args:
        folder: for the files, or `off`; see `fault_folder`.
        warn: takes warnings, one line each.
    """

    def __init__(self, folder: str | None = None, warn: Callable[[str], None] = print) -> None:
        self._folder, self._warn = fault_folder(folder), warn
        self._ring: TickRing | None = None
        self._runner: Runner | None = None
        self._policies: dict[str, dict[str, str]] = {}

    def hook(self, program: Program) -> dict[Stage, list[Block]]:
        """Return the blocks that keep the ticks; give it as the last of the hooks."""
        if self._folder is None:
            return {}
        self._ring = TickRing(program)
        if not self._ring.capacity:
            self._warn(
                f"the states of a tick take {self._ring.row_bytes >> 20} MiB: the fault record "
                "will hold no ticks"
            )
        return self._ring.blocks()

    def attach(self, runner: Runner) -> None:
        """Get to know the runner, before the first tick."""
        self._runner = runner
        if self._ring is None:
            return
        self._ring.attach(runner)
        # Now: the files may be others when the run ends.
        self._policies = {
            name: {
                "path": str(contract.path),
                "model": str(contract.model),
                "sha256": hashlib.sha256(contract.model.read_bytes()).hexdigest(),
            }
            for name, contract in runner.program.policies.items()
        }

    def write(self, report: Report) -> Path | None:
        """Write the record of a run with a fault, and return where; never raises.

        What goes wrong is one warning; a medium that takes nothing is waited for 10 s.
        """
        ring, folder = self._ring, self._folder
        if not report.faults or ring is None or folder is None:
            return None
        written: list[Path] = []
        troubles: list[str] = []

        def work() -> None:
            try:
                written.append(self._write(ring, folder, report))
            except OSError as error:
                reason = error.strerror or str(error)
                troubles.append(f"{reason}; give a folder with room in UNICON_FAULTS")
            except Exception as error:  # the run has ended: the report still comes
                troubles.append(" ".join(f"{type(error).__name__}: {error}".split()))

        thread = threading.Thread(target=work, name="fault record", daemon=True)
        thread.start()
        thread.join(PATIENCE)
        if written:
            return written[0]
        silence = f"the medium took nothing for {PATIENCE:g} s"
        self._warn(f"no fault record in {folder}: {troubles[0] if troubles else silence}")
        return None

    def _write(self, ring: TickRing, folder: Path, report: Report) -> Path:
        assert self._runner is not None
        ring.freeze()  # where nobody did: damped in the middle of a tick
        folder.mkdir(parents=True, exist_ok=True)
        _recover(folder)
        file = _new_file(folder, report.workflow)
        try:
            file.begin()
            _fill(file, ring, self._runner, report, self._policies)
            lost = file.finish()
        except BaseException:
            file.discard()
            raise
        if lost:
            self._warn(f"{file.path}: the medium is full; its last {lost} ticks are missing")
        if ring.trouble:
            self._warn(f"{file.path}: {ring.trouble}")
        _prune(folder, file.path)
        return file.path


def _fill(
    file: McapFile,
    ring: TickRing,
    runner: Runner,
    report: Report,
    policies: dict[str, dict[str, str]],
) -> None:
    """Write what is small first: a kill in the middle then leaves what explains the rest."""
    program, now = runner.program, time.time_ns()
    file.add_record(metadata("unicon", _facts(program, ring, report, policies)))
    memories = ring.memories()
    first = memories[0].row if memories else 0
    content = [
        {"before": each.row - first, "anew": each.anew, **each.remembered.content()}
        for each in memories
    ]

    def add(name: str, text: str) -> None:
        file.add_record(attachment(name, "application/json", now, text.encode()))

    built = None if ring.built is None else ring.built.content()
    add("memory.json", json.dumps({"trouble": ring.trouble, "built": built, "memories": content}))
    add("report.json", json.dumps(report.to_dict(), default=str))
    file.add(tick_channel(1, program.states.layout, ring.moments))
    _add_ticks(file, ring)
    add("trace.json", runner.statistics.trace(f"unicon {report.workflow}", max(ring.capacity, 1)))


def _add_ticks(file: McapFile, ring: TickRing) -> None:
    records = bytearray()
    rows: list[tuple[int, int, int]] = []

    def chunk() -> None:
        file.write(bytes(records), np.array(rows, ROW))
        records.clear()
        rows.clear()

    for raw in ring.kept():
        stamp = max(int(HEAD.unpack_from(raw)[1]), 0)  # times in MCAP are unsigned
        rows.append((1, stamp, len(records)))
        size = MESSAGE_HEAD.size + len(raw)
        records += MESSAGE_HEAD.pack(MESSAGE, size - 9, 1, 0, stamp, stamp)
        records += raw
        if len(records) > CHUNK_BYTES:
            chunk()
    if rows:
        chunk()


def _facts(
    program: Program, ring: TickRing, report: Report, policies: dict[str, dict[str, str]]
) -> dict[str, str]:
    """Return what the ticks mean and where they come from."""
    document, layout = program.document, program.states.layout
    return {
        "schema": SCHEMA,
        "written": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "reason": report.faults[0],
        "faults": json.dumps(report.faults),
        "traceback": report.traceback,
        "layout": layout.to_json(),
        "layout_hash": layout.hash,
        "moments": json.dumps(ring.moments),
        "phases": json.dumps([phase.value for phase in PHASES]),
        "period_s": repr(program.period),
        "workflow": document.name,
        "workflow_path": str(document.path),
        "workflow_file": _text_of(document.path),
        "workflow_effective": _yaml(document.values),
        "overridden": json.dumps(document.overridden),
        "part": program.part,
        "platform": program.platform.facts.name,
        "platform_facts": json.dumps(_platform_facts(program)),
        "outside": json.dumps(_outside(program)),
        "robot": program.robot.name,
        "robot_file": _text_of(program.robot.path),
        "policies": json.dumps(policies),
        "versions": json.dumps(versions_here()),
    }


def versions_here() -> dict[str, str]:
    """Return the versions of what is loaded by now."""
    versions = {"unicon_ros": __version__, "python": platform.python_version()}
    for name in VERSIONS:
        if name in sys.modules:
            with suppress(packages.PackageNotFoundError):
                versions[name] = packages.version(name)
    return versions


def _platform_facts(program: Program) -> dict[str, Any]:
    """Return what a stand-in needs to be built into the same graph."""
    facts = program.platform.facts
    return {
        "simulated": facts.simulated,
        "reads": facts.reads,
        "writes": facts.writes,
        "silent": program.silent,
    }


def _outside(program: Program) -> dict[str, list[str]]:
    """Return the states that hooks write, such as topics, by the moment that follows."""
    moments = {Stage.INPUT: "input", Stage.TUNE: "tuned", Stage.OBSERVE: "sent"}
    given: dict[str, list[str]] = {}
    for block in program.outside:
        if block.stage in moments:
            moment = moments[block.stage]
            given[moment] = sorted({*given.get(moment, ()), *block.writes, *block.amends})
    return given


def _text_of(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""


def _yaml(values: dict[str, Any]) -> str:
    """Return a workflow with all overrides; what was written in Python is not text."""
    try:
        return str(yaml.safe_dump(values, sort_keys=False, allow_unicode=True))
    except yaml.YAMLError:
        return ""


def _new_file(folder: Path, workflow: str) -> McapFile:
    stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime())
    clean = re.sub(r"[^A-Za-z0-9_-]+", "_", workflow)[:60]
    name, number = f"fault-{stamp}-{clean}-{os.getpid()}", 0
    while True:
        number += 1
        path = folder / f"{name}-{number}.mcap"
        if not path.exists():
            with suppress(Taken):  # by another run of this process
                return McapFile(path)


def _recover(folder: Path) -> None:
    """Finish what a killed process left."""
    for rest in folder.glob("fault-*.mcap.partial"):
        with suppress(UniconError, OSError):  # another process writes it, or it is rubble
            recover(rest)


def _prune(folder: Path, newest: Path) -> None:
    records = sorted(path for path in folder.glob("fault-*.mcap") if path != newest)
    for path in records[: max(len(records) - KEPT + 1, 0)]:
        with suppress(OSError):
            path.unlink()

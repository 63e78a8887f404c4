"""The report of a run: its fields, each of which is listed here.

A text passes as a name that the ledger or a file beside it has, or as a number.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from unicon_base.errors import UniconError
from unicon_base.resources import config_roots, sha256_of
from unicon_core.evidence import load_evidence
from unicon_core.robots import load_robot
from unicon_core.workflow.registry import known
from unicon_lab.evidence_report.figures import faults_of, figures_of, level_of
from unicon_lab.recording import Record, open_record
from unicon_lab.recording.facts import VERSIONS
from unicon_lab.replay.workflow import recorded_workflow

SCHEMA = "unicon.run/1"
OTHER = "other"
"""For a name that is not ours."""
OPTIONS = (
    *("connect", "silence", "silent", "damping", "watchdog", "dead_man", "encrypted", "check_mode"),
    *("poll", "unverified", "fsm_id", "torque_limit_rate", "filter_rate"),
)
"""Of platforms: numbers and switches, none of them an address."""
WORDS = ("layout", "generation", "peer")
"""Options of one word."""
VERSION = r"\d+(\.\d+)*"
KERNEL = rf"{VERSION}(-\d+)?([-+](rt\d*|generic|lowlatency|realtime|tegra|raspi)\b)?"


def report_of(path: Path, hardware: bool = False) -> dict[str, Any]:
    """Return the report of a recording or fault record.

    Args:
        path: of a file or bag folder.
        hardware: who reports says that it was a robot of metal.

    Raises:
        UniconError: it is of no run of one robot, cut off, or shows that it was no hardware.
    """
    record = open_record(path)
    facts = record.facts
    if not facts.get("run") or record.layout.num_robots is not None:
        raise UniconError(f"{path} is of no run of one robot; give one of unicon run --record")
    if not record.whole:
        raise UniconError(f"{path} is cut off, or being written; unicon bag recover mends it")
    if not len(record.ticks):
        raise UniconError(f"{path} has no ticks; give the recording of a run that ticked")
    workflow = recorded_workflow(record)
    said = workflow.value if workflow is not None and isinstance(workflow.value, dict) else {}
    level, why = level_of(record, said, hardware)
    if hardware and level != "hardware":
        raise UniconError(f"{path} was not on hardware: {why}; leave --hardware out")
    named = said.get("robot")
    names = [*named.values()] if isinstance(named, dict) else [facts["robot"]]
    robots = {name: load_robot(name) for name in names if _ours("robot", name)}
    platforms = [name for name in facts["platform"].split("+") if name in known("platforms")]
    networks = re.findall(r'"([0-9a-f]{64})"', facts["policies"])
    report = {
        "schema": SCHEMA,
        "level": level,
        "because": why,
        "robots": {n: str(r.transport.get("protocol", "")) for n, r in robots.items()} or OTHER,
        "robot_sha256": _digest(facts["robot_file"]),
        "platforms": platforms or OTHER,
        "options": _options(said, platforms),
        "workflow": _workflow(facts["workflow"]),
        "workflow_sha256": _digest(facts["workflow_file"]),
        "network_sha256": [*dict.fromkeys(networks)],
        "date": _matched(r"20\d\d-\d\d-\d\d", facts["written"]),
        **figures_of(record),
        "faults": faults_of(record, {j for robot in robots.values() for j in robot.joint_names}),
        **_system(record),
        "recording_sha256": recording_of(record),
    }
    return {key: value for key, value in report.items() if value not in (None, "", {})}


def recording_of(record: Record) -> list[str]:
    """Return the SHA-256 of each file of a recording, in their order."""
    return [sha256_of(path) for path in record.paths]


def _options(said: Mapping[str, Any], platforms: Sequence[str]) -> dict[str, Any]:
    given = said.get("platforms") or {}
    pairs = [pair for name in platforms for pair in (given.get(name) or {}).items()]
    numbers = {k: v for k, v in pairs if k in OPTIONS and isinstance(v, (bool, int, float))}
    return numbers | {k: v for k, v in pairs if k in WORDS and _matched(r"[\w.]{1,30}$", v)}


def _ours(kind: str, name: Any) -> str:
    """Return a name that the ledger has, else ""."""
    return name if isinstance(name, str) and (kind, name) in load_evidence() else ""


def _workflow(name: str) -> str:
    """Return the name of a workflow that lies beside a ledger."""
    roots = [root for root in config_roots() if (root / "evidence.yaml").is_file()]
    files = {path.stem for root in roots for path in (root / "workflows").glob("*.yaml")}
    return name if name in files else OTHER


def _matched(pattern: str, text: Any) -> str:
    """Return what of a text is as it should be, from its beginning on."""
    found = re.match(pattern, text) if isinstance(text, str) else None
    return found[0] if found else ""


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest() if text else ""


def _system(record: Record) -> dict[str, Any]:
    versions, system = (record.told(name, dict) for name in ("versions", "system"))
    numbers = {k: _matched(VERSION, versions.get(k)) for k in ("unicon_ros", "python", *VERSIONS)}
    return {
        "versions": {name: number for name, number in numbers.items() if number},
        "commit": _matched("[0-9a-f]{40}$", system.get("commit")),
        "os": _matched(r"[a-z]+( [\d.]+)?$", system.get("os")),
        "architecture": _matched(r"(x86_64|aarch64|armv\dl|riscv64)$", system.get("architecture")),
        "kernel": _matched(KERNEL, system.get("kernel")),
        "ros": _ours("ros", system.get("ros")),
        "middleware": _ours("middleware", system.get("middleware")),
    }

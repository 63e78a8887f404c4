"""The report of a run: its fields, each of which is listed here; written, signed and verified.

A text passes as a name that the ledger or a file beside it has, or as a number. The signature is
OpenSSH's own (`ssh-keygen -Y`): an agent, a passphrase or a token works.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Iterator, Sequence, Set
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import unicon_core
import unicon_ros
from unicon_base import AnyDict, AnyMapping, UniconError
from unicon_base.located_yaml import read_yaml
from unicon_base.resources import config_roots, sha256_of, sha256_text
from unicon_core.evidence import load_evidence
from unicon_core.page import write_file
from unicon_core.robots import load_robot
from unicon_core.runtime.phases import Phase
from unicon_core.runtime.statistics import percentiles
from unicon_core.workflow.registry import known
from unicon_lab.fault_record import fault_folder
from unicon_lab.recording import Record, open_record
from unicon_lab.recording.run_recording import VERSIONS
from unicon_lab.recording.scan import scan
from unicon_lab.replay.workflow import recorded_values
from unicon_lab.transfer.rollout import OURS

HERE = re.compile(
    r"(.*[/:@])?(127(\.\d+){1,3}|0\.0\.0\.0|\[?::1\]?|localhost\S*|lo\d*)([:/]\d+)?"
    r"|vcan\d*|virtual|/dev/pts/.*",
    re.IGNORECASE,
)
"""Where no robot of metal is: loopback, a virtual bus, a pseudo-terminal."""


def level_of(record: Record, workflow: AnyMapping, hardware: bool) -> tuple[str, str]:
    """Return a level of the ledger, and why it is that.

    Args:
        record: of the run.
        workflow: with all that was changed.
        hardware: somebody says that it was a robot of metal.
    """
    at = known("platforms")
    makers = [at.get(name, "") for name in record.facts["platform"].split("+")]
    if simulated(record) or any(maker.startswith(OURS) for maker in makers):
        return "never", "its platform, or a part of it, is simulated"
    if record.facts["dry"] == "true":
        return "never", "nothing was sent (--dry)"
    texts = {*_texts([workflow.get("platform"), workflow.get("platforms")])}
    in_robot = re.findall(r"127[\d.]+", record.facts["robot_file"])
    if any(map(HERE.fullmatch, {*texts, *in_robot})):
        return "stand_in", "an address is loopback, or a virtual bus"
    if "unitree_mujoco" in texts:
        return "vendor", "its peer is the vendor's simulator"
    if not hardware:
        return "stand_in", "nobody said that it was hardware (--hardware)"
    return "hardware", "who reports says so, and nothing in the recording contradicts"


def simulated(record: Record) -> bool:
    """Return whether its platform keeps a time of its own."""
    return record.told("platform_facts", dict).get("simulated") is not False


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, dict | list):
        for each in value.values() if isinstance(value, dict) else value:
            yield from _texts(each)
    elif isinstance(value, str):
        yield value.strip()


RANGES = {
    "motor_temperature": "motor_temperature_c",
    "battery_charge": "battery_charge",
    "battery_voltage": "battery_voltage_v",
}
UNITS = ("rad/s", "N·m", "m/s", "ms", "µs", "°C", "Hz")


def figures_of(record: Record) -> AnyDict:
    """Return what is known: names end in their unit, ranges are least and most."""
    facts, ticks, period = record.facts, len(record.ticks), record.period
    found: AnyDict = {"duration_s": round(ticks * period, 2), "ticks": ticks}
    found["period_s"] = period
    if "overruns" in facts:  # of a run that was not killed
        found["overruns"] = int(facts["overruns"])
        late = record.told("late_us", dict)
        found["late_us"] = {name: float(late[name]) for name in ("p50", "p99", "max")}
    run = np.array(record.phases) == Phase.RUN.value
    if not simulated(record):
        steps = np.diff(record.stamps)[(np.diff(record.ticks) == 1) & run[1:] & run[:-1]]
        found["period_us"] = percentiles(steps * 1e-3)
        source = record.states("stamp_ns").reshape(ticks, -1)[:, 0]
        for wall in (int(facts.get("wall_ns", 0)), 0):  # behind ROS, stamps may be the wall's
            ages = (record.stamps - wall - source)[run] * 1e-3
            if len(ages) and abs(np.median(ages)) < 1e7:
                found["observation_age_us"] = percentiles(ages)
                break
    asked = np.abs(record.states("velocity_command")[run]).max(axis=1, initial=0.0)
    found["walked_s"] = round(float((asked > 0.0).sum() * period), 2)
    place = record.states("base_pos_w")[run][:, :2].astype(np.float64)
    if place.any() and np.isfinite(place).all():
        found["moved_m"] = round(float(np.hypot(*(place[-1] - place[0]))), 2)
    for name, key in RANGES.items():
        values = record.states(name) if name in record.layout.specs else np.zeros(0)
        if np.isfinite(values).any() and values.any():  # all zero: never told
            found[key] = [round(float(f(values)), 2) for f in (np.nanmin, np.nanmax)]
    return found


def faults_of(record: Record, joints: Set[str]) -> list[str]:
    """Return the texts of faults, as the run's fault record has them, without foreign words.

    Args:
        record: a recording or fault record.
        joints: names that may be told.
    """
    told = record.told("faults", list) if "faults" in record.facts else None
    folder = fault_folder()
    for path in folder.glob("*.mcap") if told is None and folder is not None else ():
        with suppress(OSError, ValueError):  # rubble, or not ours
            facts = scan(path).facts
            told = json.loads(facts["faults"]) if facts.get("run") == record.facts["run"] else told
    if told is None and not record.ended.all():
        told = ["its text is in the fault record, which is not here"]
    return [_scrubbed(str(text), joints) for text in told or ()]


def _scrubbed(text: str, joints: Set[str]) -> str:
    """Return a text with … for all that is no number, unit, joint or word of ours."""
    found: list[str] = []
    for word in text.split():
        core = word.strip("'\"()[]{},;:.?!+-±=")
        kept = not core or core in UNITS or core in joints or core in _vocabulary()
        kept = kept or bool(re.fullmatch(r"\d{1,4}(\.\d{1,6})?", core))
        if kept or found[-1:] != ["…"]:
            found.append(word if kept else "…")
    return " ".join(found)


@lru_cache
def _vocabulary() -> frozenset[str]:
    """Return the words of our sources, none of which has a digit."""
    folders = [Path(package.__path__[0]) for package in (unicon_core, unicon_ros)]
    texts = (path.read_text("utf-8") for folder in folders for path in folder.rglob("*.py"))
    return frozenset(word for text in texts for word in re.findall(r"\b[A-Za-z_]+\b", text))


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


def report_of(path: Path, hardware: bool = False) -> AnyDict:
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
    said = recorded_values(record)
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


def _options(said: AnyMapping, platforms: Sequence[str]) -> AnyDict:
    given = said.get("platforms") or {}
    pairs = [pair for name in platforms for pair in (given.get(name) or {}).items()]
    numbers = {k: v for k, v in pairs if k in OPTIONS and isinstance(v, bool | int | float)}
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
    return sha256_text(text) if text else ""


def _system(record: Record) -> AnyDict:
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


NAMESPACE = "unicon-run"
"""Of signatures: one that was made for another purpose signs no report."""


def text_of(report: AnyDict) -> str:
    """Return a report as YAML."""
    return str(yaml.safe_dump(report, sort_keys=False, allow_unicode=True, width=100))


def signature_of(path: Path) -> Path:
    """Return where the signature of a report is."""
    return path.with_name(f"{path.name}.sig")


def read_report(path: Path) -> AnyDict:
    """Return what a report says.

    Raises:
        UniconError: it cannot be read, or is none.
    """
    value = read_yaml(path, UniconError).value
    if not isinstance(value, dict) or value.get("schema") != SCHEMA:
        raise UniconError(f"{path} is no report of a run: give what unicon report-run has written")
    return value


def refuse_existing(path: Path, force: bool) -> None:
    """Refuse to write where something is; with `force` where something is that is no file."""
    for each in (path, signature_of(path)):
        if os.path.lexists(each) and not (force and each.is_file()):
            remedy = "give another --out" + (", or --force" if each.is_file() else "")
            raise UniconError(f"{each} exists; {remedy}")


def write_report(path: Path, text: str, signature: bytes) -> None:
    """Write a report and its signature, or neither; a signature of before goes.

    Raises:
        UniconError: it cannot be written.
    """
    beside = signature_of(path)
    beside.unlink(missing_ok=True)
    try:
        if signature:
            write_file(beside, signature)
        write_file(path, text.encode())
    except UniconError:
        beside.unlink(missing_ok=True)
        raise


def sign(text: str, key: Path) -> bytes:
    """Return the signature of a report by the user's SSH key; ssh-keygen asks for its passphrase.

    Raises:
        UniconError: there is no such key or no ssh-keygen, or it refuses.
    """
    what = f"cannot sign with {key} (give a key, or FILE.pub of one that ssh-agent has)"
    arguments = ("sign", "-n", NAMESPACE, "-f", str(key.expanduser().absolute()))
    return f"{_keygen(text.encode(), what, *arguments)}\n".encode()


def signed_by(path: Path, allowed: Path | None = None) -> str:
    """Return who signed a report, as ssh-keygen tells it.

    Args:
        path: of the report; its signature is beside it, as FILE.sig.
        allowed: OpenSSH's file of signers that count; None for any key.

    Raises:
        UniconError: it is not signed, was changed, or its key is none of those.
    """
    beside = signature_of(path)
    if not beside.is_file():
        raise UniconError(f"{path} is not signed: {beside} is not there; sign with --sign KEY")
    content, what = path.read_bytes(), f"{path} is not what {beside.name} signs"
    given = ("-n", NAMESPACE, "-s", str(beside.absolute()))
    if allowed is None:
        return _keygen(content, what, "check-novalidate", *given)
    if not allowed.is_file():
        raise UniconError(f"{allowed} is not there; give OpenSSH's file of allowed signers")
    signers = ("-f", str(allowed.absolute()))
    nobody = f"{path} is signed by no key of {allowed}"
    names = _keygen(content, nobody, "find-principals", *signers, *given[2:]).splitlines()
    return _keygen(content, what, "verify", "-I", names[0], *signers, *given)


def _keygen(content: bytes, what: str, *arguments: str) -> str:
    """Return what ssh-keygen says; raise an error that begins with `what` where it refuses."""
    try:
        done = subprocess.run(["ssh-keygen", "-Y", *arguments], input=content, capture_output=True)
    except FileNotFoundError as error:
        raise UniconError(
            "ssh-keygen is not there, which makes and checks signatures: apt install openssh-client"
        ) from error
    if done.returncode:
        told = (done.stderr or done.stdout).decode(errors="replace").split("\n")
        raise UniconError(f"{what}: {next(filter(None, map(str.strip, told)), 'no reason given')}")
    return done.stdout.decode().strip()

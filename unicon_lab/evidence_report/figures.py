"""What came of a run's ticks: times, ways, temperatures, and faults in words of ours.

And its level: what it shows at most of its robot, by what its recording knows.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Set
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import unicon_core
import unicon_ros
from unicon_core.runtime.phases import Phase
from unicon_core.runtime.statistics import percentiles
from unicon_core.workflow.registry import known
from unicon_lab.fault_record import fault_folder
from unicon_lab.recording import Record
from unicon_lab.recording.scan import scan
from unicon_lab.transfer.plan import OURS

HERE = re.compile(
    r"(.*[/:@])?(127(\.\d+){1,3}|0\.0\.0\.0|\[?::1\]?|localhost\S*|lo\d*)([:/]\d+)?"
    r"|vcan\d*|virtual|/dev/pts/.*",
    re.IGNORECASE,
)
"""Where no robot of metal is: loopback, a virtual bus, a pseudo-terminal."""


def level_of(record: Record, workflow: Mapping[str, Any], hardware: bool) -> tuple[str, str]:
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
    if isinstance(value, (dict, list)):
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


def figures_of(record: Record) -> dict[str, Any]:
    """Return what is known: names end in their unit, ranges are least and most."""
    facts, ticks, period = record.facts, len(record.ticks), record.period
    found: dict[str, Any] = {"duration_s": round(ticks * period, 2), "ticks": ticks}
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

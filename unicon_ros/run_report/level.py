"""Level of a run: what it shows at most of its robot, by what its recording knows."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from unicon_core.workflow.registry import known
from unicon_ros.recording import Record

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
    if simulated(record) or any(maker.startswith("unicon_core.") for maker in makers):
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

"""The `motion:` of a policy's facts, checked."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from unicon_core.errors import PolicyError, alternatives
from unicon_core.policies.contract import MotionSpec
from unicon_core.policies.facts import Facts, dig
from unicon_core.resources import file_beside, find_resource

_KEYS = ("anchor_body", "file", "bodies", "align", "start", "end", "hold", "fps", "joints", "chain")
AXES = {
    "x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0), "-y": (0.0, -1.0, 0.0), "-z": (0.0, 0.0, -1.0),
}  # fmt: skip
"""Word of `motion.chain` to the unit vector that it means."""
_FORMATS = (".npz", ".csv")
LONGEST = 86_400.0
"""Longest motion in [s]."""


def given_clip(facts: Facts, given: Mapping[str, Any]) -> None:
    """Find the motion file that a workflow names, which may lie anywhere.

    Args:
        facts: gets it.
        given: of the workflow; a path there is beside the policy's source, absolute, or
            `assets:PATH`.

    Raises:
        PolicyError: there is none in the assets.
    """
    said = given.get("motion.file") or dig(given, "motion", "file")
    if not isinstance(said, str):
        return
    if said.startswith("assets:"):
        facts.clip = find_resource(said, "motion", error=PolicyError)
        return
    facts.clip = facts.beside(said)


def motion_spec(facts: Facts) -> MotionSpec | None:
    """Return what the facts say under `motion`, None where they say nothing.

    Raises:
        PolicyError: with the value's place.
    """
    value = facts.values.get("motion")
    if value is None:
        return None

    def wrong(key: str, rest: str) -> PolicyError:
        return facts.error(("motion", key) if key else ("motion",), f"motion{rest}")

    if not isinstance(value, Mapping):
        raise wrong("", f" is {value!r}; give a mapping {{anchor_body: torso_link, …}}")
    for key in value:
        if key not in _KEYS:
            raise wrong(str(key), f" has no {key!r}; {alternatives(str(key), _KEYS)}")

    def number(key: str, low: float, high: float) -> float | None:
        said = value.get(key)
        if said is None:
            return None
        if isinstance(said, bool) or not isinstance(said, (int, float)) or not low <= said <= high:
            raise wrong(key, f".{key} is {said!r}; give a number from {low:g} to {high:g}")
        return float(said)

    def names(key: str) -> tuple[str, ...]:
        said = value.get(key) or ()
        if not isinstance(said, (list, tuple)) or not all(isinstance(n, str) for n in said):
            raise wrong(key, f".{key} is {said!r}; give a list of names")
        for name in said:
            if list(said).count(name) > 1:
                raise wrong(key, f".{key} names {name!r} twice; name each once")
        return tuple(said)

    anchor = value.get("anchor_body")
    if not isinstance(anchor, str) or not anchor:
        raise wrong("anchor_body", f".anchor_body is {anchor!r}; name a body, as torso_link")
    align = value.get("align", "yaw")
    if align not in ("yaw", "none"):
        raise wrong("align", f".align is {align!r}; known: yaw, none")
    joints = value.get("joints")
    if isinstance(joints, str) and joints not in ("policy", "robot"):
        raise wrong("joints", f".joints is {joints!r}; known: policy, robot, or a list of joints")
    chain = value.get("chain") or {}
    if not isinstance(chain, Mapping) or not all(axis in AXES for axis in chain.values()):
        raise wrong(
            "chain", f".chain is {chain!r}; give {{JOINT: AXIS}}, with x, y, z, -x, -y or -z"
        )
    start, end = number("start", 0.0, LONGEST) or 0.0, number("end", 0.0, LONGEST)
    if end is not None and end <= start:
        raise wrong("end", f".end is {end:g} s and start {start:g} s; end after the start")
    return MotionSpec(
        anchor_body=anchor,
        file=_file(facts, value.get("file"), wrong),
        bodies=names("bodies"),
        align=align,
        start=start,
        end=end,
        hold=number("hold", 0.0, LONGEST) or 0.0,
        fps=number("fps", 1.0, 10_000.0),
        joints=joints if isinstance(joints, str) else names("joints") or None,
        chain=MappingProxyType({str(joint): axis for joint, axis in chain.items()}),
    )


def _file(facts: Facts, said: Any, wrong: Any) -> Path | None:
    if said is None:
        return None
    if not isinstance(said, str):
        raise wrong("file", f".file is {said!r}; name a .npz or .csv file")
    try:
        path = facts.clip or file_beside(facts.path, said, "motion.file", error=PolicyError)
    except PolicyError as error:
        raise facts.error(("motion", "file"), str(error)) from error
    if path.suffix not in _FORMATS:
        raise wrong("file", f".file {said!r} is not a .npz or .csv file; convert it")
    if not os.path.isfile(path):
        raise wrong("file", f".file: no such file {path}; put it there or correct the path")
    return path

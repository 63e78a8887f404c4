"""Robots as text tables, for `unicon robots [NAME]`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from unicon_base import AnyDict, AnyMapping, RobotError, one_line
from unicon_core.evidence import evidence_of, load_evidence
from unicon_core.robots.load import load_robot, robot_names
from unicon_core.robots.robot import JOINT_FIELDS, Hand, Place, Robot
from unicon_core.text_table import aligned, figure, span, wrapped

_UNITS = {
    "lower": "rad",
    "upper": "rad",
    "velocity": "rad/s",
    "effort": "N·m",
    "default": "rad",
    "rest": "rad",
    "stiffness": "N·m/rad",
    "damping": "N·m·s/rad",
}
_WIDTH = 100
# Levels of evidence, short.
_AGAINST = {
    "never": "nothing",
    "stand_in": "stand-in",
    "frames": "its frames",
    "vendor": "vendor's",
    "hardware": "hardware",
    None: "-",
}
_UNKNOWN = "unknown"


def robots_rows() -> list[AnyDict]:
    """Return what is told of each robot: `error` of a broken file, else its facts."""
    rows: list[AnyDict] = []
    ledger = load_evidence()
    for name in robot_names():
        try:
            robot = load_robot(name)
        except RobotError as error:
            rows.append({"name": name, "error": one_line(error)})
            continue
        rows.append(
            {
                "name": name,
                "kind": robot.kind,
                "joints": robot.num_joints,
                "protocol": robot.transport["protocol"],
                "description": robot.description,
                "missing": list(robot.missing_facts()),
                "evidence": ledger["robot", name].level if ("robot", name) in ledger else None,
            }
        )
    return rows


def robots_table() -> str:
    """Return a row per robot (name, joints, protocol, description, evidence), then the gaps."""
    rows, below = [("name", "joints", "protocol", "description", "run against")], list[str]()
    for row in robots_rows():
        name = row["name"]
        if "error" in row:
            rows.append((name, "-", "-", "-", "-"))
            below.append(f"{name}: the file is wrong: {row['error']}")
            continue
        protocol, count = str(row["protocol"] or _UNKNOWN), str(row["joints"])
        rows.append((name, count, protocol, row["description"], _AGAINST[row["evidence"]]))
        if row["missing"]:
            below.append(f"to drive {name}, set {', '.join(row['missing'])}")
    return "\n".join([*aligned(rows, right=(1,), underlined=False), "", *below])


def robot_table(robot: Robot) -> str:
    """Return everything a robot file says as aligned text; what is unknown stands last, marked.

    Args:
        robot: as `load_robot` returns it.
    """
    seen = evidence_of("robot", robot.name)
    head = [
        (robot.name, robot.description),
        ("manufacturer", robot.manufacturer),
        ("kind", robot.kind),
        ("file", str(robot.path)),
        ("evidence", "the ledger does not know it" if seen is None else str(seen)),
        ("models", ", ".join(f"{k} {path}" for k, path in robot.models.items()) or "none"),
        ("base frame", robot.base_frame),
        ("imu", _imu(robot)),
        ("fingertips" if robot.kind == "hand" else "feet", ", ".join(robot.feet) or "-"),
    ]
    if robot.command_ranges:
        ranges = [f"{k} {span(*bounds, '…')}" for k, bounds in robot.command_ranges.items()]
        head.append(("commands", ", ".join(ranges)))
    head += [(f"group {group}", ", ".join(names)) for group, names in robot.groups.items()]
    head += [(f"end effector {name}", _place(place)) for name, place in robot.end_effectors.items()]
    if robot.hand is not None:
        head += _hand(robot.hand)
    if robot.capsules:
        head.append(("capsules", ", ".join(robot.capsules)))
    if robot.overlay is not None:
        head.append(("overlay", str(robot.overlay)))
    right = (0, *range(2, 2 + len(JOINT_FIELDS)))
    joints = aligned(joint_limits(robot), right=right, underlined=False)
    parts = [_wrapped(head), "\n".join(joints)]
    if robot.simulated:
        parts.append("simulated\n" + _wrapped(_flat(robot.simulated), indent="  "))
    parts.append("transport\n" + _wrapped(_flat(robot.transport), indent="  "))
    parts.append("sources\n" + _wrapped(list(robot.sources.items()), indent="  "))
    parts.append(_missing(robot))
    return "\n\n".join(parts)


def joint_limits(robot: Robot) -> list[tuple[str, ...]]:
    """Return the heads, their units, then a row for each joint: limits, poses and gains."""
    order = "order not public" if "joint_order" in robot.unknown else "vendor's motor order"
    rows = [("#", f"joint ({order})", *JOINT_FIELDS), ("", "", *(_UNITS[k] for k in JOINT_FIELDS))]
    columns = [robot.joint_fact(key) for key in JOINT_FIELDS]
    for i, name in enumerate(robot.joint_names):
        rows.append((str(i), name, *(figure(column[i], ".4g") for column in columns)))
    return rows


def _imu(robot: Robot) -> str:
    if robot.imu is None:
        return _UNKNOWN.upper() if "imu" in robot.unknown else "none"
    position, quat = map(_vector, (robot.imu.position, robot.imu.quat))
    return f"{robot.imu.frame}, position [{position}] m, quat wxyz [{quat}]"


def _vector(values: Iterable[float]) -> str:
    return " ".join(figure(value, ".4g") for value in values)


def _place(place: Place) -> str:
    position, quat = map(_vector, (place.position, place.quat))
    return f"on {place.body}, position [{position}] m, quat wxyz [{quat}]"


def _hand(hand: Hand) -> list[tuple[str, str]]:
    rows = [("hand", hand.side or "left or right"), ("palm", _place(hand.palm))]
    return rows + [(f"tip of the {name}", _place(place)) for name, place in hand.fingers.items()]


def _missing(robot: Robot) -> str:
    if not robot.unknown:
        return "unknown: nothing"
    lines = [f"UNKNOWN: {', '.join(robot.unknown)}"]
    missing = robot.missing_facts()
    if missing:
        lines.append(f"CANNOT BE DRIVEN before these are given: {', '.join(missing)}")
        lines.append(f"find them in the vendor's documents and write them into {robot.path}")
    return "\n".join(lines)


def _flat(mapping: AnyMapping, prefix: str = "") -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for key, value in mapping.items():
        if isinstance(value, Mapping):
            rows += _flat(value, f"{prefix}{key}.")
        elif isinstance(value, Sequence) and not isinstance(value, str):
            rows.append((f"{prefix}{key}", " ".join(map(_said, value))))
        else:
            rows.append((f"{prefix}{key}", "?" if value is None else _said(value)))
    return rows


def _said(value: Any) -> str:
    return figure(value, "") if isinstance(value, float) else str(value)


def _wrapped(rows: Sequence[tuple[str, str]], indent: str = "") -> str:
    """Two columns, the second one wrapped below itself."""
    width = max((len(key) for key, _ in rows), default=0)
    lines: list[str] = []
    for key, text in rows:
        start = f"{indent}{key.ljust(width)}  "
        lines += wrapped(text, _WIDTH, start, " " * len(start))
    return "\n".join(lines)

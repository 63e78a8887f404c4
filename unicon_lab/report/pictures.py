"""Pictures of a run, for its page and for `--picture`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from unicon_core.drawing import (
    COLOURS,
    INK,
    Curve,
    Lines,
    Panel,
    Pictures,
    as_png,
    draw,
    drawn,
    limits,
)
from unicon_core.page import write_file
from unicon_lab.report.run_samples import Keeper

MEASURED, COMMANDED = COLOURS[:2]
MOST = 40
"""Joints in a picture; the table has all."""
TOP = 6
"""Joints whose torque is drawn over time."""
ROUNDING = 1e-4
"""Share of a torque limit that is no more than rounding: simulators clip to it in other figures."""
_SPEEDS = (
    ("forward, vx", "m/s", "base_lin_vel"),
    ("to the left, vy", "m/s", "base_lin_vel"),
    ("turning, wz", "rad/s", "base_ang_vel"),
)


def write_overview(path: str | Path, keeper: Keeper, title: str) -> None:
    """Write path, speeds and joints as one PNG, for `--picture`, folders made as needed.

    Raises:
        UniconError: the file cannot be written.
    """
    figure = drawn(_overview, keeper)
    assert figure is not None
    figure.suptitle(title)
    write_file(Path(path), as_png(figure), folders=True)


def _overview(figure: Any, keeper: Keeper) -> bool:
    from matplotlib import colormaps

    figure.set_size_inches(11.0, 9.0)
    above, below = figure.subfigures(2, 1, height_ratios=[1.2, 1.0])
    speeds = Lines(_speeds).panels(keeper)
    if speeds:
        left, right = above.subfigures(1, 2)
        _path(left, keeper)
        for axes, panel in zip(right.subplots(len(speeds), squeeze=False)[:, 0], speeds):
            draw(axes, panel)
        axes.set_xlabel("time [s]")
    joints = below.subplots()
    names = keeper.robot.joint_names
    # Matplotlib's own ten colours repeat: two joints would look like one.
    joints.set_prop_cycle(color=colormaps["turbo"](np.linspace(0.0, 1.0, len(names))))
    joints.plot(*keeper.curve("joint_pos"), label=names)
    joints.set(title="joint positions", xlabel="time [s]", ylabel="[rad]")
    joints.legend(
        loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=6, ncols=1 + len(names) // 17
    )
    return True


def _path(figure: Any, keeper: Keeper) -> bool:
    if not keeper.has("base_pos_w"):
        return False
    axes, way = figure.subplots(), keeper.first("base_pos_w")
    axes.plot(way[:, 0], way[:, 1], color=MEASURED, linewidth=1.2)
    axes.plot(way[:1, 0], way[:1, 1], "o", color=INK, label="start")
    axes.plot(way[-1:, 0], way[-1:, 1], "s", color=COMMANDED, label="end")
    axes.set(title="path of the base from above, world frame", xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend()
    return True


def _one(keeper: Keeper, label: str, colour: str, name: str, k: int, *dash: float) -> list[Curve]:
    """Return the curve of one element of a state; none where the state is not known."""
    if not keeper.has(name):
        return []
    time, values = keeper.curve(name)
    return [Curve(label, colour, time, values[:, k], dash)]


def _panel(keeper: Keeper, title: str, unit: str, *curves: list[Curve]) -> Panel:
    return Panel(title, unit, [*chain(*curves)], keeper.beside_the_run())


def _speeds(keeper: Keeper) -> Iterator[Panel]:
    """Velocities as commanded and as they were."""
    for k, (name, unit, state) in enumerate(_SPEEDS):
        measured = _one(keeper, "measured", MEASURED, state, k)
        commanded = _one(keeper, "commanded", COMMANDED, "velocity_command", k, 6, 3)
        yield _panel(keeper, name, unit, measured, commanded)


def nearest(keeper: Keeper) -> tuple[str, str]:
    """Return in words which joint came nearest to a limit, or farthest beyond one, and when."""
    robot, found = keeper.robot, list[tuple[float, str, float]]()
    middle = 0.5 * (robot.lower + robot.upper)
    for state, unit, centre, limit in (
        ("joint_effort", "N·m", 0.0 * middle, robot.effort_limit),
        ("joint_vel", "rad/s", 0.0 * middle, robot.velocity_limit),
        ("joint_pos", "rad", middle, robot.upper - middle),
    ):
        if not keeper.has(state):
            continue
        time, values = keeper.curve(state)
        centre = np.nan_to_num(centre)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.abs(values - centre) / limit
        share[~np.isfinite(share)] = -1.0
        row, k = np.unravel_index(share.argmax(), share.shape)
        value = values[row, k]
        there = centre[k] + math.copysign(limit[k], value - centre[k])
        how = "beyond" if share[row, k] > 1.0 + ROUNDING else "nearest to"
        text = f"{robot.joint_names[k]}: {value:.4g} {unit}, {how} its limit of {there:.4g} {unit}"
        found.append((float(share[row, k]), text, float(time[row])))
    if not found:
        return "not known: no joint has a number", "–"
    share, text, when = max(found)
    return (text, f"at {when:.2f} s") if share >= 0.0 else ("no joint has a limit", "–")


def beyond(keeper: Keeper) -> list[str]:
    """Return which joints were beyond a limit, by how much and when."""
    robot, said = keeper.robot, list[str]()
    strongest = robot.effort_limit * (1.0 + ROUNDING)
    for state, unit, side, limit, words in (
        ("joint_pos", "rad", -1.0, robot.lower, "below its lower limit"),
        ("joint_pos", "rad", 1.0, robot.upper, "above its upper limit"),
        ("joint_effort", "N·m", 0.0, strongest, "above its effort limit"),
    ):
        if not keeper.has(state):
            continue
        time, values = keeper.curve(state)
        past = side * (values - limit) if side else np.abs(values) - limit
        for k in np.flatnonzero((past > 0.0).any(axis=0)):
            bad = past[:, k] > 0.0
            said.append(
                f"{robot.joint_names[k]} was {past[bad, k].max():.2g} {unit} {words} of "
                f"{limit[k]:.4g} {unit}, first at {time[bad.argmax()]:.2f} s, in {bad.mean():.0%} "
                "of the samples"
            )
    return said


def _joints(keeper: Keeper) -> Iterator[Panel]:
    """Positions over time between their limits, targets behind them."""
    robot = keeper.robot
    for k, name in enumerate(robot.joint_names[:MOST]):
        target = _one(keeper, "target", COMMANDED, "joint_pos_target", k, 6, 3)
        measured = _one(keeper, "measured", MEASURED, "joint_pos", k)
        lower, upper = limits("lower limit", robot.lower[k]), limits("upper limit", robot.upper[k])
        yield _panel(keeper, name, "rad", target, measured, lower, upper)


def _torque(keeper: Keeper) -> Iterator[Panel]:
    """Torque over time of the joints that came nearest to their effort limit."""
    robot = keeper.robot
    if not (keeper.has("joint_effort") and np.isfinite(robot.effort_limit).any()):
        return
    share = np.nan_to_num(keeper.largest("joint_effort") / robot.effort_limit)
    for k in np.argsort(-share, kind="stable")[:TOP]:
        limit = float(robot.effort_limit[k])
        title = f"{robot.joint_names[k]}: {share[k]:.0%} of its limit"
        curves = _one(keeper, "measured", MEASURED, "joint_effort", k)
        yield _panel(keeper, title, "N·m", curves, limits("effort limit", limit, -limit))


def _timing(keeper: Keeper) -> Iterator[Panel]:
    """How long ticks took, and how late they began."""
    statistics = keeper.statistics
    rows, count = statistics.kept(), statistics.count
    ticks = np.arange(count - len(rows), count)
    curves = [Curve("busy", MEASURED, ticks, statistics.durations_us())]
    if keeper.paced:
        curves.append(Curve("late", COMMANDED, ticks, (rows[:, 2] - rows[:, 0]) * 1e-3))
    title = f"the last {len(rows):,} of {count:,} ticks" if len(rows) < count else ""
    yield Panel(title, "µs", [*curves, *limits("next deadline", keeper.period * 1e6)])


PICTURES: Pictures = {
    "base": (
        Lines(_speeds),
        "Velocity",
        "In the base's frame: dashed as commanded, the line as the platform told it; the sway of "
        "the gait is in it. Grey is before and after the run: approach, damping.",
    ),
    "path": (_path, "Path", ""),
    "joints": (
        Lines(_joints, columns=4),
        "Joint positions",
        "Each joint over time, with its target; dotted: the limits of the robot file.",
    ),
    "torque": (
        Lines(_torque, columns=2),
        "The torques that came nearest to their limit",
        "Over time; dotted: the effort limits of the robot file.",
    ),
    "timing": (
        Lines(_timing, "number of the tick"),
        "Timing",
        "Busy: from recv to the end of send. Late, of a paced run: from the deadline to the begin "
        "of the tick. What is above the dotted line took longer than a period.",
    ),
}
"""Name to function, heading and caption, in the page's order."""

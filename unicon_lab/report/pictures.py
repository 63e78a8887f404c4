"""Pictures of a run, for its page and for `--picture`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import AnyDict
from unicon_base.arrays import Array
from unicon_core.drawing import INK, MARK, Pictures, as_png, curve, drawn, grid
from unicon_core.page import write_file
from unicon_lab.report.run_samples import Keeper

MEASURED, COMMANDED, BAD = MARK, "#e07b00", "#d62728"
SMALL = 250
"""Points of a curve in one of many small axes, twice."""
MOST = 40
"""Joints in a picture; the table has all."""
COLUMNS = 4
TOP = 6
"""Joints whose torque is drawn over time."""
BINS = 80
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
    _moved(above, keeper)
    joints = below.subplots()
    names = keeper.robot.joint_names
    # Matplotlib's own ten colours repeat: two joints would look like one.
    joints.set_prop_cycle(color=colormaps["turbo"](np.linspace(0.0, 1.0, len(names))))
    curve(joints, *keeper.curve("joint_pos"), label=names)
    joints.set(title="joint positions", xlabel="time [s]", ylabel="[rad]")
    if len(names) <= 32:
        columns = 1 + (len(names) - 1) // 16
        joints.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7, ncols=columns)
    return True


def _path(axes: Any, keeper: Keeper) -> None:
    way = keeper.first("base_pos_w")
    axes.plot(way[:, 0], way[:, 1], color=MEASURED, linewidth=1.2)
    axes.plot(way[:1, 0], way[:1, 1], "o", color=INK, label="start")
    axes.plot(way[-1:, 0], way[-1:, 1], "s", color=COMMANDED, label="end")
    axes.set(title="path of the base from above, world frame", xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend()


def _shade(axes: Any, keeper: Keeper) -> None:
    """Mark what was before and after the run."""
    for begin, end in keeper.beside_the_run():
        axes.axvspan(begin, end, color="0.5", alpha=0.2, label="other phase")


def _one(keeper: Keeper, name: str, k: int) -> tuple[Array, Array]:
    """Return times and values of one element of a state."""
    time, values = keeper.curve(name)
    return time, values[:, k]


def _base(figure: Any, keeper: Keeper) -> bool:
    figure.set_size_inches(12.0, 5.2)
    return _moved(figure, keeper)


def _moved(figure: Any, keeper: Keeper) -> bool:
    """Path, and velocities as commanded and as they were."""
    if not any(keeper.has(state) for _, _, state in _SPEEDS):
        return False
    placed = keeper.has("base_pos_w")
    layout = [["path", name][not placed :] for name, *_ in _SPEEDS]
    axes = figure.subplot_mosaic(layout, width_ratios=[1.0, 1.3][not placed :])
    if placed:
        _path(axes["path"], keeper)
    for k, (name, unit, state) in enumerate(_SPEEDS):
        below = axes[name]
        if keeper.has(state):
            curve(below, *_one(keeper, state, k), MEASURED, "measured")
        if keeper.has("velocity_command"):
            command = _one(keeper, "velocity_command", k)
            curve(below, *command, COMMANDED, "commanded", linestyle="--", linewidth=1.4)
        _shade(below, keeper)
        below.set_title(name, loc="left")
        below.set_ylabel(f"[{unit}]")
        if k == 0:
            below.legend(*_once(below), loc="upper right", ncols=3)
    below.set_xlabel("time [s]")
    return True


def beyond(keeper: Keeper) -> list[str]:
    """Return which joints were beyond a limit, and by how much: what is red in the pictures."""
    robot = keeper.robot
    if not keeper.has("joint_pos"):
        return []
    said: list[str] = []
    low, high = keeper.reached("joint_pos")
    names = robot.joint_names
    for what, past, limits in (
        ("below its lower limit", robot.lower - low, robot.lower),
        ("above its upper limit", high - robot.upper, robot.upper),
    ):
        said += [
            f"{names[k]} was {past[k]:.2g} rad {what} of {limits[k]:.4g} rad"
            for k in np.flatnonzero(past > 0.0)
        ]
    torque, most = _peaks(keeper), robot.effort_limit
    if torque is not None:
        said += [
            f"{names[k]} had {torque[k]:.4g} N·m, {torque[k] / most[k]:.0%} of its effort limit of "
            f"{most[k]:.4g} N·m"
            for k in np.flatnonzero(_too_strong(torque, most))
        ]
    return said


def _too_strong(torque: Array, limit: Array) -> Array:
    """Return where a torque is more than its limit, not by the rounding of a float32 alone."""
    return torque > limit * (1.0 + ROUNDING)


def _ranges(figure: Any, keeper: Keeper) -> bool:
    """How much of its range each joint used, and of its torque."""
    robot = keeper.robot
    if not keeper.has("joint_pos"):
        return False
    low, high = keeper.reached("joint_pos")
    bounded = np.isfinite(robot.lower) & np.isfinite(robot.upper)
    torque = _peaks(keeper)
    told = bounded if torque is None else bounded | np.isfinite(robot.effort_limit)
    shown = np.flatnonzero(told)[:MOST]
    if not shown.size:
        return False
    figure.set_size_inches(12.0, 1.1 + 0.25 * len(shown))
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=[1.3, 1.0])
    # A wheel has no limits: its place in the left one stays empty.
    with np.errstate(invalid="ignore"):
        shares = [(side - robot.lower) / (robot.upper - robot.lower) for side in (low, high)]
    begin, end = (np.nan_to_num(100.0 * np.where(bounded, side, np.nan))[shown] for side in shares)
    outside = ((low < robot.lower) | (high > robot.upper))[shown]
    colours = [BAD if bad else MEASURED for bad in outside]
    names = [robot.joint_names[k] for k in shown]
    places = np.arange(len(shown))
    left.barh(places[bounded[shown]], 100.0, color="0.5", alpha=0.18)
    left.barh(places, end - begin, left=begin, color=colours, height=0.5)
    left.set_yticks(places, names)
    left.set(xlabel="position [% of the way from its lower to its upper limit]")
    left.set_xlim(min(0.0, begin.min()) - 2.0, max(100.0, end.max()) + 2.0)
    left.invert_yaxis()
    left.set_title("range that was used")
    if torque is None:
        right.set_axis_off()
    else:
        share = (torque / robot.effort_limit)[shown] * 100
        strong = _too_strong(torque, robot.effort_limit)[shown]
        colours = [BAD if bad else COMMANDED for bad in strong]
        right.barh(places, np.nan_to_num(share), color=colours, height=0.5)
        right.axvline(100.0, color=INK, linewidth=0.8)
        right.set_title("largest torque")
        right.set_xlabel("|torque| [% of its effort limit]")
    return True


def _peaks(keeper: Keeper) -> Array | None:
    """Return the largest torque of each joint, [N·m]; None where nobody tells one."""
    if not keeper.has("joint_effort") or not np.isfinite(keeper.robot.effort_limit).any():
        return None
    return keeper.largest("joint_effort")


def _joints(figure: Any, keeper: Keeper) -> bool:
    """Positions over time between their limits, targets behind them."""
    robot = keeper.robot
    if not keeper.has("joint_pos"):
        return False
    shown = [("joint_pos_target", COMMANDED, "target"), ("joint_pos", MEASURED, "measured")]
    every = grid(figure, min(robot.num_joints, MOST), COLUMNS, 1.5, sharex=True)
    for k, axes in enumerate(every):
        for name, colour, label in shown:
            if keeper.has(name):
                curve(axes, *_one(keeper, name, k), colour, label, SMALL)
        _limits(axes, (robot.lower[k], robot.upper[k]), "limit")
        _shade(axes, keeper)
        axes.set_title(robot.joint_names[k], fontsize=8, loc="left")
    _around(figure, every, "[rad]")
    return True


def _limits(axes: Any, limits: tuple[float, float], label: str) -> None:
    for limit in limits:
        if np.isfinite(limit):
            axes.axhline(limit, color=BAD, linestyle=":", label=label)


def _around(figure: Any, every: Any, label: str) -> None:
    """Write what all axes of a figure share around them."""
    figure.legend(*_once(*every), loc="outside upper right", ncols=4)
    figure.supylabel(label)
    figure.supxlabel("time [s]")


def _once(*all_axes: Any) -> tuple[list[Any], list[str]]:
    """Return what a legend shows, each label once."""
    by_label: AnyDict = {}
    for axes in all_axes:
        by_label |= {label: handle for handle, label in zip(*axes.get_legend_handles_labels())}
    return list(by_label.values()), list(by_label)


def _torque(figure: Any, keeper: Keeper) -> bool:
    """Torque over time of the joints that came nearest to their effort limit."""
    peaks, robot = _peaks(keeper), keeper.robot
    if peaks is None:
        return False
    share = np.nan_to_num(peaks / robot.effort_limit)
    order = np.argsort(-share, kind="stable")[:TOP]
    every = grid(figure, len(order), 2, 1.7, sharex=True)
    for axes, k in zip(every, order):
        curve(axes, *_one(keeper, "joint_effort", k), MEASURED, "measured", 2 * SMALL)
        limit = float(robot.effort_limit[k])
        _limits(axes, (-limit, limit), "effort limit")
        axes.set_title(f"{robot.joint_names[k]}: {share[k]:.0%} of its limit", loc="left")
    _around(figure, every, "torque [N·m]")
    return True


def _timing(figure: Any, keeper: Keeper) -> bool:
    """How long ticks took, how late they began, and both over the run."""
    statistics = keeper.statistics
    rows = statistics.kept()
    if not len(rows):
        return False
    busy = statistics.durations_us()
    parts = [("busy", busy, MEASURED, "from recv to the end of send")]
    if keeper.paced:
        late: Array = (rows[:, 2] - rows[:, 0]) * 1e-3
        parts.append(("late", late, COMMANDED, "from the deadline to the begin of the tick"))
    if len(rows) < statistics.count:
        figure.suptitle(f"the last {len(rows):,} of {statistics.count:,} ticks")
    period = keeper.period * 1e6
    figure.set_size_inches(12.0, 5.4)
    axes = figure.subplot_mosaic([[name for name, *_ in parts], ["over"] * len(parts)])
    number = np.arange(statistics.count - len(rows), statistics.count)
    for name, values, colour, what in parts:
        if not values.size:
            continue
        low = max(min(float(values.min()), period), 0.1)
        bins = np.geomspace(low * 0.9, max(float(values.max()), period) * 1.1, BINS)
        counts, _ = np.histogram(np.clip(values, bins[0], None), bins)
        axes[name].stairs(counts, bins, fill=True, color=colour, alpha=0.75)
        axes[name].axvline(period, color=BAD, linestyle=":", label="next deadline")
        axes[name].set(xscale="log", yscale="log", ylabel="ticks", xlabel=f"{name} [µs], {what}")
        axes[name].set_ylim(bottom=0.7)
        axes[name].legend()
        curve(axes["over"], number, values, colour, name)
    axes["over"].axhline(period, color=BAD, linestyle=":", label="next deadline")
    axes["over"].set(yscale="log", ylabel="[µs]", xlabel="number of the tick in the run")
    axes["over"].legend(loc="upper right", ncols=3)
    return True


PICTURES: Pictures = {
    "base": (
        _base,
        "Path and velocity",
        "Velocities in the base's frame: dashed as commanded, the line as the platform told it; "
        "the sway of the gait is in it. Grey is before and after the run: approach, damping.",
    ),
    "ranges": (
        _ranges,
        "Joints and torques against their limits",
        "Grey is a joint's whole range, the bar on it what was used of it; red is beyond a limit.",
    ),
    "joints": (
        _joints,
        "Joint positions",
        "Each joint over time, with its target; dotted: the limits of the robot file.",
    ),
    "torque": (
        _torque,
        "The torques that came nearest to their limit",
        "Over time; dotted: the effort limits of the robot file.",
    ),
    "timing": (
        _timing,
        "Timing",
        "How many ticks took how long (busy) and, of a paced run, began how late (late), on "
        "logarithmic scales. What is right of the dotted line took longer than a period.",
    ),
}
"""Name to function, heading and caption, in the page's order."""

"""Plots: the last seconds of states, and which of their elements a viewer sees over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from unicon_base import AnyMapping
from unicon_base.arrays import Float32, Float64
from unicon_core.states import Layout
from unicon_lab.view.source import Snapshot

SECONDS = 60.0
"""So much is kept, in [s]: about 20 MB for a robot of 30 joints."""

PLOTTED = 12.0
"""So much a plot shows at most, in [s]."""

_RATE = 100.0  # rows a second at most; a page has fewer pixels
_WIDEST = 128  # elements; a wider state is a picture, not a curve

TIMING = ("late", "busy")
"""Columns beside the states, in [ms]: the worst of the ticks of a row."""


class History:
    """Rows of states over time, the oldest first.

    Args:
        layout: of the states; those of more than 128 elements are left out.
        period: of a tick in [s].

    Attributes:
        columns: state, or one of `TIMING`, to where it is in a row.
    """

    def __init__(self, layout: Layout, period: float) -> None:
        self._stride = max(1, round(1.0 / (_RATE * period)))
        self._period = period
        rows = max(2, round(SECONDS / (period * self._stride)))
        self.columns: dict[str, slice] = {}
        width = 0
        for name in TIMING:
            self.columns[name] = slice(width, width + 1)
            width += 1
        for name, spec in layout.specs.items():
            if spec.size <= _WIDEST:
                self.columns[name] = slice(width, width + spec.size)
                width += spec.size
        self._states = [(name, where) for name, where in self.columns.items()][len(TIMING) :]
        self._shapes = {name: layout.specs[name].shape for name, _ in self._states}
        room = rows + max(rows // 4, 1)  # the rows move once in a quarter of the time
        self._rows, self._time = np.zeros((room, width), np.float32), np.zeros(room)
        self._kept, self._count, self._worst = rows, 0, (0.0, 0.0)
        self._since = 0

    def clear(self) -> None:
        """Forget all."""
        self._count = self._since = 0

    def take(self, tick: Snapshot) -> None:
        """Add a tick, in the place of all that are not earlier: the run went back, or pauses."""
        moment = tick.tick * self._period
        if self._count and moment <= self._time[self._count - 1]:
            self._count, self._since = self._until(moment), self._stride
        late, busy = self._worst if self._since else (0.0, 0.0)
        self._worst = max(late, tick.late_ns * 1e-6), max(busy, tick.busy_ns * 1e-6)
        self._since += 1
        if self._since < self._stride and self._count:
            return
        self._since = 0
        if self._count == len(self._time):
            self._rows[: self._kept] = self._rows[-self._kept :]
            self._time[: self._kept] = self._time[-self._kept :]
            self._count = self._kept
        row = self._rows[self._count]
        row[: len(TIMING)] = self._worst
        for name, where in self._states:
            row[where] = tick.states[name].reshape(-1)
        self._time[self._count] = moment
        self._count += 1

    def _until(self, moment: float) -> int:
        """Return how many rows are earlier than a time in [s]."""
        return int(np.searchsorted(self._time[: self._count], moment))

    @property
    def span(self) -> tuple[float, float]:
        """Times of the oldest row and of the newest in [s], `SECONDS` apart at most."""
        if not self._count:
            return 0.0, 0.0
        return float(self._time[max(self._count - self._kept, 0)]), float(
            self._time[self._count - 1]
        )

    def last(self, seconds: float, until: float = np.inf) -> tuple[Float64, Float32]:
        """Return times in [s], shape (m,), and rows, shape (m, width); views, the newest last.

        Args:
            seconds: how far they go back.
            until: time of the newest at most, in [s]; one row is always there.
        """
        end = max(self._until(until + 0.5 * self._period), min(self._count, 1))
        time = self._time[:end]
        first = self._until(time[-1] - seconds) if end else 0
        return time[first:], self._rows[first:end]

    def at(self, moment: float) -> tuple[float, dict[str, Float32]]:
        """Return the time of the newest row up to a time, both in [s], and its states; views."""
        time, rows = self.last(0.0, moment)
        return float(time[-1]), {n: rows[-1, w].reshape(self._shapes[n]) for n, w in self._states}


ALL = "all elements"
VELOCITY = "velocity, commanded dashed"
TIMES = "tick timing, deadline dashed"

_TARGETS = {"joint_pos": "joint_pos_target", "joint_vel": "joint_vel_target"}
_MEASURED = (("base_lin_vel", 0), ("base_lin_vel", 1), ("base_ang_vel", 2))
_VELOCITIES = (("vx", "m/s"), ("vy", "m/s"), ("wz", "rad/s"))
_LEAST = {"rad": 0.02, "m": 0.01, "m/s": 0.05, "rad/s": 0.05, "N·m": 0.5, "m/s²": 0.5, "ms": 0.1}
"""By unit, what an axis spans at least: noise below it is not magnified."""

_GROUP = 8  # elements of a group at most, where names divide further

POINTS = 300
"""Points of a curve at most: about as many as a plot is pixels wide."""

_PALETTE = (
    *("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f"),
    *("#bcbd22", "#17becf", "#3b528b", "#a0522d"),
)


@dataclass(frozen=True)
class Curve:
    """One line of a plot.

    Attributes:
        label: in the legend.
        column: in a row of the history; -1 for a constant.
        colour: as CSS has it.
        dashed: a target or a limit, not what is measured.
        constant: value of a curve without a column.
    """

    label: str
    column: int
    colour: str
    dashed: bool = False
    constant: float = 0.0


def choices(layout: Layout, history: History) -> tuple[str, ...]:
    """Return what can be plotted: two made for looking, then each state of numbers by its name."""
    special = [TIMES]
    if all(name in history.columns for name in ("velocity_command", "base_lin_vel")):
        special.insert(0, VELOCITY)
    return (*special, *(name for name in layout.specs if name in history.columns))


def groups(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return how elements are grouped by the beginning of their names, such as legs.

    Args:
        names: of elements, such as `FL_hip_joint`.
    """
    for words in (1, 2):
        found: dict[str, list[str]] = {}
        for name in names:
            found.setdefault("_".join(name.split("_")[:words]), []).append(name)
        if max(map(len, found.values()), default=0) <= _GROUP:
            break
    return {key: tuple(group) for key, group in found.items() if len(group) > 1}


def elements(layout: Layout, state: str) -> tuple[str, ...]:
    """Return what the elements of a state are called; () for those made for looking."""
    spec = layout.specs.get(state)
    if spec is None:
        return ()
    if len(spec.names) == spec.size:
        return spec.names
    return tuple(map(str, range(spec.size)))


def element_choices(layout: Layout, state: str) -> tuple[str, ...]:
    """Return what can be chosen of a state: a group, one element, or all; what is best first."""
    names = elements(layout, state)
    grouped = tuple(groups(names)) if len(names) > _GROUP else ()
    return (*grouped, ALL, *(names if len(names) > 1 else ()))


def curves_of(
    layout: Layout, history: History, state: str, chosen: str = ALL, period: float = 0.0
) -> tuple[Curve, ...]:
    """Return the curves of a choice; none where there is nothing of that name.

    Args:
        layout: of the states.
        history: whose columns they are.
        state: one of `choices`.
        chosen: one of `element_choices`.
        period: of a tick in [s], which is the deadline.
    """
    at = history.columns
    if state == TIMES:
        late, busy = (at[name].start for name in TIMING)
        return (
            Curve("late", late, _PALETTE[1]),
            Curve("busy", busy, _PALETTE[0]),
            Curve("deadline", -1, _PALETTE[3], True, period * 1e3),
        )
    if state == VELOCITY:
        if not {"velocity_command", "base_lin_vel", "base_ang_vel"} <= set(at):
            return ()
        curves = []
        for i, ((name, unit), (source, k)) in enumerate(zip(_VELOCITIES, _MEASURED)):
            measured, wanted = at[source].start + k, at["velocity_command"].start + i
            curves += [
                Curve(f"{name} [{unit}]", measured, _PALETTE[i]),
                Curve(f"{name} commanded", wanted, _PALETTE[i], True),
            ]
        return tuple(curves)
    if state not in at:
        return ()
    names = elements(layout, state)
    wanted = groups(names).get(chosen, (chosen,) if chosen in names else names)
    target = _TARGETS.get(state)
    curves = []
    for rank, name in enumerate(name for name in names if name in wanted):
        colour, place = _PALETTE[rank % len(_PALETTE)], names.index(name)
        label = name if len(names) > 1 else state
        curves.append(Curve(label, at[state].start + place, colour))
        if target in at:
            curves.append(Curve(f"{name} target", at[target].start + place, colour, True))
    return tuple(curves)


def unit_of(layout: Layout, state: str) -> str:
    """Return the unit of a choice, "" for none."""
    if state == TIMES:
        return "ms"
    if state == VELOCITY:
        return "m/s, rad/s"
    return layout.specs[state].unit if state in layout.specs else ""


def title_of(layout: Layout, state: str, chosen: str) -> str:
    """Return the title of a plot, with unit and frame."""
    unit, spec = unit_of(layout, state), layout.specs.get(state)
    words = [state if chosen == ALL else f"{state}: {chosen}"]
    words += [f"[{unit}]"] if unit else []
    words += [f"in {spec.frame}"] if spec is not None and spec.frame else []
    return " ".join(words) + (", target dashed" if state in _TARGETS else "")


class Plot:
    """The curves of one choice, as arrays that a chart takes.

    Args:
        layout: of the states.
        history: of the run.
        state, chosen, period: as for `curves_of`.

    Attributes:
        title: with unit and frame.
        curves: its lines.
    """

    def __init__(
        self, layout: Layout, history: History, state: str, chosen: str, period: float
    ) -> None:
        self._history = history
        self.curves = curves_of(layout, history, state, chosen, period)
        self.title, self.unit = title_of(layout, state, chosen), unit_of(layout, state)

    def data(self, seconds: float, until: float = np.inf) -> tuple[Float64, ...]:
        """Return times up to one in [s] and an array for each curve, at most `POINTS` long each."""
        time, rows = self._history.last(seconds, until)
        stride = max(1, -(-len(time) // POINTS))
        offset = (len(time) - 1) % stride  # the newest is always there
        time, rows = time[offset::stride], rows[offset::stride]
        if not len(time):
            time, rows = np.zeros(1), np.full((1, rows.shape[1]), np.nan, np.float32)
        values = [self._values(curve, rows) for curve in self.curves]
        return (np.array(time), *values, self._span(values, len(time)))

    def _span(self, values: Sequence[Float64], count: int) -> Float64:
        """Return what is not drawn but lets the axis span as much as its unit needs, shape (m,)."""
        span, every = np.full(count, np.nan), np.concatenate(values or [np.zeros(0)])
        every = every[np.isfinite(every)]
        if len(every):
            least = max(_LEAST.get(unit, 0.0) for unit in self.unit.split(", "))
            span[[0, -1]] = 0.5 * (every.min() + every.max()) + np.array((-0.5, 0.5)) * least
        return span

    def _values(self, curve: Curve, rows: Float32) -> Float64:
        if curve.column < 0:
            return np.full(len(rows), curve.constant)
        return rows[:, curve.column].astype(float)

    def series(self) -> tuple[AnyMapping, ...]:
        """Return how the lines look, as uPlot wants it, the axis of time first."""
        lines = [
            {
                "label": curve.label,
                "stroke": curve.colour,
                "width": 1 if curve.dashed else 1.6,
                **({"dash": (6, 4)} if curve.dashed else {}),
                "points": {"show": False},
            }
            for curve in self.curves
        ]
        span = {"label": "", "stroke": "transparent", "points": {"show": False}}
        return ({"label": "time [s]"}, *lines, span)

    def legend(self) -> str:
        """Return the names of the curves beside pieces of their lines, as HTML."""
        dash = 'stroke-dasharray="5 3"'
        items = "".join(
            f'<span style="white-space:nowrap"><svg width="26" height="8"><line x1="1" y1="4" '
            f'x2="25" y2="4" stroke="{curve.colour}" stroke-width="2" {dash * curve.dashed}/></svg>'
            f"&nbsp;{escape(curve.label)}</span> "
            for curve in self.curves
        )
        return f'<div style="{STYLE};display:flex;flex-wrap:wrap;gap:0 12px">{items}</div>'


COMMANDED, MEASURED = (31, 119, 180), (255, 127, 14)
"""Colours of the velocity arrows, and of their legend."""

STYLE = "font:13px/1.45 system-ui,sans-serif;padding:2px 12px 6px"


def table(rows: Mapping[str, str]) -> str:
    """Return names and what is said of them, as HTML."""
    cells = "".join(
        f'<tr><td style="opacity:.65;padding-right:10px;vertical-align:top;white-space:nowrap">'
        f"{name}</td><td>{value}</td></tr>"
        for name, value in rows.items()
    )
    return f'<div style="{STYLE}"><table>{cells}</table></div>'

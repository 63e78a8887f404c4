"""Words: status, graph and legends of the page, as HTML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from unicon_lab.view.page.plots import TIMING, History
from unicon_lab.view.shown import GraphLine, Shown
from unicon_lab.view.source import Snapshot

COMMANDED, MEASURED = (31, 119, 180), (255, 127, 14)
"""Colours of the velocity arrows, and of their legend."""

_STYLE = "font:13px/1.45 system-ui,sans-serif;padding:2px 12px 6px"


def table(rows: Mapping[str, str]) -> str:
    """Return names and what is said of them, as HTML."""
    cells = "".join(
        f'<tr><td style="color:#667;padding-right:10px;vertical-align:top;white-space:nowrap">'
        f"{name}</td><td>{value}</td></tr>"
        for name, value in rows.items()
    )
    return f'<div style="{_STYLE}"><table>{cells}</table></div>'


def status_html(
    shown: Shown,
    tick: Snapshot,
    history: History,
    rate: float,
    texts: dict[str, Any],
    driver: str,
    stale: float,
) -> str:
    """Return how the run is: phase, timing against the deadline, faults, gates, who drives.

    Args:
        shown: the run.
        tick: its newest one.
        history: of late.
        rate: ticks a second as they come.
        texts: of the source; `timed` False where nobody has timed its ticks.
        driver: who drives, in words.
        stale: time since the newest tick came, in [s].
    """
    _, rows = history.last(2.0)
    late, busy = (rows[:, history.columns[name].start] for name in TIMING)
    phase = shown.phases[tick.phase] if tick.phase < len(shown.phases) else str(tick.phase)
    phase = f"<b>{escape(phase)}</b>" + (", paused" if tick.paused else "")
    if stale > 1.0 and not tick.paused:
        phase += f" {_red(f'no tick for {stale:.0f} s')}"
    found = {"phase": phase}
    if texts.get("waits_for"):
        found["waits for"] = f'<b style="color:#b60">{escape(texts["waits_for"])}</b>'
    if "skill" in tick.states and shown.skills:
        number = int(tick.states["skill"].reshape(-1)[0])
        name = shown.skills[number] if 0 <= number < len(shown.skills) else "none"
        found["skill"] = f"<b>{escape(name)}</b>"
    found["tick"] = f"{tick.tick} · {tick.tick * shown.period:.1f} s"
    if texts.get("timed", True):
        found["rate"] = f"{rate:.1f} Hz, wanted {1.0 / shown.period:.1f} Hz"
        if len(rows):
            deadline = shown.period * 1e3
            p50, p99 = np.percentile(busy, (50, 99))
            share = f"{100.0 * p99 / deadline:.0f} % of the deadline of {deadline:g} ms"
            found["busy"] = f"p50 {p50:.2f} ms, p99 {p99:.2f} ms: {share}"
            found["late"] = f"p99 {np.percentile(late, 99):.2f} ms, max {late.max():.2f} ms"
        overruns = f"{tick.overruns}"
        found["overruns"] = _red(overruns) if tick.overruns else overruns
    if driver:
        found["driver"] = escape(driver)
    if faults := texts.get("faults"):
        found["fault"] = "<br>".join(_red(str(fault)) for fault in faults)
    if notes := texts.get("notes"):
        found["notes"] = "<br>".join(escape(str(note)) for note in notes[-3:])
    return table(found)


def _red(text: str) -> str:
    return f'<span style="color:#c00;font-weight:600">{escape(text)}</span>'


def graph_html(graph: Sequence[GraphLine], counters: Sequence[int]) -> str:
    """Return the tree of the workflow, what runs in this tick in full colour."""
    lines = []
    for line in graph:
        try:
            runs = line.runs(list(counters))
        except IndexError:
            runs = True
        look = "color:#111;font-weight:600" if runs else "color:#aab"
        mark = "▸" if runs else "·"
        lines.append(
            f'<div style="padding-left:{12 * line.depth}px;{look}">{mark} {escape(line.text)}</div>'
        )
    return (
        f'<div style="{_STYLE};white-space:nowrap;overflow-x:auto;font-size:12px">'
        f"{''.join(lines)}</div>"
    )


def legend_html(contacts: bool) -> str:
    """Return what the colours in the 3D view mean."""
    items = [
        (COMMANDED, "commanded velocity"),
        (MEASURED, "measured velocity"),
        ((90, 90, 200), "path of the base"),
    ]
    if contacts:
        items.append(((214, 39, 40), "foot in contact"))
    marks = " &nbsp; ".join(
        f'<span style="color:rgb{colour};font-size:16px">■</span>&nbsp;{text}'
        for colour, text in items
    )
    return f'<div style="{_STYLE}">{marks}<br>arrows: 0.6 m for 1 m/s; grid: 1 m</div>'

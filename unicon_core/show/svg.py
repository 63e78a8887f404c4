"""The graph as SVG: nested boxes (a chain from left to right, the rest from top to bottom); as a
file of its own with the state table below. Without scripts or fonts of its own."""

from __future__ import annotations

import html
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING

from unicon_core import __version__
from unicon_core.flow import Block, Chain, Node, Switch
from unicon_core.page import figure, page, pairs, place, table
from unicon_core.show.text import (
    LEGEND,
    branches,
    data_lines,
    is_critical,
    parts_rows,
    state_rows,
    title,
)
from unicon_core.states import States
from unicon_core.text_table import span

if TYPE_CHECKING:
    from unicon_core.workflow import Program


CHAR = 7.3  # px, a character of 12 px monospace, rounded up
LINE = 17  # px, from one line of text to the next
PAD = 10  # px, around the content of a box
GAP = 12  # px, between two boxes
SMALLEST = 0.65  # of its size
DATA = "⇠ reads · ⇢ writes · ± amends"
ARROW = 26  # px, between two boxes of a chain

# On a page of ours the colours are the page's.
STYLE = """
  .graph text { font: 12px ui-monospace, Menlo, Consolas, monospace; fill: var(--text, #1f2937); }
  .graph .small { fill: var(--pale, #6b7280); }
  .graph .title { font-weight: bold; }
  .graph rect { fill: var(--card, #ffffff); stroke: var(--edge, #9ca3af); }
  .graph rect.page { stroke: none; }
  .graph rect.flow { fill: var(--flow, #f8fafc); stroke-dasharray: 4 3; }
  .graph rect.critical { fill: var(--hot-box, #fff7ed); stroke: var(--hot, #c2410c);
                         stroke-width: 2.5; }
  .graph .arrow { stroke: var(--pale, #6b7280); fill: none; marker-end: url(#head); }
  .graph #head path { fill: var(--pale, #6b7280); }
"""


@dataclass
class _Box:
    """A box with its content, measured; `place` says where it stands."""

    node: Node
    lines: list[str]
    label: str
    children: list[_Box] = field(default_factory=list)
    width: float = 0.0
    height: float = 0.0

    @property
    def sideways(self) -> bool:
        return isinstance(self.node, Chain | Switch)


def show_svg(root: Node, states: States, critical: Collection[Block] = ()) -> str:
    """Return an SVG document of graph and states; the critical path has thick orange boxes.

    Args:
        root: the graph.
        states: all states.
        critical: blocks on the critical path.
    """
    parts, graph_width, y = _graph(root, critical)
    rows = state_rows(root, states)
    widths = [max(map(len, column)) * CHAR + GAP for column in zip(*rows)]
    top = y + LINE + PAD
    for i, row in enumerate(rows):
        x = float(PAD)
        for cell, width in zip(row, widths):
            parts.append(_text(x, top + i * LINE, cell, "title" if i == 0 else ""))
            x += width
    width = 2 * PAD + max(graph_width - 2 * PAD, sum(widths))
    return _svg(parts, width, top + len(rows) * LINE + PAD) + "\n"


def graph_svg(root: Node, critical: Collection[Block] = ()) -> str:
    """Return the graph alone, as an `<svg>` element of a page; at most one on a page.

    Args:
        root: the graph.
        critical: blocks on the critical path.
    """
    parts, width, height = _graph(root, critical)
    # It shrinks to the page as long as it can be read; then it is scrolled.
    small = f'<svg style="max-width: max(100%, {SMALLEST * width:.0f}px)"'
    return _svg(parts, width, height).replace("<svg", small, 1)


def _graph(root: Node, critical: Collection[Block]) -> tuple[list[str], float, float]:
    """Return the boxes with their legend, and how wide and high they are."""
    box = _measured(root, "")
    parts = _drawn(box, PAD, PAD, critical)
    y = PAD + box.height + GAP
    parts.append(f'<rect class="critical" x="{PAD}" y="{y}" width="24" height="14" rx="3"/>')
    legend = f"{LEGEND} · {DATA}"
    parts.append(_text(PAD + 32, y + 12, legend))
    width = 2 * PAD + max(box.width, len(legend) * CHAR + 32)
    return parts, width, y + 14 + PAD


def _svg(parts: list[str], width: float, height: float) -> str:
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" class="graph" width="{width:.0f}" '
            f'height="{height:.0f}" viewBox="0 0 {width:.0f} {height:.0f}">',
            f"<style>{STYLE}</style>",
            '<defs><marker id="head" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" '
            'markerHeight="7" orient="auto"><path d="M0 0L8 4L0 8z"/></marker></defs>',
            f'<rect class="page" width="{width:.0f}" height="{height:.0f}"/>',
            *parts,
            "</svg>",
        ]
    )


def _measured(node: Node, label: str) -> _Box:
    box = _Box(node, [title(node), *data_lines(node, "⇠⇢±", 3)], label)
    box.children = [_measured(child, name) for name, child in branches(node)]
    text = max(map(len, [*box.lines, label])) * CHAR
    head = len(box.lines) * LINE + (LINE if label else 0)
    widths = [child.width for child in box.children]
    heights = [child.height for child in box.children]
    inner: tuple[float, float] = 0, -4
    if box.sideways:
        inner = sum(widths) + (len(widths) - 1) * ARROW, max(heights)
    elif box.children:
        inner = max(widths), sum(heights) + (len(heights) - 1) * GAP
    box.width, box.height = max(text, inner[0]) + 2 * PAD, head + inner[1] + 2 * PAD
    return box


def _drawn(box: _Box, x: float, y: float, critical: Collection[Block]) -> list[str]:
    kind = "block" if isinstance(box.node, Block) else "flow"
    if is_critical(box.node, critical):
        kind = "critical"
    parts = [
        f'<rect class="{kind}" x="{x:.1f}" y="{y:.1f}" width="{box.width:.1f}" '
        f'height="{box.height:.1f}" rx="6"/>'
    ]
    line = y + PAD + 8
    if box.label:
        parts.append(_text(x + PAD, line, box.label, "small"))
        line += LINE
    for i, text in enumerate(box.lines):
        parts.append(_text(x + PAD, line, text, "title" if i == 0 else "small"))
        line += LINE
    inner_x, inner_y = x + PAD, line - 8
    for i, child in enumerate(box.children):
        parts += _drawn(child, inner_x, inner_y, critical)
        if not box.sideways:
            inner_y += child.height + GAP
            continue
        if isinstance(box.node, Chain) and i < len(box.children) - 1:
            start, end = inner_x + child.width, inner_x + child.width + ARROW
            parts.append(f'<path class="arrow" d="M{start:.1f} {inner_y + 16:.1f}H{end:.1f}"/>')
        inner_x += child.width + ARROW
    return parts


def _text(x: float, y: float, text: str, kind: str = "") -> str:
    style = f' class="{kind}"' if kind else ""
    return f'<text{style} x="{x:.1f}" y="{y:.1f}">{escape(text)}</text>'


WIDTH = 1600
"""Of the page at most, [pixels]: graphs are wide."""

MANY = 1 << 16
"""Writers and readers of a state: a page names all of them."""


def show_page(program: Program) -> str:
    """Return a program as one HTML page that needs nothing beside it.

    Args:
        program: of which nothing has to be open.

    Raises:
        PolicyError: a policy's observation does not fit the states.
    """
    parts = [
        pairs(dict(_facts(program))),
        figure(
            "Graph of a tick",
            "Each tick runs it from top to bottom; a chain from left to right, one step after "
            "the other in as many ticks as each takes. Orange is the critical path: the command of "
            "this tick depends on it. What is deferred runs after the command was sent.",
            graph_svg(program.root, program.critical),
        ),
        *_states(program),
        *_phases(program),
        *_robot(program),
        *_policies(program),
        f'<p class="sub">unicon_ros {__version__}; the tick as Python: unicon show --source</p>',
    ]
    description = program.document.get("description", "")
    return page(f"{program.name}: workflow", description, parts, WIDTH)


def _facts(program: Program) -> Iterator[tuple[str, str]]:
    layout, period = program.states.layout, program.period
    batch = "" if layout.num_robots is None else f" × {layout.num_robots} robots"
    facts = program.platform.facts
    yield "file", place(program.document.path)
    yield "robot", f"{program.robot.name}: {program.robot.description}"
    # Of a robot that is only shown nothing is open, and `fake` stands in its place.
    yield "platform", str(program.document.values.get("platform", facts.name))
    yield (
        "rate",
        f"{1 / period:g} Hz, a tick every {period * 1e3:g} ms, by {program.pacing.trigger}",
    )
    if program.duration is not None:
        yield "duration", f"{program.duration:g} s at most"
    yield "states", f"{len(program.states)}{batch}, {layout.nbytes} bytes, layout {layout.hash}"
    bounds = (f"{b.axis} {span(b.low, b.high, '…')}" for b in program.command_bounds)
    yield "velocity command", ", ".join(bounds) or "not read"
    yield "safety", ", ".join(program.safety) or "none"
    for name, why in program.safety_left_out.items():
        yield f"without {name}", why


def _states(program: Program) -> Iterator[str]:
    head, *rows = state_rows(program.root, program.states, MANY)
    yield "<h2>States</h2>"
    yield table(head, rows, words=True)
    if program.parts is not None:
        head, *rows = parts_rows(program.parts, program.states)
        yield "<h2>Parts</h2>"
        yield table(head, rows, words=True)


def _phases(program: Program) -> Iterator[str]:
    # Imported here: the runner's package imports the workflow's, which shows itself.
    from unicon_core.runtime.phases import describe

    yield "<h2>Phases of a run</h2>"
    yield pairs(dict(describe(program)))
    if program.gates:
        yield '<h2>Gates</h2><p class="sub">Asked before anything is sent, until all hold.</p>'
        yield pairs({gate.name: getattr(gate, "about", "") for gate in program.gates})


def _robot(program: Program) -> Iterator[str]:
    from unicon_core.robots.table import joint_limits

    head, below, *rows = ((row[1], row[0], *row[2:]) for row in joint_limits(program.robot))
    yield f"<h2>Joints of {html.escape(program.robot.name)}</h2>"
    yield '<p class="sub">Limits, poses and gains of the robot file; ? is not known.</p>'
    yield table(list(map("\n".join, zip(head, below))), rows)


def _policies(program: Program) -> Iterator[str]:
    from unicon_core.policies import joint_rows, observation_rows
    from unicon_core.policies.controller import PrefixedStates, prefix_of

    for name, contract in program.policies.items():
        yield f"<h2>Policy {html.escape(name)}</h2>"
        yield pairs(
            {
                "contract": f"{place(contract.path)} ({contract.source})",
                "network": place(contract.model),
                "rate": f"{1 / contract.period:g} Hz",
                **({"taken": "; ".join(contract.notes)} if contract.notes else {}),
            }
        )
        seen = PrefixedStates(program.states, prefix_of(name, program.policies))
        head, *rows = joint_rows(contract, program.robot)
        yield "<h3>Joints, in the policy's order</h3>"
        yield table(head, rows, words=True)
        (head, *rows), tail = observation_rows(contract, program.robot, seen)
        yield "<h3>Observation</h3>"
        yield table(head, rows, words=True)
        yield f'<p class="sub">{html.escape(tail)}</p>'

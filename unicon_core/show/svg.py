"""The graph as SVG: nested boxes (a chain from left to right, the rest from top to bottom); as a
file of its own with the state table below. Without scripts or fonts of its own."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from html import escape

from unicon_core.flow import Block, Chain, Node, Switch
from unicon_core.show.state_table import state_rows
from unicon_core.show.tree import LEGEND, branches, data_lines, is_critical, title
from unicon_core.states import States

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
        return isinstance(self.node, (Chain, Switch))


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
    text = max(len(line) for line in [*box.lines, label]) * CHAR
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

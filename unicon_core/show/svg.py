"""The graph as SVG: nested boxes (a chain from left to right, the rest from top to bottom), then
the state table. One file without scripts or fonts of its own."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from html import escape

from unicon_core.flow import Block, Chain, Node, Switch
from unicon_core.show.state_table import state_rows
from unicon_core.show.tree import LEGEND, branches, is_critical, shortened, title
from unicon_core.states import States

__all__ = ["show_svg"]

CHAR = 7.3  # px, a character of 12 px monospace, rounded up
LINE = 17  # px, from one line of text to the next
PAD = 10  # px, around the content of a box
GAP = 12  # px, between two boxes
ARROW = 26  # px, between two boxes of a chain

STYLE = """
  text { font: 12px ui-monospace, Menlo, Consolas, monospace; fill: #1f2937; }
  .small { fill: #6b7280; }
  .title { font-weight: bold; }
  rect { fill: #ffffff; stroke: #9ca3af; }
  rect.page { stroke: none; }
  rect.flow { fill: #f8fafc; stroke-dasharray: 4 3; }
  rect.critical { fill: #fff7ed; stroke: #c2410c; stroke-width: 2.5; }
  .arrow { stroke: #6b7280; fill: none; marker-end: url(#head); }
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
    box = _measured(root, "")
    parts = _drawn(box, PAD, PAD, critical)
    y = PAD + box.height + GAP
    legend = f'<rect class="critical" x="{PAD}" y="{y}" width="24" height="14" rx="3"/>'
    parts += [legend, _text(PAD + 32, y + 12, LEGEND)]
    rows = state_rows(root, states)
    widths = [max(map(len, column)) * CHAR + GAP for column in zip(*rows)]
    top = y + 2 * GAP + LINE
    for i, row in enumerate(rows):
        x = float(PAD)
        for cell, width in zip(row, widths):
            parts.append(_text(x, top + i * LINE, cell, "title" if i == 0 else ""))
            x += width
    width = 2 * PAD + max(box.width, sum(widths), len(LEGEND) * CHAR + 32)
    height = top + len(rows) * LINE + PAD
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
            f'viewBox="0 0 {width:.0f} {height:.0f}">',
            f"<style>{STYLE}</style>",
            '<defs><marker id="head" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" '
            'markerHeight="7" orient="auto"><path d="M0 0L8 4L0 8z" fill="#6b7280"/></marker>'
            "</defs>",
            f'<rect class="page" width="{width:.0f}" height="{height:.0f}"/>',
            *parts,
            "</svg>",
            "",
        ]
    )


def _measured(node: Node, label: str) -> _Box:
    box = _Box(node, _lines(node), label)
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


def _lines(node: Node) -> list[str]:
    lines = [title(node)]
    if isinstance(node, Block):
        for word, names in (("⇠", node.reads), ("⇢", node.writes), ("±", node.amends)):
            if names:
                lines.append(f"{word} {shortened(names, 3)}")
    return lines


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

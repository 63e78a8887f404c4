"""The graph as a Mermaid flowchart: the tree in full lines, the data in dotted ones."""

from __future__ import annotations

from collections.abc import Collection

from unicon_core.flow import Block, Node
from unicon_core.show.tree import LEGEND, branches, data_flow, is_critical, shortened, title
from unicon_core.states import States

ENTITIES = str.maketrans({"#": "#35;", '"': "#quot;", "<": "#lt;", ">": "#gt;"})


def show_mermaid(root: Node, states: States, critical: Collection[Block] = ()) -> str:
    """Return a Mermaid flowchart; blocks on the critical path have the class `critical`.

    Args:
        root: the graph.
        states: all states; those that nobody uses are left out.
        critical: blocks on the critical path.
    """
    chart = _Chart()
    chart.tree(root)
    for (source, reader), names in data_flow(root).items():
        known = [name for name in names if name in states]
        if known:
            # A thick line crosses the border between two parts.
            start, end = ("-.", ".->") if source.part == reader.part else ("==", "==>")
            link = f"{chart.places[source]} {start} {_quoted(shortened(known, 3))} {end} "
            chart.lines.append(link + chart.places[reader])
    marked = [chart.places[block] for block in chart.places if is_critical(block, critical)]
    style = ["classDef critical stroke:#c2410c,stroke-width:3px;"]
    if marked:
        style.append(f"class {','.join(marked)} critical;")
    head = [f"%% thick borders: {LEGEND}", "flowchart TB"]
    return "\n".join([*head, *(f"    {line}" for line in [*chart.lines, *style])])


class _Chart:
    def __init__(self) -> None:
        self.lines: list[str] = []
        self.places: dict[Block, str] = {}
        self.count = 0

    def tree(self, node: Node) -> str:
        place = f"n{self.count}"
        self.count += 1
        if isinstance(node, Block):
            self.places.setdefault(node, place)
            self.lines.append(f"{place}[{_quoted(title(node))}]")
            return place
        self.lines.append(f"{place}([{_quoted(title(node))}])")
        for predicate in (getattr(node, name, None) for name in ("until", "predicate", "selector")):
            if isinstance(predicate, Block):
                self.places.setdefault(predicate, place)
        for label, child in branches(node):
            arrow = f"-- {_quoted(label)} -->" if label else "-->"
            below = self.tree(child)
            self.lines.append(f"{place} {arrow} {below}")
        return place


def _quoted(text: str) -> str:
    """Return a text in quotes with Mermaid's entities for what would end or mark it up."""
    return f'"{text.translate(ENTITIES)}"'

"""The graph as text: a tree with the critical path marked and the tables, or a Mermaid flowchart.

In a flowchart the tree has full lines and the data dotted ones.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING

from unicon_core.flow import Block, Node
from unicon_core.show.state_table import state_rows
from unicon_core.show.tree import (
    LEGEND,
    branches,
    data_flow,
    data_lines,
    is_critical,
    shortened,
    title,
)
from unicon_core.states import States
from unicon_core.text_table import aligned

if TYPE_CHECKING:
    from unicon_core.policies import PolicyContract
    from unicon_core.robots import Robot

MARK = "●"
WORDS = ("reads", "writes", "amends")


def show_text(
    root: Node,
    states: States,
    critical: Collection[Block] = (),
    *,
    robot: Robot | None = None,
    policies: Mapping[str, PolicyContract] | None = None,
) -> str:
    """Return graph, states, and the joint and observation tables of the policies.

    Args:
        root: the graph.
        states: all states.
        critical: blocks on the critical path (`critical_path(root).critical`).
        robot: adds the place of each policy joint in the robot's order.
        policies: by name.

    Raises:
        PolicyError: a policy's observation does not fit the states.
    """
    layout = states.layout
    batch = "" if layout.num_robots is None else f" × {layout.num_robots} robots"
    parts = [
        "\n".join(aligned([*_tree(root, critical, "", "")], underlined=False)),
        f"{MARK} {LEGEND}",
        f"{len(states)} states{batch}, {layout.nbytes} bytes, layout {layout.hash[:12]}",
        "\n".join(aligned(state_rows(root, states))),
    ]
    if policies:
        from unicon_core.policies import joint_table, observation_table
        from unicon_core.policies.prefixed import PrefixedStates, prefix_of

        for name, contract in policies.items():
            parts += [f"joints of policy {name}", joint_table(contract, robot)]
            parts += [f"note: {note}" for note in contract.notes]
            seen = PrefixedStates(states, prefix_of(name, policies))
            table = observation_table(contract, robot, seen)
            parts += [f"observation of policy {name}", table]
    return "\n\n".join(parts)


def _tree(
    node: Node, critical: Collection[Block], lead: str, below: str, label: str = ""
) -> Iterator[tuple[str, str]]:
    """Yield (tree part, data part) for each line below a node."""
    mark = f"{MARK} " if is_critical(node, critical) else ""
    yield f"{lead}{label}{mark}{title(node)}", "  ".join(data_lines(node, WORDS, 4))
    children = branches(node)
    for i, (name, child) in enumerate(children):
        last = i == len(children) - 1
        yield from _tree(
            child,
            critical,
            below + ("└─ " if last else "├─ "),
            below + ("   " if last else "│  "),
            f"{name}: " if name else "",
        )


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

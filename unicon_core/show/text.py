"""The graph as text: a tree with the critical path marked and the tables, or a Mermaid flowchart.

In a flowchart the tree has full lines and the data dotted ones.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from unicon_core.flow import (
    Block,
    Chain,
    Deferred,
    Every,
    Loop,
    Node,
    Switch,
    When,
    Zip,
    blocks_of,
    children_of,
)
from unicon_core.states import Layout, States
from unicon_core.text_table import aligned

if TYPE_CHECKING:
    from unicon_core.policies import PolicyContract
    from unicon_core.robots import Robot
    from unicon_core.workflow.parts import Parts


SPEC_HEAD = ("state", "shape", "dtype", "unit", "frame")
PARTS_HEAD = ("part", "group", "bytes", "published at", "states", "others silent")


def spec_cells(layout: Layout, name: str) -> tuple[str, ...]:
    """Return what a state is, under the heads of SPEC_HEAD."""
    spec, shape = layout.specs[name], layout.slots[name].shape
    shape_text = "×".join(map(str, shape)) or "scalar"
    return (name, shape_text, spec.dtype, spec.unit or "-", spec.frame or "-")


def state_rows(root: Node, states: States, limit: int = 4) -> list[tuple[str, ...]]:
    """Return the heads, then a row for each state, in the order of their declaration.

    Args:
        root: the graph.
        states: all states.
        limit: so many writers and readers are named; the others are counted.
    """
    blocks = blocks_of(root)

    def users(name: str, attribute: str) -> list[str]:
        named = (block.name for block in blocks if name in getattr(block, attribute))
        return list(dict.fromkeys(named))

    rows: list[tuple[str, ...]] = [(*SPEC_HEAD, "writer", "readers", "description")]
    for name, spec in states.layout.specs.items():
        amenders = [f"{user} (amends)" for user in users(name, "amends")]
        rows.append(
            (
                *spec_cells(states.layout, name),
                shortened(users(name, "writes") + amenders, limit) or "-",
                shortened(users(name, "reads"), limit) or "-",
                spec.description,
            )
        )
    return rows


def parts_rows(parts: Parts, states: States) -> list[tuple[str, ...]]:
    """Return the heads, then what each part publishes, where, and when the others are silent."""
    rows: list[tuple[str, ...]] = [PARTS_HEAD]
    for part in parts.parts.values():
        silent = f"{part.silent.then} after {part.silent.after:g} s"
        groups = parts.groups(part.name, states.layout)
        for k, (name, group) in enumerate(groups.items()):
            store = parts.store
            place = (
                store.segment(part.name) if store.backend == "shm" else store.place(part.name, k)
            )
            where = f"{store.backend} {place}"
            size = f"{group.nbytes} B"
            rows.append((part.name, name, size, where, " ".join(group.specs), silent))
        if not groups:
            rows.append((part.name, "-", "-", "-", "-", silent))
    return rows


LEGEND = "critical path: the command of this tick depends on it"


def title(node: Node) -> str:
    """Return the word for a node, with what stands in its own line: predicates, numbers."""
    if isinstance(node, Block):
        return f"{node.name} (on {node.part})" if node.part else node.name
    if isinstance(node, Zip):
        return "zip"
    if isinstance(node, Chain):
        return "chain"
    if isinstance(node, Loop):
        return "loop" if node.until is None else f"loop until {node.until.name}"
    if isinstance(node, Every):
        return f"every {node.n} ticks"
    if isinstance(node, When):
        return f"when {node.predicate.name}"
    if isinstance(node, Switch):
        blend = f", blended over {node.blend} ticks" if node.blend else ""
        return f"switch on {node.selector.name}{blend}"
    return "deferred, found not to be part of the command" if node.ends else "deferred"


def branches(node: Node) -> list[tuple[str, Node]]:
    """Return the children that hang below a node, each with the label of its branch.

    Those of a fused block are what it was fused of.
    """
    if isinstance(node, Block):
        return [("", part) for part in node.parts]
    if isinstance(node, Chain):
        return [(str(i + 1), child) for i, child in enumerate(node.children)]
    if isinstance(node, Switch):
        return list(zip(node.names, node.children))
    return [("", child) for child in (node.children if isinstance(node, Zip) else (node.child,))]


def is_critical(node: Node, critical: Collection[Block]) -> bool:
    """Return True for a block on the critical path, or fused from one that is."""
    return isinstance(node, Block) and any(part in critical for part in (node, *node.parts))


def shortened(names: Sequence[str], limit: int) -> str:
    """Return names with commas; of more than `limit` the first ones and the number of others."""
    if len(names) <= limit:
        return ", ".join(names)
    return f"{', '.join(names[: limit - 1])}, +{len(names) - limit + 1}"


def data_lines(node: Node, words: Sequence[str], limit: int) -> list[str]:
    """Return what a block reads, writes and amends, each behind its word; none of other nodes."""
    if not isinstance(node, Block):
        return []
    uses = zip(words, (node.reads, node.writes, node.amends))
    return [f"{word} {shortened(names, limit)}" for word, names in uses if names]


def data_flow(root: Node) -> dict[tuple[Block, Block], list[str]]:
    """Return the states that go from a block that writes or amends them to one that reads them.

    A reader gets a state from whichever block may have been the last to write it: of several
    branches that exclude each other from each, without one in this tick from the tick before.
    """
    flow: dict[tuple[Block, Block], list[str]] = {}
    _tick(root, _tick(root, {}, {}), flow)
    return flow


Writers = dict[str, tuple[Block, ...]]


def _tick(root: Node, before: Writers, flow: dict[tuple[Block, Block], list[str]]) -> Writers:
    after = _reach(root, before, flow)
    for child in _put_off(root):
        after = _either([after, _reach(child, after, flow)])
    return after


def _put_off(node: Node) -> list[Node]:
    if isinstance(node, Deferred):
        return [node.child]
    return [found for child in children_of(node) for found in _put_off(child)]


def _reach(node: Node, before: Writers, flow: dict[tuple[Block, Block], list[str]]) -> Writers:
    """Note in `flow` who reads what from whom; return who may have written what after a node."""
    if isinstance(node, Block):
        for name in (*node.reads, *node.amends):
            for source in before.get(name, ()):
                names = flow.setdefault((source, node), [])
                if name not in names:
                    names.append(name)
        return before | dict.fromkeys((*node.writes, *node.amends), (node,))
    if isinstance(node, Chain | Switch):
        if isinstance(node, Switch):
            before = _reach(node.selector, before, flow)
        return _either([_reach(child, before, flow) for child in node.children])
    if isinstance(node, When):
        before = _reach(node.predicate, before, flow)
        return _either([before, _reach(node.child, before, flow)])
    after = before
    for child in () if isinstance(node, Deferred) else children_of(node):
        after = _reach(child, after, flow)
    return _either([before, after]) if isinstance(node, Every) else after


def _either(ways: list[Writers]) -> Writers:
    names = dict.fromkeys(name for way in ways for name in way)
    return {
        name: tuple(dict.fromkeys(block for way in ways for block in way.get(name, ())))
        for name in names
    }


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
        "\n".join(aligned([*_tree(root, critical, "", "")], underlined=False, width=1 << 20)),
        f"{MARK} {LEGEND}",
        f"{len(states)} states{batch}, {layout.nbytes} bytes, layout {layout.hash[:12]}",
        "\n".join(aligned(state_rows(root, states))),
    ]
    if policies:
        from unicon_core.policies import joint_table, observation_table
        from unicon_core.policies.controller import PrefixedStates, prefix_of

        for name, contract in policies.items():
            parts += [f"joints of policy {name}", joint_table(contract, robot)]
            parts += [f"note: {note}" for note in contract.notes]
            seen = PrefixedStates(states, prefix_of(name, policies))
            parts += [f"observation of policy {name}", observation_table(contract, robot, seen)]
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

"""The graph as text: a tree with the critical path marked, then the tables."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING

from unicon_core.aligned import aligned
from unicon_core.flow import Block, Node
from unicon_core.show.state_table import state_rows
from unicon_core.show.tree import LEGEND, branches, data_lines, is_critical, title
from unicon_core.states import States

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

"""The page of a workflow: graph, states, phases, gates, joints and policies, for a browser."""

from __future__ import annotations

import html
from collections.abc import Iterator
from typing import TYPE_CHECKING

from unicon_core import __version__
from unicon_core.page import figure, page, pairs, place, table
from unicon_core.show.state_table import parts_rows, state_rows
from unicon_core.show.svg import graph_svg
from unicon_core.text_table import span

if TYPE_CHECKING:
    from unicon_core.workflow import Program

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
    from unicon_core.policies.prefixed import PrefixedStates, prefix_of

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

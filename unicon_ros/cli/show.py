"""`unicon show WORKFLOW`: graph, states and tables of a workflow, without running it."""

from __future__ import annotations

import argparse
from pathlib import Path

from unicon_ros.cli.console import print_table
from unicon_ros.cli.options import WORKFLOW, argument, command, exclusive, flag


def show(arguments: argparse.Namespace) -> int:
    """Run the command."""
    from unicon_core.flow import compile_graph
    from unicon_core.page import write_file
    from unicon_core.runtime.phases import describe
    from unicon_core.show.svg import show_page, show_svg
    from unicon_core.show.text import parts_table, show_mermaid, show_text
    from unicon_core.workflow import Program, load_document

    # Dry: nothing is opened or published only to be shown.
    program = Program(load_document(arguments.workflow, arguments.overrides), dry=True)
    try:
        facts = (program.root, program.states, program.critical)
        if arguments.source:
            print(compile_graph(program.root).source, end="")
        elif arguments.mermaid:
            print(show_mermaid(*facts))
        elif arguments.svg or arguments.html:
            text = show_svg(*facts) if arguments.svg else show_page(program)
            path = arguments.svg or arguments.html
            write_file(Path(path), text.encode())
            print(path)
        else:
            print(show_text(*facts, robot=program.robot, policies=program.policies))
            print("\nPhases")
            for phase, what in describe(program):
                print(f"  {phase:<10} {what}")
            if program.gates:
                print("\nGates")
                gates = [(f"  {g.name}", getattr(g, "about", "")) for g in program.gates]
                print_table(gates)
            if program.parts is not None:
                print("\nParts")
                print("\n".join(f"  {line}" for line in parts_table(program.parts, program.states)))
    finally:
        program.close()
    return 0


add = command(
    "show",
    show,
    "show graph and states",
    __doc__,
    *WORKFLOW,
    exclusive(
        flag("--source", "the compiled step as Python"),
        flag("--mermaid", "the graph as Mermaid"),
        argument("--svg", "FILE", "the graph as SVG, written to FILE"),
        argument("--html", "FILE", "all of it as one page, written to FILE"),
    ),
)

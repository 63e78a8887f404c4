"""What a workflow is and whether it would run: `unicon check`, `explain`, `show` and `schema`.

unicon check WORKFLOW     every finding with culprit, evidence and remedy
unicon explain [CODE]     what a finding means
unicon show WORKFLOW      graph, states and tables of a workflow, without running it
unicon schema [KIND]      JSON Schema of documents, by which editors complete and check them
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING

from unicon_base import AnyDict, UniconError, alternatives
from unicon_base.packages import registered
from unicon_core.page import write_file
from unicon_ros.cli.console import print_table, print_text
from unicon_ros.cli.options import (
    MAP,
    WORKFLOW,
    argument,
    command,
    exclusive,
    flag,
    option,
    together,
    whole,
)

if TYPE_CHECKING:
    from unicon_core.workflow import HookBlocks, Program


KINDS = {
    "workflow": ("unicon_core.workflow.file:Workflow",),
    "policy": ("unicon_core.policies.file:PolicyFile",),
    "map": ("unicon_msgs_map.mapfile.document:MapDocument",),
    "robot": ("unicon_core.robots.file:RobotFile", "unicon_core.robots.file:Overlay"),
} | {name: (entry.value,) for name, entry in registered("documents").items()}
"""Kind of document to its classes."""


def check(arguments: argparse.Namespace) -> int:
    """Run the command; exit status 0 clean, 1 findings."""
    from unicon_core.check import CheckResult, check_workflow
    from unicon_core.check.subject import Subject
    from unicon_core.text_table import alarming, terminal_width

    def mirror(subject: Subject, result: CheckResult) -> None:
        values = subject.document.values
        if arguments.ros or arguments.map or values.get("ros") or values.get("map"):
            from unicon_ros.bridge.map_fit import check_mirror  # 0.2 s with what it imports

            check_mirror(subject, result, arguments.map)

    def heard(program: Program) -> HookBlocks:
        if not (arguments.ros or program.document.get("ros", False)):
            return {}
        from unicon_ros.bridge.map_fit import mirror_hook

        return mirror_hook(program, arguments.map)

    result = check_workflow(
        arguments.workflow, arguments.overrides, twin=arguments.twin, more=[mirror], hooks=[heard]
    )
    if arguments.json:
        result.write(arguments.json)
    if arguments.quiet:
        result.sections.clear()
    text = result.text(terminal_width())
    print(text.replace("\nFindings\n", f"\n{alarming('Findings', sys.stdout)}\n", 1))
    return 1 if result.findings else 0


def explain(arguments: argparse.Namespace) -> int:
    """Run the command."""
    from unicon_core.check.rules import CODES, markdown

    if arguments.markdown:
        print(markdown(), end="")
    elif arguments.code is None:
        rows = [(code, rule.what) for code, rule in sorted(CODES.items())]
        print_table(rows)
    elif arguments.code in CODES:
        print(CODES[arguments.code].text())
    else:
        known = alternatives(arguments.code, CODES, limit=len(CODES))
        raise UniconError(f"explain: no finding has the code {arguments.code!r}; {known}")
    return 0


def show(arguments: argparse.Namespace) -> int:
    """Run the command."""
    from unicon_core.flow import compile_graph
    from unicon_core.runtime.phases import describe
    from unicon_core.show.svg import show_page, show_svg
    from unicon_core.show.text import parts_rows, show_mermaid, show_text
    from unicon_core.workflow import Program, load_document

    # Dry: nothing is opened or published only to be shown.
    program = Program(load_document(arguments.workflow, arguments.overrides), dry=True)
    try:
        facts = (program.root, program.states, program.critical)
        if arguments.source == "cpp":
            from unicon_core.native.tick import NativeTick

            print(NativeTick(program.states, print).source(program.root), end="")
        elif arguments.source:
            print(compile_graph(program.root).source, end="")
        elif arguments.mermaid:
            print(show_mermaid(*facts))
        elif arguments.svg or arguments.html:
            text = show_svg(*facts) if arguments.svg else show_page(program)
            path = arguments.svg or arguments.html
            write_file(Path(path), text.encode())
            print(path)
        else:
            print_text(show_text(*facts, robot=program.robot, policies=program.policies))
            print("\nPhases")
            for phase, what in describe(program):
                print_text(f"  {phase:<10} {what}")
            if program.gates:
                print("\nGates")
                gates = [(f"  {g.name}", getattr(g, "about", "")) for g in program.gates]
                print_table(gates)
            if program.parts is not None:
                print("\nParts")
                rows = parts_rows(program.parts, program.states)
                print_table([(f"  {part}", *row) for part, *row in rows], underlined=True)
    finally:
        program.close()
    return 0


def export(arguments: argparse.Namespace) -> int:
    """Run the command."""
    from unicon_core.native.export import export
    from unicon_core.workflow import load_document

    folder = Path(arguments.cpp)
    export(load_document(arguments.workflow, arguments.overrides), folder, arguments.ticks)
    print(folder)
    return 0


def schema_of(kind: str) -> AnyDict:
    """Return the JSON Schema of a kind of document.

    Raises:
        UniconError: there is no such kind.
    """
    from unicon_base.schema.read import json_schema

    if kind not in KINDS:
        raise UniconError(f"schema: unknown kind {kind!r}; {alternatives(kind, KINDS)}")
    return json_schema(*map(resolve_name, KINDS[kind]))


def schema(arguments: argparse.Namespace) -> int:
    """Run the command."""
    kinds = [arguments.kind] if arguments.kind else list(KINDS)
    if arguments.kind is None and arguments.out is None:
        raise UniconError(f"schema: give one of {', '.join(KINDS)}, or --out FOLDER for all")
    for kind in kinds:
        text = json.dumps(schema_of(kind), indent=1, ensure_ascii=False) + "\n"
        if arguments.out is None:
            print(text, end="")
            continue
        path = Path(arguments.out) / f"{kind}.json"
        write_file(path, text.encode(), folders=True)
        print(path)
    return 0


add = together(
    command(
        "check",
        check,
        "check a workflow before a motor moves",
        None,
        *WORKFLOW,
        flag("--twin", "also simulate it, and broken twins"),
        flag(
            "--ros",
            "also check the message map that `run --ros` would use (default: what the workflow "
            "says)",
        ),
        MAP,
        argument("--json", "FILE", "write the findings as JSON"),
    ),
    command(
        "explain",
        explain,
        "what a finding means and what to do about it",
        "What a finding of `unicon check` means, why it matters, and what to do.",
        argument("code", "CODE", "of a finding; all unless given", nargs="?"),
        flag("--markdown", "all rules as a page"),
    ),
)
add_show = command(
    "show",
    show,
    "show graph and states",
    "Show graph, states and tables of a workflow, without running it.",
    *WORKFLOW,
    exclusive(
        option(
            "--source",
            nargs="?",
            const="python",
            choices=("python", "cpp"),
            help="the compiled step as Python, or what `run --native` compiles",
        ),
        flag("--mermaid", "the graph as Mermaid"),
        argument("--svg", "FILE", "the graph as SVG, written to FILE"),
        argument("--html", "FILE", "all of it as one page, written to FILE"),
    ),
)
add_export = command(
    "export",
    export,
    "write a controller in C++",
    "Write the tick of a workflow as a C++ project that needs no Python, with recorded vectors.",
    *WORKFLOW,
    argument("--cpp", "DIR", "the project's folder: absent or empty", required=True),
    argument(
        "--ticks",
        "N",
        "recorded at most, in simulation (default 1000)",
        type=whole("a number of ticks", 1, 1_000_000),
        default=1000,
    ),
)
add_schema = command(
    "schema",
    schema,
    "JSON Schema of documents, for editors",
    "JSON Schema of documents, by which editors complete and check them.",
    argument("kind", "KIND", f"one of {', '.join(KINDS)}", nargs="?"),
    argument("--out", "FOLDER", "write KIND.json, or all of them, there"),
)

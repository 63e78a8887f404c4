"""`unicon check WORKFLOW`: preflight; every finding with culprit, evidence and remedy.

`unicon explain [CODE]` tells what a finding means.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from unicon_base.errors import UniconError, alternatives
from unicon_ros.cli.console import print_table
from unicon_ros.cli.options import MAP, WORKFLOW, argument, command, flag, together

if TYPE_CHECKING:
    from unicon_core.flow import Block, Stage
    from unicon_core.workflow import Program


def check(arguments: argparse.Namespace) -> int:
    """Run the command; exit status 0 clean, 1 findings."""
    from unicon_core.check import CheckResult, check_workflow
    from unicon_core.check.subject import Subject
    from unicon_core.terminal import terminal_width

    def mirror(subject: Subject, result: CheckResult) -> None:
        values = subject.document.values
        if arguments.ros or arguments.map or values.get("ros") or values.get("map"):
            from unicon_ros.bridge.map_fit import check_mirror  # 0.2 s with what it imports

            check_mirror(subject, result, arguments.map)

    def heard(program: Program) -> dict[Stage, list[Block]]:
        if not (arguments.ros or program.document.get("ros", False)):
            return {}
        from unicon_ros.bridge.map_fit import mirror_hook

        return mirror_hook(program, arguments.map)

    result = check_workflow(
        arguments.workflow,
        arguments.overrides,
        twin=arguments.twin,
        more=[mirror],
        hooks=[heard],
    )
    if arguments.json:
        result.write(arguments.json)
    if arguments.quiet:
        result.sections.clear()
    print(result.text(terminal_width()))
    return 1 if result.findings else 0


def explain(arguments: argparse.Namespace) -> int:
    """Run the command."""
    from unicon_core.check.result import markdown
    from unicon_core.check.rules import CODES

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

"""`refuse_errors`: what `unicon check` calls an error does not run; for command and node."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from unicon_core.check.check import check_section, static_checks
from unicon_core.check.result import CheckResult
from unicon_core.check.rules import CODES, FIRM
from unicon_core.check.subject import Subject, declared_platform
from unicon_core.errors import CheckError, WorkflowError, alternatives

if TYPE_CHECKING:
    from unicon_core.workflow import Program

TOLD = {
    "safety.none": "commands are sent as they are, also those that are not finite or beyond the "
    "limits of a joint",
    "safety.less": "",
    "safety.remote": "",
    "joints.welded": "",
    "model.meshes": "",
    "reach.apart": "",
    "start.gates": "the robot is moved whatever it tells of itself",
}
"""Notes that every start tells, and what each means where its evidence does not say it."""


def refuse_errors(program: Program, force: Iterable[str] = ()) -> list[str]:
    """Check a workflow that was built to run; a simulator is left as it was.

    The static checks of `unicon check` take the workflow as it is: 20 to 50 ms, once.

    Args:
        program: built, not yet ticked; `forced` is set in it.
        force: codes of errors to go on with.

    Returns:
        Warnings to be told at every start: errors that are forced or accepted, a workflow without
        safety blocks or gates, and safety blocks that a robot does not have.

    Raises:
        WorkflowError: an unknown code.
        CheckError: errors that are not forced; all are named.
    """
    forced = list(dict.fromkeys(force))
    for code in forced:
        if code not in CODES:
            raise WorkflowError(
                f"force: no finding has the code {code!r}; {alternatives(code, CODES)}"
            )
        if code in FIRM:
            raise WorkflowError(f"force: a run cannot begin with {code!r}; mend what it finds")
    document = program.document
    result = CheckResult(program.name)
    check_section(document, result)
    facts = declared_platform(document) if program.has_platform else (program.platform.facts, True)
    static_checks(Subject(document, program, *facts, live=True), result)
    errors = [found for found in result.findings if found.code not in forced]
    if errors:
        codes = " ".join(
            f"--force {code}" for code in dict.fromkeys(e.code for e in errors) if code not in FIRM
        )
        risk = f" or go on at your own risk with {codes}" if codes else ""
        raise CheckError(
            f"workflow {program.name!r} is not run, mend it{risk}:",
            [str(found) for found in errors],
        )
    told = [f"forced: {found}" for found in result.findings]
    told += [f"accepted by the workflow: {found}" for found in result.waived]
    decided = dict.fromkeys(found.code for found in [*result.findings, *result.waived])
    program.forced = tuple(decided)
    notes = [note for note in result.notes if note.code in TOLD]
    return told + [f"{note.culprit}: {TOLD[note.code] or note.evidence}" for note in notes]

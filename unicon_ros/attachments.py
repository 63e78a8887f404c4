"""What goes with a run: its recording, pages, viewers, records of faults.

Other packages bring them by entry points of group `unicon.run`, each of which names an object with
`OPTIONS`, which `unicon run` adds to its own, `CHECKS` of texts by option, which raise,
`refuse(options)`, which raises where options contradict each other, and `attachments(asked)`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from unicon_base import AnyDict, TextSink
from unicon_base.packages import loaded

if TYPE_CHECKING:
    from unicon_core.runtime import Report, Runner
    from unicon_core.workflow import HookBlocks, Program, WorkflowDocument
    from unicon_ros.bridge import RosSession

File = tuple[str, str, Callable[[], object]]
"""What a run leaves: its name, its path, and what writes it."""


@dataclass(frozen=True)
class Asked:
    """What a run was asked for.

    Attributes:
        options: values by name, such as `record`; one that is missing is not asked for.
        document: the workflow.
        map_name: message map, name or path; None for `default`.
        session: of ROS; None without.
        warn: takes lines for the operator.
    """

    options: AnyDict
    document: WorkflowDocument
    map_name: str | None
    session: RosSession | None
    warn: TextSink


class Attachment:
    """Goes with one run.

    Attributes:
        address: where it is seen, once it is attached; "" where nowhere.
        label: says in the operator's line what is there.
        drives: an operator can start and stop the run there.
        returns: a page may set the run back.
        stays: it is closed once `watched` is False, others when the run has ended.
        again: arguments of `unicon`, which replaces this process with them once `watched` is
            False; () for no.
    """

    address, label, drives, returns, stays = "", "", False, True, False
    again: tuple[str, ...] = ()

    def hook(self, program: Program) -> HookBlocks:
        """Return its blocks, while the program is built."""
        return {}

    def attach(self, runner: Runner) -> None:
        """Get to know the runner before its first tick."""

    def status(self) -> AnyDict:
        """Return what the status line begins with."""
        return {}

    def ended(self, report: Report) -> tuple[str, str] | None:
        """Complete the report of a run that ended; return a name and what to say, if anything."""
        return None

    def watched(self) -> bool:
        """Return whether somebody looks at a run that has ended; called ten times a second."""
        return False

    def files(self, report: Report) -> Iterator[File]:
        """Return what it writes at the end."""
        return iter(())

    def close(self) -> None:
        """Let go of what it holds, after the run."""


def said_at_end(attachments: list[Attachment], report: Report) -> Iterator[tuple[str, str]]:
    """Yield what attachments say of a run that ended, the last one first, name and text each.

    One that raises is named: neither the report nor a fault's status is lost by it.
    """
    for each in reversed(attachments):
        try:
            said = each.ended(report)
        except Exception as wrong:  # whatever another package's code raises
            said = type(each).__name__, f"failed: {type(wrong).__name__}: {wrong}"
        if said is not None:
            yield said


def attached(asked: Asked) -> list[Attachment]:
    """Return what goes with a run, in the order of their hooks."""
    return [each for extension in loaded("run").values() for each in extension.attachments(asked)]

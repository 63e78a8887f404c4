"""`run`: checks a program and runs it to the end, for programs that are described in Python."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any, Protocol

from unicon_core.check import refuse_errors
from unicon_core.runtime.phases import RunOptions
from unicon_core.runtime.report import Report
from unicon_core.runtime.runner import Runner
from unicon_core.workflow import Program


class Attached(Protocol):
    """What comes along with a run, such as a ROS session."""

    def attach(self, runner: Runner) -> None:
        """Get to know the runner, before the first tick."""
        ...

    def close(self) -> None:
        """Let go, after the run."""
        ...


def run(program: Program, *attached: Attached, force: Sequence[str] = (), **options: Any) -> Report:
    """Check a program, run it to the end and return the report; a fault is in it.

        session = RosSession(map="default")
        report = run(Program(…, hooks=[session.hook]), session)

    Args:
        program: what to run.
        attached: what comes along, told before the first tick and closed after the last.
        force: codes of errors of `unicon check` to go on with.
        options: of `RunOptions`: duration, speed, warn.

    Raises:
        CheckError: what `unicon check` calls an error.
        UniconError: an option is unknown or wrong, or it cannot be run.
    """
    with ExitStack() as rest:
        for each in attached:
            rest.callback(each.close)
        rest.callback(program.close)
        wishes = RunOptions.of(options)
        for line in refuse_errors(program, force):
            wishes.warn(line)
        runner = Runner(program, wishes)
        for each in attached:
            each.attach(runner)
        return runner.run()

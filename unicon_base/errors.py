"""The errors of the core, for everybody who raises, catches or reads one.

    UniconError                    base: one clear line, exit status 1
    ├── WorkflowError              a workflow file or graph is wrong (carries file and line)
    ├── CheckError                 `unicon check` finds errors (lists them)
    ├── StateError                 a state is unknown, or its shape, dtype, unit or frame is wrong
    ├── RobotError                 a robot file is wrong, or lacks a fact that is needed
    ├── ModelError                 a simulator model is missing or lacks a joint, sensor or actuator
    ├── PolicyError                a policy or its contract is missing, incomplete or contradictory
    ├── PlatformError              a platform is unknown, unreachable or cannot do what is asked
    ├── MissingDependencyError     an optional package is absent (names the install command)
    └── MapError                   a message map is wrong (`unicon_msgs_map/errors.py`)
    Fault                          raised inside a tick: the runner damps, closes, exit status 3
    ├── EmergencyStopPressed       a person pressed one, whichever device it is on
    └── Hung                       a tick took too long, or none ran: nothing that may hang is asked

A message names the culprit, the alternatives and the remedy, in one line. An error about a document
with several mistakes has `problems`, and a line for each.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any


class UniconError(Exception):
    """Base of every error that a user can cause and mend; `str()` is the one line to print.

    Args:
        message: what is wrong, with alternatives and remedy.
        where: `file:line` of the culprit, put in front of the message where known.

    Attributes:
        problems: the mistakes of a document that has several.
    """

    LISTED = 100
    problems: tuple[UniconError, ...] = ()

    def __init__(self, message: str, where: str | None = None) -> None:
        super().__init__(f"{where}: {message}" if where else message)
        self.message = message
        self.where = where

    def __str__(self) -> str:
        # A name of a file may hold anything, and an error stays one line for all that.
        line = " ".join(super().__str__().split("\n"))
        if not self.problems:
            return line
        more = len(self.problems) - self.LISTED
        cut = [f"… and {more} more"] if more > 0 else []
        return line + _numbered([*map(str, self.problems[: self.LISTED]), *cut])

    @classmethod
    def of(cls, what: str, problems: Sequence[UniconError]) -> UniconError:
        """Return the one problem of a document, or one error with all of them.

        Args:
            what: the document, such as `robot file rover.yaml`.
            problems: at least one.
        """
        if len(problems) == 1:
            return problems[0]
        error = cls(f"{what} has {len(problems)} mistakes:")
        error.problems = tuple(problems)
        return error


class WorkflowError(UniconError):
    """A workflow file or graph is wrong."""


class CheckError(UniconError):
    """A workflow has errors that `unicon check` finds: one line each.

    Args:
        message: that it is not run, and how to go on.
        findings: what was found, one line each.
    """

    def __init__(self, message: str, findings: Sequence[str]) -> None:
        super().__init__(message)
        self.findings = tuple(" ".join(found.split("\n")) for found in findings)

    def __str__(self) -> str:
        if len(self.findings) == 1:
            return f"{super().__str__()} {self.findings[0]}"
        return super().__str__() + _numbered(self.findings)


class StateError(UniconError):
    """A state is unknown, or its shape, dtype, unit or frame is not as asked."""


class RobotError(UniconError):
    """A robot file is wrong or lacks a fact that is needed."""


class ModelError(UniconError):
    """A simulator model is missing or lacks a joint, sensor or actuator."""


class PolicyError(UniconError):
    """A policy or its contract is missing, incomplete or contradictory."""


class PlatformError(UniconError):
    """A platform is unknown, unreachable or cannot do what is asked of it."""


class MissingDependencyError(UniconError):
    """An optional package is absent.

    Args:
        what: who needs it, such as `"platform 'mujoco'"`.
        package: the distribution's name.
        install: the command that installs it.
    """

    def __init__(self, what: str, package: str, install: str) -> None:
        super().__init__(f"{what} needs {package}: {install}")
        self.package = package


def imported(name: str, what: str, extra: str = "", package: str = "") -> Any:
    """Return an optional module.

    Args:
        name: of the module.
        what: who needs it, such as `"--picture"`.
        extra: of `unicon_ros`, which installs it; "" where pip installs the package by itself.
        package: the distribution's name, where it is not that of the module's first part.

    Raises:
        MissingDependencyError: it is not installed.
    """
    try:
        return import_module(name)
    except ImportError as error:
        package = package or name.partition(".")[0]
        install = f"'unicon_ros[{extra}]'" if extra else package
        raise MissingDependencyError(what, package, f"pip install {install}") from error


@contextmanager
def cannot(what: str, remedy: str) -> Iterator[None]:
    """Turn an error of the system that is raised inside into one line: `cannot WHAT: why; REMEDY`.

    Args:
        what: is done there, such as `"write FILE"`.
        remedy: what to do.

    Raises:
        UniconError: in the place of an OSError.
    """
    try:
        yield
    except OSError as error:
        raise UniconError(f"cannot {what}: {error.strerror or error}; {remedy}") from error


class Fault(Exception):
    """Raised by a block inside a tick: the runner damps, sends nothing else and closes."""


class EmergencyStopPressed(Fault):
    """A person pressed an emergency stop, whichever device it is on: it latches the robot."""


class Silence(Fault):
    """A robot says nothing any more, or this machine had no time to hear it."""


class Hung(Fault):
    """A tick took too long, or the process stood still: what hung may do so again."""


def _numbered(lines: Sequence[str]) -> str:
    return "".join(f"\n  {i}. {line}" for i, line in enumerate(lines, 1))


def alternatives(wrong: str, known: Iterable[str], *, limit: int = 24) -> str:
    """Return a phrase that names what else there is: the close match first, then the list.

    Args:
        wrong: the name that was not found.
        known: the names that exist.
        limit: how many names to list at most.
    """
    names = sorted(map(str, known))
    if not names:
        return "none is known"
    import difflib  # where something is wrong, and not at every start

    close = difflib.get_close_matches(str(wrong)[:80], names, n=1)
    shown = ", ".join(names[:limit]) + (f", … ({len(names)} in all)" if len(names) > limit else "")
    return f"did you mean {close[0]!r}? known: {shown}" if close else f"known: {shown}"


def one_line(error: BaseException) -> str:
    """Return what any exception says, in one line; its kind where it says nothing."""
    return " ".join(str(error).split()) or type(error).__name__

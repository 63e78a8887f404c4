"""Pictured: what `--picture` and `--report FILE.html` need of a run, in one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from unicon_core.flow import Block, Stage
from unicon_ros.report.kept import Keeper
from unicon_ros.report.pictures import write_overview
from unicon_ros.report.run_page import RunPage

if TYPE_CHECKING:
    from unicon_core.runtime import Report, Runner
    from unicon_core.workflow import Program


class Pictured:
    """Keeps what is drawn when the run has ended.

    Args:
        picture: path of the PNG, or "".
        page: path of the page, or "".

    Attributes:
        page: of the run, once it is attached; None where none was asked for.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """

    def __init__(self, picture: str | None, page: str | None) -> None:
        self._picture, self._path = picture or "", page or ""
        self._keeper = Keeper("--picture" if self._picture else "--report FILE.html")
        self.page: RunPage | None = None

    def hook(self, program: Program) -> Mapping[Stage, Sequence[Block]]:
        """Return the block that keeps the states."""
        return self._keeper.hook(program)

    def attach(self, runner: Runner) -> None:
        """Get to know the runner, before its first tick."""
        self._keeper.attach(runner)
        if self._path:
            self.page = RunPage(self._path, self._keeper, runner)

    def draw(self, report: Report) -> None:
        """Write the PNG.

        Raises:
            OSError: its folder cannot be made.
            UniconError: it cannot be written.
        """
        title = f"{report.workflow} on {report.robot} ({report.platform})"
        write_overview(self._picture, self._keeper, title)

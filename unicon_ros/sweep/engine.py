"""Engine: takes rows of a sweep and yields what became of each, in whatever order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol

from unicon_ros.sweep.plan import Row


@dataclass(frozen=True)
class Result:
    """What became of a row.

    Attributes:
        index: of the row.
        figures: as of `figures.COLUMNS`.
        facts: hash of a program that was new to its worker, to what it is made of.
        built: programs that this worker has built so far.
        why_not: why one of them has to be built for each row, "" for none.
    """

    index: int
    figures: dict[str, Any]
    facts: dict[str, dict[str, str]] = field(default_factory=dict)
    built: int = 0
    why_not: str = ""


class Engine(Protocol):
    """Runs rows somewhere: `local` and `batch` in processes here, `ray` on a cluster."""

    def run(self, rows: Iterable[Row]) -> Iterator[Result]:
        """Yield the result of each row once.

        A row whose worker dies is tried again, then told as crashed. It ends early where a signal
        asks; what was not yielded by then was not run.

        Raises:
            UniconError: no row can be run here.
        """
        ...

    def close(self) -> None:
        """End whatever it has started."""
        ...

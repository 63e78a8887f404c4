"""Result of `unicon bench faults`: a row for each fault, as JSON, as text and as Markdown."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from unicon_core.errors import UniconError
from unicon_ros.bench.faults.case import Case, Measured
from unicon_ros.bench.faults.judge import judge, reaction
from unicon_ros.bench.report import Bench, machine

__all__ = ["FaultBench", "escaped", "write_table"]

BEGIN, END = "<!-- unicon bench faults: begin -->", "<!-- unicon bench faults: end -->"
_HEAD = ("fault", "commands after", "ticks", "reaction", "status", "reason", "on disk", "holds")


class FaultBench(Bench):
    """Cases are faults; the one ratio is the share of them that hold."""

    def fault(self, case: Case, got: Measured) -> list[str]:
        """Add the row of one case and return what is not as wanted; of several rounds it stays."""
        name, missed = case.row, judge(case.wants, got)
        before: Any = self.cases.get(name, {})
        row: dict[str, Any] = {
            "commands_after": got.commands,
            "ticks": got.ticks,
            "reaction": reaction(case.wants, got, case.topics),
            "damped_ms": _rounded(got.ms),
            "ended_ms": _rounded(got.ended_ms),
            "status": got.status,
            "reason": got.reason,
            "disk": got.disk,
            "longest_gap_ms": _rounded(got.gap_ms),
            "overruns": got.overruns,
            "velocity_zero_ms": _rounded(got.zero_ms),
            "missed": [*before.get("missed", []), *missed],
        }
        row["holds"] = not row["missed"]
        self.cases[name] = row
        return missed

    def conclude(self, order: list[str]) -> None:
        """Put the cases in this order (they end in another) and count those that hold."""
        self.cases = {name: self.cases[name] for name in order}
        held = sum(bool(case["holds"]) for case in self.cases.values())
        self.facts["cases that hold"] = f"{held} of {len(self.cases)}"
        self.ratio("cases_that_hold", held / max(len(self.cases), 1), 1.0, at_least=True)

    def table(self) -> str:
        """Return the rows as text."""
        lines = [f"bench faults: {machine()}", ""]
        width = max(map(len, self.cases), default=0)
        for name, case in self.cases.items():
            cells = _cells(case)
            said = f"after {cells[0]}  ticks {cells[1]}  {cells[2]}  status {cells[3]}"
            lines.append(f"{name:<{width}}  {said}  {_verdict(case)}")
        lines += ["", *(f"{name}  {value}" for name, value in self.facts.items())]
        return "\n".join(lines)

    def markdown(self) -> str:
        """Return the rows as a Markdown table."""
        rows = [_HEAD, ("---",) * len(_HEAD)]
        group = ""
        for name, case in self.cases.items():
            head, _, words = name.partition(": ")
            if head != group:
                group = head
                rows.append((f"**{group}**", *("" for _ in _HEAD[1:])))
            holds = "yes" if case["holds"] else "**no**"
            rows.append((words, *_cells(case), holds))
        return "\n".join(f"| {' | '.join(map(escaped, row))} |" for row in rows)


def write_table(bench: FaultBench, path: Path) -> None:
    """Replace the table in a document, between two comments.

    Raises:
        UniconError: it cannot be read or written, or has no such comments.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise UniconError(f"cannot read {path}: {error.strerror}") from error
    head, begin, rest = text.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not (begin and end):
        raise UniconError(f"{path} has no place for the table; add the lines {BEGIN} and {END}")
    told = f"{machine()}; {bench.facts['cases that hold']} hold."
    table = f"{head}{BEGIN}\n{told}\n\n{bench.markdown()}\n{END}{tail}"
    try:
        path.write_text(table, encoding="utf-8")
    except OSError as error:
        raise UniconError(f"cannot write {path}: {error.strerror}") from error


def _cells(case: Any) -> tuple[str, str, str, str, str, str]:
    return (
        str(case["commands_after"]),
        "" if case["ticks"] is None else str(case["ticks"]),
        case["reaction"],
        "none, killed" if case["status"] is None else str(case["status"]),
        _short(case["reason"]),
        ", ".join(case["disk"]),
    )


def _verdict(case: Any) -> str:
    return "holds" if case["holds"] else f"MISSED: {'; '.join(case['missed'])}"


def _short(text: str, most: int = 80) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"


def escaped(cell: str) -> str:
    """Return a text as a cell of a Markdown table."""
    return cell.replace("|", "\\|").replace("<", "&lt;")


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 1)

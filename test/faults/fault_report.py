"""Result of `unicon bench faults`: a row for each fault, as JSON, as text and as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

from faults.case import Case, Measured
from faults.judge import judge, reaction
from faults.simulated_case import ROBOTS, SimulatedCase
from faults.simulated_run import ROOM, Came
from unicon_ros.bench.report import Bench, machine

Rows: TypeAlias = Mapping[str, Sequence[str]]
"""Cells of each row behind its name, as Markdown."""

_SIMULATED_HEAD = ("fault", "outcome", *ROBOTS, "reason", "holds")
_HEAD = ("fault", "commands after", "ticks", "reaction", "status", "reason", "on disk", "holds")


class FaultBench(Bench):
    """Cases are faults; ratios are the share of them that hold, and how late the latest was found.

    Attributes:
        late: ticks beyond its detection time that the latest reaction in MuJoCo took.
    """

    late = 0

    def simulated(
        self, case: SimulatedCase, robot: str, came: Sequence[tuple[int, Came]]
    ) -> list[str]:
        """Add the row of one case in MuJoCo and return what is not as declared.

        Args:
            robot: `go2` or `g1`.
            came: each tick, with what came of the fault there.
        """
        name = case.name_in(robot)
        before: Any = self.cases.get(name, {})
        reactions = [c.reaction for _, c in came if c.reaction is not None]
        told = dict.fromkeys(f"at tick {at}: {m}" for at, c in came for m in c.missed)
        row: dict[str, Any] = {
            "robot": robot,
            "ticks": [*before.get("ticks", []), *(at for at, _ in came)],
            "outcome": case.outcome,
            "reaction_ticks": max([*reactions, before.get("reaction_ticks") or 0]),
            "detection_ticks": case.detection(robot),
            "reason": next((c.reason for _, c in came if c.reason), ""),
            "missed": [*before.get("missed", []), *told],
        }
        row["holds"] = not row["missed"]
        self.cases[name] = row
        if case.outcome in ("damp", "soft"):
            self.late = max(self.late, row["reaction_ticks"] - case.detection(robot))
        return list(told)

    def fault(self, case: Case, got: Measured) -> list[str]:
        """Add the row of one case and return what is not as wanted; of several runs it stays."""
        name, missed = case.row, judge(case.wants, got)
        before: Any = self.cases.get(name, {})
        row: dict[str, Any] = {
            "robot": case.robot,
            "ticks": [*before.get("ticks", []), case.at],
            "outcome": case.outcome,
            "with": case.marks,
            "declared": {k: v for k, v in vars(case.wants).items() if v not in (None, "", ())},
            "reaction_ticks": got.ticks,
            "commands_after": got.commands,
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
        self.ratio("reaction_beyond_detection", self.late, ROOM)

    def table(self) -> str:
        """Return the rows as text."""
        lines = [f"bench faults: {machine()}", ""]
        width = max(map(len, self.cases), default=0)
        for name, case in self.cases.items():
            if _in_mujoco(case):
                said = f"{case['outcome']}, {case['reaction_ticks']} ticks"
            else:
                cells = _cells(case)
                said = f"after {cells[0]}  ticks {cells[1]}  {cells[2]}  status {cells[3]}"
            lines.append(f"{name:<{width}}  {said}  {_verdict(case)}")
        lines += ["", *(f"{name}  {value}" for name, value in self.facts.items())]
        return "\n".join(lines)

    def markdown(self) -> str:
        """Return two tables of what was run, as Markdown: in MuJoCo, and as processes."""
        cases: dict[str, Any] = self.cases
        processes = {
            name: [*map(_escaped, _cells(case)), _yes(case)]
            for name, case in cases.items()
            if not _in_mujoco(case)
        }
        tables = _table(_SIMULATED_HEAD, self._by_fault()), _table(_HEAD, processes)
        facts = (f"{name}: {value}" for name, value in self.facts.items())
        return "\n\n".join([f"# Faults\n\n{machine()}", *facts, *tables]) + "\n"

    def _by_fault(self) -> Rows:
        """Return the rows of the faults in MuJoCo, both robots in one."""
        robots: dict[str, dict[str, Any]] = {}
        for name, case in self.cases.items():
            if _in_mujoco(case):
                row, _, robot = name.rpartition(", ")
                robots.setdefault(row, {})[robot] = case
        rows = {}
        for row, of in robots.items():
            first = next(iter(of.values()))
            damps = first["outcome"] in ("damp", "soft")
            taken = [
                f"{of[robot]['reaction_ticks']} of {of[robot]['detection_ticks'] + ROOM}"
                if robot in of and damps
                else ""
                for robot in ROBOTS
            ]
            holds = "yes" if all(case["holds"] for case in of.values()) else "**no**"
            rows[row] = [first["outcome"], *taken, _escaped(_short(first["reason"])), holds]
        return rows


def _cells(case: Any) -> tuple[str, str, str, str, str, str]:
    return (
        str(case["commands_after"]),
        "" if case["reaction_ticks"] is None else str(case["reaction_ticks"]),
        case["reaction"],
        "none, killed" if case["status"] is None else str(case["status"]),
        _short(case["reason"]),
        ", ".join(case["disk"]),
    )


def _in_mujoco(case: Any) -> bool:
    return "detection_ticks" in case


def _yes(case: Any) -> str:
    return "yes" if case["holds"] else "**no**"


def _table(head: Sequence[str], rows: Rows) -> str:
    """Return rows as a Markdown table, a line for each group; a name is `group: words`."""
    lines: list[Sequence[str]] = [head, ("---",) * len(head)]
    group = ""
    for name, cells in rows.items():
        of, _, words = name.partition(": ")
        if of != group:
            group = of
            lines.append((f"**{of}**", *("" for _ in head[1:])))
        lines.append((_escaped(words), *cells))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _verdict(case: Any) -> str:
    return "holds" if case["holds"] else f"MISSED: {'; '.join(case['missed'])}"


def _short(text: str, most: int = 80) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"


def _escaped(cell: str) -> str:
    """Return a text as a cell of a Markdown table."""
    return cell.replace("|", "\\|").replace("<", "&lt;")


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 1)

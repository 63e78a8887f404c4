"""`unicon bench diagnose`: what a diagnosis says of records whose fault is known.

`injected.yaml` has 42 kinds of faults with five sizes each; each kind meets each robot and plant
that has it in 15 records of 20 s, and 60 records are healthy. The simulator that a diagnosis
compares with is nominal; where the plant has latency, is another simulator or an emulated robot, a
healthy record of the same plant is the reference. A finding is right if its group holds the cause
and at most two others; it is wrong if it is not and has a probability above 50 %. `cover` is the
share of 95 % intervals of causes in the plant that hold the change.

Rows go to `--rows FILE` as they come, and a run with the same FILE continues it. `--sizes FILE`
finds the sizes of what `--only` selects instead, and writes them like `injected.yaml`.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any

import numpy as np

from benchmarks.injected import HEALTHY, Case, cases, sizes
from benchmarks.injected_records import LATENCY, ladder, made
from unicon_base.errors import Fault, UniconError, cannot
from unicon_core.page import plain, write_file
from unicon_core.signals import SIGNALS
from unicon_lab.diagnose import Cause
from unicon_lab.diagnose.diagnosis import diagnose
from unicon_lab.recording import Record
from unicon_ros.bench.report import Bench
from unicon_ros.cli.console import note

QUICK = 40
MOST_OTHERS = 2
BARS = {
    "first": (0.9, True),
    "top3": (0.98, True),
    "wrong": (0.02, False),
    "healthy_findings": (0.0, False),
    "cover": (0.9, True),
    "cover_at_most": (0.99, False),
}
"""Rate to its bar, and whether it has to reach it."""
Row = dict[str, Any]


def run(
    rounds: int | None = None,
    *,
    quick: bool = False,
    only: str = "",
    rows: str | None = None,
    sizes: str | None = None,
) -> Bench:
    """Make and diagnose the records, or find sizes.

    Args:
        rounds: of no use here.
        quick: 40 records.
        only: those that have it in ROBOT/PLANT/KIND.
        rows: JSON-lines file that a run adds to, and continues.
        sizes: YAML file that the sizes go to.

    Raises:
        UniconError: nothing is selected, or a file cannot be read or written.
    """
    wanted = cases()
    if quick:
        wanted = [wanted[i] for i in np.linspace(0, len(wanted) - 1, QUICK).round().astype(int)]
    wanted = [case for case in wanted if only in case.name]
    if not wanted:
        raise UniconError(
            f"--only {only}: no record is called so; give a part of {cases()[0].name}"
        )
    bench = Bench("diagnose", 1)
    with SIGNALS.guard():
        if sizes:
            find_sizes(Path(sizes), wanted)
        else:
            summarise(bench, diagnosed(wanted, None if rows is None else Path(rows)))
    return bench


def diagnosed(wanted: Sequence[Case], path: Path | None) -> list[Row]:
    """Return the row of each case; those that a file has are not made again.

    Raises:
        UniconError: the file cannot be read or written.
    """
    rows = {} if path is None else _read(path)
    with TemporaryDirectory(prefix="unicon_diagnose_") as folder:
        references: dict[Case, Record] = {}
        for number, case in enumerate(wanted, 1):
            if case.name in rows and rows[case.name]["amount"] == case.amount:
                continue
            SIGNALS.check()
            row = rows[case.name] = _examined(case, Path(folder), references)
            SIGNALS.check()  # an interrupted diagnosis is none
            note(f"{number} of {len(wanted)}: {case.name}: {row['rank'] or row['note']}")
            if path is not None:
                with cannot(f"write {path}", "make room, and run it again"), path.open("a") as file:
                    file.write(json.dumps(plain(row)) + "\n")
    return [rows[case.name] for case in wanted]


def _read(path: Path) -> dict[str, Row]:
    """Return the rows of a file, which is left without a line that was cut off."""
    with cannot(f"read {path}", "name a file of rows, or a new one"):
        there = path.exists() and not path.is_char_device()  # /dev/full never ends
        text = path.read_text(encoding="utf-8") if there else ""
    whole = text[: text.rfind("\n") + 1]
    try:
        rows = {row["case"]: row for row in map(json.loads, whole.splitlines())}
    except (KeyError, TypeError, ValueError) as error:
        raise UniconError(f"{path} holds no rows of this bench; name another file") from error
    write_file(path, whole.encode())
    return rows


def _examined(case: Case, folder: Path, references: dict[Case, Record]) -> Row:
    """Make a record and diagnose it; what cannot be is a note."""
    begin, found, notes = time.perf_counter(), tuple[Cause, ...](), ""
    name, layer, change = "", "", float("nan")
    healthy, reference = replace(case, kind=HEALTHY, size=0, amount=0.0), None
    with TemporaryDirectory(dir=folder) as own:
        try:
            record, name, layer, change = made(case, case.size, Path(own))
            if case.plant != "mujoco" or LATENCY[case.seed]:
                if healthy not in references:
                    there = Path(mkdtemp(dir=folder))  # a record is read as it is asked for
                    references[healthy] = made(healthy, 0, there)[0]
                reference = references[healthy]
            said = diagnose(record, case.name, reference=reference, hung=case.hung)
            found, notes = said.causes, "; ".join(said.notes)
        except (Fault, UniconError) as error:
            notes = str(error)
    return {
        "case": case.name,
        **asdict(case),
        "cause": name,
        "change": change,
        **judged(found, name, layer, change),
        "found": [asdict(replace(cause, shown=None)) for cause in found],
        "note": notes,
        "seconds": time.perf_counter() - begin,
    }


def judged(causes: Sequence[Cause], name: str, layer: str, change: float) -> Row:
    """Judge what a diagnosis found.

    Args:
        causes: in their order.
        name, layer: of the cause; "" of a healthy record.
        change: of the plant, or NaN.

    Returns:
        `rank`, from 1, or None; whether a cause is `wrong`; whether the interval `covers` the
        change, or None.
    """
    rank, covers, wrong = None, None, False
    for place, cause in enumerate(causes, 1):
        group = {cause.name, *cause.alike}
        if cause.layer != layer or name not in group:
            wrong |= cause.probability > 0.5
        elif rank is None and len(group) <= 1 + MOST_OTHERS:
            rank = place
            if cause.name == name and np.isfinite(change):
                covers = cause.low <= change <= cause.high
    return {"rank": rank, "wrong": wrong, "covers": covers}


def summarise(bench: Bench, rows: Sequence[Row]) -> None:
    """Add rates, and a line for each plant, robot and kind."""
    rates = rates_of(rows)
    bench.facts["records"], bench.facts["rates"] = len(rows), rates
    for key in ("plant", "robot", "kind"):
        for word in dict.fromkeys(row[key] for row in rows):
            its = rates_of(row for row in rows if row[key] == word)
            said = (f"{rate} {value:.3g}" for rate, value in its.items() if value == value)
            bench.facts[f"{key} {word}"] = ", ".join(said)
    for rate, (bar, at_least) in BARS.items():
        bench.ratio(rate, rates[rate.removesuffix("_at_most")], bar, at_least=at_least)


def rates_of(rows: Iterable[Row]) -> dict[str, float]:
    """Return the rates of rows, NaN where there are none to count."""
    rows = list(rows)
    faulty = [row for row in rows if row["kind"] != HEALTHY]
    healthy = [row for row in rows if row["kind"] == HEALTHY]
    fits = [row["covers"] for row in rows if row["covers"] is not None]

    def share(said: Iterable[bool]) -> float:
        return float(np.mean([*said] or np.nan))

    return {
        "first": share(row["rank"] == 1 for row in faulty),
        "top3": share((row["rank"] or 4) <= 3 for row in faulty),
        "wrong": share(row["wrong"] for row in faulty),
        "healthy_findings": float(sum(len(row["found"]) for row in healthy)) if healthy else np.nan,
        "cover": share(fits),
        "fits": len(fits),
    }


def find_sizes(path: Path, wanted: Sequence[Case]) -> None:
    """Write the sizes, those of the kinds and robots that are wanted found anew."""
    found = {kind: dict(known) for kind, known in sizes().items()}
    for kind, robot in dict.fromkeys((case.kind, case.robot) for case in wanted):
        SIGNALS.check()
        if robot in found.get(kind, ()):
            found[kind][robot] = ladder(robot, kind)
            note(f"{kind}, {robot}: {found[kind][robot]}")
            lines = [f"{each}: {json.dumps(known)}" for each, known in found.items()]
            text = "\n".join(("# Written by unicon bench diagnose --sizes", *lines, ""))
            write_file(path, text.encode())

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
import os
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

import numpy as np

from benchmarks.injected import HEALTHY, SETUP, SIZES, Case, cases, ladder, made
from unicon_base import AnyDict, Fault, UniconError, cannot
from unicon_core.page import plain, write_file
from unicon_core.signals import SIGNALS
from unicon_lab.diagnose import Cause, Diagnosis
from unicon_lab.diagnose.diagnosis import diagnose, motion_in, searched, simulated
from unicon_lab.diagnose.search import Search
from unicon_ros.bench.report import Bench
from unicon_ros.cli.console import note

Row = AnyDict


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
    wanted = every = cases()
    if quick:
        wanted = [every[i] for i in np.linspace(0, len(every) - 1, 40).round().astype(int)]
    wanted = [case for case in wanted if only in case.name]
    if not wanted:
        raise UniconError(f"--only {only}: no record is called so; give a part of {every[0].name}")
    bench = Bench("diagnose", 1)
    with SIGNALS.guard():
        if sizes:
            find_sizes(Path(sizes), wanted)
        else:
            summarise(bench, diagnosed(wanted, Path(rows or os.devnull)))
    return bench


def diagnosed(wanted: Sequence[Case], path: Path) -> list[Row]:
    """Return the row of each case; those that a file has are not made again.

    A line of the file that was cut off is removed.

    Raises:
        UniconError: the file cannot be read or written.
    """
    with cannot(f"read {path}", "name a file of rows, or a new one"):
        there = path.exists() and not path.is_char_device()  # /dev/full never ends
        text = path.read_text("utf-8") if there else ""
    text = text[: text.rfind("\n") + 1]
    try:
        rows = {row["case"]: row for row in map(json.loads, text.splitlines())}
    except (KeyError, TypeError, ValueError) as error:
        raise UniconError(f"{path} holds no rows of this bench; name another file") from error
    write_file(path, text.encode())
    references: dict[Case, Search] = {}
    with TemporaryDirectory(prefix="unicon_diagnose_") as folder:
        for number, case in enumerate(wanted, 1):
            if case.name in rows and rows[case.name]["amount"] == case.amount:
                continue
            row = rows[case.name] = _examined(case, folder, references)
            SIGNALS.check()  # an interrupted diagnosis is none
            note(f"{number} of {len(wanted)}: {case.name}: {row['rank'] or row['note']}")
            with cannot(f"write {path}", "make room, and run it again"), path.open("a") as file:
                print(json.dumps(plain(row)), file=file)
    return [rows[case.name] for case in wanted]


def _examined(case: Case, folder: str, references: dict[Case, Search]) -> Row:
    """Make a record and diagnose it; what cannot be is a note."""
    begin, name = time.perf_counter(), ""
    healthy, reference = replace(case, kind=HEALTHY, size=0, amount=0.0), None
    with TemporaryDirectory(dir=folder) as own:
        try:
            record, name = made(case, case.size, own)
            if case.plant != "mujoco" or case.seed:  # a record is read as it is asked for
                reference = references.get(healthy) or _searched(healthy, folder)
                references[healthy] = reference
            said = diagnose(record, case.name, reference=reference, hung=case.hung)
        except (Fault, UniconError) as error:
            said = Diagnosis((), (str(error),))
    return {
        "case": case.name,
        **asdict(case),
        "cause": name,
        "change": case.change,
        **judged(said.causes, name, case.change),
        "found": [asdict(replace(cause, shown=None)) for cause in said.causes],
        "note": "; ".join(said.notes),
        "seconds": time.perf_counter() - begin,
    }


def _searched(case: Case, folder: str) -> Search:
    record, _ = made(case, 0, mkdtemp(dir=folder))
    robot, scene = simulated(record, case.name, None)
    motion, scene = motion_in(record, case.name, 0.2, case.hung, robot, scene)
    return searched(motion, robot, scene)


def judged(causes: Sequence[Cause], name: str, change: float) -> Row:
    """Judge what a diagnosis found.

    Args:
        causes: in their order.
        name: of the cause; "" of a healthy record.
        change: of the plant, or NaN of the contract.

    Returns:
        `rank`, from 1, or None; whether a cause is `wrong`; whether the interval `covers` the
        change, or None.
    """
    rank, covers, wrong = None, None, False
    layer = "contract" if np.isnan(change) else "plant"
    for place, cause in enumerate(causes, 1):
        group = {cause.name, *cause.alike}
        if cause.layer != layer or name not in group:
            wrong |= cause.probability > 0.5
        elif rank is None and len(group) <= 3:
            rank = place
            if cause.name == name and layer == "plant":
                covers = cause.low <= change <= cause.high
    return {"rank": rank, "wrong": wrong, "covers": covers}


def summarise(bench: Bench, rows: Sequence[Row]) -> None:
    """Add rates, and a line for each plant, robot and kind."""
    rates = rates_of(rows)
    bench.facts |= {"records": len(rows), "rates": rates}
    for key in ("plant", "robot", "kind"):
        for word in dict.fromkeys(row[key] for row in rows):
            its = rates_of([row for row in rows if row[key] == word])
            said = (f"{rate} {value:.3g}" for rate, value in its.items() if value == value)
            bench.facts[f"{key} {word}"] = ", ".join(said)
    for rate, (bar, at_least) in SETUP["bars"].items():
        bench.ratio(rate, rates[rate.removesuffix("_at_most")], bar, at_least=at_least)


def rates_of(rows: Sequence[Row]) -> dict[str, float]:
    """Return the rates of rows, NaN where there are none to count."""
    faulty = [row for row in rows if row["kind"] != HEALTHY]
    healthy = [len(row["found"]) for row in rows if row["kind"] == HEALTHY]
    shares = {
        "first": [row["rank"] == 1 for row in faulty],
        "top3": [(row["rank"] or 4) <= 3 for row in faulty],
        "wrong": [row["wrong"] for row in faulty],
        "cover": [row["covers"] for row in rows if row["covers"] is not None],
    }
    rates = {rate: float(np.mean(said or np.nan)) for rate, said in shares.items()}
    found = float(sum(healthy)) if healthy else np.nan
    return {**rates, "healthy_findings": found, "fits": len(shares["cover"])}


def find_sizes(path: Path, wanted: Sequence[Case]) -> None:
    """Find the sizes of the kinds and robots that are wanted, and write the table with them."""
    for kind, robot in dict.fromkeys((case.kind, case.robot) for case in wanted):
        if robot in SIZES.get(kind, ()):
            five = SIZES[kind][robot] = ladder(robot, kind)
            SIGNALS.check()
            note(f"{kind}, {robot}: {five}")
            table = {**SIZES, "setup": SETUP}.items()
            write_file(path, "".join(f"{k}: {json.dumps(v)}\n" for k, v in table).encode())

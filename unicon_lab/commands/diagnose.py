"""`unicon diagnose RECORD [WORKFLOW]`: why a robot moves unlike its simulation."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from unicon_base import UniconError
from unicon_core.page import (
    Html,
    answers,
    findings,
    link,
    page,
    plain,
    refuse_existing,
    refuse_unwritable,
    shell,
    table,
    write_file,
    write_json,
)
from unicon_lab.diagnose import MOTIONS
from unicon_ros.cli.console import Console, print_table
from unicon_ros.cli.options import (
    Adder,
    argument,
    command,
    flag,
    listed,
    option,
    positive,
    together,
)

if TYPE_CHECKING:
    from unicon_core.drawing import Panel
    from unicon_lab.diagnose import Diagnosis, Shown
    from unicon_lab.recording import Record


def _diagnose(arguments: argparse.Namespace) -> int:
    """Run the command; exit status 0, whatever is found, 130 after Ctrl-C."""
    from unicon_core.robots import load_robot
    from unicon_core.workflow import load_document
    from unicon_core.workflow.members import load_robot_of
    from unicon_core.workflow.policies import load_policies
    from unicon_lab.diagnose.diagnosis import diagnose
    from unicon_lab.recording import open_record

    if arguments.processes < 0:
        raise UniconError(f"--processes is {arguments.processes}; give 1 or more")
    for file in filter(None, (arguments.json, arguments.html)):
        refuse_unwritable(Path(file))
    if arguments.html:
        from unicon_core.drawing import require

        require("unicon diagnose --html")
    path, contracts = Path(arguments.record), None
    record = open_record(path)
    if arguments.workflow:
        document = load_document(arguments.workflow)
        contracts = [*load_policies(document, load_robot_of(document)).values()]
    console = Console()

    def tell(text: str, share: float | None = None) -> None:
        if share is None:
            console.say(f"diagnose: {text}")
        elif console.due(0.2) and not arguments.quiet:
            console.status({text: f"[{'#' * round(20 * share):20}] {share:.0%}"})

    try:
        found = diagnose(
            record,
            path.name,
            contracts=contracts,
            robot=load_robot(arguments.robot) if arguments.robot else None,
            reference=open_record(arguments.reference) if arguments.reference else None,
            hung=arguments.hung,
            window=arguments.window,
            processes=arguments.processes,
            tell=tell,
        )
    finally:
        console.close()
    _print(path.name, found)
    if arguments.json:
        write_json(Path(arguments.json), plain(asdict(found)), folders=True)
    if arguments.html:
        write_file(
            Path(arguments.html),
            _page(record, path, Path(arguments.html), found).encode(),
            folders=True,
        )
    return 0 if found.complete else 130


_HEADS = ("", "cause", "probability", "change", "95 % interval")


def _page(record: Record, path: Path, out: Path, found: Diagnosis) -> str:
    """Return the page: what was found, each cause with its evidence as a drawing."""
    from unicon_core.drawing import Lines, drawings

    parts = [_answers(record, path, out, found)]
    parts += [table(_HEADS, _rows(found), words=True)] if found.causes else []
    for number, cause in enumerate(found.causes, 1):
        said = [f"{number}. {cause.name}", cause.evidence]
        said += [f"The record does not tell it from {', '.join(cause.alike)}."] * bool(cause.alike)
        parts.append(findings([*said, *[f"Remedy: {cause.remedy}"] * bool(cause.remedy)]))
        if cause.shown is not None:
            picture = {f"cause{number}": (Lines(_evidence), cause.shown.signal, cause.name)}
            parts += [shown for _, shown in drawings(picture, cause.shown)]
    parts += [findings(found.notes)] if found.notes else []
    title = found.causes[0].name if found.causes else "nothing found"
    return page(f"{path.name}: {title}", f"unicon diagnose, {found.windows} windows", parts)


def _answers(record: Record, path: Path, out: Path, found: Diagnosis) -> str:
    from unicon_lab.report import ANSWERING, words

    joint = "none: no cause explains the record better than noise does"
    when = f"at no time of {found.windows} windows from beginning to end"
    if found.causes:
        first = found.causes[0]
        change, interval = first.figures()
        joint = f"{first.where or 'all of the robot'}: {first.name}, {first.probability:.0%}"
        joint += f", {change} (95 %: {interval})" * bool(change)
        when = "from beginning to end: the contract differs"
        if first.shown:
            time = first.shown.time
            when = f"{first.shown.signal} shows it from {time[0]:.2f} to {time[-1]:.2f} s"
    there = [name for name in ANSWERING if name in record.layout.slots]
    states = {name: record.states(name)[record.ended] for name in there}
    where = Html(f"{link(path, out.parent)} {shell(f'unicon view {quote(str(path))}')}")
    return answers(joint, when, *words(states, record.period), where)


def _evidence(shown: Shown) -> Iterator[Panel]:
    import numpy as np

    from unicon_core.drawing import INK, MARK, PALE, Curve, Panel

    sides = (
        ("record", INK, shown.record, ()),
        ("without the cause", PALE, shown.without, (6, 3)),
        ("with the cause", MARK, shown.with_it, ()),
    )
    time = np.array(shown.time)
    yield Panel("", shown.unit, [Curve(a, b, time, np.array(y), dash) for a, b, y, dash in sides])


def _print(name: str, found: Diagnosis) -> None:
    if not found.causes:
        ended = "explains more of the record than noise does" if found.complete else "is known yet"
        print(f"nothing found: no cause {ended} ({found.windows} windows)")
    else:
        print_table([_HEADS, *_rows(found)], underlined=True)
    for number, cause in enumerate(found.causes, 1):
        print(f"{number}. {cause.evidence}")
        if cause.alike:
            print(f"   the record does not tell it from: {', '.join(cause.alike)}")
            print(f"   to tell them apart, record {_motion(cause.next, name)}")
        if cause.remedy:
            print(f"   remedy: {cause.remedy}")
    for text in found.notes:
        print(f"note: {text}")
    if found.next:
        print(f"next, record {_motion(found.next, name)}")


def _motion(text: str, name: str) -> str:
    """Return what to record, with the command that writes its workflow."""
    wanted = f"a {text}: unicon excite {name} --kind {text} --out {text}.yaml"
    return wanted if text in MOTIONS else text


def _rows(found: Diagnosis) -> list[tuple[str, ...]]:
    return [
        (str(number), cause.name, f"{cause.probability:.0%}", *cause.figures())
        for number, cause in enumerate(found.causes, 1)
    ]


def _excite(arguments: argparse.Namespace) -> int:
    """Write the workflow, and print its first lines, which say how to run it; exit status 0."""
    from unicon_lab.diagnose.diagnosis import experiment_text

    out = Path(arguments.out)
    if out.suffix != ".yaml":
        raise UniconError(f"excite: {out} is not a .yaml file; give --out NAME.yaml")
    refuse_existing(out, "excite: ")
    text = experiment_text(arguments.subject, arguments.kind, arguments.out, arguments.joints)
    write_file(out, text.encode())
    print(text.partition("\n\n")[0])
    return 0


def replays(window: str) -> Sequence[Adder]:
    """Return what adds the options of replays, the one for their time under a name."""
    return (
        argument(window, "S", "of a replay (default: 0.2)", type=positive, default=0.2),
        flag("--hung", "the robot hung in the air, or its base was fixed"),
        argument("--robot", "ROBOT", "its file (default: the record's)"),
        argument("--processes", "N", "at once (default: one for each core)", type=int, default=0),
    )


add = together(
    command(
        "diagnose",
        _diagnose,
        "say why a robot moves unlike its simulation",
        __doc__,
        argument("record", "RECORD", "record (.mcap) of the robot"),
        argument(
            "workflow",
            "WORKFLOW",
            "whose contract should have made it (default: its own)",
            nargs="?",
        ),
        argument(
            "--reference",
            "RECORD",
            "of the same robot without the trouble: what both lack is no cause",
        ),
        *replays("--window"),
        argument("--json", "FILE", "write causes and notes as JSON"),
        argument("--html", "FILE", "write a page with the evidence drawn"),
    ),
    command(
        "excite",
        _excite,
        "write a workflow whose motion tells causes apart",
        "A workflow whose motion tells causes apart that a record does not.",
        argument("subject", "ROBOT|RECORD", "a robot, or a record (.mcap) of one"),
        option("--kind", choices=MOTIONS, default="wiggle"),
        argument("--joints", "PATTERNS", "that move, separated by commas", type=listed, default=""),
        argument("--out", "FILE.yaml", "the workflow", required=True),
    ),
)

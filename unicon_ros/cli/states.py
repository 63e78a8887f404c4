"""`unicon states [NAME]`: looks at the states that running processes share, and costs them
nothing: it only reads. `unicon states --header FILE.h WORKFLOW` tells a program in C of them."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from unicon_base import AnyDict, StateError
from unicon_core.page import write_json
from unicon_core.text_table import number_text
from unicon_ros.cli.console import print_table
from unicon_ros.cli.options import OVERRIDES, argument, command, flag, positive

if TYPE_CHECKING:
    from unicon_base.arrays import Array
    from unicon_core.states.backends.shm import Segment
    from unicon_core.states.groups import Groups
    from unicon_core.workflow import Program

LOOK = 0.5
"""Time in [s] over which rates are counted."""

RATE = 10.0
"""Looks of `--watch` in [Hz] where none are asked for."""

OF_WATCH = ("rate", "duration", "csv")
"""Options that go with `--watch` alone."""

HEAD = ("name", "process", "size", "group", "states", "bytes", "rate", "age")


def states(arguments: argparse.Namespace) -> int:
    """Run the command."""
    if arguments.header or arguments.part or arguments.overrides:
        return _header(arguments)
    _refuse_wrong_use(arguments)
    if arguments.clean:
        return _clean()
    if arguments.watch:
        from unicon_ros.cli.watch import watch

        rate = arguments.rate or RATE
        return watch(arguments.name, arguments.watch, rate, arguments.duration, arguments.csv)
    if arguments.name:
        return _show(arguments.name)
    return _list(arguments.json)


def _refuse_wrong_use(arguments: argparse.Namespace) -> None:
    if arguments.watch and not arguments.name:
        raise StateError(
            f"states: --watch goes with a name: unicon states NAME --watch {arguments.watch[0]}; "
            f"there are: {_names()}"
        )
    for option in OF_WATCH:
        if getattr(arguments, option) and not arguments.watch:
            raise StateError(
                f"states: --{option} goes with --watch: unicon states NAME --watch STATE --{option}"
            )
    if arguments.json and (arguments.name or arguments.clean):
        raise StateError("states: --json writes the list: unicon states --json FILE")
    if arguments.clean and arguments.name:
        raise StateError(
            "states: --clean removes whatever writers that died have left, and takes no name: "
            "unicon states --clean"
        )


def _names() -> str:
    from unicon_core.states.backends.shm import segments

    return ", ".join(found.name for found in segments()) or "none"


# -- the list ------------------------------------------------------------------------------------


def _list(file: str | None) -> int:
    found = look()
    if file:
        write_json(Path(file), found)
    rows = [HEAD]
    for segment in found:
        process = f"{segment['pid'] or '?'}" + ("" if segment["alive"] else " (dead)")
        head = (segment["name"], process, f"{segment['size']} B")
        for name, group in segment["groups"].items() or [("-", None)]:
            rows.append((*head, name, *(_group_cells(group) if group else ("-",) * 4)))
            head = ("", "", "")
    if len(rows) == 1:
        print("no process of this user shares its states (a workflow does with store: shm)")
        return 0
    print_table(rows, right=(2, 4, 5, 6, 7))
    wrong = [segment["error"] for segment in found if segment["error"]]
    dead = [segment["name"] for segment in found if not segment["alive"] and not segment["error"]]
    if dead:
        wrong.append(f"left by writers that died: {', '.join(dead)}; unicon states --clean")
    if wrong:
        print("", *wrong, sep="\n")
    return 0


def look(seconds: float = LOOK) -> list[AnyDict]:
    """Return this user's segments as plain values.

    Args:
        seconds: over which rates are counted, [s].

    Returns:
        For each `name`, `alive`, `pid` of its writer (0: not known), `size` in [B], `hash`,
        `error` in words or None, and `groups`, each with number of `states`, `bytes`, `number` of
        the newest value, its `age` in [s] and `rate` in [Hz], both None where there is none.
    """
    from unicon_core.states.backends.shm import Segment, segments

    listed: list[AnyDict] = []
    facts: AnyDict
    opened: list[Segment | None] = []
    for found in segments():
        facts = {"name": found.name, "alive": found.alive, "pid": 0, "size": found.size}
        listed.append({**facts, "hash": "", "error": None, "groups": {}})
        try:
            opened.append(Segment.attach(found.name, read_only=True))
        except StateError as error:
            opened.append(None)
            listed[-1]["error"] = str(error)
    before = [_newest(segment) if segment else {} for segment in opened]
    if any(facts["alive"] for facts in listed):
        time.sleep(seconds)
    for facts, segment, then in zip(listed, opened, before):
        if segment is None:
            continue
        facts["pid"], facts["hash"] = segment.pid, segment.hash
        for name, (number, stamp) in _newest(segment).items():
            layout = segment.groups[name]
            came, passed = number - then[name][0], stamp - then[name][1]
            rate = came * 1e9 / passed if came and passed else 0.0
            facts["groups"][name] = {
                "states": len(layout.specs),
                "bytes": layout.nbytes,
                "number": number,
                "age": (time.monotonic_ns() - stamp) * 1e-9 if number else None,
                "rate": rate if facts["alive"] and number else None,
            }
        segment.close()
    return listed


def _newest(segment: Segment) -> dict[str, tuple[int, int]]:
    return {name: segment.latest(name) for name in segment.groups}


def _group_cells(group: AnyDict) -> tuple[str, ...]:
    rate = "-" if group["rate"] is None else f"{group['rate']:.1f} Hz"
    return (str(group["states"]), str(group["bytes"]), rate, _age(group["age"]))


def _age(age: float | None) -> str:
    if age is None:
        return "no value"
    return f"{age * 1e3:.1f} ms" if age < 1.0 else f"{age:.1f} s"


# -- one in full ---------------------------------------------------------------------------------


def _show(name: str) -> int:
    from unicon_core.show.text import SPEC_HEAD, spec_cells
    from unicon_core.states import States
    from unicon_core.states.backends.shm import Segment, ShmWatcher

    segment = Segment.attach(name, read_only=True)
    print(f"{name}: {segment.memory.nbytes} B of process {segment.pid}")
    if not segment.alive():
        print("its writer has died, and these are its last values; unicon states --clean")
    for group, layout in segment.groups.items():
        values = States(layout)
        watcher = ShmWatcher(name, group, values, layout)
        taken = watcher.take()
        age = (time.monotonic_ns() - watcher.stamp_ns) * 1e-9
        told = f"value {watcher.number}, {_age(age)} old" if taken else "no value yet"
        print(f"\ngroup {group}: {layout.nbytes} B, {told}")
        rows: list[tuple[str, ...]] = [(*SPEC_HEAD, "value")]
        for state in layout.specs:
            value = summary(values[state]) if taken else "-"
            rows.append((*spec_cells(layout, state), value))
        print_table(rows, underlined=True)
        watcher.close()
    segment.close()
    return 0


def summary(value: Array) -> str:
    """Return the present value of a state in short: few numbers in full, else their range."""
    import numpy as np

    flat = value.reshape(-1)
    if flat.size <= 4:
        return " ".join(number_text(x) for x in flat.tolist())
    if flat.dtype == bool:
        return f"{int(flat.sum())} of {flat.size} true"
    unknown = np.isnan(flat)
    lost = f", {int(unknown.sum())} NaN" if unknown.any() else ""
    if unknown.all():
        return lost.removeprefix(", ")
    known = flat[~unknown]
    least, most = number_text(known.min().item()), number_text(known.max().item())
    return (f"all {least}" if least == most else f"{least} … {most}") + lost


# -- leftovers -----------------------------------------------------------------------------------


def _clean() -> int:
    from unicon_core.handles import clean_frames
    from unicon_core.states.backends.shm import Segment, clean, segments

    for name in (removed := clean() + clean_frames()):
        print(f"removed {name}")
    left = 0
    for found in segments():
        if not found.alive:
            left += 1
            try:
                Segment.attach(found.name, read_only=True).close()
            except StateError as error:
                print(f"left {found.name}: {error}")
    if not removed and not left:
        print("no writer that died has left anything")
    return 0


# -- the header of C ----------------------------------------------------------------------------


def _header(arguments: argparse.Namespace) -> int:
    """Write the groups of a workflow's states for C and C++."""
    from unicon_core.states.c_header import write_header
    from unicon_core.workflow import Program, load_document

    other = any(getattr(arguments, name) for name in ("watch", *OF_WATCH, "json", "clean"))
    if not arguments.header or not arguments.name or other:
        raise StateError(
            "states: --header takes a workflow, --part and --set, and they go with it alone: "
            "unicon states --header FILE.h WORKFLOW"
        )
    program = Program(load_document(arguments.name, arguments.overrides), dry=True)
    try:
        groups = _published(program, arguments.part)
    finally:
        program.close()
    part = f", part {arguments.part}" if arguments.part else ""
    write_header(arguments.header, groups, arguments.name + part)
    print(arguments.header)
    return 0


def _published(program: Program, part: str) -> Groups:
    """Return what a run of the program publishes in one segment."""
    from unicon_core.states.groups import groups_of

    layout, parts = program.states.layout, program.parts
    if parts is not None and part in parts.parts:
        return parts.groups(part, layout)
    if parts is not None:
        raise StateError(
            f"states: {f'no part {part!r}' if part else 'each part publishes its own states'}; "
            f"give --part {' or --part '.join(parts.parts)}"
        )
    if part:
        raise StateError(f"states: --part {part}: the workflow has no parts; leave it out")
    return groups_of(layout)


add = command(
    "states",
    states,
    "look at the states that running processes share",
    __doc__,
    argument("name", "NAME", "show its states; all are listed", nargs="?"),
    argument("--watch", "STATE", "follow these states of NAME", nargs="+"),
    argument("--rate", "HZ", f"of --watch: looks a second ({RATE:g})", type=positive),
    argument("--duration", "S", "of --watch: end after S seconds", type=positive),
    flag("--csv", "of --watch: print CSV, in full precision"),
    argument("--json", "FILE", "write the list as JSON"),
    flag("--clean", "remove what writers that died have left"),
    argument("--header", "FILE.h", "write the states of workflow NAME as a header of C"),
    argument("--part", "PART", "of --header: one part's states", default=""),
    OVERRIDES,
)

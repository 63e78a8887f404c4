"""`unicon states NAME --watch STATE`: follows states of a running process, and only reads."""

from __future__ import annotations

import csv
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence

from unicon_base import StateError, alternatives
from unicon_core.signals import SIGNALS
from unicon_core.states import Layout, States
from unicon_core.states.backends.shm import Segment, ShmWatcher, segment_path
from unicon_core.text_table import number_text
from unicon_ros.cli.console import note

SILENCE = 1.0
"""Time in [s] without a new value after which a living writer is said to be silent."""


def watch(
    name: str, chosen: Sequence[str], rate: float, duration: float | None, as_csv: bool
) -> int:
    """Print states of a segment until Ctrl-C, the end of its writer, or the end of a time.

    Args:
        name: of the segment.
        chosen: names of the states.
        rate: looks in [Hz]; a value that has been printed is not printed again.
        duration: in [s], or None.
        as_csv: in place of text for people.

    Raises:
        StateError: no such segment or state, or a new writer has other states.
    """
    layouts = _layouts(name, chosen)
    watched = {group: _Watched(name, group, layout) for group, layout in layouts.items()}
    owner = {
        state: each
        for state in chosen
        for each in watched.values()
        if state in each.states.layout.specs
    }
    print_values = _csv(watched, owner) if as_csv else _text(owner)
    end = None if duration is None else time.monotonic() + duration
    heard, told, writer = time.monotonic(), False, _writer(watched)
    with SIGNALS.guard():
        for now in _looks(rate, end):
            # Asked before its last value is taken, so that this one is not lost.
            alive = [each.alive() for each in watched.values()]
            if writer != (writer := _writer(watched)):
                note(f"unicon: {name}: process {writer} has taken over")
            if sum(each.take() for each in watched.values()):  # all of them take
                print_values()
                sys.stdout.flush()
                heard, told = now, False
            if not all(alive):
                died = os.path.lexists(segment_path(name))
                how = "has died; unicon states --clean removes the rest" if died else "has ended"
                note(f"unicon: {name}: process {writer} {how}")
                break
            if now - heard > SILENCE and not told:
                note(f"unicon: {name}: no new value for {SILENCE:g} s; process {writer} lives")
                told = True
    for each in watched.values():
        each.close()
    return 0


def _layouts(name: str, chosen: Sequence[str]) -> dict[str, Layout]:
    """Return the groups in which the chosen states are."""
    segment = Segment.attach(name, read_only=True)
    segment.close()
    home = {state: group for group, layout in segment.groups.items() for state in layout.specs}
    for state in chosen:
        if state not in home:
            raise StateError(
                f"segment {name!r} has no state {state!r}; {alternatives(state, home)}"
            )
    wanted = {home[state] for state in chosen}
    return {group: layout for group, layout in segment.groups.items() if group in wanted}


class _Watched(ShmWatcher):
    """A group of which states are watched, with these."""

    def __init__(self, name: str, group: str, layout: Layout) -> None:
        self.states = States(layout)
        super().__init__(name, group, self.states, layout)


def _writer(watched: Mapping[str, _Watched]) -> int:
    return next(iter(watched.values())).pid


def _looks(rate: float, end: float | None) -> Iterator[float]:
    """Yield the time in [s] at absolute deadlines, until a signal or the end."""
    period, due = 1.0 / rate, time.monotonic()
    while not SIGNALS.asked:
        now = time.monotonic()
        if end is not None and now >= end:
            return
        if now < due:
            time.sleep(min(due - now, 0.05))  # so that a signal is heard soon
            continue
        yield now
        due = max(due + period, now)  # who was stopped does not make up for it


def _csv(watched: Mapping[str, _Watched], owner: Mapping[str, _Watched]) -> Callable[[], None]:
    """Print the head of CSV; return what prints a line of values, in full precision.

    They are when each group was published in [ns], then every element.
    """
    write = csv.writer(sys.stdout, lineterminator="\n").writerow
    columns = [f"{group}.stamp_ns" for group in watched]
    for state, each in owner.items():
        columns += each.states.layout.elements(state)
    write(columns)
    views = [each.states[state] for state, each in owner.items()]

    def values() -> None:
        row = [each.stamp_ns for each in watched.values()]
        for view in views:
            row += (view.view("uint8") if view.dtype == bool else view).reshape(-1).tolist()
        write(row)

    return values


def _text(owner: Mapping[str, _Watched]) -> Callable[[], None]:
    """Print what the states are; return what prints a line for each, behind the time in [s]."""
    for state, each in owner.items():
        spec = each.states.spec(state)
        unit = f" [{spec.unit}]" if spec.unit else ""
        print(f"{state}{unit}: {', '.join(spec.names) or spec.description or 'no names'}")
    first_ns, width = 0, max(map(len, owner))

    def values() -> None:
        nonlocal first_ns
        newest = max(each.stamp_ns for each in owner.values())
        first_ns = first_ns or newest
        time_text = f"{(newest - first_ns) * 1e-9:9.3f}"
        for state, each in owner.items():
            flat = each.states[state].reshape(-1).tolist()
            numbers = " ".join(f"{number_text(x):>9}" for x in flat)
            print(f"{time_text}  {state:<{width}}  {numbers}")
            time_text = " " * len(time_text)

    return values

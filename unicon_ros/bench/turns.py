"""Turns: many loops that live at once and are measured one after the other, round after round."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from functools import partial

from unicon_core.signals import SIGNALS, Interrupted
from unicon_ros.bench.loops import Loop, breathe
from unicon_ros.cli.console import CLEAR, is_terminal


def take_turns(
    makers: Mapping[str, Callable[[], Loop]], rounds: int, seconds: float
) -> tuple[int, dict[str, Loop]]:
    """Let loops take their turns; Ctrl-C ends it with the rounds that are whole.

    Call it within `SIGNALS.guard()`.

    Args:
        makers: name of each loop to what makes it.
        rounds: how many turns each has.
        seconds: measured time of one turn.

    Returns:
        How many rounds are whole, and the loops, which have ended.

    Raises:
        UniconError: a loop does not start, or a process of it has ended.
    """
    loops: dict[str, Loop] = {}
    whole = 0
    try:
        for i, (name, make) in enumerate(makers.items()):
            SIGNALS.check()
            _say(f"start: {i + 1} of {len(makers)}, {name}")
            held = list(loops.values())
            loops[name] = loop = make()
            loop.start(meanwhile=partial(breathe, held))
            breathe(held)
        for number in range(rounds):
            label = f"round {number + 1} of {rounds}"
            if not is_terminal():
                _say(label)
            for i, (name, loop) in enumerate(loops.items()):
                SIGNALS.check()
                if is_terminal():
                    _say(f"{label}: {i + 1} of {len(makers)}, {name}")
                loop.run(seconds)
            whole += 1
    except Interrupted:
        _say(f"stopped; {whole} whole rounds are kept")
    finally:
        for loop in loops.values():
            loop.end()
        for loop in loops.values():
            loop.close()
        if is_terminal():
            _say("")
    return whole, loops


def _say(text: str) -> None:
    """Tell how far it is: in one line of a terminal, else a line each."""
    begin, end = (CLEAR, "") if is_terminal() else ("", "\n")
    print(f"{begin}{text}", end=end, file=sys.stderr, flush=True)

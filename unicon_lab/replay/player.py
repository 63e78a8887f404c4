"""Player: a record's states go to ROS topics, with `/clock`, as they were; nothing is computed.

A program whose platform writes all recorded states of a tick and whose flow does nothing, so that
bridge, services and frames are those of any run.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from unicon_base import AnyDict, TextSink, UniconError
from unicon_core.blocks.controls.device import read_keys, take_terminal
from unicon_core.flow import Block
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.states.standard import HARDWARE_STATES, standard_states
from unicon_core.workflow import Program
from unicon_lab.recording import Record, open_record
from unicon_lab.replay.platform import TARGET, ReplayPlatform
from unicon_lab.replay.workflow import robot_of
from unicon_ros.bridge.services import Controls

if TYPE_CHECKING:
    from unicon_ros.bridge import RosSession

HELP = "space: pause or go on, → ←: 5 s on or back, s: one tick, r: from the beginning, q: end"
RIGHT, LEFT = b"\x1b[C", b"\x1b[D"
LOOK = 0.2
"""How long a key is waited for before the end is looked for, in [s]."""


def press(controls: Controls, seek: Callable[[int], object], ticks: int, pressed: bytes) -> None:
    """Do what a key says.

    Args:
        controls: of the run.
        seek: goes on by so many ticks.
        ticks: of an arrow.
        pressed: as the terminal sends it.
    """
    if pressed in (RIGHT, LEFT):
        seek(ticks if pressed == RIGHT else -ticks)
        pressed = b"s" if controls.paused else b""
    pause = controls.start if controls.paused else controls.pause
    does = {b" ": pause, b"s": controls.step, b"r": controls.reset, b"q": controls.stop}
    if pressed in does:
        does[pressed]()


@contextmanager
def _keys(take: Callable[[bytes], None]) -> Iterator[None]:
    """Let a thread take keys; the terminal is then as it was."""
    over = threading.Event()

    def read() -> None:
        while not over.is_set():
            pressed = read_keys(LOOK)
            if pressed is None:  # the terminal has gone
                return
            take(pressed)

    thread = threading.Thread(target=read, name="keys", daemon=True)
    give_back = take_terminal()
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        give_back()


SEEK = 5.0
"""By an arrow, of the record's time in [s]."""


def play(
    path: str | Path,
    *,
    rate: float = 1.0,
    loop: bool = False,
    start: float = 0.0,
    duration: float | None = None,
    session: RosSession | None = None,
    keys: bool = False,
    warn: TextSink = print,
    status: Callable[[AnyDict], None] | None = None,
) -> Report:
    """Play a record to its end.

    Args:
        path: of a recording or fault record: a file or a folder.
        rate: how many times faster than it was.
        loop: begin anew at its end.
        start: how much is left out at its beginning, in [s].
        duration: end after this time in [s]; None: with the record.
        session: of ROS, which is told of the run; it hears no topics. Not closed.
        keys: a terminal is there: space pauses, arrows seek.
        warn: takes warnings, one line each.
        status: called about once a second.

    Raises:
        UniconError: it cannot be read, or its robot is not known.
    """
    record = open_record(path)
    hooks = []
    if session is not None:
        session.map = replace(session.map, subscribe=())  # the record alone says what is
        hooks.append(session.hook)
    described = _described(record, Path(path).absolute(), rate, {"loop": loop, "start": start})
    program = Program(None, hooks=hooks, **described)
    try:
        platform = program.platform
        assert isinstance(platform, ReplayPlatform)
        options = RunOptions(duration=duration, warn=warn, status=status)
        runner = Runner(program, options)
        if session is not None:
            session.attach(runner)
            controls = session.controls
        else:
            controls = Controls(time.sleep)
            controls.runner = runner
        take = partial(press, controls, platform.seek, round(SEEK / record.period))
        with _keys(take) if keys else nullcontext():
            return runner.run()
    finally:
        program.close()


def _described(record: Record, path: Path, rate: float, options: AnyDict) -> AnyDict:
    """Return the keys of the program that plays a record."""
    layout, robot = record.layout, robot_of(record)
    if "joint_pos" not in layout.specs:
        raise UniconError(f"{path.name} has no joint_pos: no robot can be shown")
    standard = standard_states(layout.specs["joint_pos"].names)
    own = [n for n in layout.specs if n not in standard and n not in HARDWARE_STATES]
    options |= {
        "bag": str(path),
        "moment": "sent",
        "also": [name for name in layout.specs if name != "tick"],
        "each": True,
        "driven": False,
    }
    return {
        "name": f"play_{record.facts.get('workflow') or path.stem}",
        "robot": robot,
        "platform": TARGET,
        "platforms": {TARGET: options},
        "rate": rate / record.period,
        "pacing": {"overrun": "catch_up"},
        "num_robots": layout.num_robots,
        "states": {name: layout.specs[name].to_dict() for name in own},
        "flow": Block("nothing", bool, endless=True),
        "safety": "none",  # recorded commands go nowhere, and there may be none
    }

"""`unicon view BAG`: a recording in the live page, with a time slider; or in Foxglove.

`unicon video RECORD FILE` makes a video of it.
"""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from unicon_base import UniconError, alternatives
from unicon_core.page import refuse_unwritable
from unicon_core.signals import SIGNALS, Interrupted
from unicon_lab.run_options import VIEW_OPTIONS, view_options
from unicon_lab.view import SINKS
from unicon_ros.cli.console import Console, note
from unicon_ros.cli.options import (
    REPEATED,
    argument,
    command,
    flag,
    option,
    positive,
    seconds,
    together,
    whole,
)

EVERY = 0.2
"""Of the progress line in [s]."""


def _view(arguments: argparse.Namespace) -> int:
    """Run the command until Ctrl-C; exit status 0."""
    from unicon_lab.recording import open_record
    from unicon_lab.view.process import INTERVAL, sink_class
    from unicon_lab.view.recorded import RecordedSource, shown_in
    from unicon_lab.view.source import Remote

    record = open_record(arguments.path)
    shown, notes = shown_in(record)
    source = RecordedSource(record, shown, notes)
    source.speed = arguments.speed
    options = view_options(vars(arguments), arguments.sink)
    sink = sink_class(arguments.sink)(shown, source, Remote(None), options)
    try:
        for line in notes:
            note(f"unicon view: {line}")
        seconds = source.span[1]
        ticks = f"{len(record.ticks):,} ticks, {seconds:.2f} s"
        print(f"{shown.workflow} on {shown.robot.name} ({shown.platform}): {ticks}")
        print(f"view: {sink.address} (Ctrl-C ends)", flush=True)
        with SIGNALS.guard():
            due = time.monotonic()
            while not SIGNALS.asked:
                if arguments.sink != "page":
                    source.play_on()
                sink.poll()
                due = max(due + INTERVAL, time.monotonic())
                time.sleep(max(due - time.monotonic(), 0.002))
    finally:
        sink.close()
    return 0


FPS = whole("a number of frames a second", 1, 120)


def _size(text: str) -> tuple[int, int]:
    """Return width and height, [pixels]; video codecs take even numbers alone."""
    found = re.fullmatch(r"(\d{2,4})x(\d{2,4})", text)
    size = (int(found[1]), int(found[2])) if found else (0, 0)
    if not all(64 <= side <= 4096 and side % 2 == 0 for side in size):
        raise argparse.ArgumentTypeError(f"{text} is no size; give even numbers like 640x480")
    return size


def _video(arguments: argparse.Namespace) -> int:
    """Write a video; exit status 0."""
    from unicon_lab.recording import open_record
    from unicon_lab.view.video import CODECS, MOST, Film, write_video

    path, begin = arguments.out, arguments.begin
    if (ending := path.suffix.lower()) not in CODECS:
        raise UniconError(f"cannot write {path}: unknown ending; {alternatives(ending, CODECS)}")
    refuse_unwritable(path)
    record = open_record(arguments.record)
    if path.exists() and path.samefile(arguments.record):
        raise UniconError(f"{path} is the record, which a video would replace; give another name")
    film = Film(record, arguments.size, arguments.ghost, arguments.plot)
    end = min(film.end if arguments.end is None else arguments.end, film.end)
    if not begin < end:
        raise UniconError(
            f"--from {begin:g} is not before {end:.3g}, where the video ends; the record has "
            f"{film.end:.3g} s"
        )
    step = arguments.speed / arguments.fps
    if (end - begin) / step > MOST:
        raise UniconError(
            f"more than {MOST} frames; give --from and --to, a lower --fps or a higher --speed"
        )
    for line in film.notes:
        note(f"unicon video: {line}")
    whole, console = int((end - begin) / step + 1e-6) + 1, Console()

    def shown() -> Iterator[Any]:
        for done, frame in enumerate(film.frames(begin, end, step)):
            if console.due(EVERY):
                console.status({f"{path}": f"{done} of {whole} frames"})
            yield frame

    try:
        with SIGNALS.guard():
            count = write_video(path, shown(), arguments.fps)
    except Interrupted:
        console.close()
        note(f"unicon video: stopped: {path} was not written")
        raise
    finally:
        console.close()
    print(f"{path}: {count} frames, {count / arguments.fps:.2f} s")
    return 0


add = together(
    command(
        "view",
        _view,
        "look at a recording",
        __doc__,
        argument("path", "BAG", "a recording, or a fault record", type=Path),
        option(
            "--in",
            dest="sink",
            choices=tuple(SINKS),
            default="page",
            help="where: a page in the browser (default) or Foxglove",
        ),
        option(
            "--speed",
            type=positive,
            default=1.0,
            help="of playing, where no slider is (default: 1)",
        ),
        *VIEW_OPTIONS,
    ),
    command(
        "video",
        _video,
        "make a video of a recording",
        "Draw a recording offscreen: the robot on its ground, plots and the time.",
        argument("record", "RECORD", "a recording, or a fault record", type=Path),
        argument("out", "FILE", ".mp4, .webm, .webp or .gif", type=Path),
        flag("--ghost", "show the targets of the joints as a transparent robot"),
        argument(
            "--plot",
            "STATE[:ELEMENT]",
            "plot a state below, or one element with its target, such as joint_pos:FL_hip_joint "
            "(repeatable)",
            **REPEATED,
        ),
        argument(
            "--from", "S", "begin S s after the first tick", type=seconds, dest="begin", default=0.0
        ),
        argument("--to", "S", "end S s after the first tick", type=seconds, dest="end"),
        argument("--speed", "X", "show it X times faster (default: 1)", type=positive, default=1.0),
        argument("--size", "WxH", "in pixels (default: 640x480)", type=_size, default=(640, 480)),
        argument("--fps", "N", "frames a second (default: 25)", type=FPS, default=25),
    ),
)

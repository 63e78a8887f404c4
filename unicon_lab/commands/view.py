"""`unicon view BAG`: a recording in the live page, with a time slider; or in Foxglove."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from unicon_core.signals import SIGNALS
from unicon_lab.run_options import VIEW_OPTIONS, view_options
from unicon_lab.view import SINKS
from unicon_ros.cli.console import note
from unicon_ros.cli.options import argument, command, option, positive

INTERVAL = 1.0 / 60.0
"""How often a sink looks, in [s]."""


def _view(arguments: argparse.Namespace) -> int:
    """Run the command until Ctrl-C; exit status 0."""
    from unicon_lab.recording import open_record
    from unicon_lab.view.process import sink_class
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


add = command(
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
        "--speed", type=positive, default=1.0, help="of playing, where no slider is (default: 1)"
    ),
    *VIEW_OPTIONS,
)

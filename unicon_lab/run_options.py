"""What the lab adds to a run: `--record`, `--picture`, `--view`, `--metrics`, …"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unicon_base import AnyDict, AnyMapping, UniconError
from unicon_core.page import refuse_unwritable
from unicon_lab.view import LOCAL, PORT, SINKS
from unicon_ros.attachments import Asked, Attachment
from unicon_ros.cli.options import argument, flag, option, port, positive, whole

if TYPE_CHECKING:
    from unicon_core.workflow import HookBlocks, Program

VIEW_OPTIONS = (
    argument("--view-host", "HOST", "where the viewer is served", default=LOCAL),
    argument(
        "--view-port",
        "PORT",
        f"its port (default {PORT}, or the next free one)",
        type=port,
        default=PORT,
    ),
    argument("--view-token", "TOKEN", "what others have to know, for --view-host", default=""),
    argument("--view-layout", "FILE.json", "write a layout for Foxglove's import", default=""),
    argument("--view-fps", "N", "pictures per second at most", type=positive, default=30.0),
)
"""Where and how a viewer is served."""

OPTIONS = (
    argument(
        "--record",
        "FILE.mcap|FOLDER/",
        "record every state of every tick, and the messages of the map",
    ),
    argument(
        "--record-split",
        "1GB|60s",
        "record to a bag folder whose files are that large or long, or both: 1GB,10min",
        default="",
    ),
    argument(
        "--record-frames",
        "all|NAME,…",
        "record pictures and clouds too: of all cameras and scanners, or of these handles",
        default="",
    ),
    argument(
        "--record-jpeg",
        "QUALITY",
        "record raw pictures as JPEG of that quality, 1 to 100 (default: as they are)",
        type=whole("a quality of a JPEG", 1, 100),
        default=0,
    ),
    argument(
        "--collect",
        "DIR",
        "make a LeRobot data set of episodes that keys or a headset start, keep and discard",
        default="",
    ),
    argument(
        "--episodes",
        "N",
        "how many --collect keeps in all (default: 20)",
        type=whole("a number of episodes", 1, 100_000),
        default=0,
    ),
    argument("--task", "TEXT", "what they show (default: the workflow's name)", default=""),
    argument(
        "--faults",
        "DIR",
        "where the record of a fault goes, or off (default: $UNICON_FAULTS, else "
        "~/.local/state/unicon/faults)",
    ),
    argument("--picture", "FILE.png", "draw path, velocities and joints"),
    option(
        "--view",
        nargs="?",
        const="page",
        choices=(*SINKS, "window"),
        help="show the run: a page in the browser (default), Foxglove, or the simulator's window",
    ),
    *VIEW_OPTIONS,
    argument(
        "--metrics",
        "PORT",
        "tell figures to Prometheus at http://127.0.0.1:PORT/metrics",
        type=port,
    ),
    flag("--diagnose", "warn of causes that make it unlike its simulation"),
)
"""What `unicon run` takes besides its own."""


def view_options(options: AnyMapping, sink: str = "") -> AnyDict:
    """Return the options of a viewer, for `View`."""
    chosen = {"sink": sink or options["view"]}
    if options["view_layout"] and chosen["sink"] != "foxglove":
        raise UniconError("--view-layout is a file for Foxglove; show it there, or leave it out")
    names = ("host", "port", "token", "fps", "layout")
    return chosen | {n: options[f"view_{n}"] for n in names}


def _split(text: str) -> object:
    from unicon_lab.recording.bag_folder import Split

    return Split.of(text)


CHECKS = {"record_split": _split}
"""What can be known of a text when it is given; raises UniconError."""


def refuse(options: argparse.Namespace) -> None:
    """Refuse options that go with others, which are not given.

    Raises:
        UniconError: the first of them.
    """
    if options.record == "":  # as of a variable that is not set
        raise UniconError("--record has no name; give FILE.mcap or FOLDER/")
    if options.collect and (options.record or options.speed == "max"):
        raise UniconError(
            "--collect records by itself, for an operator; leave --record and --speed"
        )
    if options.diagnose and options.speed == "max":
        raise UniconError("--diagnose cannot follow --speed max; leave one out")
    alone = bool(options.view_token) or options.view_host != LOCAL
    for word, given, main, needed in (
        ("--record-split", options.record_split, "--record FOLDER/", options.record),
        ("--record-frames", options.record_frames, "--record FILE.mcap", options.record),
        ("--record-jpeg", options.record_jpeg, "--record-frames all", options.record_frames),
        (
            "--episodes and --task",
            options.episodes or options.task,
            "--collect DIR",
            options.collect,
        ),
        ("--view-host and --view-token", alone, "--view", options.view),
        ("--view-layout", options.view_layout, "--view=foxglove", options.view),
    ):
        if given and not needed:
            verb = "go" if " " in word else "goes"
            raise UniconError(f"{word} {verb} with {main}; add it")


def attachments(asked: Asked) -> Iterator[Attachment]:
    """Return what a run was asked for, in the order of the hooks.

    Raises:
        MissingDependencyError: a package that one needs is not installed.
        UniconError: an option's value is of no use.
    """

    def get(name: str) -> Any:
        return asked.options.get(name) or ""

    recording = None
    if get("record") or get("collect"):
        from unicon_lab.recording.collection import Collection
        from unicon_lab.recording.run_recording import Recording

        made: Callable[..., Recording] = Recording
        if get("collect"):
            made = partial(Collection, get("episodes") or 20, get("task"))
        recording = made(
            get("record") or get("collect"),
            asked.map_name,
            asked.session,
            asked.warn,
            get("speed") == "max",
            get("record_split"),
            get("namespace"),
            get("frame_prefix"),
            [name for each in get("record_frames").split(",") if (name := each.strip())],
            get("record_jpeg") or 0,
        )
        yield recording
    picture, page = get("picture"), get("report")
    page = page if page.lower().endswith(".html") else ""
    if picture:
        refuse_unwritable(Path(picture))
    if picture or page:
        from unicon_lab.report.run_page import Pictured

        yield Pictured(picture, page, get("record"))
    if get("view") == "window":
        yield _Window()
    elif get("view"):
        from unicon_lab.view.view import View

        options, prefix = view_options(asked.options), asked.options["frame_prefix"]
        view = View(options, asked.session, asked.map_name, prefix, asked.warn, get("record"))
        view.declare(asked.document)
        yield view
    if asked.options.get("metrics") is not None:
        from unicon_lab.view.metered import Metered

        yield Metered(asked.options["metrics"], asked.session, asked.warn)
    if get("diagnose"):
        from unicon_lab.diagnose.fit import Diagnosed

        yield Diagnosed(asked)
    from unicon_lab.fault_record import FaultRecord

    yield FaultRecord(get("faults"), asked.warn, recording)  # the last one: it looks behind them


class _Window(Attachment):
    """`--view=window`: the simulator's own."""

    def hook(self, program: Program) -> HookBlocks:
        """See `Attachment`."""
        from unicon_core.flow import Stage, as_block
        from unicon_core.platforms.platform import Viewable

        platform = program.platform
        if not isinstance(platform, Viewable):
            raise UniconError(f"platform {platform.facts.name!r} has no window; give --view alone")
        return {Stage.OBSERVE: [as_block(platform.viewer())]}

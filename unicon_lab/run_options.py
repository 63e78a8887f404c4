"""What the lab adds to a run: `--record`, `--picture`, `--view`, `--metrics`, `--faults`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unicon_base.errors import UniconError
from unicon_core.page import refuse_unwritable
from unicon_lab.view import LOCAL, PORT, SINKS
from unicon_ros.attachments import Asked, Attachment, File
from unicon_ros.cli.options import argument, option, port, positive, whole

if TYPE_CHECKING:
    from unicon_core.flow import Block, Stage
    from unicon_core.runtime import Report, Runner
    from unicon_core.workflow import Program
    from unicon_lab.view.view import Metered, View

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
)
"""What `unicon run` takes besides its own."""


def view_options(options: Mapping[str, Any], sink: str = "") -> dict[str, Any]:
    """Return the options of a viewer, for `View`."""
    names = ("host", "port", "token", "fps")
    return {"sink": sink or options["view"]} | {n: options[f"view_{n}"] for n in names}


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
    alone = bool(options.view_token) or options.view_host != LOCAL
    for word, given, main, needed in (
        ("--record-split", options.record_split, "--record FOLDER/", options.record),
        ("--record-frames", options.record_frames, "--record FILE.mcap", options.record),
        ("--record-jpeg", options.record_jpeg, "--record-frames all", options.record_frames),
        ("--view-host and --view-token", alone, "--view", options.view),
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
    get = asked.options.get
    recording = _Recorded(asked) if get("record") else None
    if recording is not None:
        yield recording
    picture, page = get("picture") or "", get("report") or ""
    if picture:
        refuse_unwritable(Path(picture))
    if picture or page.lower().endswith(".html"):
        yield _Drawn(picture, page if page.lower().endswith(".html") else "")
    if get("view") == "window":
        yield _Window()
    elif get("view"):
        yield _Viewed(asked)
    if get("metrics") is not None:
        yield _Metered(asked)
    yield _Faults(asked, recording)  # the last one: it looks behind the others


class _Recorded(Attachment):
    """`--record`."""

    def __init__(self, asked: Asked) -> None:
        from unicon_lab.recording.run_recording import Recording, names_in

        get = asked.options.get
        self.recording = Recording(
            asked.options["record"],
            asked.map_name,
            asked.session,
            asked.warn,
            get("speed") == "max",
            get("record_split") or "",
            get("namespace") or "",
            get("frame_prefix") or "",
            names_in(get("record_frames") or ""),
            get("record_jpeg") or 0,
        )
        self.hook = self.recording.hook

    def ended(self, report: Report) -> tuple[str, str]:
        report.extra["recording"] = self.recording.counts()
        return "recording", self.recording.summary()


class _Drawn(Attachment):
    """`--picture` and `--report FILE.html`."""

    def __init__(self, picture: str, page: str) -> None:
        from unicon_lab.report.run_page import Pictured

        self._picture, self._page, self._pictured = picture, page, Pictured(picture, page)
        self.hook = self._pictured.hook

    def attach(self, runner: Runner) -> str:
        self._pictured.attach(runner)
        return ""

    def files(self, report: Report) -> Iterator[File]:
        if self._page:
            yield "report", self._page, lambda: self._pictured.write(report)
        if self._picture:
            yield "picture", self._picture, lambda: self._pictured.draw(report)


class _Window(Attachment):
    """`--view=window`: the simulator's own."""

    def __init__(self) -> None:
        self.hook = _window


def _window(program: Program) -> dict[Stage, list[Block]]:
    from unicon_core.flow import Stage, as_block
    from unicon_core.platforms.platform import Viewable

    platform = program.platform
    if not isinstance(platform, Viewable):
        raise UniconError(f"platform {platform.facts.name!r} has no window; give --view alone")
    return {Stage.OBSERVE: [as_block(platform.viewer())]}


class _Served(Attachment):
    """What a process of its own shows at an address."""

    name: str
    shown: View | Metered

    def attach(self, runner: Runner) -> str:
        self.shown.attach(runner)
        return f"{self.name}: {self.shown.address}"

    def close(self) -> None:
        self.shown.close()


class _Viewed(_Served):
    """`--view`."""

    drives, name = True, "view"

    def __init__(self, asked: Asked) -> None:
        from unicon_lab.view.view import View

        options = view_options(asked.options)
        prefix = asked.options["frame_prefix"]
        self.shown = view = View(options, asked.session, asked.map_name, prefix, asked.warn)
        view.declare(asked.document)
        self.hook = view.hook


class _Metered(_Served):
    """`--metrics`."""

    name = "metrics"

    def __init__(self, asked: Asked) -> None:
        from unicon_lab.view.view import Metered

        self.shown = metered = Metered(asked.options["metrics"], asked.session, asked.warn)
        self.hook = metered.hook


class _Faults(Attachment):
    """The record of a fault."""

    def __init__(self, asked: Asked, recorded: _Recorded | None) -> None:
        from unicon_lab.fault_record import FaultRecord

        recording = None if recorded is None else recorded.recording
        self._record = FaultRecord(asked.options.get("faults"), asked.warn, recording)
        self.hook = self._record.hook

    def attach(self, runner: Runner) -> str:
        self._record.attach(runner)
        return ""

    def ended(self, report: Report) -> tuple[str, str] | None:
        path = self._record.write(report)
        if path is None:
            return None
        report.extra["fault_record"] = str(path)
        return "fault record", str(path)

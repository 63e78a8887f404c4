"""FaultRecord: the last ticks of a run that was cut off, as a file; for `unicon run` and the node.

    record = FaultRecord()
    program = load_workflow("go2_walk", hooks=[…, record.hook])     # the last of the hooks
    runner = Runner(program)
    record.attach(runner)
    path = record.write(runner.run())                               # None: there was no fault

Nothing is written before the robot is damped. The file is one of MCAP, which `open_record` reads,
and so does any reader of ROS 2 bags.
"""

from __future__ import annotations

import json
import os
import re
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from unicon_base import TextSink, UniconError
from unicon_base.resources import user_folder
from unicon_core.runtime.tick_ring import FEWEST, TickRing
from unicon_lab.recording import McapFile, recover
from unicon_lab.recording.mcap_file import FileInUse
from unicon_lab.recording.records import attachment, metadata
from unicon_lab.recording.run_recording import content_of, facts_of
from unicon_lab.recording.ticks import add_ticks, term_names, tick_channel, to_json
from unicon_ros.attachments import Attachment

if TYPE_CHECKING:
    from unicon_core.runtime import Report, Runner
    from unicon_core.workflow import HookBlocks, Program
    from unicon_lab.recording.run_recording import Recording

OFF = "off"
KEPT = 10
"""Records in a folder; older ones make room."""
PATIENCE = 10.0
"""For the medium in [s]: nobody is to wait for ever for the report of a fault."""


def fault_folder(given: str | None = None) -> Path | None:
    """Return where fault records go: as given, else `UNICON_FAULTS`, else the user's state folder.

    Args:
        given: a folder, or `off`.
    """
    named = given or os.environ.get("UNICON_FAULTS", "")
    return None if named == OFF else user_folder("faults", named)


class FaultRecord(Attachment):
    """Keeps the last ticks, and writes them where a fault cut the run off.

    Args:
        folder: for the files, or `off`; see `fault_folder`.
        warn: takes warnings, one line each.
        recording: gets every tick that is kept, also where there is no folder.
    """

    def __init__(
        self,
        folder: str | None = None,
        warn: TextSink = print,
        recording: Recording | None = None,
    ) -> None:
        self._folder, self._warn, self._recording = fault_folder(folder), warn, recording
        self._ring: TickRing | None = None
        self._runner: Runner | None = None
        self._facts: dict[str, str] = {}

    def hook(self, program: Program) -> HookBlocks:
        """Return the blocks that keep the ticks; give it as the last of the hooks."""
        recording = self._recording
        if self._folder is None and recording is None:
            return {}
        ring = self._ring = TickRing(program, 0 if recording is None else 2)
        if ring.capacity < FEWEST and self._folder is not None:
            self._warn(
                f"the states of a tick take {ring.row_bytes >> 20} MiB: the fault record "
                f"will hold {ring.capacity or 'no'} ticks"
            )
        if recording is not None:
            recording.keep(ring)
        return ring.blocks()

    def attach(self, runner: Runner) -> None:
        """Get to know the runner, before the first tick."""
        self._runner = runner
        if self._ring is None:
            return
        self._ring.attach(runner)
        self._facts = facts_of(runner, dict.fromkeys(self._ring.moments))
        if self._recording is not None:
            self._recording.begin(self._facts, runner.statistics)

    def ended(self, report: Report) -> tuple[str, str] | None:
        """See `Attachment`."""
        path = self.write(report)
        if path is None:
            return None
        report.extra["fault_record"] = str(path)
        return "fault record", str(path)

    def write(self, report: Report) -> Path | None:
        """Write the record of a run with a fault, and return where; never raises.

        What goes wrong is one warning; a medium that takes nothing is waited for 10 s.
        """
        ring, folder = self._ring, self._folder
        if not report.faults or ring is None or folder is None:
            return None
        written: list[Path] = []
        troubles: list[str] = []

        def work() -> None:
            try:
                written.append(self._write(ring, folder, report))
            except OSError as error:
                reason = error.strerror or str(error)
                troubles.append(f"{reason}; give a folder with room in UNICON_FAULTS")
            except Exception as error:  # the run has ended: the report still comes
                troubles.append(" ".join(f"{type(error).__name__}: {error}".split()))

        thread = threading.Thread(target=work, name="fault record", daemon=True)
        thread.start()
        thread.join(PATIENCE)
        if written:
            return written[0]
        silence = f"the medium took nothing for {PATIENCE:g} s"
        self._warn(f"no fault record in {folder}: {troubles[0] if troubles else silence}")
        return None

    def _write(self, ring: TickRing, folder: Path, report: Report) -> Path:
        assert self._runner is not None
        ring.freeze()  # where nobody did: damped in the middle of a tick
        folder.mkdir(parents=True, exist_ok=True)
        for rest in folder.glob("fault-*.mcap.partial"):  # what a killed process left
            with suppress(UniconError, OSError):  # another process writes it, or it is rubble
                recover(rest)
        file = _new_file(folder, report.workflow)
        try:
            file.begin()
            _fill(file, ring, self._runner, report, self._facts)
            lost = file.finish()
        except BaseException:
            file.discard()
            raise
        if lost:
            self._warn(f"{file.path}: the medium is full; its last {lost} ticks are missing")
        if ring.trouble:
            self._warn(f"{file.path}: {ring.trouble}")
        _prune(folder, file.path)
        return file.path


def _fill(
    file: McapFile, ring: TickRing, runner: Runner, report: Report, facts: dict[str, str]
) -> None:
    """Write what is small first: a kill in the middle then leaves what explains the rest."""
    now = time.time_ns()
    told = {
        "written": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "reason": report.faults[0],
        "faults": json.dumps(report.faults),
        "traceback": report.traceback,
    }
    file.add_record(metadata("unicon", facts | told))
    memories = ring.memories()
    first = memories[0].row if memories else 0
    content = [content_of(each, each.row - first) for each in memories]

    def add(name: str, text: str) -> None:
        file.add_record(attachment(name, now, text.encode()))

    built = None if ring.built is None else to_json(ring.built)
    add("memory.json", json.dumps({"trouble": ring.trouble, "built": built, "memories": content}))
    add("report.json", json.dumps(report.to_dict(), default=str))
    program, moments = runner.program, dict.fromkeys(ring.moments)
    file.add(tick_channel(1, program.states.layout, moments, term_names(program)))
    add_ticks(file, ring.kept())
    add("trace.json", runner.statistics.trace(f"unicon {report.workflow}", max(ring.capacity, 1)))


def _new_file(folder: Path, workflow: str) -> McapFile:
    stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime())
    clean = re.sub(r"[^A-Za-z0-9_-]+", "_", workflow)[:60]
    name, number = f"fault-{stamp}-{clean}-{os.getpid()}", 0
    while True:
        number += 1
        path = folder / f"{name}-{number}.mcap"
        if path.exists():
            continue
        with suppress(FileInUse):  # by another run of this process
            file = McapFile(path)
            if not path.exists():
                return file
            file.discard()  # that run had it until now, and has given it this name


def _prune(folder: Path, newest: Path) -> None:
    with suppress(OSError):  # another run clears up as well
        # By their age: names of one second are used again once their records were cleared away.
        records = [(p.stat().st_mtime_ns, p) for p in folder.glob("fault-*.mcap") if p != newest]
        for _, path in sorted(records)[: max(len(records) - KEPT + 1, 0)]:
            path.unlink(missing_ok=True)

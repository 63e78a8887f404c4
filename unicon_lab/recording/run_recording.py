"""Recording: writes the messages of a run and every tick into MCAP, for `unicon run --record`.

With the facts of recordings and fault records: what ticks mean and where they come from.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import platform
import re
import sys
import time
import uuid
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from importlib import metadata as packages
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from unicon_base import AnyDict, TextSink, UniconError, imported
from unicon_core import __version__
from unicon_core.flow import Stage
from unicon_core.memory import Snapshot
from unicon_core.robots import Robot, robot_files
from unicon_core.runtime import Report, Runner
from unicon_core.runtime.tick_ring import HEAD, KeptMemory, TickRing
from unicon_core.workflow import HookBlocks, Program
from unicon_lab.recording.bag_folder import Split
from unicon_lab.recording.recorder import Recorder
from unicon_lab.recording.records import attachment, metadata
from unicon_lab.recording.ticks import (
    Names,
    RecordedSubset,
    kept_moments,
    layout_facts,
    term_names,
    to_json,
)
from unicon_ros.attachments import Attachment

if TYPE_CHECKING:
    from unicon_core.runtime.statistics import TickStatistics
    from unicon_lab.recording.recorded_topics import RecordedFrames
    from unicon_ros.bridge import RosSession


VERSIONS = (
    *("numpy", "onnxruntime", "torch", "mujoco", "pybullet", "jax", "newton", "rclpy"),
    "cyclonedds",
)


def network_hash(path: Path) -> str:
    """Return the SHA-256 of a network's file, and of those beside it that it names.

    ONNX keeps large weights in files of their own, and their names in the network.
    """
    raw = path.read_bytes()
    digest = hashlib.sha256(raw)
    for beside in sorted(path.parent.iterdir()):
        if beside != path and beside.is_file() and beside.name.encode() in raw:
            digest.update(beside.read_bytes())
    return digest.hexdigest()


def facts_of(runner: Runner, kept: RecordedSubset) -> dict[str, str]:
    """Return the facts of a run; call it before the first tick: files may be others later."""
    program, facts = runner.program, runner.program.platform.facts
    document = program.document
    scene = document.values.get("scene")
    texts = {
        "overridden": document.overridden,
        "options": {"speed": runner.options.speed, "duration": runner.options.duration},
        "dry": program.silent,
        "platform_facts": {  # what a stand-in needs to be built into the same graph
            "simulated": facts.simulated,
            "reads": facts.reads,
            "writes": facts.writes,
            "silent": program.silent,
        },
        "outside": _outside(program),
        "policies": {
            name: {
                "path": str(contract.path),
                "model": str(contract.model),
                "sha256": network_hash(contract.model),
                "networks": {part.name: network_hash(part.model) for part in contract.networks},
            }
            for name, contract in program.policies.items()
        },
        "versions": versions_here(),
        "system": system_here(),
    }
    return layout_facts(program.states.layout, kept) | {
        "run": uuid.uuid4().hex,
        "period_s": repr(program.period),
        "workflow": document.name,
        "workflow_path": str(document.path),
        "workflow_file": _text_of(document.path),
        "workflow_effective": _yaml(document.values),
        "seed": str(scene.get("seed", 0) if isinstance(scene, dict) else 0),
        "part": program.part,
        "platform": facts.name,
        **robot_facts(program.robot),
        **{name: json.dumps(value) for name, value in texts.items()},
        "wall_ns": str(time.time_ns() - time.monotonic_ns()),  # of stamps, to be compared
    }


def robot_facts(robot: Robot) -> dict[str, str]:
    """Return what says which robot it is: its file, and the overlay that extends it or "".

    `robot_path` is the one of both that a workflow would name, "" where there are members.
    """
    overlay = robot.overlay
    return {
        "robot": robot.name,
        "robot_path": "" if robot.members else str((overlay or robot.path).absolute()),
        "robot_file": robot_text(robot),
        "robot_overlay": "" if overlay is None else _text_of(overlay),
    }


def content_of(memory: KeptMemory, row: int) -> AnyDict:
    """Return what was remembered before a tick, for `memory.json`.

    Args:
        memory: it.
        row: index of the tick in the file.
    """
    blocks = to_json(memory.remembered)
    return {"before": row, "anew": memory.anew, "blocks": blocks, "unproven": memory.unproven}


def versions_here() -> dict[str, str]:
    """Return the versions of what is loaded by now."""
    versions = {"unicon_ros": __version__, "python": platform.python_version()}
    for name in VERSIONS:
        if name in sys.modules:
            with suppress(packages.PackageNotFoundError):
                versions[name] = packages.version(name)
    return versions


def system_here() -> dict[str, str]:
    """Return what else a run may depend on: system, ROS, and the commit of our code; "" for none.

    None of it names the machine.
    """
    system, middleware = {"ID": platform.system().lower()}, ""
    with suppress(OSError):
        system = platform.freedesktop_os_release()
    if "rclpy" in sys.modules:
        with suppress(Exception):  # there is none, and nobody uses ROS
            from rclpy.utilities import get_rmw_implementation_identifier

            middleware = str(get_rmw_implementation_identifier())
    return {
        "os": f"{system['ID']} {system.get('VERSION_ID', '')}".rstrip(),
        "architecture": platform.machine(),
        "kernel": platform.release(),
        "ros": os.environ.get("ROS_DISTRO", ""),
        "middleware": middleware,
        "commit": _commit(Path(__file__).resolve().parents[2] / ".git"),
    }


def _commit(git: Path) -> str:
    """Return what is checked out, "" where our code is installed; without starting git."""
    head = _text_of(git / "HEAD").strip()
    name = head.removeprefix("ref: ")
    if name == head:
        return head
    packed = re.search(rf"^(\w+) {re.escape(name)}$", _text_of(git / "packed-refs"), re.MULTILINE)
    return _text_of(git / name).strip() or (packed[1] if packed else "")


def _outside(program: Program) -> dict[str, list[str]]:
    """Return the states that hooks and devices write, by the moment that follows.

    A device behind `send` says by an attribute `outside` that what it tells comes from there.
    """
    moments = {Stage.INPUT: "input", Stage.TUNE: "tuned", Stage.OBSERVE: "sent"}
    given: dict[str, set[str]] = {}
    devices = [each for each in program.blocks if getattr(each.tick, "outside", False)]
    for block in (*program.outside, *devices):
        if block.stage in moments:
            given.setdefault(moments[block.stage], set()).update(block.writes, block.amends)
    return {moment: sorted(states) for moment, states in given.items()}


def robot_text(robot: Robot) -> str:
    """Return what the files of a robot say, one behind the other where it has members."""
    return "\n".join(_text_of(path) for path in robot_files(robot).values())


def _text_of(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except (OSError, UnicodeDecodeError):
        return ""


def _yaml(values: AnyDict) -> str:
    """Return a workflow with all overrides; what was written in Python is not text."""
    try:
        return str(yaml.safe_dump(values, sort_keys=False, allow_unicode=True))
    except yaml.YAMLError:
        return ""


@dataclass(eq=False)
class Recording(Attachment):
    """Records the messages of a run, what came in and what goes out, and every state of every tick.

        recording = Recording("walk.mcap")
        record = FaultRecord(recording=recording)
        program = load_workflow("go2_walk", hooks=[recording.hook, record.hook])
        runner = Runner(program)
        record.attach(runner)

    Args:
        path: of the MCAP file.
        map_name: message map, name or path; `default` if None.
        session: where ROS is on, its messages are recorded as they leave, encoded once; the hook
            must then stand behind the session's own.
        warn: takes warnings, one line each, from a thread.
        patient: wait for a slow disk rather than drop messages: for runs at full speed.
        split: where a next file of a bag folder begins, such as `1GB` or `60s`; "" for nowhere.
        namespace: of relative topics, where there is no session.
        frame_prefix: of the names of frames, where there is no session.
        frames: handles whose pictures and clouds are recorded, without `_handle`, or `all`.
        jpeg: quality from 1 to 100 of pictures that are raw, 0 to leave them as they are.

    Raises:
        MissingDependencyError: rosbags is not installed.
        UniconError: nothing can be split so, or that is not a quality.
    """

    path: str | Path
    map_name: str | None = None
    session: RosSession | None = None
    warn: TextSink = print
    patient: bool = False
    split: str = ""
    namespace: str = ""
    frame_prefix: str = ""
    frames: Sequence[str] = ()
    jpeg: int = 0
    _recorder: Recorder = field(init=False)

    def __post_init__(self) -> None:
        imported("rosbags", "--record", "bags")  # it has the texts of the message types
        if not 0 <= self.jpeg <= 100:
            raise UniconError(
                f"{self.jpeg} is not a quality of a JPEG; give 1 to 100, or 0 for none"
            )
        self._split = Split.of(self.split) if self.split else None
        self._ticks: RecordedTicks | None = None
        self._frames: RecordedFrames | None = None
        self._statistics: TickStatistics | None = None

    def counts(self) -> AnyDict:
        """Return messages in the file, those dropped, bytes, and the error or "".

        Where frames are recorded, `frames` tells of each ring how many were taken and missed.
        """
        frames = {} if self._frames is None else {"frames": self._frames.counts()}
        return self._recorder.counts() | frames

    def summary(self) -> str:
        """Return what became of it, for the end of a run."""
        counts = self.counts()
        text = f"{self.path}: {counts['messages']} messages"
        if counts["dropped"]:
            text += f", {counts['dropped']} lost"
        for name, frames in counts.get("frames", {}).items():
            missed = f", {frames['missed']} missed" if frames["missed"] else ""
            text += f", {frames['frames']} frames of {name}{missed}"
        return text + (f" ({counts['error']})" if counts["error"] else "")

    def hook(self, program: Program) -> HookBlocks:
        """Return the block that records."""
        from unicon_lab.recording.recorded_topics import (
            RecordedFrames,
            RecordedTopics,
            chosen_sources,
        )

        # A robot does not wait for a disk, however its run is paced.
        patient = self.patient and program.platform.facts.simulated
        recorder = Recorder(self.path, self.warn, patient, self._split)
        try:
            names = (self.namespace, self.frame_prefix)
            topics = RecordedTopics(recorder, program, self.map_name, self.session, *names)
            if self.frames:
                sources = chosen_sources(program, self.frames)
                self._frames = RecordedFrames(recorder, sources, topics.now, self.jpeg, self.warn)
        except BaseException:
            recorder.close()
            raise
        self._recorder, topics.block.close = recorder, self._close
        self._names = term_names(program)
        return {Stage.OBSERVE: [topics.block]}

    def _close(self) -> None:
        if self._frames is not None:
            self._frames.close()
        if self._ticks is not None and self._statistics is not None:
            self._recorder.add_record(partial(_late, self._statistics))
        self._recorder.close()

    def keep(self, ring: TickRing) -> None:
        """Record the ticks that a ring keeps; behind the hook."""
        self._ticks = RecordedTicks(self._recorder, ring, self._names)

    def ended(self, report: Report) -> tuple[str, str]:
        """See `Attachment`."""
        report.extra["recording"] = self.counts()
        return "recording", self.summary()

    def begin(self, facts: Mapping[str, str], statistics: TickStatistics) -> None:
        """Get facts and statistics of the run, and begin to write, before the first tick."""
        self._statistics = statistics
        if self._ticks is not None:
            self._ticks.attach(facts)
        self._recorder.start()
        if self._frames is not None:
            self._frames.start()


def _late(statistics: TickStatistics) -> bytes:
    """Return what is known at the end of a run."""
    late = json.dumps(statistics.lateness_us())
    return metadata("unicon", {"overruns": str(statistics.overruns), "late_us": late})


class RecordedTicks:
    """Takes the ticks of a ring into a recording; makes the facts and memories that go with them.

    Of the moments before `sent` only those states are recorded that came from outside there; the
    rest follows from the tick before. Where nothing is before (the first tick, a reset) they are
    all in `memory.json`, beside what the blocks remembered.

    Args:
        recorder: not started yet.
        ring: whose blocks stand in the program.
        names: of elements, as of `term_names`.
    """

    def __init__(self, recorder: Recorder, ring: TickRing, names: Names) -> None:
        self._recorder, self._ring = recorder, ring
        self._layout = layout = ring.layout
        self._write = recorder.tick_channel(layout, ring.outside, names)
        moments = kept_moments(layout, ring.outside).values()
        self._whole = slice(HEAD.size, HEAD.size + layout.nbytes)
        self._row = bytearray(HEAD.size + sum(moment.size for moment in moments))
        self._copies = [(slice(0, HEAD.size), slice(0, HEAD.size))]
        for number, moment in enumerate(moments):
            there = HEAD.size + number * layout.nbytes
            for to, source in moment.copies(layout):
                self._copies.append((to, slice(there + source.start, there + source.stop)))
        self._memory: KeptMemory | None = None
        self._rows = 0
        ring.tap = self._take

    def attach(self, facts: Mapping[str, str]) -> None:
        """Give the facts of the run to the recorder."""
        facts = {**facts, **layout_facts(self._layout, self._ring.outside)}
        self._recorder.add_record(partial(metadata, "unicon", facts))

    def _take(self, raw: memoryview) -> None:
        row, memory = self._row, self._ring.newest
        for to, source in self._copies:
            row[to] = raw[source]
        _, stamp, _, _, _ = HEAD.unpack_from(raw)
        if not self._write(stamp, row):
            return  # dropped, and counted
        if memory is not self._memory or not self._rows:
            self._memory = memory
            if memory is None or memory.anew or not self._rows:  # others are for fault records
                states = base64.b64encode(raw[self._whole]).decode()
                found = memory or KeptMemory(0, False, Snapshot(), {"every block": "is unknown"})
                facts = found, self._rows, self._ring.trouble, states, time.time_ns()
                self._recorder.add_record(partial(_attachment, *facts))
        self._rows += 1


def _attachment(memory: KeptMemory, row: int, trouble: str, states: str, stamp_ns: int) -> bytes:
    """Return the attachment of a memory, made in a thread: it takes milliseconds."""
    content = content_of(memory, row) | {"received": states}
    text = json.dumps({"trouble": trouble, "memories": [content]})
    return attachment(f"memory-{row}.json" if row else "memory.json", stamp_ns, text.encode())

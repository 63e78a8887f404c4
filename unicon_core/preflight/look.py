"""`look`: receives from a live platform for some seconds and says what it saw; it sends nothing.

Beside what the gates say: how often frames come, where the flow begins, what it would send first.
"""

from __future__ import annotations

import math
import os
import shutil
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from unicon_base import AnyDict, Fault, UniconError
from unicon_base.arrays import Float32
from unicon_core.blocks.approach import Target
from unicon_core.check.rules import live_code
from unicon_core.flow import Node, Stage, Zip, compile_graph
from unicon_core.gates.build import beginning, first_command
from unicon_core.gates.data import Rate
from unicon_core.gates.gate import SoleCommander
from unicon_core.page import write_json
from unicon_core.platforms.joined import members_of
from unicon_core.platforms.platform import (
    CountsArrivals,
    ReportsVariant,
    SeesCommanders,
    WaitsForData,
    info_of,
)
from unicon_core.signals import SIGNALS
from unicon_core.text_table import aligned, figure
from unicon_core.workflow import Program


@dataclass(frozen=True)
class Row:
    """One thing that was looked at.

    Attributes:
        name: of it, a word or two.
        ok: whether it is in order; None where that is for a person to say.
        told: what was seen, with figures; where it is not in order also the remedy.
        code: of the rule that is broken, for `unicon explain`; "" where none is.
    """

    name: str
    ok: bool | None
    told: str
    code: str = ""

    @property
    def word(self) -> str:
        """`pass`, `FAIL` or `note`."""
        return "note" if self.ok is None else "pass" if self.ok else "FAIL"

    @property
    def line(self) -> str:
        """What was seen, with the code of a broken rule."""
        return f"{self.told}  [{self.code}]" if self.code else self.told


@dataclass
class PreflightResult:
    """All that was looked at.

    Attributes:
        workflow, robot, platform: names.
        seconds: how long was received in [s].
        ticks: looks.
        rows: what was looked at.
        first_command: joint to how far the flow's first command is from where the joint was
            measured in [rad]; empty where there was none.
        first_step: likewise, from where the flow begins: what is left once the approach has ended.
        fault: what ended the reception early; else empty.
    """

    workflow: str
    robot: str
    platform: str
    seconds: float = 0.0
    ticks: int = 0
    rows: list[Row] = field(default_factory=list)
    first_command: dict[str, float] = field(default_factory=dict)
    first_step: dict[str, float] = field(default_factory=dict)
    fault: str = ""

    def add(self, name: str, ok: bool | None, told: str, code: str = "") -> None:
        """Add a row; `code` is that of its rule, where its name does not say it."""
        code = (live_code(name) or code) if ok is False else ""
        self.rows.append(Row(name, ok, told, code))

    @property
    def ok(self) -> bool:
        """Whether nothing failed."""
        return not self.fault and all(row.ok is not False for row in self.rows)

    def text(self) -> str:
        """Return the table."""
        head = (
            f"{self.workflow} on {self.robot} (platform {self.platform}): received for "
            f"{self.seconds:.1f} s, no joint was commanded"
        )
        lines = aligned([(row.word, row.name, row.line) for row in self.rows], underlined=False)
        passed, failed = (sum(row.ok is ok for row in self.rows) for ok in (True, False))
        end = [f"fault: {self.fault}"] if self.fault else []
        return "\n".join([head, *(f"  {x}" for x in lines), *end, f"{passed} pass, {failed} fail"])

    def to_dict(self) -> AnyDict:
        """Return all of it as plain values."""
        return {**asdict(self), "ok": self.ok}

    @staticmethod
    def write(values: AnyDict, path: str | Path) -> None:
        """Write values as JSON.

        Raises:
            UniconError: it cannot be written.
        """
        write_json(Path(path), values)


FREE_BYTES = 1 << 30
"""Free disk that a run should have: a recording grows by 1 to 10 MB a minute."""
NEAREST = 3
"""So many joints are named that are nearest to a limit."""


def waiting(program: Program) -> Node:
    """Return the tree of a tick that only receives: recv, estimate and the commands of others."""
    stages = (Stage.RECV, Stage.ESTIMATE, Stage.INPUT)
    return Zip(*(node for stage in stages for node in program.stages[stage]))


def look(program: Program, seconds: float) -> PreflightResult:
    """Receive for some seconds, ask all gates in every tick, and judge what was seen.

    Where a gate does not hold at the end it is asked for as long again, as a run would.

    Args:
        program: built silently; it stays open.
        seconds: at least 1, which the gates need.

    Raises:
        Interrupted: a signal asked to end.
        UniconError: there are several robots.
    """
    facts = program.platform.facts
    if program.states.num_robots is not None:
        raise UniconError("preflight looks at one robot; leave num_robots out")
    result = PreflightResult(program.name, program.robot.name, facts.name)
    said: dict[str, str] = {}
    gaps = _Gaps(program)
    try:
        _receive(program, seconds, said, gaps, result)
    except Fault as fault:
        result.fault = str(fault)
    _of_robot(program, result)
    seen = {"rate": gaps.told(), "imu": _imu(program), "posture": _posture(program)}
    for gate in program.gates:
        reason = said.get(gate.name, "it was not asked")
        told = reason or seen.get(gate.name, "") or getattr(gate, "about", "")
        result.add(gate.name, not reason, told, "gate.stop")
    if not program.gates:
        result.add("gates", None, "none are asked (start: {gates: false})")
    if not result.fault:
        try:
            tell_frames(program, result)
            tell_first_command(program, result)
        except Fault as fault:
            result.fault = str(fault)
    _around(program, result)
    return result


def _receive(
    program: Program, seconds: float, said: dict[str, str], gaps: _Gaps, result: PreflightResult
) -> None:
    step = compile_graph(waiting(program)).step
    begun = due = time.perf_counter()
    refused: set[str] = set()
    while due - begun < seconds or (any(said.values()) and due - begun < 2.0 * seconds):
        SIGNALS.check()
        if step():
            raise Fault("the platform has gone")
        gaps.note()
        for gate in program.gates:
            if gate.name in refused:
                continue
            try:
                said[gate.name] = gate()
            except Fault as fault:  # it does not help to ask it again
                said[gate.name] = str(fault)
                refused.add(gate.name)
        result.ticks += 1
        due += program.period
        time.sleep(max(0.0, due - time.perf_counter()))
        due = max(due, time.perf_counter() - program.period)  # a busy machine looks less often
        result.seconds = round(time.perf_counter() - begun, 3)


class _Gaps:
    """How often there were new data, and the longest time without."""

    def __init__(self, program: Program) -> None:
        gates = (getattr(gate, "gate", gate) for gate in program.gates)
        self._rate = next((gate for gate in gates if isinstance(gate, Rate)), None)
        self._last, self._new = -1, 0
        self._at = self._first = time.perf_counter()
        self._longest = 0.0

    def note(self) -> None:
        """Look whether the data are new."""
        count = -1 if self._rate is None else self._rate.count()
        now = time.perf_counter()
        if count != self._last:
            self._longest = max(self._longest, now - self._at if self._new else 0.0)
            self._first = self._first if self._new else now
            self._last, self._at, self._new = count, now, self._new + 1

    def told(self) -> str:
        """Return the figures; "" where nothing tells."""
        if self._rate is None or self._new < 2:
            return ""
        hz = (self._new - 1) / max(self._at - self._first, 1e-9)
        age = time.perf_counter() - self._at
        return (
            f"new data {hz:.3g} times a second, longest gap {1e3 * self._longest:.0f} ms, age "
            f"{1e3 * age:.0f} ms"
        )


def _of_robot(program: Program, result: PreflightResult) -> None:
    """What was opened: protocol, map, topics, variant."""
    for member, platform, robot in members_of(program.platform, program.robot):
        info = dict(info_of(platform))
        told = f"{robot.path.name}, protocol {robot.transport.get('protocol')}"
        told += f", map {info['map']}" if info.get("map") else ""
        result.add("robot", None, f"{member}: {told}" if member else told)
        for topic, count in dict(info.get("received") or {}).items():
            result.add("received", None, f"{topic}: {count} messages taken")
        for note in info.get("notes") or ():
            result.add("platform", None, str(note))
        if isinstance(platform, ReportsVariant):
            reported = ", ".join(f"{key} {value}" for key, value in platform.variant().items())
            result.add("reported", None, reported or "nothing yet")
        elif "mode_machine" in robot.transport:
            mode = robot.transport["mode_machine"]
            result.add("reported", None, f"no variant; the robot file is of mode_machine {mode}")


def _imu(program: Program) -> str:
    states, writes = program.states, program.platform.facts.writes
    figures = []
    if "base_lin_acc" in writes:
        size = float(np.linalg.norm(states["base_lin_acc"]))
        figures.append(f"accelerometer {size:.2f} m/s²")
    if "base_ang_vel" in writes:
        figures.append(f"gyroscope {float(np.linalg.norm(states['base_ang_vel'])):.3f} rad/s")
    if "projected_gravity" in writes:
        down = float(np.clip(-states["projected_gravity"].reshape(-1, 3)[0, 2], -1.0, 1.0))
        figures.append(f"leans by {math.acos(down):.2f} rad")
    return ", ".join(figures)


def _posture(program: Program) -> str:
    robot, pos = program.robot, program.states["joint_pos"]
    room = np.fmin(pos - robot.lower, robot.upper - pos)  # NaN where no limit is known
    order = np.argsort(np.nan_to_num(room, nan=np.inf))[:NEAREST]
    known = [i for i in order if np.isfinite(room[i])]
    named = [f"{robot.joint_names[i]} {figure(room[i], '.2f')} rad" for i in known]
    return f"nearest to a limit: {', '.join(named)}" if named else ""


def _around(program: Program, result: PreflightResult) -> None:
    """What is around: others who command, room for a recording."""
    platform = program.platform
    if isinstance(platform, SeesCommanders) and not any(
        gate.name == SoleCommander.name for gate in program.gates
    ):
        alone = SoleCommander(platform.commanders)
        others = alone()
        if platform.commanders():
            result.add(alone.name, not others, others or alone.about)
        else:
            told = "this protocol does not tell who else sends; see that no other program does"
            result.add(alone.name, None, told)
    free = shutil.disk_usage(os.getcwd()).free
    told = f"{free / 1e9:.1f} GB free in this folder"
    if free < FREE_BYTES:
        told += f", {FREE_BYTES / 1e9:.1f} GB are advised; make room, or record elsewhere"
    result.add("disk", free >= FREE_BYTES, told)


def tell_first_command(program: Program, result: PreflightResult) -> None:
    """Add where the flow begins and what it would send first; nothing is sent.

    Args:
        program: whose platform has been received from.
        result: is added to.
    """
    measured = np.array(program.states["joint_pos"])
    try:
        begins, first = beginning(program), first_command(program)
        entry = _entered(program, begins)
    except Exception as error:  # of a block, which may raise anything
        kind = "" if isinstance(error, UniconError | Fault) else f"{type(error).__name__}: "
        result.add("first command", False, f"{kind}{error}; nothing would be sent")
        return
    way, joint = _farthest(program, begins, measured)
    approach = f"{begins.source}, {way:.2f} rad away ({joint})"
    speed = program.start.approach
    if not program.platform.facts.simulated and way > 0.0:
        approach += f": an approach of {way / speed:.1f} s at {speed:g} rad/s"
    result.add("begins at", None, approach)
    result.first_command = _distances(program, first, measured)
    result.first_step = _distances(program, entry, begins.joint_pos)
    size, joint = _farthest(program, first, measured)
    gain = first.stiffness[program.robot.joint_names.index(joint)]
    told = f"of the flow from here: {size:.2f} rad away ({joint}) at {gain:g} N·m/rad"
    if way > 0.0:
        size, joint = _farthest(program, entry, begins.joint_pos)
        told += f"; from where it begins: {size:.2f} rad ({joint})"
    finite = all(np.isfinite(command.joint_pos).all() for command in (first, entry))
    result.add("first command", finite, told + ("" if finite else "; mend the flow"))


def _entered(program: Program, at: Target) -> Target:
    """Return the first command as it is where the approach has ended, at rest there."""
    states = program.states
    before = states.snapshot()
    try:
        states["joint_pos"][...] = at.joint_pos
        states["joint_vel"][...] = 0.0
        return first_command(program)
    finally:
        states.restore(before)


def _distances(program: Program, target: Target, origin: Float32) -> dict[str, float]:
    away = np.round(np.abs(target.joint_pos - origin).astype(float), 6).tolist()
    return dict(zip(program.robot.joint_names, away))


def _farthest(program: Program, target: Target, origin: Float32) -> tuple[float, str]:
    """Return the largest distance in [rad] and its joint; one that is not finite is the largest."""
    away = np.abs(target.joint_pos - origin)
    worst = int(np.argmax(np.nan_to_num(away, nan=np.inf)))
    return float(away[worst]), program.robot.joint_names[worst]


SECONDS = 0.5
"""For so long they are counted."""
SHARE = 0.5
"""Of the promise that must be kept: a network that loses a few, or a busy machine, is no reason."""
LOOKING = 0.001
"""Between two looks at a platform that cannot wait for them, [s]."""


def tell_frames(program: Program, result: PreflightResult) -> None:
    """Add how often frames come, beside what the robot file promises (`transport.rate_hz`).

    The gate `rate` is content with new data in every tick, and a tick may be ten times slower than
    the robot is: this sees a robot in a slow mode, or a network that loses most of it. A platform
    that does not declare the robot's protocol, such as one over topics, has another rate.

    Args:
        program: whose platform has been received from.
        result: is added to.

    Raises:
        Fault: of the platform.
    """
    platform, transport = program.platform, program.robot.transport
    promised = transport.get("rate_hz")
    if not isinstance(platform, CountsArrivals) or not isinstance(promised, int | float):
        return
    if transport.get("protocol") not in platform.facts.protocols:
        return
    platform.recv()  # what had come before
    count, begun = platform.arrivals(), time.perf_counter()
    while time.perf_counter() - begun < SECONDS:
        if isinstance(platform, WaitsForData):
            platform.wait(LOOKING)
        else:
            time.sleep(LOOKING)
        platform.recv()
    hz = (platform.arrivals() - count) / (time.perf_counter() - begun)
    told = f"{hz:.3g} frames a second, {promised:g} are promised"
    good = hz >= SHARE * promised
    if not good:
        told += "; see whether the robot is in another mode and the network loses frames, or "
        told += f"correct rate_hz of {program.robot.path.name}"
    result.add("frames", good, told)

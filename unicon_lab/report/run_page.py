"""What a run did: as one page that needs nothing beside it, and as a picture."""

from __future__ import annotations

import html
import json
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from unicon_base.arrays import Array
from unicon_core import __version__
from unicon_core.drawing import drawings, require
from unicon_core.flow import Block, Stage
from unicon_core.page import findings, number, page, pairs, place, table, write_file
from unicon_core.runtime.phases import describe
from unicon_lab.recording.facts import facts_of
from unicon_lab.report.pictures import PICTURES, beyond, write_overview
from unicon_ros.attachments import Attachment, File
from unicon_ros.bridge.bindings import told_states

if TYPE_CHECKING:
    from unicon_core.runtime import Report, Runner
    from unicon_core.runtime.phases import Phase
    from unicon_core.workflow import Program


STATES = (
    *("base_pos_w", "base_lin_vel", "base_ang_vel", "projected_gravity", "velocity_command"),
    *("joint_pos", "joint_pos_target", "joint_vel", "joint_effort"),
)
ROWS = 8192
"""Of what is kept: 164 s at 50 Hz tick by tick. Then a row stands for two ticks, four, …"""


class Keeper(Attachment):
    """Keeps states of all ticks; of long runs the first, lowest and highest values of stretches.

    Args:
        what: wants to draw them, such as `--picture`.

    Attributes:
        stride: ticks that a row stands for.
        robot: whose states they are.
        period: of the ticks in [s].
        ticks: that were kept, of all phases.
        phases: (number of the tick at which it began, phase), in order.
        told: the states that the platform or a block writes.
        statistics: of the run, once it is attached.

    Raises:
        MissingDependencyError: matplotlib is not installed: said before the run, not after it.
    """

    def __init__(self, what: str) -> None:
        require(what)
        self.stride = 1
        self.phases: list[tuple[int, Phase]] = []
        self.told: frozenset[str] = frozenset()
        self._columns: dict[str, slice] = {}
        self.ticks = self._row = self._in_row = 0
        self._runner: Runner | None = None
        self._phase: Phase | None = None

    def hook(self, program: Program) -> dict[Stage, list[Block]]:
        """Return the block that keeps the states."""
        states = program.states
        self.robot, self.period, start = program.robot, program.period, 0
        views = {name: states[name] for name in STATES if name in states}
        if states.num_robots is not None:
            views = {name: view[0] for name, view in views.items()}
        for name, view in views.items():
            self._columns[name] = slice(start, start + view.size)
            start += view.size
        # Written once, so that no page of it is new to a tick: first, lowest, highest.
        self._rows = np.full((ROWS, 3, start), np.nan, np.float32)
        now = np.zeros(start, np.float32)
        places = [(now[self._columns[name]], view) for name, view in views.items()]

        def keep() -> None:
            for place, view in places:
                place[...] = view
            row = self._rows[self._row]
            if self._in_row:
                np.minimum(row[1], now, out=row[1])
                np.maximum(row[2], now, out=row[2])
            else:
                row[...] = now
            runner = self._runner
            if runner is not None and runner.phase is not self._phase:
                self._phase = runner.phase
                self.phases.append((self.ticks, self._phase))
            self.ticks += 1
            self._in_row += 1
            if self._in_row == self.stride:
                self._in_row = 0
                self._row += 1
                if self._row == ROWS:
                    self._halve()

        return {Stage.OBSERVE: [Block("kept", keep, reads=tuple(views))]}

    def attach(self, runner: Runner) -> None:
        """Get to know the runner, whose phases are kept, and who writes what."""
        self._runner, self.statistics = runner, runner.statistics
        self.told = told_states(runner.program)

    def _halve(self) -> None:
        """Let each row stand for twice as many ticks; a millisecond, once in that many ticks."""
        pairs = self._rows.reshape(ROWS // 2, 2, *self._rows.shape[1:])
        half = self._rows[: ROWS // 2]
        half[:, 0] = pairs[:, 0, 0]
        half[:, 1] = np.minimum(pairs[:, 0, 1], pairs[:, 1, 1])
        half[:, 2] = np.maximum(pairs[:, 0, 2], pairs[:, 1, 2])
        self.stride *= 2
        self._row = ROWS // 2

    # -- for the pictures -----------------------------------------------------------------------

    @property
    def paced(self) -> bool:
        """Whether the clock paced the ticks, so that they may be late."""
        return self._runner is not None and self._runner.options.speed == "real"

    @property
    def begin(self) -> int:
        """Number of the kept tick with which the flow began; time counts from there."""
        return next((tick for tick, phase in self.phases if phase.value == "run"), 0)

    def spans(self) -> list[tuple[str, int, int]]:
        """Return each phase with the numbers of its first tick and of the one behind its last."""
        ends = [*(tick for tick, _ in self.phases[1:]), self.ticks]
        return [(phase.value, begin, end) for (begin, phase), end in zip(self.phases, ends)]

    def beside_the_run(self) -> list[tuple[float, float]]:
        """Return from when to when another phase than the run was kept, in [s]."""
        return [
            ((begin - self.begin) * self.period, (end - self.begin) * self.period)
            for phase, begin, end in self.spans()
            if phase != "run"
        ]

    def time(self) -> Array:
        """Return when each row begins in [s], shape (rows,)."""
        ticks = np.arange(self._used, dtype=np.float64) * self.stride
        return (ticks - self.begin) * self.period

    def first(self, name: str) -> Array:
        """Return the first values of a state in each row, shape (rows, elements)."""
        return self._of(name, 0)

    def reached(self, name: str) -> tuple[Array, Array]:
        """Return the lowest and the highest value of each element in the run, shape (elements,)."""
        return np.fmin.reduce(self._of(name, 1), axis=0), np.fmax.reduce(self._of(name, 2), axis=0)

    def largest(self, name: str) -> Array:
        """Return the largest size of each element in the run, shape (elements,)."""
        low, high = self.reached(name)
        return np.asarray(np.fmax(np.abs(low), np.abs(high)))

    def curve(self, name: str) -> tuple[Array, Array]:
        """Return times in [s] and values of a state to draw, no peak lost."""
        time = self.time()
        if self.stride == 1:
            return time, self.first(name)
        both = np.stack([self._of(name, 1), self._of(name, 2)], axis=1)
        return np.repeat(time, 2), both.reshape(-1, both.shape[2])

    def has(self, name: str) -> bool:
        """Return whether somebody tells a state, and it is a number in some tick."""
        return (
            name in self._columns
            and name in self.told
            and bool(np.isfinite(self.first(name)).any())
        )

    def unfit(self) -> dict[str, float]:
        """Return states that were not a number for a while: when first, in [s] of the run."""
        found = {}
        for name in self._columns:
            bad = ~np.isfinite(self._of(name, 1) + self._of(name, 2)).all(axis=1)
            if self.has(name) and bad.any():
                found[name] = float(self.time()[bad.argmax()])
        return found

    def _of(self, name: str, which: int) -> Array:
        """Return the first (0), lowest (1) or highest (2) values of a state in each row."""
        return self._rows[: self._used, which, self._columns[name]]

    @property
    def _used(self) -> int:
        return self._row + (self._in_row > 0)


MOST_TOLD = 4
"""Joints beyond a limit that are named at the head; the pictures show all of them red."""


class Pictured(Keeper):
    """What `--picture` and `--report FILE.html` need of a run: keeps what is drawn at its end.

    Args:
        picture: path of the PNG, or "".
        page: path of the page, or "".

    Attributes:
        page: as given.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """

    def __init__(self, picture: str | None, page: str | Path) -> None:
        super().__init__("--picture" if picture else "--report FILE.html")
        self._picture, self.page = picture or "", page

    def attach(self, runner: Runner) -> None:
        """Get to know the runner, before its first tick: its files may be others later."""
        super().attach(runner)
        if self.page:
            self._run = runner
            self._facts = facts_of(runner, {})
            self._begun = time.strftime("%Y-%m-%d %H:%M:%S %z")
            self._phases = dict(describe(runner.program))

    def files(self, report: Report) -> Iterator[File]:
        """See `Attachment`."""
        yield "report", str(self.page), partial(self.write, report)
        yield "picture", self._picture, partial(self.draw, report)

    def draw(self, report: Report) -> None:
        """Write the PNG.

        Raises:
            UniconError: it cannot be written.
        """
        write_overview(self._picture, self, _title(report))

    def write(self, report: Report) -> None:
        """Write the page, folders made as needed.

        Raises:
            UniconError: the page cannot be written.
        """
        parts = [
            findings(self._said(report), bad=bool(report.faults or report.fell)),
            "<h2>Run</h2>",
            pairs(self._about(report)),
        ]
        for name, shown in drawings(PICTURES, self):
            parts.append(shown)
            if name == "ranges":
                parts += ["<h2>Every joint</h2>", self._joints()]
        parts += ["<h2>Blocks</h2>", self._blocks(report), "<h2>Phases</h2>", self._in_phases()]
        if report.traceback:
            parts += ["<h2>Traceback</h2>", f"<pre>{html.escape(report.traceback)}</pre>"]
        parts += [
            "<h2>What was run</h2>",
            pairs(self._files(report)),
            f'<p class="sub">unicon_ros {__version__}; all figures with all digits: '
            "--report FILE.json; every state of every tick: --record FILE.mcap</p>",
        ]
        robots = self._run.program.states.num_robots
        many = "" if robots is None else f"; the first of {robots} robots is shown"
        text = page(_title(report), f"begun {self._begun}{many}", parts)
        write_file(Path(self.page), text.encode(), folders=True)

    def _said(self, report: Report) -> list[str]:
        """Return what stands out, most important first."""
        said = [f"Fault: {fault}" for fault in report.faults]
        if not said:
            said = [f"Ended: {report.ended}, after {report.duration_s:.2f} s of ticks, no fault."]
        if "fault_record" in report.extra:
            file = report.extra["fault_record"]
            said.append(
                f"The last ticks before the fault are in {file}: unicon view shows them, unicon "
                "replay --verify computes them again."
            )
        if report.fell:
            said.append(f"The base leaned by up to {report.tilt_deg:g}°, which counts as a fall.")
        if past := beyond(self):
            more = f" and {len(past) - MOST_TOLD} more" if len(past) > MOST_TOLD else ""
            tripped = "" if report.faults else "; no safety block stopped the run for it"
            said.append(f"Beyond a limit: {'; '.join(past[:MOST_TOLD])}{more}{tripped}.")
        for name, when in self.unfit().items():
            said.append(f"{name} was not a number, first at {when:.2f} s: a gap in the curves.")
        if report.ticks and report.overruns:
            worst = ", ".join(f"{name} ({n})" for name, n in report.overrun_blocks.items())
            said.append(
                f"{report.overruns} of {report.ticks} deadlines were missed"
                + (f"; most time took {worst}." if worst else ".")
            )
        said += [f"Advice: {report.advice}."] if report.advice else []
        if report.forced:
            said.append(
                f"It was forced past these errors of the check: {', '.join(report.forced)}."
            )
        said += [f"Without safety block {n}: {why}." for n, why in report.safety_left_out.items()]
        said += ["Dry: nothing was sent."] if report.dry else []
        return said

    def _about(self, report: Report) -> dict[str, str]:
        late, busy = report.late_us, report.tick_us
        period = self.period
        about = {
            "ticks": f"{report.ticks:,} of {period * 1e3:g} ms ({1 / period:g} Hz), "
            f"{report.duration_s:.2f} s",
            "wall time": f"{report.wall_text()}, speed {self._run.options.speed}",
            "tick busy": _times(busy),
            **({"tick late": _times(late)} if self.paced else {}),
            "overruns": f"{report.overruns}",
            "base": report.base_moved(),
            "safety": ", ".join(report.safety) or "none",
        }
        if report.startup_s is not None:
            about["start-up"] = f"{report.startup_s:.2f} s to the first tick"
        if report.bridge is not None:
            about["ROS 2"] = (
                f"published {report.bridge.get('published', 0)}, received "
                f"{report.bridge.get('received', 0)} messages"
            )
        return about

    def _joints(self) -> str:
        robot = self.robot
        if not self.ticks:
            return "<p>no tick was run</p>"
        heads = ["joint", "lowest\nrad", "highest\nrad", "lower limit\nrad", "upper limit\nrad"]
        columns = [*self.reached("joint_pos"), robot.lower, robot.upper]
        for state, limit, unit, what in (
            ("joint_vel", robot.velocity_limit, "rad/s", "speed"),
            ("joint_effort", robot.effort_limit, "N·m", "torque"),
        ):
            if self.has(state):
                columns += [self.largest(state), limit]
                heads += [f"largest {what}\n{unit}", f"{what} limit\n{unit}"]
        rows = [
            [name, *(number(float(column[k])) for column in columns)]
            for k, name in enumerate(robot.joint_names)
        ]
        return table(heads, rows)

    def _blocks(self, report: Report) -> str:
        period = self.period * 1e6
        heads = ["block", "p50\nµs", "p99\nµs", "max\nµs"]
        heads += ["p50\n% of the period", "calls", "late ticks by it"]
        rows = [
            [
                label,
                *(f"{times[name]:.1f}" for name in ("p50", "p99", "max")),
                f"{100 * times['p50'] / period:.2f}",
                f"{times['calls']:.0f}",
                str(report.overrun_blocks.get(label, 0)),
            ]
            for label, times in report.blocks.items()
        ]
        return table(heads, rows)

    def _in_phases(self) -> str:
        rows = [
            [
                phase,
                f"{(begin - self.begin) * self.period:.2f}",
                str(end - begin),
                self._phases.get(phase, ""),
            ]
            for phase, begin, end in self.spans()
        ]
        return table(["phase", "begins [s]", "ticks", "what it is"], rows, words=True)

    def _files(self, report: Report) -> dict[str, str]:
        facts = self._facts
        overridden = json.loads(facts["overridden"])
        policies = json.loads(facts["policies"])
        versions = json.loads(facts["versions"])
        return {
            "workflow": place(facts["workflow_path"]),
            "changed by --set": ", ".join(map(str, overridden)) or "nothing",
            "robot file": place(self.robot.path),
            "seed": facts["seed"],
            **{f"policy {name}": place(each["model"]) for name, each in policies.items()},
            **{f"SHA-256 of {name}": each["sha256"] for name, each in policies.items()},
            "SHA-256 of the commands": report.sha256_commands,
            "layout of the states": facts["layout_hash"],
            "versions": ", ".join(f"{name} {version}" for name, version in versions.items()),
            **{
                key.replace("_", " "): value if isinstance(value, str) else json.dumps(value)
                for key, value in report.extra.items()
            },
        }


def _title(report: Report) -> str:
    return f"{report.workflow} on {report.robot} ({report.platform})"


def _times(us: dict[str, float]) -> str:
    return ", ".join(f"{name} {us.get(name, 0.0):,.0f} µs" for name in ("p50", "p99", "max"))

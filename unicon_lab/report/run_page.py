"""What a run did: as one page that needs nothing beside it, and as a picture."""

from __future__ import annotations

import html
import json
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from unicon_core import __version__
from unicon_core.drawing import drawings
from unicon_core.page import (
    Html,
    answers,
    findings,
    link,
    number,
    page,
    pairs,
    place,
    shell,
    table,
    write_file,
)
from unicon_core.runtime.phases import describe
from unicon_lab.recording.run_recording import facts_of
from unicon_lab.report import ANSWERING, words
from unicon_lab.report.pictures import PICTURES, beyond, nearest, write_overview
from unicon_lab.report.run_samples import Keeper
from unicon_ros.attachments import File

if TYPE_CHECKING:
    from unicon_core.runtime import Report, Runner

MOST_TOLD = 4
"""Joints beyond a limit that are named at the head; the table has all."""


class Pictured(Keeper):
    """What `--picture` and `--report FILE.html` need of a run: keeps what is drawn at its end.

    Args:
        picture: path of the PNG, or "".
        page: path of the page, or "".
        recorded: path of the run's recording, or "".

    Attributes:
        page: as given.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """

    def __init__(self, picture: str | None, page: str | Path, recorded: str | Path = "") -> None:
        super().__init__("--picture" if picture else "--report FILE.html")
        self._picture, self.page, self._recorded = picture or "", page, recorded

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
            self._answers(report),
            findings(self._said(report), bad=bool(report.faults or report.fell)),
            "<h2>Run</h2>",
            pairs(self._about(report)),
        ]
        parts += [shown for _, shown in drawings(PICTURES, self)]
        parts += [
            "<h2>Every joint</h2>",
            self._joints(),
            "<h2>Blocks</h2>",
            self._blocks(report),
            "<h2>Phases</h2>",
            self._in_phases(),
        ]
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

    def _answers(self, report: Report) -> str:
        joint, when = nearest(self) if self.ticks else ("no tick was run", "–")
        states = {name: self.first(name) for name in ANSWERING if self.has(name)}
        fast, fell, asked = words(states, self.stride * self.period)
        if report.fell is None:
            fell = f"cannot fall: {report.base_moved()}"
        recorded = self._recorded or report.extra.get("fault_record", "")
        folder = Path(self.page).parent
        where = f"not recorded; {shell(f'unicon run {report.workflow} --record FILE.mcap')}"
        if recorded:
            where = f"{link(recorded, folder)} {shell(f'unicon view {quote(place(recorded))}')}"
        when += f" of {report.duration_s:.2f} s" if report.ticks else ", before the flow"
        return answers(joint, when, fast, fell, asked, Html(where))

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
            said.append(
                f"Beyond a limit: {'; '.join(past[:MOST_TOLD])}{more}{tripped}. A real joint meets "
                "its stop at a position limit; at its effort limit a motor gives no more."
            )
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

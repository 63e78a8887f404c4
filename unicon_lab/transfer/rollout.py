"""Transfer: its plan, and each row of it, a rollout in a process of its own (`python -m`).

The plan says which platforms and seeds are run, and refuses before anything starts. A rollout is a
sweep's row, with figures by the same code; besides, it tells what its simulator is, how long its
ticks took, and how far it is meanwhile. An engine that crashes takes nothing else with it, and
nothing is tried again.
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from unicon_base import AnyDict, MissingDependencyError, PlatformError, UniconError
from unicon_core.check import refuse_errors
from unicon_core.pacing import process_age_s
from unicon_core.page import write_json
from unicon_core.platforms.platform import info_of
from unicon_core.runtime.report import Report
from unicon_core.runtime.rollouts import Look, Rollout
from unicon_core.runtime.statistics import percentiles
from unicon_core.signals import SIGNALS, signal_name
from unicon_core.states import States
from unicon_core.workflow import Program, WorkflowDocument, load_document
from unicon_core.workflow.hardware import declared_facts
from unicon_core.workflow.members import read_platforms
from unicon_core.workflow.registry import find_factory, known
from unicon_lab.recording.run_recording import versions_here
from unicon_lab.sweep.figures import columns_of, finite_rows
from unicon_lab.sweep.plan import Row, one_robots_seed
from unicon_lab.sweep.pool import LOOK, PipedProcess
from unicon_lab.sweep.worker import RowRunner, Tell, WarmProgram, serve

SEEDS = 3
WITHOUT_PHYSICS = ("fake", "replay")
"""Simulated platforms that simulate no world: compared only where they are named."""
ROBOTS = "unicon_hardware."
"""Where platforms of robots are: 2 s to import, for nothing."""


@dataclass(frozen=True)
class Plan:
    """What is run.

    Attributes:
        document: the workflow, as its file and `--set` have it.
        overrides: texts of `--set`.
        platforms: in order; the others are compared with the first.
        asked: the platforms were named by the user, so that a missing one is a row.
        seeds: of `scene.seed`.
        duration: in [s], None for the workflow's.
        timeout: in [s] of wall time for a run.
        notes: what was decided otherwise than asked for, in sentences.
    """

    document: WorkflowDocument
    overrides: tuple[str, ...]
    platforms: tuple[str, ...]
    asked: bool
    seeds: tuple[int, ...]
    duration: float | None
    timeout: float
    notes: tuple[str, ...]

    @property
    def longest(self) -> float:
        """Time in [s] after which a run ends at the latest."""
        said = self.document.get("duration")
        return float(said if self.duration is None else self.duration)

    def task(self) -> AnyDict:
        """Return what a worker begins with, as in a sweep."""
        task = {"workflow": str(self.document.path), "duration": self.longest}
        return task | {"stops_at_fall": False, "reference": None}

    def rows(self) -> list[Row]:
        """Return all runs, as a sweep's grid of seeds and platforms; values are platform and seed.

        Seed by seed: whatever ends it leaves platforms with equally many runs.
        """
        return [
            Row(
                i * len(self.platforms) + k,
                0,
                (platform, seed),
                (*self.overrides, f"platform={platform}", f"scene.seed={seed}"),
                f"seed_{seed}",
            )
            for i, seed in enumerate(self.seeds)
            for k, platform in enumerate(self.platforms)
        ]


def make_plan(
    workflow: str,
    overrides: Sequence[str],
    platforms: str | None,
    seeds: int | None,
    duration: float | None,
    timeout: float,
) -> Plan:
    """Decide what is run.

    Args:
        workflow: name or path.
        overrides: texts of `--set`.
        platforms: names with commas between, or None for every simulator.
        seeds: how many, or None.
        duration: in [s], or None for the workflow's.
        timeout: in [s].

    Raises:
        UniconError: the workflow is wrong or may never end, a platform is unknown or a robot.
    """
    document = load_document(workflow, overrides)
    if duration is None and document.get("duration") is None:
        raise UniconError(
            f"workflow {document.name} says no duration, so it may never end; give --duration S"
        )
    notes: list[str] = []
    names = _every(document, notes) if platforms is None else _named(platforms, notes)
    scene = document.values.get("scene")
    scene = scene if isinstance(scene, dict) else {}
    first = one_robots_seed(document)
    count = SEEDS if seeds is None else seeds
    # A simulator draws noise and pushes alone from its seed: nothing else differs.
    if not (scene.get("noise") or scene.get("push")):
        if seeds is not None and seeds > 1:
            notes.append(
                "All seeds would be the same run, since the scene has neither noise nor push: one "
                "run for each platform (--set scene.noise.joint_vel=0.1 disturbs them)."
            )
        count = 1
    seeds_of = tuple(first + k for k in range(count))
    asked = platforms is not None
    texts = tuple(overrides)
    return Plan(document, texts, names, asked, seeds_of, duration, timeout, tuple(notes))


def _named(text: str, notes: list[str]) -> tuple[str, ...]:
    """Return the platforms that the user named, each once."""
    given = [name.strip() for name in text.split(",")]
    names = tuple(dict.fromkeys(name for name in given if name))
    if not names:
        raise PlatformError(
            f"--platforms {text!r} names none; give some of {', '.join(simulators())}"
        )
    twice = [name for name in names if given.count(name) > 1]
    if twice:
        notes.append(f"{', '.join(twice)} is named more than once and was run once.")
    for name in names:
        if not re.fullmatch(r"[\w.:-]+", name):
            raise PlatformError(f"--platforms: {name!r} is not a name; put commas between names")
        try:
            if _is_robot(name):
                raise PlatformError(
                    f"platform {name!r} is a robot, and a transfer compares simulators: "
                    f"{', '.join(simulators())}"
                )
        except MissingDependencyError:
            continue  # a row will say so
    return names


def _every(document: WorkflowDocument, notes: list[str]) -> tuple[str, ...]:
    """Return all simulators, the workflow's own first."""
    own = read_platforms(document).get("")
    names = simulators()
    if own is None:  # one for each member: none of them is all of the robot
        return names
    try:
        robot = _is_robot(own.name)
    except MissingDependencyError:
        robot = False
    if robot:
        notes.append(f"Platform {own.name}, the workflow's, is a robot and was left out.")
        return names
    return own.name, *(name for name in names if name != own.name)


OURS = ("unicon_core.", "unicon_sims.")
"""Factories of our own simulators begin so."""


def simulators() -> tuple[str, ...]:
    """Return the names of all simulators that are known, installed or not; ours come first.

    Of two names of one factory it is the first.
    """
    found: list[str] = []
    targets = known("platforms")
    for name in sorted(targets, key=lambda name: not targets[name].startswith(OURS)):
        if name in WITHOUT_PHYSICS or targets[name].startswith(ROBOTS):
            continue
        try:
            robot = _is_robot(name)
        except (MissingDependencyError, PlatformError):
            robot = True  # nobody can say what it is
        if not robot and targets[name] not in [targets[other] for other in found]:
            found.append(name)
    return tuple(found)


def _is_robot(name: str) -> bool:
    factory = find_factory("platforms", name, PlatformError)
    return not declared_facts(factory, name).simulated


KEPT = (
    *("joint_pos", "joint_vel", "joint_pos_target", "joint_effort"),
    *("base_pos_w", "base_quat", "projected_gravity", "base_ang_vel", "velocity_command"),
)
"""States that are kept of every tick, as they are at its end."""
FIGURES = (
    *("distance_m", "commanded_m", "speed_error", "turn_error", "energy_j", "tilt_deg"),
    *("fall_s", "ticks", "duration_s", "sha256_commands"),
)
"""Of a sweep's row."""
TELL_NS = 100_000_000
"""Time between two words on how far it is."""


class Watch:
    """Times the ticks of a rollout, and tells how far it is; a look that ends nothing.

    Args:
        period: of a tick in [s].
        tell: is told.
    """

    def __init__(self, period: float, tell: Tell) -> None:
        self._period, self._tell, self._next = period, tell, 0
        self.startup_s = process_age_s()
        self.stamps = [time.perf_counter_ns()]

    def __call__(self) -> bool:
        self.stamps.append(now := time.perf_counter_ns())
        if now >= self._next:
            self._next = now + TELL_NS
            self._tell({"at": (len(self.stamps) - 1) * self._period})
        return False


class TimedRunner(RowRunner):
    """Runs the row of a transfer.

    Args:
        task: as of `RowRunner`.
        tell: tells the parent `at`: the time in [s] that is simulated.
    """

    def __init__(self, task: AnyDict, tell: Tell) -> None:
        super().__init__(task)
        self._tell = tell
        self._warnings: list[str] = []

    def begin(self, index: int, settings: list[str], name: str = "") -> AnyDict | None:
        """As of `RowRunner`; what is not installed is an outcome here."""
        try:
            return super().begin(index, settings, name)
        except MissingDependencyError as error:
            return {"row": {"outcome": "missing", "text": str(error)}}

    def look(self, program: Program) -> Callable[[States], Look]:
        program.warn = self._warnings.append
        self._warnings += refuse_errors(program)

        def watch(states: States) -> Look:
            self._watch = Watch(program.period, self._tell)
            return self._watch

        return watch

    def of(self, kept: WarmProgram, rollout: Rollout) -> AnyDict:
        """Return `row`, and `run` besides."""
        watch, program = self._watch, kept.rollouts.program
        if not rollout.ticks and not rollout.fault:
            raise UniconError(
                f"it has no tick: they are {program.period:g} s; give a longer --duration"
            )
        told = super().of(kept, rollout)
        row, report = (
            told["row"],
            Report(program.name, program.robot.name, "", **program.monitor.found()),
        )
        places = columns_of(program.states, KEPT)
        states = {name: rollout.states[:, place] for name, place in places.items()}
        networks = {k.partition(" ")[2]: v for k, v in kept.facts.items() if k[:8] == "network "}
        told["run"] = {name: row[name] for name in FIGURES} | {
            "robot": program.robot.name,
            "period_s": program.period,
            "policies": networks,
            "info": dict(info_of(program.platform)),
            "wall_s": round((watch.stamps[-1] - watch.stamps[0]) * 1e-9, 3),
            "startup_s": watch.startup_s and round(watch.startup_s, 3),
            "tick_us": percentiles(np.diff(watch.stamps) * 1e-3),
            "faults": [rollout.fault] if rollout.fault else [],
            "ended": rollout.ended,
            "fell": report.fell,
            "base_displacement_m": report.base_displacement_m,
            "safety": list(program.safety),
            "safety_left_out": dict(program.safety_left_out),
            "warnings": self._warnings,
            "versions": versions_here(),
            "kept_rows": rollout.ticks,
            "finite_rows": finite_rows(states),
        }
        return told


Progress = Callable[[float], None]
"""Takes the time in [s] that a run has simulated, 0 before its first tick; called often."""


def run_one(plan: Plan, row: Row, folder: Path, tell: Progress) -> AnyDict:
    """Run a platform with a seed to its end, whatever that is.

    Args:
        plan: of the transfer.
        row: one of it.
        folder: where its files go: `PLATFORM/seed_K.npz`, `.json` and `.log`.
        tell: called as it goes on.

    Returns:
        What the run told; `outcome` is `ran`, `missing` (not installed), `refused`, `crashed`,
        `timeout` or `interrupted`, and `text` says why.

    Raises:
        UniconError: its files cannot be written.
    """
    platform, seed = row.values
    files = folder / re.sub(r"[^\w.-]", "_", platform) / row.name
    keep = {"folder": str(files.parent.absolute()), "states": KEPT}
    try:
        files.parent.mkdir(parents=True, exist_ok=True)
        files.with_suffix(".npz").unlink(missing_ok=True)
        process = PipedProcess("unicon_lab.transfer.rollout", files.with_suffix(".log"), {})
    except OSError as error:
        raise UniconError(
            f"cannot write {error.filename or files}: {error.strerror}; give a writable folder "
            "with room to --out"
        ) from error
    process.write(plan.task() | {"keep": keep})
    process.write({"index": row.index, "settings": row.settings, "name": row.name})
    told: AnyDict = {}
    try:
        told = _watched(process, plan.timeout, tell)
    finally:
        how = process.end()
    if SIGNALS.asked and not told:
        told = {"outcome": "interrupted", "text": f"ended by {signal_name(SIGNALS.asked)}"}
    elif not told:
        told = {"outcome": "crashed", "text": how}
    told = {"seed": seed} | told
    if told["outcome"] == "ran":
        told["file"] = str(files.with_suffix(".npz").relative_to(folder.parent))
        told["log"] = ""
        with suppress(UniconError):  # a full disk: the caller's own file tells
            write_json(files.with_suffix(".json"), told)
    return told


def _watched(process: PipedProcess, timeout: float, tell: Progress) -> AnyDict:
    """Wait for what a process tells of its row; return {} of one that ended, or was not awaited."""
    seconds, end = 0.0, time.monotonic() + timeout
    while not SIGNALS.asked and not process.over:
        tell(seconds)
        if process.connection.poll(LOOK):
            for told in process.heard():
                if "error" in told:
                    return {"outcome": "refused", "text": told["error"]}
                if "run" in told:
                    return {"outcome": "ran", "text": "", **told["run"]}
                if "row" in told:
                    return {key: told["row"][key] for key in ("outcome", "text")}
                seconds = told["at"]
        if time.monotonic() > end:
            text = f"no end within {timeout:g} s; it was ended (--timeout S)"
            return {"outcome": "timeout", "text": text}
        if text := process.flooded():
            return {"outcome": "crashed", "text": text}
    return {}


if __name__ == "__main__":
    sys.exit(serve(TimedRunner))

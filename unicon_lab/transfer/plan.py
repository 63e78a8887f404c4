"""Plan: which platforms and seeds a transfer runs, decided and refused before anything starts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from unicon_base.errors import MissingDependencyError, PlatformError, UniconError
from unicon_core.workflow import load_document
from unicon_core.workflow.document import WorkflowDocument
from unicon_core.workflow.hardware import declared_facts
from unicon_core.workflow.members import read_platforms
from unicon_core.workflow.registry import find_factory, known
from unicon_lab.sweep.plan import Row, one_robots_seed

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

    def task(self) -> dict[str, Any]:
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

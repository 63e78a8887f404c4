"""Plan: which rollouts a sweep has; row i follows from the file and i, and from nothing else."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import unicon_core
from unicon_base import AnyDict, AnyMapping, UniconError, WorkflowError, imported
from unicon_base.arrays import Float64
from unicon_base.located_yaml import Located, read_yaml
from unicon_base.resources import find_config, sha256_of, sha256_text
from unicon_core import __version__
from unicon_core.workflow.document import WorkflowDocument, document_at
from unicon_core.workflow.platforms import facts_of_all, find_platforms
from unicon_lab.sweep.draws import setting_of
from unicon_lab.sweep.sweep_file import SCHEMA, SweepFile

STATES = "kept"
"""Folder of the states that are kept, in that of the sweep."""


@dataclass(frozen=True)
class Row:
    """One rollout.

    Attributes:
        index: of the row.
        repetition: of its point, from 0.
        values: of the parameters.
        settings: texts of `--set`.
        name: of the file with its states, where they are kept.
    """

    index: int
    repetition: int
    values: tuple[Any, ...]
    settings: tuple[str, ...]
    name: str = ""


def row_name(index: int) -> str:
    """Return the name of the file with a row's states, without its ending."""
    return f"row_{index:06d}"


class Plan:
    """All rollouts of a sweep.

    Args:
        sweep: as it was read.

    Attributes:
        sweep: the same.
        workflow_file: as it was read.
        document: the workflow of the first row.
        duration: of a rollout at most in [s].

    Raises:
        UniconError: the workflow is wrong, or may never end.
    """

    def __init__(self, sweep: SweepFile) -> None:
        self.sweep = sweep
        path = find_config("workflows", sweep.workflow, error=WorkflowError)
        self.workflow_file = read_yaml(path, WorkflowError)
        self._seed = 0
        first = self.row(0).settings
        base = document_with(self.workflow_file, first[:-1] if sweep.said.repeat > 1 else first)
        self._seed = one_robots_seed(base)
        self.document = document_with(self.workflow_file, self.row(0).settings)
        one_robots_seed(self.document)
        refuse_robot(self.document)
        said = self.document.get("duration")
        if sweep.said.duration is None and said is None:
            raise UniconError(
                f"workflow {base.name} says no duration, so it may never end; give duration in "
                f"{sweep.path}"
            )
        self.duration = float(said if sweep.said.duration is None else sweep.said.duration)

    def __len__(self) -> int:
        return self.sweep.rows

    def __iter__(self) -> Iterator[Row]:
        return map(self.row, range(len(self)))

    def row(self, index: int) -> Row:
        """Return row `index`."""
        sweep = self.sweep
        point, repetition = divmod(index, sweep.said.repeat)
        values = self._point(point)
        settings = [setting_of(p.path, value) for p, value in zip(sweep.parameters, values)]
        if sweep.said.repeat > 1:
            settings.append(setting_of("scene.seed", self._seed + repetition))
        return Row(index, repetition, values, (*sweep.settings, *settings), row_name(index))

    def _point(self, point: int) -> tuple[Any, ...]:
        parameters = self.sweep.parameters
        if self.sweep.said.sample == "grid":  # the last parameter changes first
            every = [each.values or () for each in parameters]
            at = np.unravel_index(point, [len(values) for values in every])
            return tuple(values[k] for values, k in zip(every, at))
        if self.sweep.said.sample == "sobol":
            places = self._sobol[point]
        else:
            places = np.random.default_rng((self.sweep.said.seed, point)).random(len(parameters))
        return tuple(each.at(u) for each, u in zip(parameters, places.tolist()))

    @cached_property
    def _sobol(self) -> Float64:
        """All points of a scrambled Sobol sequence, shape (points, parameters)."""
        qmc = imported("scipy.stats", "sample: sobol", "sweep").qmc
        count = self.sweep.points
        bits = max(1, (count - 1).bit_length())
        random = np.random.default_rng(self.sweep.said.seed)
        sequence = qmc.Sobol(len(self.sweep.parameters), scramble=True, rng=random)
        points: Float64 = sequence.random_base2(bits)[:count]
        return points

    def identity(self) -> AnyDict:
        """Return what decides every row, as plain values: two sweeps with the same are the same."""
        sweep, document = self.sweep, self.workflow_file
        return {
            "schema": SCHEMA,
            "workflow": self.document.name,
            "sha256_workflow": sha256_of(document.path),
            "set": list(sweep.settings),
            "vary": [[each.path, each.words] for each in sweep.parameters],
            "sample": sweep.said.sample,
            "points": sweep.points,
            "seed": sweep.said.seed,
            "repeat": sweep.said.repeat,
            "duration_s": self.duration,
            "early_stop": sweep.said.early_stop == "fall",
            "sha256_reference": None if sweep.reference is None else sha256_of(sweep.reference),
        }

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of `identity`."""
        return sha256_text(json.dumps(self.identity(), sort_keys=True))

    def task(self, out: Path | None = None) -> AnyDict:
        """Return what a worker begins with.

        Args:
            out: folder of the sweep, for states that are kept; or None.
        """
        reference, keep = self.sweep.reference, {}
        if out is not None and self.sweep.keep:
            folder = str((out / STATES).absolute())
            keep = {"keep": {"folder": folder, "states": self.sweep.keep}}
        return keep | {
            "workflow": str(self.workflow_file.path),
            "duration": self.duration,
            "stops_at_fall": self.sweep.said.early_stop == "fall",
            "reference": None if reference is None else str(reference.absolute()),
        }


def one_robots_seed(document: WorkflowDocument) -> int:
    """Return `scene.seed` of a workflow of one robot, 0 unless told.

    Raises:
        WorkflowError: it is none, or the workflow has several robots.
    """
    if document.values.get("num_robots") is not None:
        raise document.error(
            "num_robots: a rollout has one robot; add --set num_robots=null", "num_robots"
        )
    scene = document.values.get("scene")
    return int((scene or {}).get("seed") or 0)


def refuse_robot(document: WorkflowDocument) -> None:
    """Refuse a workflow on a robot, before anything of it is opened.

    Raises:
        WorkflowError: it is on one.
    """
    facts = facts_of_all(find_platforms(document))
    if not facts.simulated:
        raise document.error(
            f"platform {facts.name!r} is a robot, and a sweep simulates; write set: {{platform: "
            "mujoco}",
            "platform",
        )


def document_with(located: Located, settings: Sequence[str]) -> WorkflowDocument:
    """Return the document of a workflow that was read once, with `--set` of a row.

    Raises:
        WorkflowError: a setting is wrong.
    """
    own = Located(located.path, deepcopy(located.value), located.lines, WorkflowError)
    return document_at(own, settings)


PACKAGES = ("numpy", "mujoco", "onnxruntime", "scipy")
"""Packages whose version may move the last bit of a row."""
ROWS = (
    *("unicon_base", "unicon_core", "unicon_manipulation", "unicon_sims"),
    *("unicon_lab/sweep", "unicon_lab/analysis"),
)
"""Folders of the code that makes rows."""


@lru_cache
def code_sha256() -> str:
    """Return the SHA-256 of the code that makes rows."""
    digest = hashlib.sha256()
    ours = Path(str(unicon_core.__file__)).parents[1]
    for folder in (ours / name for name in ROWS):
        for path in sorted((*folder.rglob("*.py"), *folder.rglob("*.yaml"))):
            digest.update(f"{path.relative_to(folder)}\n".encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def versions() -> dict[str, str]:
    """Return the versions of what makes rows."""
    found = {"unicon_ros": __version__}
    for name in PACKAGES:
        with suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


def differing(there: Mapping[str, str], here: Mapping[str, str]) -> Iterator[tuple[str, str, str]]:
    """Yield name, version there and version here of what differs, by name."""
    for name in sorted({*there, *here}):
        if there.get(name) != here.get(name):
            yield name, there.get(name, "absent"), here.get(name, "absent")


def changes(there: AnyMapping, here: AnyMapping, identity: AnyMapping) -> str:
    """Return how a folder's sweep differs from the one at hand, "" where it does not.

    Args:
        there: what the folder says.
        here: the same of now.
        identity: of the sweep at hand.
    """
    if there["sha256"] != here["sha256"]:
        said = there["identity"]
        which = [key for key in identity if said.get(key) != identity[key]]
        return f"it differs in {', '.join(which) or 'the file'}"
    if there.get("versions") != here["versions"]:
        found = differing(there.get("versions") or {}, here["versions"])
        return ", ".join(f"{name} was {old} and is {new}" for name, old, new in found)
    if there.get("code") != here["code"]:
        return "it was made by other code of the same version"
    if there.get("program") != here["program"]:
        return "robot, model or policy are other files by now"
    return ""

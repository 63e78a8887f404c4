"""Worker: a process that runs rows of a sweep, one or some at a time (`python -m`, see `engines`).

It reads its task and then rows from its parent, and tells it what became of each. What engines
print goes to the log that its parent made. It has one thread, and keeps models, networks and graphs
from row to row.
"""

from __future__ import annotations

import gc
import json
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from unicon_base import AnyDict, MissingDependencyError, UniconError, WorkflowError
from unicon_base.located_yaml import read_yaml
from unicon_base.resources import sha256_of, sha256_text
from unicon_core.models.find import model_of
from unicon_core.platforms.kit.scene import SCENE_KEYS
from unicon_core.policies.networks.onnx import share_sessions
from unicon_core.runtime.rollouts import Lockstep, Look, Rollout, Rollouts
from unicon_core.states import States
from unicon_core.workflow import Program, WorkflowDocument
from unicon_lab.analysis.run import Run, read_run
from unicon_lab.recording.run_recording import network_hash, robot_text
from unicon_lab.sweep.figures import FallLook, Figures, empty_row, keep_states, reference_for
from unicon_lab.sweep.plan import document_with, refuse_robot
from unicon_lab.sweep.pool import Line

LookAt = Callable[[Program], Callable[[States], Look] | None]
MOST = 4
"""Programs that are kept beside those that run; each holds a model and a network."""

BUILT_ANEW = ("model", "mounts")
"""Keys of a scene that make another model."""
DISTURBS = ("delay", "noise", "push")
"""Keys of a scene of which something stands around the platform, or nothing."""


@dataclass(eq=False)
class WarmProgram:
    """A program that is kept.

    Attributes:
        key: what a document has to share with its own, as of `key_of`.
        rollouts: of it.
        figures: of them.
        facts: what it is made of: name to SHA-256.
        sha256: of the facts, as of `program_sha256`.
        period: of a tick in [s].
    """

    key: str
    rollouts: Rollouts
    figures: Figures
    facts: dict[str, str]
    sha256: str
    period: float

    def close(self) -> None:
        """Let go; how a simulator ends does not matter."""
        with suppress(Exception):
            self.rollouts.program.close()


class WarmPrograms:
    """The programs of one process.

    A row that differs from one before in its scene alone begins anew in 4 ms, on other ground in
    14 to 50; a program takes 60 ms to be built.

    Args:
        look: takes a program that was just built, and returns what makes looks at its rollouts.
        reference: to compare with, or None.
        beside: programs that may run side by side.

    Attributes:
        built: programs that were built.
        why_not: why a program could not begin anew, the last such reason; "" for none.
    """

    def __init__(self, look: LookAt, reference: Run | None, beside: int = 1) -> None:
        self._look, self._reference, self._beside = look, reference, beside
        self._kept: list[WarmProgram] = []
        self.built = 0
        self.why_not = ""

    def begun(self, document: WorkflowDocument) -> WarmProgram:
        """Return a program of a document at its beginning, which the caller has until `keep`.

        Raises:
            UniconError: it cannot be built.
        """
        key = key_of(document)
        kept = next((each for each in reversed(self._kept) if each.key == key), None)
        if kept is not None:
            self._kept.remove(kept)
            if not kept.rollouts.why_not:
                try:
                    kept.rollouts.begin(document)
                except BaseException:
                    kept.close()
                    raise
                return kept
            kept.close()
        return self._build(document, key)

    def keep(self, kept: WarmProgram) -> None:
        """Take a program back for another row; its rollout is of no use then."""
        self._kept.append(kept)
        if len(self._kept) >= MOST + self._beside:
            self._kept.pop(0).close()

    def _build(self, document: WorkflowDocument, key: str) -> WarmProgram:
        refuse_robot(document)
        program = Program(document)
        try:
            rollouts = Rollouts(program, self._look(program), beside=self._beside > 1)
            told = self._reference
            reference = told and reference_for(told, program.robot, program.period)
            figures = Figures(program.states, program.robot, program.period, reference)
            facts = facts_of(program)
        except BaseException:
            program.close()
            raise
        self.built += 1
        gc.freeze()  # no pass over what stays: 2 ms each
        self.why_not = rollouts.why_not or self.why_not
        return WarmProgram(key, rollouts, figures, facts, program_sha256(program), program.period)

    def close(self) -> None:
        """Let all go."""
        for kept in self._kept:
            kept.close()
        self._kept.clear()


def key_of(document: WorkflowDocument) -> str:
    """Return what a document has to share with another to begin anew in its program."""
    values = dict(document.values)
    scene = values.pop("scene", None)
    scene = scene if isinstance(scene, dict) else {}
    fixed = {key: value for key, value in scene.items() if key not in SCENE_KEYS}
    fixed |= {key: scene[key] for key in BUILT_ANEW if key in scene}
    disturbed = any(scene.get(key) for key in DISTURBS)
    return json.dumps([values, fixed, disturbed], sort_keys=True, default=repr)


def program_sha256(program: Program) -> str:
    """Return the hash of what a program is made of, 16 digits."""
    return sha256_text(json.dumps(facts_of(program), sort_keys=True))[:16]


def facts_of(program: Program) -> dict[str, str]:
    """Return what a program is made of: name to SHA-256 of the files."""
    facts = {
        "robot": sha256_text(robot_text(program.robot)),
        "robot_name": program.robot.name,
        "platform": program.platform.facts.name,
    }
    with suppress(UniconError, OSError):
        facts["model"] = sha256_of(model_of(program.platform, program.robot))
    for name, contract in program.policies.items():
        facts[f"policy {name}"] = sha256_of(contract.path)
        facts[f"network {name}"] = network_hash(contract.model)
    return facts


Tell = Callable[[AnyDict], None]
"""Tells the parent something, while a row runs too."""


class RowRunner:
    """Runs rows.

    Args:
        task: `workflow` (file), `duration`, `stops_at_fall` and `reference` (file or None); where
            states are kept, `keep`: their `folder` and the names of the `states`; `batch`, where
            more than one row is run at a time.
        said: an error, as the row of a refused rollout has it.

    Raises:
        UniconError: a file cannot be read.
    """

    def __init__(self, task: AnyDict, said: Callable[[object], str] = str) -> None:
        self._said = said
        self._located = read_yaml(Path(task["workflow"]), WorkflowError)
        reference = task["reference"]
        told = None if reference is None else read_run(Path(reference))
        self.batch = int(task.get("batch", 1))
        if self.batch > 1:
            share_sessions()
        self.programs = WarmPrograms(self.look, told, self.batch)
        self._stops = bool(task["stops_at_fall"])
        self._duration = float(task["duration"])
        self._keep = task.get("keep")
        self._told: set[str] = set()
        self._running: Lockstep[tuple[int, str, WarmProgram]] = Lockstep()

    def __call__(self, settings: list[str], name: str = "") -> AnyDict:
        """Return `row` of some settings; where a program is new, also its `facts`.

        Args:
            settings: texts of `--set`.
            name: of the file with its states, where they are kept.

        Raises:
            MissingDependencyError: what it needs is not installed.
            UniconError: its states cannot be written.
        """
        refused = self.begin(0, settings, name)
        if refused is not None:
            return refused
        while not (ended := self.tick()):
            pass
        ((_, told),) = ended
        return told

    def __len__(self) -> int:
        """How many rows are running."""
        return len(self._running)

    def begin(self, index: int, settings: list[str], name: str = "") -> AnyDict | None:
        """Have a row run beside the others; return what is told of it where it is refused."""
        try:
            kept = self.programs.begun(document_with(self._located, settings))
        except MissingDependencyError:
            raise  # it is so of every row
        except UniconError as error:
            return {"row": empty_row() | {"outcome": "refused", "text": self._said(error)[:300]}}
        limit = round(self._duration / kept.period)
        self._running.add((index, name, kept), kept.rollouts, limit)
        return None

    def tick(self) -> list[tuple[int, AnyDict]]:
        """Run a tick of each row; return the index of each that has ended, and what is told."""
        return [
            (index, self._ended(name, kept, rollout))
            for (index, name, kept), rollout in self._running.tick()
        ]

    def _ended(self, name: str, kept: WarmProgram, rollout: Rollout) -> AnyDict:
        if self._keep is not None:
            path = Path(self._keep["folder"], f"{name}.npz")
            keep_states(path, self._keep["states"], kept.rollouts.program, rollout)
        told = self.of(kept, rollout)
        self.programs.keep(kept)
        return told

    def look(self, program: Program) -> Callable[[States], Look] | None:
        """Return what makes looks at the rollouts of a program that was just built."""
        stops = self._stops and program.robot.floats
        return (lambda states: FallLook(states, program.period)) if stops else None

    def of(self, kept: WarmProgram, rollout: Rollout) -> AnyDict:
        """Return what is told of a rollout."""
        result = {"row": kept.figures(rollout) | {"program": kept.sha256}}
        if kept.sha256 not in self._told:
            self._told.add(kept.sha256)
            result["facts"] = {kept.sha256: kept.facts | {"period_s": repr(kept.period)}}
        return result

    def told(self, settings: list[str], name: str = "") -> AnyDict:
        """Return what is told of a row: as above with `why_not`, or an `error`."""
        try:
            return self.counted(self(settings, name))
        except UniconError as error:
            return {"error": self._said(error)}

    def counted(self, told: AnyDict) -> AnyDict:
        """Return what is told of a row with `why_not` of the programs so far."""
        return told | {"why_not": self.programs.why_not}


def serve(make: Callable[[AnyDict, Tell], RowRunner]) -> int:
    """Run rows until the line ends.

    Args:
        make: makes what runs them, of the task.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's
    line = Line()
    try:
        if task := line.read():
            _run(make(task, line.write), line)
    except UniconError as error:
        line.write({"error": str(error)})
        return 1
    return 0


def _run(runner: RowRunner, line: Line) -> None:
    """Run rows until none comes any more; each is told before the next one begins."""
    while not line.over or len(runner):
        for index, told in runner.tick():
            line.write(runner.counted(told) | {"index": index})
        while not line.over and len(runner) < runner.batch:
            # Waited for only where there is nothing else to do.
            if not line.connection.poll(0 if len(runner) else None) or not (row := line.read()):
                break
            refused = runner.begin(row["index"], row["settings"], row["name"])
            if refused is not None:
                line.write(runner.counted(refused) | {"index": row["index"]})


if __name__ == "__main__":
    sys.exit(serve(lambda task, tell: RowRunner(task)))

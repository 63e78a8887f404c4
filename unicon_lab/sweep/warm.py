"""Warm programs: what a worker keeps from one rollout to the next, by what it depends on.

A row that differs from one before in its scene alone begins anew in 4 ms, on other ground in 14 to
50; a program takes 60 ms to be built.
"""

from __future__ import annotations

import gc
import hashlib
import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from unicon_base.errors import UniconError
from unicon_base.resources import sha256_of
from unicon_core.models.find import model_of
from unicon_core.platforms.kit.scene import SCENE_KEYS
from unicon_core.runtime.rollouts import Look, Rollouts
from unicon_core.states import States
from unicon_core.workflow import Program
from unicon_core.workflow.document import WorkflowDocument
from unicon_lab.analysis.run import Run
from unicon_lab.recording.facts import network_hash, robot_text
from unicon_lab.sweep.figures import Figures, reference_for
from unicon_lab.sweep.plan import refuse_robot

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
    text = json.dumps(facts_of(program), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def facts_of(program: Program) -> dict[str, str]:
    """Return what a program is made of: name to SHA-256 of the files."""
    robot = hashlib.sha256(robot_text(program.robot).encode()).hexdigest()
    facts = {"robot": robot, "robot_name": program.robot.name}
    facts["platform"] = program.platform.facts.name
    with suppress(UniconError, OSError):
        facts["model"] = sha256_of(model_of(program.platform, program.robot))
    for name, contract in program.policies.items():
        facts[f"policy {name}"] = sha256_of(contract.path)
        facts[f"network {name}"] = network_hash(contract.model)
    return facts

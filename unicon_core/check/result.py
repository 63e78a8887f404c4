"""CheckResult: tables, findings and notes of a preflight check, for people and as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from unicon_core.aligned import aligned
from unicon_core.errors import UniconError, alternatives
from unicon_core.page import write_file
from unicon_core.terminal import WIDTH, near, wrapped

if TYPE_CHECKING:
    from unicon_core.policies import PolicyContract

CODES = {
    "build": "the workflow cannot be built",
    "graph": "the graph of blocks is wrong",
    "blocks.memory": "a block remembers what it does not declare (a note)",
    "joints.held": "joints that no policy moves (a note)",
    "joints.welded": "the simulated model lacks joints that no policy moves (a note)",
    "joints.seen": "a policy sees joints that other blocks move",
    "joints.motors": "motor slots do not fit the joints",
    "joints.order": "the joints are named in another order than the figures have",
    "evidence": "what the platform or the robot was run against, where that is little (a note)",
    "gains.differ": "the policy's gains are not the robot file's (a note)",
    "gains.symmetry": "left and right joints have different gains",
    "gains.damping": "a joint has stiffness but no damping",
    "gains.passive": "the model's joints damp themselves about as much as the policy does (a note)",
    "gains.stiff": "a joint is at its effort limit within a tenth of a radian, or by its damping",
    "gains.swapped": "damping is greater than stiffness",
    "limits.differ": "robot file and model have other limits (a note)",
    "limits.effort": "effort limits of robot file and model are far apart",
    "action.scale": "one unit of action is more than a joint's range, or nothing (up to 1 a note)",
    "action.limp": "a joint is given positions and has no stiffness",
    "action.symmetry": "left and right joints have different action scales",
    "action.offset": "action 0 means a target outside the limits",
    "action.reach": "clipped actions reach far outside the limits, and nothing limits targets",
    "action.unsent": "the platform does not send the velocities or torques that are commanded",
    "action.torque": "one unit of action asks for more torque than there is (a note)",
    "observation.scale": "a term is multiplied by 0 (some elements, or an odd factor: a note)",
    "observation.clip": "a term is clipped to a single value",
    "observation.measured": "a term cannot be measured on this platform",
    "observation.frame": "the platform's orientation and gravity contradict each other",
    "timing.period": "the control period is not plausible",
    "timing.clock": "a phase or the period of the gait clock is in another unit",
    "timing.catch_up": "missed ticks shall be caught up on a robot",
    "timing.trigger": "ticks shall come with data of a platform that cannot tell when they arrive",
    "command.range": "the workflow commands more than the policy was trained for",
    "command.bounds": "nobody says how much may be commanded (a note)",
    "policy.source": "what was read of a policy, and from where, or left open (a note)",
    "pose.differ": "the policy's default pose is not the robot file's (a note)",
    "pose.limits": "the default pose is outside the limits",
    "pose.symmetry": "the default pose is not the same on both sides",
    "pose.feet": "in the default pose the robot does not stand on its feet",
    "pose.floor": "the simulation begins inside the floor or far above it",
    "pose.start": "a policy is the first to move a robot that lies (simulated: a note)",
    "start.gates": "nothing is asked before a robot moves (a note)",
    "start.watchdog": "nothing damps a robot whose process is killed (a note)",
    "safety.none": "no safety block looks at commands (a note)",
    "safety.less": "a robot lacks safety blocks that others have (a note)",
    "safety.remote": "buttons that stop the robot (a note) have another meaning as well",
    "safety.partial": "a safety block does not look at every command, or at nothing",
    "parts.writers": "two parts of a divided workflow write one state",
    "parts.published": "a state does not reach the part that reads it, or nothing writes it",
    "parts.silent": "nobody says what is commanded when the part that commands is silent",
    "zmq.keys": "everybody on the network may read or write states, for want of keys",
    "platform.open": "what only the opened platform can tell (a note)",
    "model.meshes": "mesh files of the model are absent (a note)",
    "model.collision": "the robot's model does not collide with the floor",
    "model.bodies": "the model lacks a body that the robot file names (a note)",
    "reach.apart": "capsules that are near at the default pose are not kept apart (a note)",
    "map.fit": "the message map does not fit the states, or could not be looked at",
    "robot.facts": "the robot file lacks what is needed to drive the robot",
    "check.settings": "the workflow's check: section is wrong",
    "twin.run": "the twin could not be run",
    "twin.platform": "the twin runs on another platform than the workflow's (a note)",
    "twin.fall": "the policy falls in the twin",
    "twin.command": "the policy does not follow its command, or its motion, in the twin",
    "twin.suspect": "another contract does clearly better (a note where a broken one does as well)",
    "twin.saturated": "a joint is at its limit of effort or position for much of the walk",
}
"""What can be found. A workflow accepts one with `check: {accept: [CODE]}`: it is then a note."""

FIRM = (
    "build",
    "check.settings",
    "graph",
    "map.fit",
    "parts.published",
    "parts.silent",
    "parts.writers",
    "robot.facts",
    "timing.catch_up",
    "timing.trigger",
)
"""What a run cannot begin with: nobody can accept it or force it."""

CAUSES = (
    "check.settings",
    "build",
    "graph",
    "robot.facts",
    "parts.writers",
    "parts.published",
    "parts.silent",
    "joints.motors",
    "joints.order",  # then poses, scales and gains are at the wrong joints
    "model.collision",
    "limits.effort",  # then gains look too stiff
    "gains.swapped",
    "gains.damping",
    "pose.limits",  # then an action of 0, which is the pose, is outside the limits as well
    "pose.symmetry",
    "timing.period",
    "timing.clock",
    "observation.frame",
    "observation.scale",
    "observation.clip",
    "observation.measured",
    "action.limp",
    "action.scale",  # then the reach of the action is wrong as well
    "gains.symmetry",
    "action.symmetry",
    "action.offset",
    "gains.stiff",
    "pose.feet",
)
"""What explains other findings, most of them first; what is not named stands behind.

An order of joints that is wrong, for example, also gives poses outside the limits, different sides,
and feet in the air: whoever reads it shall begin with the order.
"""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or worth knowing.

    Attributes:
        code: one of `CODES`.
        culprit: who is to blame: a policy, joint, term or file.
        evidence: what was seen, with numbers.
        remedy: what to do about it.
        where: `file:line` or a file, "" where there is none.
        severity: `error` fails the check, `note` does not.
    """

    code: str
    culprit: str
    evidence: str
    remedy: str
    where: str = ""
    severity: Literal["error", "note"] = "error"

    def __str__(self) -> str:
        """The finding in one line."""
        text = f"{self.culprit}: {self.evidence}"
        text += f"; {self.remedy}" if self.remedy else ""
        return f"{text}  [{self.code}{f', {self.where}' if self.where else ''}]"


@dataclass(frozen=True)
class Section:
    """One table.

    Attributes:
        title: its heading.
        columns: names of the columns.
        rows: cells as text.
        lines: what stands below the table.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[str, ...] = ()

    def text(self, width: int = WIDTH) -> str:
        """Return the table with its heading, in lines of at most so many columns."""
        lines = wrapped(self.title, width, "", "  ")
        if self.rows:
            rows = [[near(cell) for cell in row] for row in (self.columns, *self.rows)]
            lines += [f"  {line}".rstrip() for line in aligned(rows, width=width - 2)]
        below = (wrapped(near(line), width, "  ", "    ") for line in self.lines)
        return "\n".join(chain(lines, *below))


@dataclass
class CheckResult:
    """All that a check found.

    Attributes:
        workflow: its name.
        subject: robot, platform and file, one line.
        findings: what fails the check; after the static checks what explains the others is first.
        notes: what does not.
        sections: tables.
        accepted: codes that the workflow accepts.
        waived: errors that are notes because of that.
    """

    workflow: str
    subject: str = ""
    findings: list[Finding] = field(default_factory=list)
    notes: list[Finding] = field(default_factory=list)
    sections: list[Section] = field(default_factory=list)
    accepted: frozenset[str] = frozenset()
    waived: list[Finding] = field(default_factory=list)

    def accept(self, codes: Any, where: str) -> None:
        """Take over the workflow's `check: {accept: [...]}`; an unknown code is a finding."""
        listed = codes if isinstance(codes, list) else [codes]
        for code in listed:
            if not isinstance(code, str) or code not in CODES:
                remedy = f"{alternatives(str(code), CODES)}"
                self.find("check.settings", "check.accept", f"no finding {code!r}", remedy, where)
            elif code in FIRM:
                evidence = f"{code}: a run cannot begin with it, accepted or not"
                remedy = "take it out of check.accept, and mend what it finds"
                self.find("check.settings", "check.accept", evidence, remedy, where)
        self.accepted = frozenset(str(code) for code in listed)

    def find(
        self,
        code: str,
        culprit: str,
        evidence: str,
        remedy: str,
        where: Any = "",
        *,
        error: bool = True,
    ) -> None:
        """Add what fails the check, or a note where the workflow accepts it or it may be right."""
        if code in self.accepted:
            if error:
                self.waived.append(Finding(code, culprit, evidence, "", str(where)))
            self.note(code, culprit, f"{evidence} (accepted by the workflow)", "", where)
        elif error:
            self.findings.append(Finding(code, culprit, evidence, remedy, str(where)))
        else:
            self.note(code, culprit, evidence, remedy, where)

    def find_error(self, code: str, culprit: str, error: UniconError) -> None:
        """Add an error of one line as a finding: its last part is the remedy."""
        evidence, _, remedy = str(error).rpartition("; ")
        self.find(code, culprit, evidence or remedy, remedy if evidence else "")

    def note(
        self, code: str, culprit: str, evidence: str, remedy: str = "", where: Any = ""
    ) -> None:
        """Add what is worth knowing and does not fail the check."""
        self.notes.append(Finding(code, culprit, evidence, remedy, str(where), "note"))

    def table(
        self,
        title: str,
        columns: Sequence[str],
        rows: Iterable[Sequence[str]],
        lines: Iterable[str] = (),
    ) -> None:
        """Add a table."""
        self.sections.append(Section(title, tuple(columns), tuple(map(tuple, rows)), tuple(lines)))

    def sort(self) -> None:
        """Bring what explains other findings to the front, else leave the order as it is."""
        places = {code: place for place, code in enumerate(CAUSES)}
        self.findings.sort(key=lambda finding: places.get(finding.code, len(CAUSES)))

    @property
    def clean(self) -> bool:
        """Whether nothing fails the check."""
        return not self.findings

    def text(self, width: int = WIDTH) -> str:
        """Return findings, notes and the verdict, then tables and the verdict, for a terminal.

        Args:
            width: columns that a line may take.
        """
        head = f"check {self.workflow}" + (f": {self.subject}" if self.subject else "")
        parts = ["\n".join(wrapped(near(head), width, "", "  "))]
        for title, found, form in (
            ("Findings", self.findings, "  {}. "),
            ("Notes", self.notes, "  · "),
        ):
            marks = [form.format(i + 1) for i in range(len(found))]
            told = (
                wrapped(near(str(each)), width, mark, " " * len(mark))
                for mark, each in zip(marks, found)
            )
            parts += ["\n".join(chain([title], *told))] if found else []
        count = len(self.findings)
        verdict = "clean" if self.clean else f"{count} finding{'s' if count > 1 else ''}"
        tables = [section.text(width) for section in self.sections]
        return "\n\n".join([*parts, verdict, *tables, *([verdict] if tables else [])])

    def to_json(self) -> dict[str, Any]:
        """Return all as plain values."""
        return {
            "workflow": self.workflow,
            "subject": self.subject,
            "clean": self.clean,
            "findings": [vars(finding) for finding in self.findings],
            "notes": [vars(note) for note in self.notes],
            "sections": [vars(section) for section in self.sections],
        }

    def write(self, path: str | Path) -> None:
        """Write `to_json` to a file, folders made as needed."""
        text = json.dumps(self.to_json(), indent=2, ensure_ascii=False)
        write_file(Path(path), f"{text}\n".encode(), folders=True)


@dataclass(frozen=True)
class PolicyResult:
    """What is found about one policy: each finding names it and the file of its contract.

    Attributes:
        result: is added to.
        key: of the policy under `policies:`.
        contract: of the policy.
    """

    result: CheckResult
    key: str
    contract: PolicyContract

    def find(self, code: str, part: str, evidence: str, remedy: str, *, error: bool = True) -> None:
        """Add what fails the check; as `CheckResult.find`, with a part of the contract or ""."""
        where = self.contract.path
        self.result.find(code, self._culprit(part), evidence, remedy, where, error=error)

    def note(self, code: str, part: str, evidence: str) -> None:
        """Add what is worth knowing."""
        self.result.note(code, self._culprit(part), evidence)

    def _culprit(self, part: str) -> str:
        return f"policy {self.key!r}, {part}" if part else f"policy {self.key!r}"

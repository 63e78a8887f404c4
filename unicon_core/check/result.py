"""CheckResult: tables, findings and notes of a preflight check, for people and as JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from unicon_base import AnyDict, UniconError, alternatives
from unicon_base.arrays import Bool
from unicon_core.check.rules import CODES, FIRM
from unicon_core.page import write_json
from unicon_core.text_table import WIDTH, aligned, near, wrapped

if TYPE_CHECKING:
    from unicon_core.policies import PolicyContract


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or worth knowing.

    Attributes:
        code: of a rule.
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
        remedy: str | None = None,
        where: Any = "",
        *,
        error: bool = True,
    ) -> None:
        """Add what fails the check, or a note where the workflow accepts it or it may be right.

        Args:
            code: of its rule.
            culprit: who is to blame.
            evidence: what was seen, with numbers; nothing is added where it is empty.
            remedy: what to do; None for the rule's.
            where: `file:line` or a file.
            error: False where it may be right.
        """
        remedy = CODES[code].remedy if remedy is None else remedy
        if not evidence:
            return
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
        """Add what is worth knowing and does not fail the check; nothing where it is empty."""
        if evidence:
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

    def columns(
        self, title: str, columns: Mapping[str, Iterable[str]], lines: Iterable[str] = ()
    ) -> None:
        """Add a table of columns by their names."""
        self.table(title, list(columns), zip(*columns.values()), lines)

    def sort(self) -> None:
        """Bring what explains other findings to the front, else leave the order as it is."""
        places = {code: place for place, code in enumerate(CODES)}
        self.findings.sort(key=lambda finding: places[finding.code])

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

    def to_json(self) -> AnyDict:
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
        write_json(Path(path), self.to_json(), folders=True)


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

    def find(
        self,
        code: str,
        part: str,
        evidence: str,
        remedy: str | None = None,
        where: str = "",
        *,
        error: bool = True,
    ) -> None:
        """Add what fails the check; as `CheckResult.find`, with a part of the contract or ""."""
        place = where or self.contract.path
        self.result.find(code, self._culprit(part), evidence, remedy, place, error=error)

    def note(self, code: str, part: str, evidence: str) -> None:
        """Add what is worth knowing."""
        self.result.note(code, self._culprit(part), evidence)

    def _culprit(self, part: str) -> str:
        return f"policy {self.key!r}, {part}" if part else f"policy {self.key!r}"


def first(wrong: Bool, text: Callable[[int], str]) -> str:
    """Return what is wrong with the first of several joints, and how many they are; "" for none."""
    return f"{text(int(wrong.argmax()))} ({wrong.sum()} joints)" if wrong.any() else ""

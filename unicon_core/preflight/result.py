"""PreflightResult: what was seen of the live robot, as a table and as JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from unicon_core.check.rules import live_code
from unicon_core.page import write_file
from unicon_core.text_table import aligned


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
        failed = sum(row.ok is False for row in self.rows)
        passed = sum(row.ok is True for row in self.rows)
        end = [f"fault: {self.fault}"] if self.fault else []
        return "\n".join([head, *(f"  {x}" for x in lines), *end, f"{passed} pass, {failed} fail"])

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain values."""
        return {**asdict(self), "ok": self.ok}

    @staticmethod
    def write(values: dict[str, Any], path: str | Path) -> None:
        """Write values as JSON.

        Raises:
            UniconError: it cannot be written.
        """
        write_file(Path(path), (json.dumps(values, indent=2) + "\n").encode())

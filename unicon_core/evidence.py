"""The ledger of evidence, `config/evidence.yaml`: what each part last ran against.

A user's first question is whether a robot, simulator or policy format was ever run, and by what.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from unicon_base.located_yaml import read_yaml
from unicon_base.resources import config_files

LEVELS = {
    "never": "never run",
    "stand_in": "run against our own stand-in",
    "frames": "run against recorded frames of the vendor",
    "vendor": "run against the vendor's own",
    "hardware": "run on hardware",
}
"""Levels, the weakest first, in words."""


@dataclass(frozen=True)
class Evidence:
    """What one part last ran against.

    Attributes:
        kind: `robot`, `simulator`, `peripheral`, `ros`, `middleware` or `policy`.
        name: of the part.
        level: one of `LEVELS`.
        against: what exactly, in words.
        test: file that shows it; "" where none does.
        report: file of `evidence/` beside the ledger that tells of a run on hardware; else "".
        commit: of the last run.
        date: of it, YYYY-MM-DD.
    """

    kind: str
    name: str
    level: str
    against: str
    test: str = ""
    report: str = ""
    commit: str = ""
    date: str = ""

    def __str__(self) -> str:
        """The level in words, and what it ran against."""
        return f"{LEVELS[self.level]}: {self.against}"


def load_evidence() -> dict[tuple[str, str], Evidence]:
    """Return the ledger by kind and name; of one part the first configuration folder's counts.

    Raises:
        UniconError: a ledger is malformed.
    """
    found: dict[tuple[str, str], Evidence] = {}
    for path in config_files("evidence.yaml"):
        found = {**_read(path), **found}
    return found


def evidence_of(kind: str, name: str) -> Evidence | None:
    """Return what one part last ran against; None where the ledger does not know it."""
    return load_evidence().get((kind, name))


def _read(path: Path) -> dict[tuple[str, str], Evidence]:
    document = read_yaml(path)
    found = {}
    kinds = document.value if isinstance(document.value, dict) else {}
    for kind, entries in kinds.items():
        if kind == "schema":
            continue
        for name, told in entries.items() if isinstance(entries, dict) else ():
            try:
                each = Evidence(str(kind), str(name), **{k: str(v) for k, v in told.items()})
                if each.level not in LEVELS:
                    raise ValueError
            except (AttributeError, TypeError, ValueError) as error:
                raise document.error(
                    (kind, name),
                    f"give {name!r} as {{level: {'|'.join(LEVELS)}, against: …, test: …, commit: "
                    "…, date: YYYY-MM-DD}",
                ) from error
            found[each.kind, each.name] = each
    return found

"""Rules of `unicon check`, gates and `unicon preflight`: code, what it looks at, why, and a remedy.

`unicon explain CODE` prints one, docs/reference/rules.md all.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from unicon_base.located_yaml import read_yaml


@dataclass(frozen=True)
class Rule:
    """One thing that may be wrong.

    Attributes:
        code: names it, for `accept`, `--force` and `unicon explain`.
        kind: `error` fails the check, `note` does not; `either`, by what is seen; `firm`: an error
            with which a run cannot begin: nobody can accept it or force it.
        needs: what it looks at, beside the workflow: document, robot, policy, model, platform,
            rollout, or `live`, the data of the running robot, which gates and `unicon preflight`
            have; with commas.
        what: is wrong, in one line.
        why: it matters.
        remedy: what to do about it.
        at_start: of a note that every start logs: what it means, "" where its evidence says so.
    """

    code: str
    kind: str
    needs: str
    what: str
    why: str
    remedy: str
    at_start: str | None = None

    def text(self) -> str:
        """Return the rule for a terminal."""
        kinds = {
            "firm": "error, cannot be accepted or forced",
            "either": "error or note, by what is seen",
        }
        return (
            f"{self.code}: {self.what}\n  kind    {kinds.get(self.kind, self.kind)}\n"
            f"  looks at {self.needs}\n  why     {self.why}\n  remedy  {self.remedy}"
        )


RULES = tuple(
    Rule(code, **said)
    for code, said in read_yaml(Path(__file__).with_name("rules.yaml")).value.items()
)
"""All rules, of the file beside this one: what explains other findings stands first."""

CODES = {rule.code: rule for rule in RULES}
"""Code to rule. A workflow accepts one with `check: {accept: [CODE]}`: it is then a note."""

LIVE = frozenset(rule.code for rule in RULES if rule.needs == "live")
"""What the running robot alone shows; no finding of `unicon check` has such a code."""

FIRM = frozenset(rule.code for rule in RULES if rule.kind == "firm")
"""What a run cannot begin with."""


def live_code(name: str) -> str:
    """Return the code of a gate, or of another row of preflight; "" for a name that has none."""
    codes = (f"{group}.{name.replace(' ', '_')}" for group in ("gate", "preflight"))
    return next((code for code in codes if code in LIVE), "")


def markdown() -> str:
    """Return all rules as the page docs/reference/rules.md."""
    lines = [_PAGE]
    for rule in RULES:
        cells = (f"`{rule.code}`", rule.kind, rule.needs, rule.what, rule.why, rule.remedy)
        lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    return "\n".join(lines) + "\n"


_PAGE = """\
# Rules

What `unicon check` looks at; `unicon run` refuses by the same errors, the twin's aside. \
Gates and `unicon preflight` look at *live* data. \
`unicon explain CODE` prints one. Generated: `unicon explain --markdown`.

A workflow accepts a finding with `check: {accept: [CODE]}`, a run with `--force CODE`; \
those marked *firm* cannot be accepted.

| code | kind | looks at | what | why | remedy |
| --- | --- | --- | --- | --- | --- |"""

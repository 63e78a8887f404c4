"""Rules of `unicon check`, gates and `unicon preflight`: code, what it looks at, why, and a remedy.

`unicon explain CODE` prints one, docs/reference/rules.md all. What explains other findings stands
first: an order of joints that is wrong, for example, also gives poses outside the limits, different
sides and feet in the air.
"""

from __future__ import annotations

from dataclasses import dataclass

from unicon_core.check.rule_table import TABLE


@dataclass(frozen=True)
class Rule:
    """One thing that may be wrong.

    Attributes:
        code: names it, for `accept`, `--force` and `unicon explain`.
        needs: what it looks at, beside the workflow: document, robot, policy, model, platform,
            rollout, or `live`, the data of the running robot, which gates and `unicon preflight`
            have.
        what: is wrong, in one line.
        why: it matters.
        remedy: what to do about it.
        severity: `error` fails the check, `note` does not; `either`, by what is seen.
        firm: a run cannot begin with it: nobody can accept it or force it.
    """

    code: str
    needs: tuple[str, ...]
    what: str
    why: str
    remedy: str
    severity: str = "error"
    firm: bool = False

    def text(self) -> str:
        """Return the rule for a terminal."""
        kinds = {"error": "error", "note": "note", "either": "error or note, by what is seen"}
        kind = kinds[self.severity] + (", cannot be accepted or forced" if self.firm else "")
        return (
            f"{self.code}: {self.what}\n  kind    {kind}\n  looks at {', '.join(self.needs)}\n"
            f"  why     {self.why}\n  remedy  {self.remedy}"
        )


RULES = tuple(
    Rule(
        code, tuple(needs.split()), what, why, remedy, kind.replace("firm", "error"), kind == "firm"
    )
    for code, needs, kind, what, why, remedy in TABLE
)

CODES = {rule.code: rule for rule in RULES}
"""Code to rule. A workflow accepts one with `check: {accept: [CODE]}`: it is then a note."""

LIVE = frozenset(rule.code for rule in RULES if "live" in rule.needs)
"""What the running robot alone shows; no finding of `unicon check` has such a code."""

FIRM = frozenset(rule.code for rule in RULES if rule.firm)
"""What a run cannot begin with."""


def live_code(name: str) -> str:
    """Return the code of a gate, or of another row of preflight; "" for a name that has none."""
    codes = (f"{group}.{name.replace(' ', '_')}" for group in ("gate", "preflight"))
    return next((code for code in codes if code in LIVE), "")


def markdown() -> str:
    """Return all rules as the page docs/reference/rules.md."""
    lines = [
        "# Rules",
        "",
        "What `unicon check` looks at; `unicon run` refuses by the same errors, the twin's aside. "
        "Gates and `unicon preflight` look at *live* data. "
        "`unicon explain CODE` prints one. Generated: `unicon explain --markdown`.",
        "",
        "A workflow accepts a finding with `check: {accept: [CODE]}`, a run with `--force CODE`; "
        "those marked *firm* cannot be accepted.",
        "",
        "| code | kind | looks at | what | why | remedy |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for rule in RULES:
        kind = "firm" if rule.firm else rule.severity
        cells = (f"`{rule.code}`", kind, ", ".join(rule.needs), rule.what, rule.why, rule.remedy)
        lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    return "\n".join(lines) + "\n"

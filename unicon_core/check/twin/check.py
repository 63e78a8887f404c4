"""The preflight twin: the deploy graph simulated, broken contracts beside it, and a verdict."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from unicon_core.check.collision import check_collision
from unicon_core.check.result import CheckResult, PolicyResult
from unicon_core.check.subject import listed, on_platform
from unicon_core.check.twin.measures import Measures
from unicon_core.check.twin.perturb import Change, perturbations
from unicon_core.check.twin.repair import repairs
from unicon_core.check.twin.session import TwinSession
from unicon_core.errors import UniconError
from unicon_core.models.find import Modelled
from unicon_core.platforms.platform import Platform
from unicon_core.workflow.document import WorkflowDocument
from unicon_core.workflow.platform_use import read_platforms

__all__ = ["check_twin"]

MARGIN = 0.1
"""By how much the given contract's score must exceed that of a broken one."""
POOR = 0.5
"""Tracking below this makes the search for a better contract worth its time."""
FOLLOWS = 0.3
"""Tracking below this is a finding even where nothing mends it."""
MENDED = 0.15
"""By how much a mended contract must do better to be believed."""
ALIKE = 0.02
"""Scores within this are alike."""
_PATIENCE = 120.0  # [s] of wall time for the search


def check_twin(
    document: WorkflowDocument, platform: Platform, settings: Mapping[str, Any], result: CheckResult
) -> None:
    """Run the workflow on its simulator and add tables and findings.

    Args:
        document: the workflow.
        platform: as it was built for the checks. One that simulates no model, such as hardware and
            `fake`, is exchanged for MuJoCo, and a note says so.
        settings: its `check:` section.
        result: is added to.
    """
    uses = read_platforms(document).values()
    simulator = named = "+".join(dict.fromkeys(use.name for use in uses))
    if not isinstance(platform, Modelled):
        simulator = "mujoco"
        result.note(
            "twin.platform",
            f"platform {named!r}",
            "it simulates no model: the twin runs in MuJoCo (platform 'mujoco')",
        )
    policies = list(document.get("policies", dict, {}))
    pose = {"initial_pose": f"policy:{policies[0]}"} if len(policies) == 1 else {}
    try:
        session = TwinSession(on_platform(document, simulator, pose), settings.get("command"))
    except UniconError as error:
        result.find_error("twin.run", f"twin on platform {simulator!r}", error)
        return
    codes = {finding.code for finding in (*result.findings, *result.notes)}
    if not {"model.collision", "model.meshes"} & codes:  # the check's model may be another
        check_collision(session.model, session.program.robot, result, document.path)
    try:
        _Twin(session, float(settings.get("duration", 5.0)), result, document.path).check()
    finally:
        session.close()


@dataclass(frozen=True)
class _Mended:
    """The change that helps most; `others` are culprits whose change helps as much."""

    policy: PolicyResult
    change: Change
    measures: Measures
    tried: int
    others: tuple[str, ...]


@dataclass
class _Twin:
    session: TwinSession
    seconds: float
    result: CheckResult
    where: Path
    rows: list[list[str]] = field(default_factory=list)
    policies: list[PolicyResult] = field(default_factory=list)

    def check(self) -> None:
        session, result = self.session, self.result
        given = session.run(self.seconds)
        self.add("as given", given)
        suspects = []
        for key, contract in session.contracts.items():
            if key in session.called:
                self.policies.append(PolicyResult(result, key, contract))
            else:
                result.note("twin.run", f"policy {key!r}", "the flow never calls it in the twin")
        for policy in self.policies:
            for broken in perturbations(policy.contract, session.depths(policy.contract.joints)):
                alone = len(self.policies) == 1
                name = broken.name if alone else f"{policy.key}: {broken.name}"
                if broken.contract is None:
                    self.rows.append([name, f"not tried: {broken.reason}", *[""] * 4])
                    continue
                measures = self.run(policy, broken, self.seconds)
                self.add(name, measures)
                if measures.score >= given.score - MARGIN:
                    suspects.append((policy, broken, measures))
        self.verdict(given)
        if given.stands and (not given.follows or given.tracking >= POOR):
            suspects.sort(key=lambda suspect: -suspect[2].score)
            if given.follows and any(not broken.unlikely for _, broken, _ in suspects):
                self.better(given)
            for policy, broken, measures in suspects:
                # Scales of 1 have been left out by nobody, and who only stands up does so anyhow.
                policy.find(
                    "twin.suspect",
                    broken.culprit,
                    f"with {broken.name} it does as well (score {measures.score:.2f}) as with the "
                    f"given contract ({given.score:.2f}): yours is suspect",
                    f"compare {broken.culprit} with the training side",
                    error=given.tracks and not broken.unlikely,
                )
        self.tables(given)

    def better(self, given: Measures) -> None:
        """Of a contract that walks, and beside which broken ones do: what would walk better."""
        found = self.mend(given, MARGIN, self.seconds)  # the first seconds were good as they are
        if found is None:
            return
        repair, mended = found.change, found.measures
        self.add(f"mended: {repair.name}", mended)
        found.policy.find(
            "twin.suspect",
            repair.culprit,
            f"with {repair.name} it does better (score {mended.score:.2f}) than with the given "
            f"contract ({given.score:.2f}), the best of {found.tried} changes",
            f"compare {repair.culprit} with the training side",
        )

    def add(self, name: str, measures: Measures) -> None:
        self.rows.append(
            [
                name,
                measures.outcome(),
                f"{measures.score:.2f}",
                f"{measures.tracking:.2f}" if measures.follows else "-",
                _error(measures),
                f"{measures.target_rate:.1f}",
            ]
        )

    def verdict(self, given: Measures) -> None:
        """Findings of the given contract: a fall, or a command that is not followed."""
        poor = bool(self.policies) and given.follows and given.tracking < POOR
        if given.stands and not poor:
            return
        code, what = "twin.fall", given.outcome()
        if given.fault:
            what += f" ({given.fault})"
        if given.stands:
            code, what = "twin.command", _strays(given)
        found = self.mend(given)
        if found is not None:
            repair, mended = found.change, found.measures
            self.add(f"mended: {repair.name}", mended)
            also = f"; as well with another {listed(found.others, 2)}" if found.others else ""
            found.policy.find(
                code,
                repair.culprit,
                f"{what} (score {given.score:.2f}); with {repair.name} it {mended.outcome()} "
                f"(score {mended.score:.2f}), the best of {found.tried} changes{also}",
                f"compare {repair.culprit} with the training side",
            )
        elif not self.policies:
            self.result.find(code, "flow", what, "change the flow, or its gains", self.where)
        elif not given.stands or given.tracking < FOLLOWS:
            self.policies[0].find(
                code,
                "",
                f"{what} (score {given.score:.2f}), and none of the usual mistakes explains it",
                "compare default pose, gains, action scale, terms and the model with the training "
                "side",
            )
        else:
            self.policies[0].note(code, "", what)

    def mend(self, given: Measures, least: float = MENDED, first: float = 2.0) -> _Mended | None:
        """Return the change under which the policy does best, if it does better by `least`.

        All are tried for the `first` seconds and the best few for the whole time. Of those that do
        as well as the best one the likeliest is taken: exchanged sines and cosines are also mended
        by the sign of one of them.
        """
        until = time.monotonic() + _PATIENCE
        session = self.session
        tried: list[tuple[float, int, PolicyResult, Change]] = []
        poses = session.poses()
        for policy in self.policies:
            depths = session.depths(policy.contract.joints)
            tried += [
                (self.run(policy, repair, first).score, number, policy, repair)
                for number, repair in enumerate(
                    repairs(policy.contract, session.program.robot, depths, poses)
                )
                if time.monotonic() < until
                and (session.lifts or not repair.unlimited)
                and (session.damps or not repair.undamped)
            ]
        tried.sort(key=lambda entry: -entry[0])
        finals = [
            (self.run(policy, repair, self.seconds), number, policy, repair)
            for _, number, policy, repair in tried[:10]
        ]
        if not finals:
            return None
        best = max(measures.score for measures, *_ in finals)
        good = sorted((f for f in finals if f[0].score >= best - ALIKE), key=lambda final: final[1])
        measures, _, policy, repair = good[0]
        if not measures.stands or measures.score < given.score + least:
            return None
        if measures.follows and measures.tracking < FOLLOWS:
            return None
        others = dict.fromkeys(c.culprit for *_, c in good if c.culprit != repair.culprit)
        return _Mended(policy, repair, measures, len(tried), tuple(others))

    def run(self, policy: PolicyResult, change: Change, seconds: float) -> Measures:
        return self.session.run(
            seconds,
            policy.key,
            change.contract,
            unlimited=change.unlimited,
            undamped=change.undamped,
        )

    def tables(self, given: Measures) -> None:
        what = f"{self.seconds:g} s of the policy" if self.policies else "the whole flow"
        title = f"Twin on platform {self.session.program.platform.facts.name}, {what}"
        columns = ["contract", "outcome", "score", "tracking", "error", "rate [rad/s]"]
        lines = ["score = survival · (0.7 · tracking + 0.3 · smoothness), from 0 to 1"]
        lines.append("a walk does not validate the rate: half the rate walks as well")
        self.result.table(title, columns, self.rows, lines if self.policies else ())
        rows = [["outcome", given.outcome() + (f": {given.fault}" if given.fault else "")]]
        if given.tracks and self.policies:
            rows.append(["command", _velocity(given.command)])
            rows.append(["velocity", _velocity(given.velocity)])
        hits = [f"{name} {share:.0%}" for name, share in given.limit_hits.items()]
        rows += [
            ["torque", f"{given.torque_use:.0%} of the limit at {given.torque_joint} (rms)"],
            ["saturated", f"{given.saturated:.2%} of all torques"],
            ["change of targets", f"{given.target_rate:.2f} rad/s (rms)"],
            ["at position limits", ", ".join(hits[:4]) or "never"],
        ]
        self.result.table("Twin, as given", ["what", "value"], rows)


def _error(measures: Measures) -> str:
    if measures.motion_error is not None:
        return f"{measures.motion_error:.2f}"
    return f"{measures.velocity_error:.2f}" if measures.tracks else "-"


def _strays(given: Measures) -> str:
    if given.motion_error is not None:
        return f"it stays up, but its joints are {given.motion_error:.2f} rad from the motion (rms)"
    moves = _velocity(given.velocity)
    return f"it stays up, but moves at {moves} where {_velocity(given.command)} is commanded"


def _velocity(values: tuple[float, float, float]) -> str:
    return f"vx {values[0]:.2f}, vy {values[1]:.2f} m/s, wz {values[2]:.2f} rad/s"

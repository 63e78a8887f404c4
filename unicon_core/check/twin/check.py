"""The preflight twin: the deploy graph simulated, broken contracts beside it, and a verdict."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from unicon_base import AnyMapping, UniconError
from unicon_core.check.joints import joint_depths
from unicon_core.check.pose import check_collision
from unicon_core.check.result import CheckResult, PolicyResult
from unicon_core.check.subject import listed, on_platform
from unicon_core.check.twin.measures import (
    FOLLOWS,
    MENDED,
    SLIGHT,
    Compared,
    Measures,
    Tried,
    chosen,
    find_pressing,
)
from unicon_core.check.twin.perturb import (
    GAINS,
    GAIT,
    Change,
    evident_changes,
    perturbations,
    rivals,
)
from unicon_core.check.twin.repair import repairs
from unicon_core.check.twin.session import TwinBlindError, TwinSession
from unicon_core.models.find import Modelled
from unicon_core.platforms.platform import Platform
from unicon_core.policies import PolicyContract
from unicon_core.text_table import figure
from unicon_core.workflow.document import WorkflowDocument
from unicon_core.workflow.members import read_platforms

MARGIN = 0.1
"""A broken contract that loses less in its first run is compared with the given one."""
GOOD = 0.8
"""A walk that scores less is searched for all usual mistakes, as a fall is."""
COLUMNS = ("contract", "outcome", "score", "tracking", "error", "rate [rad/s]")
STANDING = [{"velocity_command": {"constant": [0, 0, 0]}}]
"""`commands:` of a workflow that only stands."""
_PATIENCE = 120.0  # [s] of wall time for the search


def check_twin(
    document: WorkflowDocument, platform: Platform, settings: AnyMapping, result: CheckResult
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
        evidence = "it simulates no model: the twin runs in MuJoCo (platform 'mujoco')"
        result.note("twin.platform", f"platform {named!r}", evidence)
    policies = list(document.get("policies", {}))
    pose = {"initial_pose": f"policy:{policies[0]}"} if len(policies) == 1 else {}
    command = settings.get("command")
    if command is None and document.values.get("commands") == STANDING:
        command = [0.0, 0.0, 0.0]
        result.note(
            "twin.command",
            "commands",
            "the workflow commands to stand, and so does the twin, which tells less; let it walk "
            "by check: {command: [0.6, 0, 0]}",
        )
    culprit = f"twin on platform {simulator!r}"
    try:
        session = TwinSession(on_platform(document, simulator, pose), command)
    except TwinBlindError as blind:  # nobody can mend that an arm has no base that moves
        result.note("twin.run", culprit, str(blind))
        return
    except UniconError as error:
        result.find_error("twin.run", culprit, error)
        return
    codes = {finding.code for finding in (*result.findings, *result.notes)}
    if not {"model.collision", "model.meshes"} & codes:  # the check's model may be another
        check_collision(session.model, session.program.robot, result, document.path)
    twin = _Twin(session, float(settings.get("duration", 5.0)), result, document.path)
    try:
        twin.check()
    finally:
        session.close()


@dataclass
class _Twin:
    session: TwinSession
    seconds: float
    result: CheckResult
    where: Path
    rows: list[list[str]] = field(default_factory=list)
    policies: list[PolicyResult] = field(default_factory=list)
    walked: tuple[Measures, ...] = ()

    def check(self) -> None:
        session, result = self.session, self.result
        given = session.run(self.seconds)
        self.rows.append(_row("as given", given))
        suspects = list[Tried]()
        for key, contract in session.contracts.items():
            if key in session.called:
                self.policies.append(PolicyResult(result, key, contract))
            else:
                result.note("twin.run", f"policy {key!r}", "the flow never calls it in the twin")
        alone = len(self.policies) == 1
        for policy in self.policies:
            for broken in perturbations(
                policy.contract,
                joint_depths(session.model, session.program.robot, policy.contract.joints),
            ):
                name = broken.name if alone else f"{policy.key}: {broken.name}"
                measures = None if broken.reason else self.run(policy, broken)
                self.rows.append(_row(name, measures, broken.reason))
                if measures and measures.score >= given.score - MARGIN:
                    suspects.append(Tried(policy, broken, measures, 0))
        self.verdict(given)
        if not given.poor and self.policies:
            for policy in self.policies:
                find_pressing(policy, session.program.robot, given)
            suspects.sort(key=lambda tried: -tried.measures.score)
            self.suspect(given, suspects)
        self.tables(given)
        told = any(finding.code == "twin.suspect" for finding in result.findings)
        walks = given.tracks and any(given.command) and not given.poor and not given.rests
        if walks and alone and not told:
            self.rival(given)

    def suspect(self, given: Measures, suspects: list[Tried]) -> None:
        """Of a contract that walks: what walks clearly better, and what as well."""
        likely = not all(each.change.unlikely for each in suspects)
        if likely and given.follows and not given.rests:
            found = self.mend(given, MARGIN, self.seconds)  # the first seconds were good
            if found:
                best = found[0]
                self.rows.append(_row(f"mended: {best.change.name}", best.measures))
                self.better(best, self.compared(best))
        names = listed(each.change.name for each in suspects if each.measures.rests)
        if given.rests and names:
            suspects[0].policy.note(
                "twin.suspect",
                "",
                f"it rests, and with {names} it does, too: the network hardly responds, so the "
                "twin cannot tell whether the contract is right",
            )
        for each in suspects:
            broken = each.change
            if given.rests and each.measures.rests:
                continue
            # Scales of 1 have been left out by nobody, and who only stands up does so anyhow.
            telling = given.tracks and any(given.command) and not broken.unlikely
            compared = self.compared(each) if telling else None
            if compared is not None and compared.clear:
                self.better(each, compared)
                continue
            # Trained policies bear other gains, as training varies them: only a gain tells.
            suspicious = compared is not None and compared.alike and broken.culprit != GAINS
            scores = compared or Compared((given,), (each.measures,))
            verdict = "yours is suspect" if suspicious else "the twin does not tell which is right"
            each.policy.find(
                "twin.suspect",
                broken.culprit,
                f"with {broken.name} it does as well as with the given contract: {scores}; "
                + verdict,
                error=suspicious,
            )

    def better(self, tried: Tried, compared: Compared, *, error: bool = True) -> None:
        """Find, or note, a change under which the policy walks better."""
        change = tried.change
        how = "does better than" if error else "does slightly better than"
        if error and not compared.clear:
            how = "does as well, with less torque, as" if compared.lighter else "does as well as"
            if change.culprit == GAIT:
                how = "does as well, in calmer steps, as"
        tried.policy.find(
            "twin.suspect",
            change.culprit,
            f"with {change.name} it {how} with the given contract: {compared}{change.because}",
            change.remedy or None,
            error=error,
        )

    def compared(self, tried: Tried) -> Compared:
        """Run the same commands with and without a change; without commands the one run."""
        commands = self.session.walks()
        if not self.walked:
            self.walked = tuple(self.session.run(self.seconds, command=c) for c in commands)
        runs = (self.run(tried.policy, tried.change, command=c) for c in commands)
        return Compared(self.walked, tuple(runs))

    def verdict(self, given: Measures) -> None:
        """Findings of the given contract: a fall, or a command that is not followed."""
        if not given.poor or (given.stands and not self.policies):
            return
        code, what = "twin.fall", given.outcome()
        if given.fault:
            what += f" ({given.fault})"
        if given.stands:
            code, what = "twin.command", _strays(given)
        if "model.collision" in {finding.code for finding in self.result.findings}:
            self.result.note(code, "model", f"{what}, as nothing or no foot touches the floor")
            return
        found = self.mend(given)
        if found:
            policy, repair, mended = found[0].policy, found[0].change, found[0].measures
            self.rows.append(_row(f"mended: {repair.name}", mended))
            others = dict.fromkeys(t.change.culprit for t in found[1:])
            others.pop(repair.culprit, None)
            also = f"; as well with another {listed(others, 2)}" if others else ""
            policy.find(
                code,
                repair.culprit,
                f"{what} (score {given.score:.2f}); with {repair.name} it {mended.outcome()} "
                f"(score {mended.score:.2f}){repair.because}{also}",
                repair.remedy or None,
            )
        elif not self.policies:
            self.result.find(code, "flow", what, "change the flow, or its gains", self.where)
        elif not given.stands or given.tracking < FOLLOWS:
            self.policies[0].find(
                code,
                "",
                f"{what} (score {given.score:.2f}), and none of the usual mistakes explains it",
                "compare default pose, gains, action scale, terms and the model with the training "
                "side"
                + ("; if it only stands: check: {command: [0, 0, 0]}" if given.rests else ""),
            )
        else:
            self.policies[0].note(code, "", what)

    def mend(self, given: Measures, least: float = MENDED, first: float = 2.0) -> list[Tried]:
        """Return the change to be told, and behind it those that do as well; none if none helps.

        All are tried for the `first` seconds; those for which the model speaks and the best few of
        the others for the whole time. What is told does clearly better with other commands, too.
        """
        session, robot = self.session, self.session.program.robot
        own, platform = session.passive_damping, session.program.platform.facts.name
        finals = self.tried(lambda given: evident_changes(given, robot, own, platform))
        enough = chosen(finals, given, least)
        if not enough or enough[0].measures.score < 1.0 - MENDED:  # else none can be far better
            likely = self.tried(lambda given: repairs(given, robot, session.model), first)
            likely.sort(key=lambda each: -each.measures.score)
            finals += [
                replace(each, measures=self.run(each.policy, each.change)) for each in likely[:10]
            ]
        best = chosen(finals, given, least)
        return best if best and self.compared(best[0]).clear else []

    def tried(
        self, changes: Callable[[PolicyContract], Iterable[Change]], seconds: float | None = None
    ) -> list[Tried]:
        """Return the changes of all policies that the simulator can make, and their runs."""
        until = time.monotonic() + _PATIENCE
        return [
            Tried(policy, change, self.run(policy, change, seconds), number)
            for policy in self.policies
            for number, change in enumerate(changes(policy.contract))
            if time.monotonic() < until and self.session.can(change)
        ]

    def rival(self, given: Measures) -> None:
        """Compare a contract that walks with half and twice its damping and periods."""
        policy, rows = self.policies[0], []
        found = list[tuple[bool, float, Tried, Compared]]()
        for change in rivals(policy.contract):
            try:
                measures = self.run(policy, change)
            except UniconError as error:
                reason = str(error).split(" (")[0].split(";")[0]
                rows.append(_row(change.name, None, reason))
                continue
            rows.append(_row(change.name, measures))
            once = Compared((given,), (measures,))
            if once.gain >= 0.5 * SLIGHT or change.evidence or _tells(change, once):
                tried = Tried(policy, change, measures, len(rows))
                compared = self.compared(tried)
                clear = _tells(change, compared)
                if clear or compared.slight:
                    found.append((clear, compared.gain, tried, compared))
        # What is wrong in one of them is made up for by another, but less.
        best = max(found, key=lambda each: each[:2], default=None)
        if given.score < GOOD and not (best and best[0]) and (mended := self.mend(given)):
            rows.append(_row(f"mended: {mended[0].change.name}", mended[0].measures))
            best = (True, 0.0, mended[0], self.compared(mended[0]))
        self.result.table("Twin, half and twice the damping and periods", COLUMNS, rows)
        if best:
            self.better(best[2], best[3], error=best[0])

    def run(
        self,
        policy: PolicyResult,
        change: Change,
        seconds: float | None = None,
        command: Sequence[float] | None = None,
    ) -> Measures:
        return self.session.run(seconds or self.seconds, policy.key, change, command)

    def tables(self, given: Measures) -> None:
        what = f"{self.seconds:g} s of the policy" if self.policies else "the whole flow"
        title = f"Twin on platform {self.session.program.platform.facts.name}, {what}"
        lines = ["score = survival · (0.7 · tracking + 0.3 · smoothness), from 0 to 1"]
        self.result.table(title, COLUMNS, self.rows, lines if self.policies else ())
        rows = {"outcome": given.outcome() + (f": {given.fault}" if given.fault else "")}
        if given.tracks and self.policies:
            rows |= {"command": _velocity(given.command), "velocity": _velocity(given.velocity)}
        hits = [f"{name} {share:.0%}" for name, share in given.limit_hits.items()]
        rows |= {
            "torque": f"{given.torque_use:.0%} of the limit at {given.torque_joint} (rms)",
            "saturated": f"{given.saturated:.2%} of all torques",
            "change of targets": f"{given.target_rate:.2f} rad/s (rms)",
            "at position limits": ", ".join(hits[:4]) or "never",
        }
        self.result.table("Twin, as given", ["what", "value"], rows.items())


def _tells(change: Change, compared: Compared) -> bool:
    """Return whether the given figure is suspect beside half or twice of it."""
    eased = compared.calmer if change.culprit == GAIT else compared.lighter
    return compared.clear or eased or (bool(change.evidence) and compared.gain > 0.0)


def _row(name: str, measures: Measures | None, reason: str = "") -> list[str]:
    if measures is None:
        return [name, f"not tried: {reason}", *[""] * 4]
    error = measures.velocity_error if measures.tracks else None
    error = error if measures.motion_error is None else measures.motion_error
    return [
        name,
        measures.outcome(),
        f"{measures.score:.2f}",
        f"{measures.tracking:.2f}" if measures.follows else "-",
        "-" if error is None else f"{error:.2f}",
        f"{measures.target_rate:.1f}",
    ]


def _strays(given: Measures) -> str:
    if given.motion_error is not None:
        return f"it stays up, but its joints are {given.motion_error:.2f} rad from the motion (rms)"
    moves = _velocity(given.velocity)
    return f"it stays up, but moves at {moves} where {_velocity(given.command)} is commanded"


def _velocity(values: Sequence[float]) -> str:
    vx, vy, wz = (figure(value, ".2f") for value in values)
    return f"vx {vx}, vy {vy} m/s, wz {wz} rad/s"

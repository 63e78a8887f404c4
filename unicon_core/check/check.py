"""All checks of a workflow before a motor moves: `check_workflow` for `unicon check` and CI.

`refuse_errors` is for command and node: what `unicon check` calls an error does not run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from unicon_base import (
    AnyDict,
    CheckError,
    MissingDependencyError,
    ModelError,
    PlatformError,
    PolicyError,
    RobotError,
    UniconError,
    WorkflowError,
    alternatives,
)
from unicon_base.resources import sha256_of
from unicon_core.check.gains import check_gains, check_held, check_limits
from unicon_core.check.graph import (
    check_blocks,
    check_gates,
    check_keys,
    check_memory,
    check_parts,
    check_safety,
    check_start,
    prove_memory,
)
from unicon_core.check.joints import check_joints, check_order
from unicon_core.check.observation import (
    check_commands,
    check_frames,
    check_observation,
    check_timing,
)
from unicon_core.check.pose import check_action, check_fed, check_pose
from unicon_core.check.result import CheckResult
from unicon_core.check.rules import CODES, FIRM
from unicon_core.check.subject import Subject, build_subject, declared_platform, listed
from unicon_core.evidence import LEVELS, Evidence, load_evidence
from unicon_core.platforms.kit.scene import CONTACT, TERRAIN
from unicon_core.platforms.platform import Facts
from unicon_core.policies.networks.onnx_file import read_onnx
from unicon_core.robots import Robot, robot_files
from unicon_core.terrain.words import FLAT, read_terrain
from unicon_core.workflow import Hook, WorkflowDocument, load_document

if TYPE_CHECKING:
    from unicon_core.workflow import Program


def check_files(subject: Subject, result: CheckResult) -> None:
    """Add the table of files; loading refuses a network that is not the contract's."""
    files = [("workflow", subject.document.path)]
    files += [(f"robot {m}".strip(), path) for m, path in robot_files(subject.robot).items()]
    if subject.model is not None:
        files.append(("model", subject.model.path))
    expected = dict[Path, str | None]()
    for policy in subject.policy_results(result):
        for note in policy.contract.notes:
            policy.note("policy.source", "", note)
    for key, contract in subject.policies.items():
        files.append((f"policy {key}", contract.path))
        if contract.model != contract.path:
            files.append((f"network {key}", contract.model))
        files += [(f"network {key}.{part.name}", part.model) for part in contract.networks]
        expected |= {part.model: part.sha256 for part in contract.networks}
        expected[contract.model] = contract.sha256
        if contract.is_onnx:
            external = read_onnx(contract.model).external
            files += [(f"weights {key}", contract.model.parent / name) for name in external]
    rows = []
    for role, path in files:
        digest = sha256_of(path)
        said = "as the contract says" if expected.get(path) == digest else ""
        rows.append([role, str(path), f"{path.stat().st_size / 1024:.0f}", digest[:16], said])
    result.table("Files", ["what", "file", "KiB", "sha256", ""], rows)


def check_robot(subject: Subject, result: CheckResult) -> None:
    """Missing facts of the robot file: findings on hardware, notes in simulation."""
    robot = subject.robot
    missing = robot.missing_facts()
    if not missing:
        return
    culprit = f"robot {robot.name}"
    evidence = f"the file does not say {listed(missing, 8)}"
    if subject.platform.simulated:
        result.note("robot.facts", culprit, f"{evidence}: the real robot cannot be driven")
    else:
        result.find("robot.facts", culprit, evidence, where=robot.path)


ENOUGH = {"simulator": "vendor", "robot": "hardware"}
"""Levels from which nothing is said."""


def little_seen(facts: Facts, robot: Robot) -> list[Evidence]:
    """Return what was hardly run of a workflow's platform, or of the robots that it drives.

    Args:
        facts: of the platform.
        robot: of the workflow.
    """
    robots = [("robot", each.name) for each in (robot.members.values() or (robot,))]
    ledger, levels = load_evidence(), list(LEVELS)
    found = [
        ledger.get(key) for key in ([("simulator", facts.name)] if facts.simulated else robots)
    ]
    return [
        each
        for each in found
        if each is not None and levels.index(each.level) < levels.index(ENOUGH[each.kind])
    ]


def check_seen(subject: Subject, result: CheckResult) -> None:
    """Note what the workflow's platform was hardly run against."""
    for each in little_seen(subject.platform, subject.robot):
        result.note("evidence", f"{each.kind} {each.name}", str(each))


def check_ground(subject: Subject, result: CheckResult) -> None:
    """Note a terrain where no simulator lays it under the feet."""
    said = subject.document.get("scene", {}).get(TERRAIN) or FLAT
    if read_terrain(said, 0) and not {TERRAIN, CONTACT} <= {*subject.platform.physics}:
        evidence = f"platform {subject.platform.name!r} lays none: the world gives the ground"
        result.note("scene.ground", "scene.terrain", evidence)


def check_reach(subject: Subject, result: CheckResult) -> None:
    """Note the pairs of capsules that a block `reach` leaves out."""
    for block in subject.blocks:
        for note in getattr(block.tick, "notes", ()):
            result.note("reach.apart", f"block {block.name!r}", note, where=block.where)


def check_bodies(subject: Subject, result: CheckResult) -> None:
    """Note end effectors and capsules of the robot file on bodies that the model lacks.

    No block of this workflow uses one: a block that does is not built without the body.
    """
    robot = subject.robot
    named = {f"end effector {name!r}": place.body for name, place in robot.end_effectors.items()}
    named |= {f"capsule {name!r}": capsule.body for name, capsule in robot.capsules.items()}
    if not named or subject.model is None:
        return
    model = subject.model.model
    known = [model.body(i).name for i in range(1, model.nbody)]
    for what, body in named.items():
        if body not in known:
            evidence = f"{what} is on body {body!r}, which model {subject.model.path} lacks"
            remedy = f"no block uses it; {alternatives(body, known)}"
            result.note("model.bodies", f"robot {robot.name}", evidence, remedy, robot.path)


Check = Callable[[Subject, CheckResult], None]

CHECKS = (
    check_joints, check_order, check_gains, check_held, check_limits, check_observation,
    check_action, check_fed, check_timing, check_commands, check_pose, check_start, check_gates,
    check_safety, check_parts, check_keys, check_reach, check_robot, check_ground,
)  # fmt: skip
"""Those that `unicon run` asks, too."""

SLOWER = (
    check_frames, check_files, check_bodies, check_blocks, check_memory, check_seen,
)  # fmt: skip
"""They read the platform, hash files, or repeat what the build has done."""

_CULPRITS = {
    RobotError: "robot",
    ModelError: "model",
    PolicyError: "policy",
    PlatformError: "platform",
    MissingDependencyError: "installation",
    UniconError: "workflow",
}


def check_workflow(
    name_or_path: str | Path,
    overrides: Iterable[str] = (),
    *,
    twin: bool = False,
    more: Iterable[Check] = (),
    hooks: Sequence[Hook] = (),
) -> CheckResult:
    """Check a workflow without moving anything.

    Hardware is never opened: its platform is exchanged for `fake`. A workflow that cannot be built
    gives its error as a finding.

    Args:
        name_or_path: a name in `config/workflows/`, or a path.
        overrides: `path=value` texts as of `--set`.
        twin: also simulate it, and broken contracts beside it.
        more: further checks of the built workflow, such as that of its message map.
        hooks: hooks that stand for what a run would add to the graph, such as topics.

    Returns:
        Tables, findings and notes; `findings` is empty where all is well.
    """
    result = CheckResult(Path(str(name_or_path)).stem)
    try:
        document = load_document(name_or_path, overrides)
        result.workflow = document.name
        settings = check_section(document, result)
        subject = build_subject(document, hooks)
    except UniconError as error:
        culprit = next(name for kind, name in _CULPRITS.items() if isinstance(error, kind))
        for each in error.problems or (error,):
            result.find_error("build", culprit, each)
        return result
    try:
        platform = subject.platform
        kind = "simulated" if platform.simulated else "hardware, not opened"
        result.subject = (
            f"robot {subject.robot.name}, platform {platform.name} ({kind}), {document.path}"
        )
        for note in subject.program.platform.facts.notes:
            result.note("platform.open", f"platform {platform.name!r}", note)
        static_checks(subject, result)
        for check in more:
            check(subject, result)
        if twin:
            prove_memory(subject, result)
    finally:
        subject.program.close()
    if twin:
        from unicon_core.check.twin.check import check_twin

        check_twin(document, subject.program.platform, settings, result)
    return result


def static_checks(subject: Subject, result: CheckResult) -> None:
    """Do all checks that take no run; of a live subject those that a run has not done itself.

    Args:
        subject: what is checked.
        result: is added to.
    """
    checks = CHECKS if subject.live else (*CHECKS, *SLOWER)
    for check in checks:
        check(subject, result)
    result.sort()


def check_section(document: WorkflowDocument, result: CheckResult) -> AnyDict:
    """Return the workflow's `check:` section, its codes accepted by the result."""
    settings: AnyDict = document.get("check", {})
    if settings.get("accept") is not None:
        result.accept(settings["accept"], document.where("check", "accept"))
    return settings


def refuse_errors(program: Program, force: Iterable[str] = ()) -> list[str]:
    """Check a workflow that was built to run; a simulator is left as it was.

    The static checks of `unicon check` take the workflow as it is: 20 to 50 ms, once.

    Args:
        program: built, not yet ticked; `forced` is set in it.
        force: codes of errors to go on with.

    Returns:
        Warnings to be told at every start: errors that are forced or accepted, a workflow without
        safety blocks or gates, and safety blocks that a robot does not have.

    Raises:
        WorkflowError: an unknown code.
        CheckError: errors that are not forced; all are named.
    """
    forced = dict.fromkeys(force)
    for code in forced:
        if code not in CODES:
            raise WorkflowError(
                f"force: no finding has the code {code!r}; {alternatives(code, CODES)}"
            )
        if code in FIRM:
            raise WorkflowError(f"force: a run cannot begin with {code!r}; mend what it finds")
    document = program.document
    result = CheckResult(program.name)
    check_section(document, result)
    facts = declared_platform(document) if program.has_platform else (program.platform.facts, True)
    static_checks(Subject(document, program, *facts, live=True), result)
    errors = [found for found in result.findings if found.code not in forced]
    if errors:
        codes = " ".join(
            f"--force {code}" for code in dict.fromkeys(e.code for e in errors) if code not in FIRM
        )
        risk = f" or go on at your own risk with {codes}" if codes else ""
        raise CheckError(
            f"workflow {program.name!r} is not run, mend it{risk}:",
            [str(found) for found in errors],
        )
    told = [f"forced: {found}" for found in result.findings]
    told += [f"accepted by the workflow: {found}" for found in result.waived]
    decided = dict.fromkeys(found.code for found in [*result.findings, *result.waived])
    program.forced = tuple(decided)
    notes = [(note, CODES[note.code].at_start) for note in result.notes]
    told += [f"{note.culprit}: {text or note.evidence}" for note, text in notes if text is not None]
    return told

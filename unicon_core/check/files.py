"""What a workflow consists of: its files with their hashes, what they lack, and what was tried.

The robot file's missing facts, bodies that it names and the model lacks, capsules that arms do not
keep apart, and what platform and robots last ran against.
"""

from __future__ import annotations

from unicon_base.errors import alternatives
from unicon_base.resources import sha256_of
from unicon_core.check.result import CheckResult
from unicon_core.check.subject import Subject, listed
from unicon_core.evidence import LEVELS, Evidence, load_evidence
from unicon_core.platforms.platform import Facts
from unicon_core.policies.networks.onnx_file import read_onnx
from unicon_core.robots import Robot, robot_files


def check_files(subject: Subject, result: CheckResult) -> None:
    """Add the table of files; loading refuses a network that is not the contract's."""
    files = [("workflow", subject.document.path)]
    files += [(f"robot {m}".strip(), path) for m, path in robot_files(subject.robot).items()]
    if subject.model is not None:
        files.append(("model", subject.model.path))
    expected = {}
    for policy in subject.policy_results(result):
        for note in policy.contract.notes:
            policy.note("policy.source", "", note)
    for key, contract in subject.policies.items():
        files.append((f"policy {key}", contract.path))
        if contract.model != contract.path:
            files.append((f"network {key}", contract.model))
        for part in contract.networks:
            files.append((f"network {key}.{part.name}", part.model))
            if part.sha256 is not None:
                expected[part.model] = part.sha256
        if contract.sha256 is not None:
            expected[contract.model] = contract.sha256
        if not contract.is_torchscript:
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
        result.find(
            "robot.facts",
            culprit,
            evidence,
            where=robot.path,
        )


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

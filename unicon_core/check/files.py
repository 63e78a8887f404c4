"""The files that a workflow consists of, with their hashes, and what the robot file lacks."""

from __future__ import annotations

from unicon_core.check.result import CheckResult
from unicon_core.check.subject import Subject, listed
from unicon_core.policies.networks.onnx_file import read_onnx
from unicon_core.resources import sha256_of
from unicon_core.robots import robot_files


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
            "find them (the vendor's URDF, SDK or a measurement) and add them with their source",
            robot.path,
        )

"""Joint coverage and order: one table of policy, robot and platform."""

from __future__ import annotations

from unicon_core.check.result import CheckResult
from unicon_core.check.subject import Subject, listed

__all__ = ["check_joints"]


def check_joints(subject: Subject, result: CheckResult) -> None:
    """Add the table of joints; motor slots that do not fit are findings."""
    robot = subject.robot
    names = robot.joint_names
    model = subject.model
    motors = robot.transport.get("motors")
    columns = ["robot", "joint", *(f"policy {name}" for name in subject.policies)]
    columns += [subject.platform.name]
    rows = []
    for i, name in enumerate(names):
        row = [str(i), name]
        for contract in subject.policies.values():
            if name not in contract.joints:
                row.append("held")
            else:
                place = str(contract.joints.index(name))
                row.append(place if name in contract.action.joints else f"{place}, held")
        if model is not None:
            joint = model.joints[i]
            row.append(f"joint {joint} {model.model.joint(joint).name}")
        elif isinstance(motors, list) and i < len(motors) and not subject.platform.simulated:
            row.append(f"motor {motors[i]}")
        else:
            row.append(str(i))
        rows.append(row)
    lines = []
    for policy in subject.policy_results(result):
        contract = policy.contract
        moved = [name for name in contract.joints if name in contract.action.joints]
        same = [name for name in names if name in contract.joints] == list(contract.joints)
        order = "in the robot's order" if same else "in another order, aligned by name"
        lines.append(f"policy {policy.key} moves {len(moved)} of {len(names)} joints, {order}")
        held = [name for name in names if name not in contract.action.joints]
        if held:
            evidence = f"does not move {listed(held)}; they are held at their default"
            policy.note("joints.held", "", evidence)
    result.table("Joints", columns, rows, lines)
    if subject.platform.simulated or not isinstance(motors, list):
        return
    if len(motors) != len(names) or len(set(motors)) != len(motors):
        result.find(
            "joints.motors",
            f"robot {robot.name}, transport.motors",
            f"{len(motors)} motor slots, {len(set(motors))} of them different, for "
            f"{len(names)} joints",
            "give one slot for each joint, in the order of joints",
            robot.path,
        )

"""Joint coverage and order: one table of policy, robot and platform."""

from __future__ import annotations

from collections.abc import Mapping

from unicon_core.check.result import CheckResult
from unicon_core.check.subject import Subject, listed
from unicon_core.policies.driven import DrivenPolicy
from unicon_core.robots import Robot


def check_joints(subject: Subject, result: CheckResult) -> None:
    """Add the table of joints; motor slots that do not fit are findings."""
    robot = subject.robot
    names = robot.joint_names
    model = subject.model
    motors = [str(n) for each in _each(robot).values() for n in _slots(each)]
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
        elif motors[i] and not subject.platform.simulated:
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
    if model is not None and model.welded:
        result.note(
            "joints.welded",
            f"model {model.path.name}",
            f"it lacks {listed(model.welded)}, which no policy moves: they are taken as welded",
        )
    _seen(subject, result)
    result.table("Joints", columns, rows, lines)
    if subject.platform.simulated:
        return
    for each in _each(robot).values():
        slots = each.transport.get("motors")
        count = len(each.joint_names)
        if isinstance(slots, list) and not len(set(slots)) == len(slots) == count:
            result.find(
                "joints.motors",
                f"robot {each.name}, transport.motors",
                f"{len(slots)} motor slots, {len(set(slots))} of them different, for "
                f"{count} joints",
                where=each.path,
            )


def _seen(subject: Subject, result: CheckResult) -> None:
    """Find policies that see joints which others move: few were trained so."""
    keys = {id(contract): key for key, contract in subject.program.policies.items()}
    for block in subject.program.blocks:
        tick = block.tick
        if not isinstance(tick, DrivenPolicy) or not {"joint_pos", "joint_vel"} & {*tick.reads}:
            continue
        names = subject.robot.joint_names
        known = {names[place] for place in (*tick.places, *tick.hidden)}
        seen = [name for name in names if name in tick.contract.joints and name not in known]
        if seen:
            result.find(
                "joints.seen",
                f"policy {keys[id(tick.contract)]!r}",
                f"sees {listed(seen)}, which others move: most policies fall by that",
                where=block.where,
            )


def _each(robot: Robot) -> Mapping[str, Robot]:
    return robot.members or {"": robot}


def _slots(robot: Robot) -> list[object]:
    """Return the motor slot of each joint, "" where none is said."""
    slots = robot.transport.get("motors")
    slots = slots if isinstance(slots, list) else []
    return [slots[i] if i < len(slots) else "" for i in range(robot.num_joints)]

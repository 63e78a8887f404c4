"""Which contract made a record: the policy runs over the recorded sensors, open loop.

The recorded sensors are what the policy saw, so the contract that made the record gives the
recorded targets again, but for rounding. Where the given one does not, it is changed in one way
after another; the change that gives them names the cause.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from unicon_base import AnyDict, Fault, UniconError, WorkflowError, alternatives, one_line
from unicon_base.arrays import Array, Bool
from unicon_core.check.twin.perturb import AS_GIVEN, GAINS, TERMS, Change
from unicon_core.check.twin.repair import repairs
from unicon_core.policies import PolicyContract, load_policy
from unicon_core.policies.action_map import ActionMap, lacking_joints
from unicon_core.policies.controller import prefix_of
from unicon_core.policies.policy_yaml import contract_values
from unicon_core.robots import Robot, joint_index, load_robot
from unicon_core.workflow.members import load_robot_of
from unicon_core.workflow.policies import load_policies
from unicon_lab.diagnose import Cause, name_of
from unicon_lab.diagnose.open_loop import LEAST, OpenLoop, hypotheses, nearer
from unicon_lab.recording import Record
from unicon_lab.replay.workflow import recorded_workflow, robot_of, workflow_of

SAME = 1e-3
"""RMS of targets in [rad] up to which a contract made the record: processors round otherwise."""
EXACT = 3e-5
"""RMS in [rad] below which two contracts explain a record equally well."""
LEFT = 0.1
"""Share of the residual that an explanation other than these contracts is taken to leave."""
_SIZES = (100, 200, 500, 1000, 2000, 4000)  # ticks that are tried
_FINAL = 12  # hypotheses that are tried over more ticks
_MOST = 5  # causes that are returned
_RIGHT = "for this record; correct what is not as in training"
_VARIED = "the policy under commands of every direction and turn"
Tell = Callable[..., object]


def contract_causes(
    record: Record, where: str, contract: PolicyContract | None = None, tell: Tell = lambda *_: None
) -> tuple[list[Cause], list[str]]:
    """Say in what the contract that made a record differs from the given one.

    Args:
        record: of a run of one robot.
        where: what messages call the record.
        contract: the given one; None for those of the recorded workflow, as their files are now.
        tell: takes what is examined, and the share of it that is done.

    Returns:
        The causes, the most probable first, and what could not be examined. Probabilities are
        among contracts: what the causes of one policy lack of 1 is that no contract explains the
        targets. Gains stand in the record, and their causes are certain by themselves. `size` is
        NaN where a cause has none.
    """
    causes, notes = list[Cause](), list[str]()
    try:
        robot, given = _given(record, contract)
    except UniconError as error:
        return [], [f"{where}: contract hypotheses are not examined: {one_line(error)}"]
    for key, each in given.items():
        label = f"{where}, policy {key!r}"
        try:
            played = OpenLoop(record, each, robot, prefix_of(key, record.policies))
            found, more = _examined(played, label, tell)
        except (Fault, UniconError) as error:
            more, found = [f"contract hypotheses are not examined: {one_line(error)}"], []
        causes += found
        notes += [f"{label}: {text}" for text in more]
    return sorted(causes, key=lambda cause: -cause.probability), notes


def _given(
    record: Record, contract: PolicyContract | None
) -> tuple[Robot, dict[str, PolicyContract]]:
    """Return the robot, and the contract to examine by the record's name of each policy."""
    document, keys = None, list(record.policies)
    if recorded_workflow(record) is not None:
        try:
            document = workflow_of(record)
        except WorkflowError:
            if contract is None:
                raise
    robot = load_robot(robot_of(record)) if document is None else load_robot_of(document)
    if record.joints != robot.joint_names:
        raise UniconError(
            f"robot {robot.name} has the joints {', '.join(robot.joint_names)}, and the record has "
            f"{', '.join(record.joints) or 'none'}; restore the robot file of the recording"
        )
    if contract is not None:
        path = str(contract.path)
        mine = [k for k, said in record.policies.items() if said.get("path") == path] or keys
        mine = [key for key in mine if len(mine) == 1 or key == contract.name]
        if keys and not mine:
            raise UniconError(
                f"nothing says which policy of the record {contract.name} is: "
                f"{alternatives(contract.name, keys)}; name the contract like one of them"
            )
        found = {mine[0] if mine else contract.name: contract}
    elif document is not None:
        found = load_policies(document, robot)
    else:
        found = {key: load_policy(str(said.get("path"))) for key, said in record.policies.items()}
    if not found:
        raise UniconError("the record names no policy; give a workflow with one")
    for each in found.values():
        if lacking := lacking_joints(each, robot):
            raise UniconError(f"policy {each.name}: {lacking}")
    if re.search(r"\b(drives|sees_default_for):", record.facts.get("workflow_effective", "")):
        raise UniconError(
            "the policy moves some joints alone (drives, sees_default_for); record a run in which "
            "it moves all of them"
        )
    return robot, found


def _examined(played: OpenLoop, label: str, tell: Tell) -> tuple[list[Cause], list[str]]:
    """Return the causes that one policy's ticks show, and notes."""
    contract, notes = played.contract, played.notes
    changes = [*repairs(contract, played.robot, played.model, recorded=True)]
    own = played.run(AS_GIVEN)
    squares = played.squares(own)
    whole = float(np.sqrt(squares.mean()))
    if len(own) * contract.period < 1.0:
        notes.append(f"it ran for {len(own)} ticks, less than 1 s: what they say is uncertain")
    if whole < SAME:
        gains = _gain_causes(played, changes, contract)
        but = ", but for its gains" if gains else ""
        return gains, [*notes, f"the given contract made this record{but} ({whole:.1g} rad rms)"]

    def enough(least: int) -> int:
        """Return how many ticks from the beginning show what all of them show."""
        sizes = [n for n in _SIZES if least <= n < len(own)]
        return next((n for n in sizes if squares[:n].mean() > 0.25 * whole**2), len(own))

    tried, left = list(hypotheses(played, own, changes)), list[float]()
    for i, each in enumerate(tried):
        tell(f"{label}: contracts", i / len(tried))
        left.append(played.residual(each, enough(0)))
    order = np.argsort(left, kind="stable")[::-1].tolist()
    scales = {tried[i].culprit: i for i in order if f"{TERMS}scale of" in tried[i].culprit}
    for i in scales.values() if min(left) > SAME else ():
        fitted = nearer(played, tried[i], enough(0))
        if abs(fitted.size - 1.0) > LEAST and (off := played.residual(fitted, enough(0))) < left[i]:
            tried[i], left[i] = fitted, off
    ticks = enough(500)
    before = float(np.sqrt(squares[:ticks].mean()))
    for i in np.argsort(left, kind="stable")[:_FINAL].tolist():
        left[i] = played.residual(tried[i], ticks)
    samples = max(ticks / 10.0, 1.0)
    score = -samples * np.log(np.hypot([*left, LEFT * before], EXACT))
    score -= 0.5 * np.log(samples) * np.array([*(each.figures for each in tried), 0])
    weight = np.exp(score - score.max())
    weight /= weight.sum()
    causes, free = list[Cause](), [*range(len(tried))]
    for i in np.argsort(-score[:-1], kind="stable").tolist():
        if i not in free or len(causes) == _MOST or weight[i] < 0.01:
            continue
        group = [k for k in free if left[k] <= 3.0 * max(left[i], EXACT)]
        free = [k for k in free if k not in group]
        lead, alike = tried[i], dict.fromkeys(name_of(*tried[k].place) for k in group)
        kind, where = lead.place
        alike.pop(name_of(kind, where), None)
        causes.append(
            Cause(
                kind,
                where,
                "contract",
                float(weight[group].sum()),
                lead.size,
                lead.size - lead.spread,
                lead.size + lead.spread,
                lead.unit,
                f"joint_pos_target: with {lead.name} the policy gives it within {left[i]:.1g} rad "
                f"rms, as given within {before:.2g}",
                _remedy(contract, lead),
                tuple(alike),
                next=_VARIED if alike else "",
            )
        )
    best, made = int(np.argmin(left)), contract
    if weight[-1] > 0.5:
        notes.append(
            f"no contract hypothesis explains the record, which is {before:.2g} rad rms from the "
            f"given contract; with {tried[best].name} {left[best]:.2g} are left"
        )
    else:
        made = tried[best].contract or contract
    return [*causes, *_gain_causes(played, changes, made)], notes


def _gain_causes(
    played: OpenLoop, changes: Iterable[Change], contract: PolicyContract
) -> list[Cause]:
    """Return in what the recorded gains differ from those of a contract."""
    record, robot, rows = played.record, played.robot, played.rows
    names = ("joint_stiffness", "joint_damping")
    if not {*names} <= {*record.layout.specs}:
        played.notes.append("the record has no joint_stiffness and joint_damping")
        return []
    made = np.stack([np.median(record.states(name)[rows], axis=0) for name in names])

    def near(contract: PolicyContract) -> tuple[Array, Bool]:
        """Return stiffness and damping of a contract, and where they are the recorded ones."""
        said = ActionMap(contract, robot)
        gains = np.stack((said.stiffness, said.damping))
        return gains, np.isclose(made, gains, LEAST, 1e-6)

    given, fits = near(contract)
    if fits.all():
        return []
    path = _file(contract)
    for each in changes:
        if each.culprit == GAINS and each.contract and near(each.contract)[1].all():
            said = f"joint_stiffness and joint_damping are the contract's with {each.name}"
            remedy = f"{path} needs stiffness and damping in that order {_RIGHT}"
            none = float("nan")
            return [Cause("gain_order", "", "contract", 1.0, none, none, none, "", said, remedy)]
    found = []
    for kind, is_, was, fit in zip(("stiffness", "damping"), made, given, fits):
        off = np.flatnonzero(~fit)
        if not off.size:
            continue
        factor = is_[off] / np.where(was[off] == 0.0, np.nan, was[off])
        size = float(np.median(factor))
        every = fit.size == off.size and np.ptp(factor) < LEAST * size
        joints = [robot.joint_names[i] for i in off]
        where = "" if every or off.size > 3 else ", ".join(joints)
        text = f"joint_{kind} of {joints[0]} is {is_[off[0]]:g}, in {path} it is "
        text += f"{was[off[0]]:g}" + (f"; {off.size} joints differ" if off.size > 1 else "")
        places = joint_index(contract.joints, robot.joint_names)
        values = ", ".join(f"{value:.6g}" for value in is_[places])
        remedy = f"{path} needs {kind}: [{values}] {_RIGHT}"
        low, high = float(factor.min()), float(factor.max())
        found.append(Cause(kind, where, "contract", 1.0, size, low, high, "", text, remedy))
    return found


def _remedy(contract: PolicyContract, tried: Change) -> str:
    """Return the lines of the policy's file in which two contracts differ."""
    if tried.contract is None:
        return f"let the policy see what it saw in training: the record has {tried.name}"
    given, other = (_lines(contract_values(each)) for each in (contract, tried.contract))
    said = list[str]()
    for key in {**given, **other}:
        was, needs = given.get(key), other.get(key)
        if was == needs:
            continue
        lines = [(key, was, needs)]
        if isinstance(was, list) and isinstance(needs, list) and not key.endswith("terms"):
            each = [(f"{key}[{i}]", *ab) for i, ab in enumerate(zip(was, needs)) if ab[0] != ab[1]]
            lines = each if 0 < len(each) <= 4 else lines
        said += [f"{place}: {_text(new)} instead of {_text(old)}" for place, old, new in lines]
    return f"{_file(contract)} needs {', '.join(said)} {_RIGHT}"


def _file(contract: PolicyContract) -> str:
    """Return where the user writes what the contract says."""
    return contract.path.name if contract.source == "policy.yaml" else "'given' of the policy"


def _lines(values: Any, key: str = "") -> AnyDict:
    """Return dotted key to value; of terms by their name, and those names in order."""
    lines = AnyDict()
    if key.endswith("terms"):
        lines[key], values = [term["name"] for term in values], {t["name"]: t for t in values}
    if not isinstance(values, dict):
        return {key: values}
    for name, value in values.items():
        lines |= _lines(value, f"{key}.{name}".lstrip("."))
    return lines


def _text(value: Any) -> str:
    if isinstance(value, list) and all(each == value[0] for each in value[1:]):
        return _text(value[0])
    if isinstance(value, list):
        return f"[{', '.join(map(_text, value))}]"
    return "(left out)" if value is None else str(value)

"""Policies as text tables, for `unicon policies`, `unicon show` and `unicon check`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby

from unicon_base import AnyDict, PolicyError, alternatives
from unicon_base.arrays import Float32
from unicon_core.policies.action_map import TermSlice, term_slices
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.controller import PackedStates
from unicon_core.policies.load import load_policy, policy_names
from unicon_core.policies.policy_states import policy_states, states_of
from unicon_core.robots import Robot
from unicon_core.states import States, standard_states
from unicon_core.text_table import aligned, figure, span


def policies_rows() -> list[AnyDict]:
    """Return what is said of each policy in `config/policies/`: `error` of a broken one."""
    rows: list[AnyDict] = []
    for name in policy_names():
        row: AnyDict = {"name": name}
        try:
            contract = load_policy(name)
            row |= {
                "robot": contract.robot,
                "rate": 1.0 / contract.period,
                "joints": len(contract.joints),
                "source": contract.source,
                "terms": [term.name for term in contract.terms],
            }
        except PolicyError as error:
            row["error"] = str(error)
        rows.append(row)
    return rows


def policies_table() -> str:
    """Return one line for each policy in `config/policies/`; a broken one shows its error."""
    rows = [["policy", "robot", "rate [Hz]", "joints", "source", "terms"]]
    for row in policies_rows():
        facts = ["?", "?", "?", row.get("error", ""), ""]
        if "error" not in row:
            facts = [row["robot"] or "-", f"{row['rate']:g}", str(row["joints"]), row["source"]]
            facts.append(" ".join(row["terms"]))
        rows.append([row["name"], *facts])
    return "\n".join(aligned(rows)) if len(rows) > 1 else "no policies in config/policies"


def policy_table(contract: PolicyContract, robot: Robot | None = None) -> str:
    """Return all that is known of a policy.

    Args:
        contract: the policy.
        robot: adds each joint's place in the robot's order.
    """
    action = contract.action
    lines = [
        f"policy {contract.name}  ({contract.source}: {contract.path})",
        f"network      {contract.model}",
        *(f"  after      {part.name}: {part.model}" for part in contract.networks),
        f"period       {contract.period:g} s ({1.0 / contract.period:g} Hz)",
        f"robot        {contract.robot or 'not said'}",
        f"inputs       {_pairs(contract.inputs.items())}",
        f"outputs      {_pairs(contract.outputs.items())}",
    ]
    if contract.recurrent:
        lines.append(f"recurrent    {_pairs((r.output, r.input) for r in contract.recurrent)}")
    value = "action" if action.clip is None else "clip(action)"
    if action.filter is not None:
        value = f"filter({value})"
    lines.append(
        f"action       target = offset + scale · {value}; last action is the {action.feedback} one"
    )
    if action.extra is not None:
        lines.append(f"extra        outputs beyond the joints: state {action.extra}")
    if action.filter is not None:
        lines.append(f"filter       {action.filter}, begins with {action.filter.start}")
    if (chunk := contract.chunk) is not None:
        row = chunk.period or contract.period
        lines.append(f"chunk        {chunk.size} rows of {row:g} s, {chunk.execution}")
    if contract.command is not None:
        slew = ", ".join(map(figure, contract.command.slew))
        lines.append(f"command      changes by at most {slew} [m/s², m/s², rad/s²] (slew)")
    for name, (low, high) in contract.command_ranges.items():
        lines.append(f"command      {name} from {span(low, high, ' to ')}")
    if (phase := contract.phase) is not None:
        offsets = ", ".join(figure(offset, ".4g") for offset in phase.offsets)
        words = {"None": "keeps running", "freeze": "stands still", "zero": "sine and cosine are 0"}
        still = words.get(str(phase.stand)) or (
            f"stands at {figure(float(phase.stand or 0), '.4g')} rad"
        )
        speed = "" if phase.rate is None else f", its speed times {phase.rate}"
        speed += "" if phase.shift is None else f", ahead by {phase.shift}"
        lines.append(
            f"gait phase   period {phase.period:g} s{speed}, offsets {offsets} rad, {still} "
            "without a command"
        )
    if contract.height_scan is not None:
        lines.append(f"height scan  {contract.height_scan}")
    lines += [f"image        {name}: {image}" for name, image in contract.images.items()]
    lines += [f"note         {note}" for note in contract.notes]
    lines += ["", joint_table(contract, robot)]
    if contract.terms:
        has_all = robot is not None and set(contract.joints) <= set(robot.joint_names)
        lines += ["", observation_table(contract, robot if has_all else None)]
    return "\n".join(lines)


def joint_table(contract: PolicyContract, robot: Robot | None = None) -> str:
    """Return `joint_rows` as text."""
    return "\n".join(aligned(joint_rows(contract, robot)))


def joint_rows(contract: PolicyContract, robot: Robot | None = None) -> list[list[str]]:
    """Return the heads, then a row for each joint in policy order: gains, pose and action.

    Args:
        contract: the policy.
        robot: adds the place in the robot's order, and a line for each joint that is only held.
    """
    action = contract.action
    place = {} if robot is None else {name: i for i, name in enumerate(robot.joint_names)}
    unit = "" if action.kinds else " [rad]"
    head = ["#", "joint", "kp", "kd", "default [rad]", "scale", f"offset{unit}", "clip"]
    head += ["target"] if action.kinds else []
    held = ["held", "-", "-", *(["-"] if action.kinds else [])]
    rows = [[*head[:2], "robot", *head[2:]] if robot is not None else head]
    gains = (contract.stiffness, contract.damping, contract.default_joint_pos)
    for i, name in enumerate(contract.joints):
        row = [str(i), name] + ([] if robot is None else [str(place.get(name, "missing"))])
        row += [figure(values[i]) for values in gains]
        ends = held
        if name in action.joints:
            j = action.joints.index(name)
            clip = "-" if action.clip is None else span(action.clip[0, j], action.clip[1, j], "…")
            ends = [
                figure(action.scale[j]),
                figure(action.offset[j]),
                clip,
                *action.kinds[j : j + 1],
            ]
        rows.append(row + ends)
    own = ["robot's"] * 3
    return rows + [
        ["-", name, str(place[name]), *own, *held] for name in place if name not in contract.joints
    ]


def observation_table(
    contract: PolicyContract, robot: Robot | None = None, states: PackedStates | None = None
) -> str:
    """Return `observation_rows` as text, and what the numbers mean."""
    rows, tail = observation_rows(contract, robot, states)
    return "\n".join([*aligned(rows), tail])


def observation_rows(
    contract: PolicyContract, robot: Robot | None = None, states: PackedStates | None = None
) -> tuple[list[list[str]], str]:
    """Return the heads and a row for each term, and a line with what the numbers mean.

    A row has the source state, the slice of the input, numbers and unit.

    Args:
        contract: the policy.
        robot: joint order; the policy's own if None.
        states: the workflow's states; the standard ones and the policy's own if None.

    Raises:
        PolicyError: a term does not fit the states.
    """
    joints: Sequence[str] = contract.joints if robot is None else robot.joint_names
    if states is None:
        known = {**standard_states(joints), **states_of(contract)}
        for term in contract.terms:
            if term.state not in known:
                raise PolicyError(
                    f"policy {contract.name}: term {term.name!r}: state {term.state!r} is neither "
                    f"standard nor its own; {alternatives(term.state, known)}; where a workflow "
                    "has it, such as another policy's last action: unicon show WORKFLOW"
                )
        states = States({**known, **policy_states(contract, joints)})
    slices = term_slices(contract, states, joints)
    rows = [["term", "state", "slice", "subtract", "scale", "clip", "history", "unit"]]
    for part, where in zip(slices, input_places(contract, slices)):
        term = part.term
        rows.append(
            [
                term.name,
                _source(part),
                where,
                term.subtract
                if isinstance(term.subtract, str)
                else _values(part.subtract, "-", 0.0),
                _values(part.scale, "1", 1.0),
                "-" if term.clip is None else span(part.low.min(), part.high.max(), "…"),
                str(term.history),
                part.unit or "-",
            ]
        )
    layout = contract.observation
    history = any(part.term.history > 1 for part in slices)
    order = f"{layout.layout}, newest {layout.newest}" if history else "no history"
    filtered = any(part.term.filter is not None for part in slices)
    state = "filter(state)" if filtered else "state"
    size = sum(part.elements.size * part.term.history for part in slices)
    tail = f"{size} values, {order}; term = scale · clip({state} − subtract)"
    return rows, tail


def input_places(contract: PolicyContract, slices: Sequence[TermSlice]) -> list[str]:
    """Return where each term stands in the network's input, as `[0:15]`.

    In layout `frame_major`, where whole frames follow each other, `frame[0:3]`: its place in each;
    with several histories, `[0:280]` with it are the frames of the neighbours that have one.

    Args:
        contract: the policy.
        slices: its terms, of `term_slices`.
    """
    places: list[str] = []
    start, groups = 0, [[*parts] for _, parts in groupby(slices, lambda p: p.term.history)]
    for group in groups:
        first, history = group[0].start, group[0].term.history
        stop = start + history * (group[-1].stop - first)
        frames = contract.observation.layout == "frame_major" and (history > 1 or len(groups) == 1)
        within = f"[{start}:{stop}] " if len(groups) > 1 else ""
        for part in group:
            size = part.elements.size * history
            places.append(
                f"{within}frame[{part.start - first}:{part.stop - first}]"
                if frames
                else f"[{start}:{start + size}]"
            )
            start += 0 if frames else size
        start = stop
    return places


def _source(part: TermSlice) -> str:
    index, value = part.term.index, part.term.value
    if value is not None:
        return f"constant {', '.join(map(figure, value))}"
    source = part.term.state + ("" if index is None else f"[{','.join(map(str, index))}]")
    return source if part.term.filter is None else f"{source}, {part.term.filter}"


def _values(values: Float32, same: str, neutral: float) -> str:
    if (values == neutral).all():
        return same
    if (values == values[0]).all():
        return figure(values[0])
    return span(values.min(), values.max(), "…")


def _pairs(items: Iterable[tuple[str, str]]) -> str:
    return ", ".join(f"{a} → {b}" for a, b in items) or "-"

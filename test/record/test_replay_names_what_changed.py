"""What a replay names where a policy is not the recorded one: twenty cases of four policies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnxruntime", reason="the policies are ONNX networks")
pytest.importorskip("onnx")

import onnx
from replaying import Told, cut_off

from unicon_core.policies import PolicyContract
from unicon_core.robots import load_robot
from unicon_core.workflow import load_document
from unicon_core.workflow.policies import load_policies
from unicon_lab.recording import Record
from unicon_lab.replay import Difference, verify, workflow_of

WORKFLOWS = {"go2_walk": 260, "go1_walk": 40, "g1_walk": 130, "g1_holosoma": 130}
"""With the ticks before the fault; the last two are recorded from their middle on."""
FROM_THE_MIDDLE = ("g1_walk", "g1_holosoma")
SAFETY = {"safety": ["finite"], "wind_down": None}  # noise would trip more, and limits hide targets


@pytest.fixture(scope="module")
def recorded(
    assets: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], tuple[Told, PolicyContract]]:
    """Return what records a workflow once, and its policy."""
    known: dict[str, tuple[Told, PolicyContract]] = {}

    def record(workflow: str) -> tuple[Told, PolicyContract]:
        if workflow not in known:
            with pytest.MonkeyPatch.context() as patch:
                patch.setenv("UNICON_ASSETS", str(assets))
                if workflow in FROM_THE_MIDDLE:
                    patch.setattr("unicon_core.runtime.tick_ring.KEPT_S", 1.0)
                folder = tmp_path_factory.mktemp(workflow)
                told = cut_off(workflow, folder, WORKFLOWS[workflow], overrides=SAFETY)
                document = load_document(workflow)
                policies = load_policies(document, load_robot(document.values["robot"]))
            known[workflow] = told, policies["walk"]
        return known[workflow]

    return record


@dataclass
class Expected:
    """What is to be named."""

    row: int
    state: str
    element: str
    why: str


def permuted(contract: PolicyContract, record: Record, folder: Path) -> tuple[Any, Expected]:
    """Two joints have each other's places."""
    joints = list(contract.joints)
    joints[1], joints[4] = joints[4], joints[1]
    other = replace(contract, joints=tuple(joints))
    changed = [
        i for i, term in enumerate(contract.terms) if term.state in ("joint_pos", "joint_vel")
    ]
    return other, observed(contract, other, record, changed)


def scaled(contract: PolicyContract, record: Record, folder: Path) -> tuple[Any, Expected]:
    """The scale of a term is dropped, or is there where none was."""
    terms = list(contract.terms)
    wanted = {"go2": "velocity_command", "g1_29dof": "joint_vel"}.get(record.facts["robot"], "")
    at = next(i for i, term in enumerate(terms) if term.state == (wanted or "base_ang_vel"))
    one = np.ones(1, np.float32)
    scale = one if (terms[at].scale != 1.0).any() else 4 * one
    terms[at] = replace(terms[at], scale=scale)
    other = replace(contract, observation=replace(contract.observation, terms=tuple(terms)))
    return other, observed(contract, other, record, [at])


def gain(contract: PolicyContract, record: Record, folder: Path) -> tuple[Any, Expected]:
    """One joint is a tenth stiffer."""
    stiffness = contract.stiffness.copy()
    stiffness[7] *= 1.1
    place = Expected(first_tick(record), "joint_stiffness", contract.joints[7], "the gain itself")
    return replace(contract, stiffness=stiffness), place


def network(contract: PolicyContract, record: Record, folder: Path) -> tuple[Any, Expected]:
    """Another network of the same form."""
    model = onnx.load(str(contract.model))
    for tensor in model.graph.initializer:
        weights = onnx.numpy_helper.to_array(tensor)
        if weights.dtype == np.float32 and weights.ndim == 2:
            tensor.CopyFrom(onnx.numpy_helper.from_array(weights * np.float32(1.05), tensor.name))
    path = folder / "other.onnx"
    onnx.save(model, str(path))
    place = Expected(first_tick(record), "action", contract.action.joints[0], "another network")
    return replace(contract, model=path, sha256=None), place


def action_scale(contract: PolicyContract, record: Record, folder: Path) -> tuple[Any, Expected]:
    """Actions count twice."""
    action = replace(contract.action, scale=2 * contract.action.scale)
    robot = load_robot(record.facts["robot"]).joint_names
    place = Expected(first_tick(record), "joint_pos_target", robot[0], "the action is the same")
    return replace(contract, action=action), place


def first_tick(record: Record) -> int:
    """Return the first row in which the policy ran."""
    return int(np.flatnonzero(record.states("observation").any(axis=1))[0])


def observed(
    contract: PolicyContract, other: PolicyContract, record: Record, changed: list[int]
) -> Expected:
    """Return where the observation differs first if some terms do, computed from the record."""
    start = 0
    places = []
    for number, (term, its) in enumerate(zip(contract.terms, other.terms)):
        slot = record.layout.specs[term.state]
        # What others command is there in the tick itself, sensors as they were received.
        moment = "sent" if term.state == "velocity_command" else "received"
        values, names = record.states(term.state, moment), [*map(str, range(slot.size))]
        if slot.names and set(slot.names) == set(contract.joints) and term.state != "action":
            values = values[:, [slot.names.index(joint) for joint in other.joints]]
            names = list(other.joints)
        elif slot.names:
            names = list(slot.names)
        index = list(range(values.shape[1])) if term.index is None else list(term.index)
        if number in changed:
            zero = np.zeros(len(index), np.float32)
            default = contract.default_joint_pos[index] if term.subtract is not None else zero
            new = (values[:, index] - default) * its.scale
            was = record.states("observation")[:, start : start + len(index)]
            for row in range(first_tick(record), int(record.ended.sum())):
                odd = np.flatnonzero(new[row] != was[row])
                if odd.size:
                    column = int(odd[0])
                    why = f"term {term.name!r} ({term.state}, {names[index[column]]})"
                    places.append((row, start + column, why))
                    break
        start += len(index)
    row, column, why = min(places)
    return Expected(row, "observation", f"element {column}", why)


CASES = (permuted, scaled, gain, network, action_scale)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("workflow", WORKFLOWS)
def test_the_first_tick_and_term_that_differ_are_named(
    workflow: str,
    case: Callable[..., tuple[PolicyContract, Expected]],
    recorded: Callable[[str], tuple[Told, PolicyContract]],
    assets: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told, contract = recorded(workflow)
    record = told.record
    monkeypatch.setenv("UNICON_ASSETS", str(assets))
    assert (record.ticks[0] > 0) == (workflow in FROM_THE_MIDDLE)
    other, expected = case(contract, record, tmp_path)
    monkeypatch.setattr("unicon_core.workflow.policies.load_policy", lambda *_, **__: other)
    verdict = verify(record, workflow_of(record))
    found = verdict.first
    assert isinstance(found, Difference)
    assert (found.row, found.state, found.element) == (
        expected.row,
        expected.state,
        expected.element,
    )
    assert found.tick == record.ticks[expected.row]
    assert found.block.startswith("policy")
    assert expected.why in found.why[0]
    assert found.recorded != found.replayed
    assert found.recorded == record.states(found.state)[found.row].flat[place_of(record, found)]
    assert any("sha256" in note for note in verdict.notes) == (case is network)


def place_of(record: Record, found: Difference) -> int:
    names = record.layout.specs[found.state].names
    return names.index(found.element) if names else int(found.element.removeprefix("element "))

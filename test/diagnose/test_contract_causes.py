"""Records made with contracts that differ in one way: the way comes out first."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from policy_helpers import write_graph

from unicon_core.check.joints import mirror_pairs
from unicon_core.check.twin.perturb import (
    clock_reordered,
    exchanged,
    gains_of,
    permuted,
    renamed,
    with_action,
    with_gains,
    with_scales,
    with_terms,
)
from unicon_core.flow import Block, Stage
from unicon_core.platforms.kit.base import rotation
from unicon_core.policies import PolicyContract
from unicon_core.policies.chunks import ChildSpec
from unicon_core.policies.contract import FilterSpec
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import Layout
from unicon_core.workflow import HookBlocks, Program, load_document
from unicon_core.workflow.members import load_robot_of
from unicon_core.workflow.policies import load_policies
from unicon_lab.diagnose import Cause
from unicon_lab.diagnose.contract import contract_causes
from unicon_lab.fault_record import FaultRecord
from unicon_lab.recording import Record, open_record
from unicon_lab.recording.run_recording import Recording

Change = Callable[[PolicyContract], PolicyContract]
NOISE = {
    "joint_pos": 0.1,
    "joint_vel": 1.0,
    "base_ang_vel": 0.5,
    "projected_gravity": 0.1,
    "velocity_command": 0.1,
}
"""Standard deviation of sensors and command in the state's unit."""
ALONE: dict[str, Any] = {
    "platform": "fake",
    "flow": {"policy": "walk"},
    "safety": ["finite"],
    "commands": [],
}
F = np.float32
GO2 = "FL_thigh_joint"


def _quiet(text: str) -> None:
    """Take a warning, such as that a command is held to its range."""


def given(contract: PolicyContract) -> PolicyContract:
    """Change nothing."""
    return contract


def noise(program: Program) -> HookBlocks:
    """Return a block that gives the policy something to see."""
    rng, first = np.random.default_rng(1), dict[str, Any]()

    def disturb() -> None:
        for name, size in NOISE.items():
            view = program.states[name]
            at_rest = first.setdefault(name, view.copy())
            view[...] = at_rest + rng.normal(0.0, size, view.shape)

    return {Stage.INPUT: [Block("noise", disturb, amends=tuple(NOISE))]}


def made(
    path: Path,
    change: Change = given,
    ticks: int = 80,
    workflow: str = "go2_walk",
    key: str = "walk",
    options: Mapping[str, Any] = ALONE,
) -> tuple[Record, PolicyContract]:
    """Return a record that was made with a changed contract, and the contract without it."""
    document = load_document(workflow, {"duration": 0.02 * ticks, **options})
    contract = load_policies(document, load_robot_of(document))[key]
    recording = Recording(path, warn=_quiet, patient=True)
    faults = FaultRecord("off", _quiet, recording)
    hooks = [recording.hook, faults.hook]
    if document.values["platform"] == "fake":
        hooks.insert(0, noise)
    program = Program(document, hooks=hooks, contracts={key: change(contract)})
    runner = Runner(program, RunOptions(speed="max", warn=_quiet))
    faults.attach(runner)
    faults.write(runner.run())
    return open_record(path), contract


def examined(record: Record, contract: PolicyContract | None = None) -> tuple[list[Cause], str]:
    """Return the causes, and the notes in one text."""
    causes, notes = contract_causes(record, "the record", contract)
    assert all("\n" not in note for note in notes)
    return causes, "; ".join(notes)


def instead(record: Record, **columns: Any) -> Record:
    """Return the record with other values of some states."""
    other, states = copy(record), record.states
    other.states = lambda name, *at: columns.get(name, states(name, *at))  # type: ignore[method-assign]
    return other


def without(record: Record, *names: str) -> Record:
    """Return the record without some states."""
    other = copy(record)
    specs = record.layout.specs
    other.layout = Layout({name: spec for name, spec in specs.items() if name not in names})
    return other


def one(contract: PolicyContract, joint: str, value: float, other: float = 1.0) -> Any:
    """Return a figure of one joint and another one of the rest, shape (n,), float32."""
    return np.where(np.array(contract.joints) == joint, value, other).astype(np.float32)


def scaled(state: str, factor: float) -> Change:
    """Return what changes the scale of one term."""
    return lambda c: with_scales(c, lambda t: t.scale * np.float32(factor ** (t.state == state)))


def swapped(i: int) -> Change:
    """Return what exchanges two terms that stand side by side."""
    return lambda c: with_terms(c, (*c.terms[:i], c.terms[i + 1], c.terms[i], *c.terms[i + 2 :]))


def by_depth(contract: PolicyContract) -> list[str]:
    return [n for part in ("hip", "thigh", "calf") for n in contract.joints if part in n]


def posed(contract: PolicyContract, shift: Any) -> PolicyContract:
    moved = with_action(contract, offset=contract.action.offset + shift)
    return replace(moved, default_joint_pos=contract.default_joint_pos + shift)


def backwards(contract: PolicyContract) -> PolicyContract:
    """Turn one joint round where it is seen and where it is moved."""
    turned = with_scales(
        contract,
        lambda t: t.scale * one(contract, GO2, -1.0) if t.state.startswith("joint_") else t.scale,
    )
    return with_action(turned, scale=contract.action.scale * one(contract, GO2, -1.0))


KINDS: dict[str, tuple[Change, str, float | None]] = {
    "depth": (lambda c: permuted(c, by_depth(c)), "joint order", None),
    "names": (lambda c: renamed(c, by_depth(c)), "joint order", None),
    "sides": (
        lambda c: renamed(c, exchanged(c.joints, mirror_pairs(c.joints))), "left right", None,
    ),
    "pair": (
        lambda c: renamed(c, exchanged(c.joints, [("FR_hip_joint", "RL_calf_joint")])),
        "joint exchange of FR_hip_joint and RL_calf_joint", None,
    ),
    "gravity": (
        scaled("projected_gravity", -1.0), "observation sign of projected_gravity", -1.0,
    ),
    "action": (
        lambda c: with_action(c, scale=c.action.scale * np.float32(1.3)), "action scale", 1.3,
    ),
    "action of one": (
        lambda c: with_action(c, scale=c.action.scale * one(c, GO2, 0.7)),
        f"action scale of {GO2}", 0.7,
    ),
    "backwards": (backwards, f"joint sign of {GO2}", -1.0),
    "pose": (lambda c: posed(c, one(c, GO2, 0.2, 0.0)), f"default pose of {GO2}", 0.2),
    "offset": (
        lambda c: with_action(c, offset=c.action.offset + one(c, GO2, 0.2, 0.0)),
        f"action offset of {GO2}", 0.2,
    ),
    "velocities": (scaled("joint_vel", 20.0), "observation scale of joint_vel_rel", 20.0),
    "gyro": (scaled("base_ang_vel", 4.0), "observation scale of base_ang_vel", 4.0),
    **{
        f"{state} times {factor}": (
            scaled(state, factor), f"observation scale of {term}", factor,
        )
        for state, term, factor in (
            ("base_ang_vel", "base_ang_vel", 1.8),
            ("joint_vel", "joint_vel_rel", 7.4),
            ("joint_pos", "joint_pos_rel", 0.3),
        )
    },
    "all scales": (
        lambda c: with_scales(c, lambda t: np.sign(t.scale)), "observation scales", None,
    ),
    "equal terms": (swapped(0), "term order of base_ang_vel and projected_gravity", None),
    "other terms": (swapped(2), "term order of velocity_command and joint_pos_rel", None),
    "clip": (
        lambda c: with_action(c, clip=np.full((2, 12), 0.5, np.float32) * F([[-1.0], [1.0]])),
        "action clip", 0.5,
    ),
    "filter": (lambda c: with_action(c, filter=FilterSpec(alpha=0.35)), "action filter", 0.35),
    "stiffness": (lambda c: replace(c, stiffness=2.0 * c.stiffness), "stiffness", 2.0),
    "damping of one": (
        lambda c: replace(c, damping=c.damping * one(c, GO2, 0.5)), f"damping of {GO2}", 0.5,
    ),
    "both gains": (lambda c: with_gains(c, gains_of(c)[::-1]), "gain order", None),
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_the_one_difference_comes_first(kind: str, tmp_path: Path) -> None:
    change, name, size = KINDS[kind]
    record, contract = made(tmp_path / "run.mcap", change)
    causes, notes = examined(record, contract)
    assert causes[0].name == name, causes
    assert causes[0].probability > 0.9
    assert causes[0].layer == "contract"
    assert sum(cause.probability for cause in causes) < 1.0 + 1e-6
    assert causes[0].evidence
    assert "policy.yaml" in causes[0].remedy
    if size is not None:
        assert causes[0].size == pytest.approx(size, rel=0.02)
    assert "no contract hypothesis" not in notes
    assert examined(record, change(contract))[0] == []


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (lambda c: clock_reordered(c, [2, 3, 0, 1]), "clock order"),
        (lambda c: replace(c, phase=replace(c.phase, period=2.0)), "clock period"),
        (lambda c: with_gains(c, gains_of(c)[:, ::-1]), "gain order"),
    ],
    ids=["sines and cosines", "period", "gains"],
)
def test_of_a_walker_with_a_gait_clock(
    change: Change, name: str, tmp_path: Path, assets: Path
) -> None:
    options = ALONE | {"scene": {}}
    record, contract = made(tmp_path / "run.mcap", change, 80, "g1_holosoma", options=options)
    causes, _ = examined(record, contract)
    assert causes[0].name == name
    assert "'given' of the policy" in causes[0].remedy
    assert examined(record, change(contract))[0] == []


def test_a_walk_in_mujoco_that_shows_it_late(tmp_path: Path) -> None:
    change = scaled("velocity_command", 0.5)
    record, contract = made(tmp_path / "run.mcap", change, 350, options={"platform": "mujoco"})
    told: list[tuple[str, float]] = []
    causes, notes = contract_causes(record, "the record", tell=lambda *it: told.append(it))
    assert causes[0].name == "observation scale of velocity_command"
    assert causes[0].remedy.startswith("policy.yaml needs observation.terms.velocity_command.scale")
    assert notes == []
    assert told[0] == ("the record, policy 'walk': contracts", 0.0)
    assert examined(record, change(contract))[0] == []


def test_a_record_and_its_own_contract(tmp_path: Path) -> None:
    record, contract = made(tmp_path / "run.mcap")
    causes, notes = examined(record)
    assert causes == []
    assert notes == "the record, policy 'walk': the given contract made this record (0 rad rms)"
    later = copy(record)
    later.ticks = record.ticks + 500  # it begins while the policy runs
    assert examined(later)[0] == []
    causes, _ = examined(later, with_action(contract, scale=2.0 * contract.action.scale))
    assert causes[0].name == "action scale"
    assert causes[0].size == pytest.approx(0.5)
    bound = np.full((2, 12), 0.5, np.float32) * F([[-1.0], [1.0]])
    causes, _ = examined(record, with_action(contract, clip=bound))
    assert causes[0].name == "action clip"


def test_histories_in_another_order(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    obs, network = 3 * (3 + 12 + 12), tmp_path / "policy.onnx"
    weights = {"w": rng.normal(0.0, 0.05, (obs, 12)).astype(np.float32)}
    shapes = {"obs": [1, obs], "actions": [1, 12]}
    write_graph(network, "actions = MatMul(obs, w)", ["obs"], shapes, weights)

    def remembering(contract: PolicyContract) -> PolicyContract:
        seen = (contract.terms[0], contract.terms[3], contract.terms[5])
        terms = tuple(replace(term, history=3) for term in seen)
        observation = replace(contract.observation, terms=terms)
        return replace(contract, model=network, sha256=None, recurrent=(), observation=observation)

    def oldest_last(contract: PolicyContract) -> PolicyContract:
        mine = remembering(contract)
        return replace(mine, observation=replace(mine.observation, newest="first"))

    record, contract = made(tmp_path / "run.mcap", oldest_last)
    causes, _ = examined(record, remembering(contract))
    assert causes[0].name == "history order"
    assert "observation.newest: first instead of last" in causes[0].remedy
    assert examined(record, oldest_last(contract))[0] == []


@pytest.mark.parametrize(
    "options",
    [{"rate": 100}, {"policies": {"walk": {"path": "go2_velocity", "child": True}}}],
    ids=["two ticks", "a child"],
)
def test_policies_at_other_ticks(options: dict[str, Any], tmp_path: Path) -> None:
    record, contract = made(tmp_path / "run.mcap", options=ALONE | options)
    assert examined(record)[0] == []
    causes, _ = examined(record, scaled("base_ang_vel", 4.0)(contract))
    assert causes[0].name == "observation scale of base_ang_vel"
    slow = replace(contract, child=ChildSpec(delay=2))
    assert "record it with delay: 1" in examined(record, slow)[1]


def test_late_sensors_and_other_frames(tmp_path: Path) -> None:
    record, _ = made(tmp_path / "run.mcap", ticks=120)
    late = {n: np.roll(record.states(n), -1, 0) for n in [*NOISE][:4]}
    assert examined(instead(record, **late))[0][0].name == "delay"
    quat = np.random.default_rng(0).normal((2.0, 0.0, 0.0, 0.0), 1.0, (120, 4))
    quat /= np.linalg.norm(quat, axis=1)[:, None]
    seen = record.states("base_ang_vel")
    turned = np.einsum("tji,tj->ti", rotation(quat), seen).astype(np.float32)
    causes, _ = examined(instead(record, base_quat=quat, base_ang_vel=turned))
    assert causes[0].name == "frame of base_ang_vel"
    assert "world" in causes[0].remedy


def test_holes_in_a_record(tmp_path: Path) -> None:
    record, _ = made(tmp_path / "run.mcap", ticks=200)
    holes = record.states("joint_pos").copy()
    holes[20:22] = np.nan
    causes, notes = examined(instead(record, joint_pos=holes))
    assert causes == []
    assert "2 ticks hold a NaN, a fault" in notes
    assert "made this" in notes
    gap = copy(record)
    gap.ticks = record.ticks + 7 * (np.arange(200) > 100)
    causes, notes = examined(gap)
    assert causes == []
    assert "made this record" in notes
    nothing = np.full_like(holes, np.nan)
    causes, notes = examined(instead(record, joint_pos_target=nothing))
    assert causes == []
    assert "ran in 0 ticks" in notes


def test_records_that_say_too_little(tmp_path: Path, assets: Path) -> None:
    record, contract = made(tmp_path / "run.mcap", scaled("projected_gravity", -1.0), 30)
    causes, notes = examined(record)
    assert causes[0].name == "observation sign of projected_gravity"
    assert "30 ticks, less than 1 s" in notes
    for name in ("velocity_command", "joint_pos_target", "joint_pos"):
        causes, notes = examined(without(record, name))
        assert causes == []
        assert "contract hypotheses are not examined" in notes
    causes, notes = examined(without(record, "joint_stiffness", "action"))
    assert "no joint_stiffness" in notes
    assert "no action" in notes
    bare = copy(record)
    bare.facts = {}
    assert "its robot '' is not here" in examined(bare)[1]
    text = record.facts["workflow_effective"]
    gone = text.replace("go2_velocity", "/nowhere/policy.yaml")
    bare.facts = dict(record.facts, workflow_effective=gone)
    assert "is not there now" in examined(bare)[1]
    assert examined(bare, contract)[0][0].name == "observation sign of projected_gravity"
    bare.facts = dict(record.facts, workflow_effective=text + "\n# drives: [legs]\n")
    assert "moves some joints alone" in examined(bare)[1]
    document = load_document("g1_holosoma", {"platform": "fake"})
    other = load_policies(document, load_robot_of(document))["walk"]
    assert "robot go2 lacks 29 of the 29 joints" in examined(record, other)[1]
    record, _ = made(tmp_path / "short.mcap", given, 8)
    assert "ran in 8 ticks" in examined(record)[1]


def test_the_ticks_of_each_of_two_policies(tmp_path: Path) -> None:
    walk = {"loop": {"do": {"policy": "walk"}, "until": {"elapsed": 1.6}}}
    policies = {"walk": "go2_velocity", "other": "go2_velocity"}
    options = ALONE | {"policies": policies, "flow": {"chain": [walk, {"policy": "other"}]}}
    change = scaled("projected_gravity", -1.0)
    record, contract = made(tmp_path / "run.mcap", change, 160, key="other", options=options)
    causes, notes = examined(record)
    assert [cause.name for cause in causes] == ["observation sign of projected_gravity"]
    assert notes == "the record, policy 'walk': the given contract made this record (0 rad rms)"
    assert "nothing says which policy" in examined(record, contract)[1]
    named = replace(contract, name="other", path=Path("policy.yaml"))
    assert examined(record, named)[0][0].name == "observation sign of projected_gravity"

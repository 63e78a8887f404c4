"""Warm-ups change nothing: every kind of policy commands the same at any speed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnxruntime", reason="the policies are ONNX networks")

from policies_of_all_kinds import INPUTS, JOINTS, KINDS, run, write_policy

from unicon_core.policies import Policy, load_policy, policy_states
from unicon_core.policies.networks import Tensor
from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_policy_commands_the_same_at_real_and_at_full_speed(
    kind: str, tmp_path: Path
) -> None:
    folder = write_policy(tmp_path / kind, kind)
    real, fast = (run(folder, speed, 0.5) for speed in ("real", "max"))
    assert real.faults == fast.faults == []
    assert real.ticks == fast.ticks == 25
    assert real.sha256_commands == fast.sha256_commands


@pytest.mark.parametrize("workflow", ["g1_walk", "g1_holosoma", "go1_walk"])
def test_other_peoples_policies_command_the_same_at_real_and_at_full_speed(
    workflow: str, assets: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mujoco")
    monkeypatch.setenv("UNICON_ASSETS", str(assets))
    real, fast = (run(workflow, speed, 1.0) for speed in ("real", "max"))
    assert real.faults == fast.faults == []
    assert real.sha256_commands == fast.sha256_commands


class Counting:
    """A network that counts its calls inside itself, and tells the count as its action."""

    inputs = (Tensor("obs", "float32", (1, INPUTS)),)
    outputs = (Tensor("actions", "float32", (1, JOINTS)),)

    def bind(self, inputs: Mapping[str, Any], outputs: Mapping[str, Any]) -> Callable[[], None]:
        return Calls(outputs["actions"])


class Calls:
    def __init__(self, actions: Any) -> None:
        self.actions, self.count, self.kept = actions, 0, 0

    def __call__(self) -> None:
        self.count = self.kept + 1
        self.actions[...] = 0.01 * self.count

    def commit(self) -> None:
        self.kept = self.count

    def reset(self) -> None:
        self.kept = 0


def policy_of(folder: Path, **options: Any) -> tuple[Policy, States]:
    contract, machine = load_policy(folder), load_robot("go2")
    states = States(
        standard_states(machine.joint_names) | policy_states(contract, machine.joint_names)
    )
    return Policy(contract, states, machine, **options), states


def told_by(policy: Policy, states: States, warm_ups: int, ticks: int) -> list[list[float]]:
    rng = np.random.default_rng(5)
    told = []
    for _ in range(ticks):
        for _ in range(warm_ups):
            # What a warm-up sees is older than what the tick sees.
            states["joint_vel"] = rng.normal(size=JOINTS) if warm_ups else 0.0
            policy.warm_up()
        states["joint_vel"] = np.sin(len(told) + np.arange(JOINTS))
        policy()
        told.append(states["action"].tolist())
    return told


@pytest.mark.parametrize("network", [None, Counting()])
def test_what_a_network_remembers_goes_on_with_ticks_only_and_reset_clears_it(
    network: Any, tmp_path: Path
) -> None:
    kind = "recurrent" if network is None else "plain"
    policy, states = policy_of(write_policy(tmp_path / kind, kind), network=network)
    plain = told_by(policy, states, 0, 6)
    policy.reset()
    assert told_by(policy, states, 3, 6) == plain
    policy.reset()
    assert told_by(policy, states, 0, 6) == plain
    assert told_by(policy, states, 0, 6) != plain  # it does remember

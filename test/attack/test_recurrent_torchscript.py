"""TorchScript policies keep their memory in the module: it goes on with ticks only."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("torch", reason="TorchScript: pip install 'unicon_ros[torch]'")

import torch
import torch_modules
from policies_of_all_kinds import run, write_contract
from test_recurrent_policies import policy_of, told_by

from unicon_base.errors import PolicyError
from unicon_core.policies import Policy, load_policy, policy_states
from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states

RECURRENT = ("Lstm", "Gru", "Counter")


@pytest.fixture
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A policy's folder with the module of the name that is the test's parameter."""
    torch.manual_seed(0)
    path = tmp_path / request.param
    write_contract(path, onnx=None, torchscript="policy.pt")
    network = getattr(torch_modules, request.param)()
    torch.jit.script(network.eval()).save(str(path / "policy.pt"))
    return path


@pytest.mark.parametrize("folder", [*RECURRENT, "Plain"], indirect=True)
def test_a_torchscript_policy_commands_the_same_at_real_and_at_full_speed(folder: Path) -> None:
    real, fast = (run(folder, speed, 1.0) for speed in ("real", "max"))
    assert real.faults == fast.faults == []
    assert real.sha256_commands == fast.sha256_commands


@pytest.mark.parametrize("folder", RECURRENT, indirect=True)
def test_a_modules_memory_goes_on_with_ticks_only_and_reset_clears_it(folder: Path) -> None:
    policy, states = policy_of(folder)
    # The same module in plain torch, never tried and never warmed up.
    module = torch.jit.load(str(folder / "policy.pt")).eval()
    expected = []
    plain = []
    for _ in range(6):
        plain += told_by(policy, states, 0, 1)
        with torch.inference_mode():
            expected.append(module(torch.from_numpy(states["observation"].reshape(1, -1)))[0])
    for action, value in zip(plain, expected):
        assert action == pytest.approx(value.tolist(), abs=1e-6)
    policy.reset()
    plain = told_by(policy, states, 0, 6)
    policy.reset()
    assert told_by(policy, states, 3, 6) == plain
    policy.reset()
    assert told_by(policy, states, 0, 6) == plain
    assert told_by(policy, states, 0, 6) != plain


@pytest.mark.parametrize("folder", ["Plain"], indirect=True)
def test_what_is_only_read_is_not_taken_for_memory(folder: Path) -> None:
    policy, _ = policy_of(folder)
    assert policy.network._memory.names == []


@pytest.mark.parametrize("folder", ["Lstm"], indirect=True)
def test_a_module_that_remembers_drives_one_robot(folder: Path) -> None:
    contract, machine = load_policy(folder), load_robot("go2")
    specs = standard_states(machine.joint_names) | policy_states(contract, machine.joint_names)
    with pytest.raises(PolicyError, match=r"recurrent \(cell_state, hidden_state\) and can drive"):
        Policy(contract, States(specs, 3), machine)


@pytest.mark.parametrize("folder", ["Asking"], indirect=True)
def test_a_reset_memory_that_wants_arguments_is_one_line(folder: Path) -> None:
    with pytest.raises(PolicyError, match=r"policy\.pt: its reset_memory does not run") as caught:
        policy_of(folder)
    assert "\n" not in str(caught.value)

"""A TorchScript policy moves the robot as the same network in ONNX does; torch is optional."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from policy_helpers import robot, save, toy_values, write_toy

from unicon_base.errors import PolicyError
from unicon_core.policies import Policy, import_policy, load_policy, policy_states
from unicon_core.policies.networks.torch import TorchNetwork
from unicon_core.states import States, standard_states

torch: Any = pytest.importorskip("torch", reason="TorchScript: pip install 'unicon_ros[torch]'")
pytest.importorskip("onnxruntime", reason="the twin is an ONNX network")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """One small network twice: `torch/policy.pt`, traced, and `onnx/policy.onnx`."""
    torch.manual_seed(0)
    layers = [torch.nn.Linear(15, 32), torch.nn.ELU(), torch.nn.Linear(32, 4)]
    network = torch.nn.Sequential(*layers).eval()
    write_toy(tmp_path / "torch", toy_values(onnx=None, torchscript="policy.pt"))
    torch.jit.trace(network, torch.zeros(1, 15)).save(str(tmp_path / "torch" / "policy.pt"))
    write_toy(tmp_path / "onnx")
    weights = {
        f"{kind}{i}": parameter.detach().numpy()
        for i in (0, 2)
        for kind, parameter in (("w", network[i].weight), ("b", network[i].bias))
    }
    shape: list[int | str] = ["n", 15]
    graph = helper.make_graph(
        [
            helper.make_node("Gemm", ["obs", "w0", "b0"], ["hidden"], transB=1),
            helper.make_node("Elu", ["hidden"], ["elu"]),
            helper.make_node("Gemm", ["elu", "w2", "b2"], ["actions"], transB=1),
        ],
        "mlp",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("actions", TensorProto.FLOAT, ["n", 4])],
        [numpy_helper.from_array(array, name) for name, array in weights.items()],
    )
    save(tmp_path / "onnx" / "policy.onnx", graph)
    onnx.checker.check_model(str(tmp_path / "onnx" / "policy.onnx"))
    return tmp_path


def policy_of(folder: Path, num_robots: int | None) -> tuple[Policy, States]:
    contract, machine = load_policy(folder), robot()
    specs = standard_states(machine.joint_names) | policy_states(contract, machine.joint_names)
    states = States(specs, num_robots)
    return Policy(contract, states, machine), states


@pytest.mark.parametrize("num_robots", [None, 3])
def test_targets_equal_those_of_the_onnx_network(folder: Path, num_robots: int | None) -> None:
    script, scripted = policy_of(folder / "torch", num_robots)
    twin, twinned = policy_of(folder / "onnx", num_robots)
    assert isinstance(script.network, TorchNetwork)
    assert not isinstance(twin.network, TorchNetwork)
    rng = np.random.default_rng(1)
    for _ in range(50):  # the last action feeds back
        for name in ("joint_pos", "joint_vel", "base_ang_vel"):
            scripted[name] = twinned[name] = rng.normal(size=scripted[name].shape)
        script()
        twin()
        assert np.abs(twinned["action"]).max() > 0.01
        for name in ("observation", "action", "joint_pos_target"):
            np.testing.assert_allclose(scripted[name], twinned[name], rtol=0, atol=1e-5)


def test_a_warm_up_and_building_change_nothing(folder: Path) -> None:
    policy, states = policy_of(folder / "torch", None)
    assert not states["action"].any()
    before = {name: states[name].copy() for name in states}
    policy.warm_up()
    for name, value in before.items():
        np.testing.assert_array_equal(states[name], value)


def test_a_network_of_another_size_is_refused_when_built(folder: Path) -> None:
    network = torch.nn.Linear(20, 4)
    torch.jit.trace(network, torch.zeros(1, 20)).save(str(folder / "torch" / "policy.pt"))
    with pytest.raises(PolicyError) as caught:
        policy_of(folder / "torch", None)
    line = str(caught.value)
    assert line.startswith(
        "policy toy: the TorchScript network does not run with input (1, 15) (observation.terms) "
        "and 4 joints: "
    )
    assert "\n" not in line


def test_a_file_that_is_no_torchscript_is_named(folder: Path) -> None:
    (folder / "torch" / "policy.pt").write_bytes(b"PK nonsense")
    with pytest.raises(PolicyError, match=r"policy\.pt: torch cannot load it: "):
        policy_of(folder / "torch", None)


def test_import_asks_for_all_that_a_bare_torchscript_file_does_not_say(
    folder: Path, tmp_path: Path
) -> None:
    report = import_policy(folder / "torch" / "policy.pt", tmp_path / "out")
    assert (tmp_path / "out" / "policy.pt").is_file()
    assert {"period", "joints", "action.scale", "observation.terms"} <= set(report.missing)
    given = {key: value for key, value in toy_values().items() if key not in ("schema", "onnx")}
    contract = load_policy(folder / "torch" / "policy.pt", given=given)
    assert contract.is_torchscript

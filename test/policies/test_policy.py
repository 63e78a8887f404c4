"""The policy block: the arithmetic, the joints, faults, warm-ups, batches, memory, sizes."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from policy_helpers import JOINTS, robot, toy_values, write_graph, write_linear, write_toy

from unicon_base.errors import Fault, MissingDependencyError, PolicyError
from unicon_core.policies import Policy, PolicyContract, load_policy, policy_states
from unicon_core.robots import Robot
from unicon_core.states import States, StateSpec, standard_states

EVIDENCE = "vendor"
"""What these tests run against, the most that config/evidence.yaml may say by them."""

pytest.importorskip("onnxruntime", reason="the policy block runs onnxruntime")


def states_of(
    contract: PolicyContract,
    machine: Robot,
    num_robots: int | None = None,
    extra: dict[str, StateSpec] | None = None,
) -> States:
    specs = {**standard_states(machine.joint_names), **(extra or {})}
    return States({**specs, **policy_states(contract, machine.joint_names, extra)}, num_robots)


def fill(states: States, seed: int = 0) -> None:
    rng = np.random.default_rng(seed)
    for name in ("joint_pos", "joint_vel", "base_ang_vel", "projected_gravity"):
        states[name] = rng.normal(size=states[name].shape)


def test_one_tick_equals_the_formula(tmp_path: Path) -> None:
    weight = write_linear(tmp_path / "policy.onnx", 15, 4)
    contract = load_policy(write_toy(tmp_path))
    machine = robot(("b_knee", "a_hip", "b_hip", "a_knee"))
    states = states_of(contract, machine)
    policy = Policy(contract, states, machine)
    fill(states)
    states.action = [0.1, -0.2, 0.3, -0.4]
    policy_from_robot = [machine.joint_names.index(name) for name in JOINTS]
    observation = np.concatenate(
        [
            states.base_ang_vel * np.float32(0.25),
            states.joint_pos[policy_from_robot] - np.float32([0.1, 0.2, 0.3, 0.4]),
            states.joint_vel[policy_from_robot] * np.float32(0.05),
            states.action,
        ]
    )
    policy()
    np.testing.assert_array_equal(states.observation, observation)
    np.testing.assert_allclose(states.action, observation @ weight, rtol=1e-5)
    target = np.float32([0.1, 0.2, 0.3, 0.4]) + np.float32(0.25) * states.action
    np.testing.assert_array_equal(states.joint_pos_target[policy_from_robot], target)
    assert states.joint_stiffness.tolist() == [40.0, 10.0, 30.0, 20.0]
    assert states.joint_damping.tolist() == [4.0, 1.0, 3.0, 2.0]


def test_it_says_what_it_reads_and_writes(tmp_path: Path) -> None:
    contract = load_policy(write_toy(tmp_path))
    machine = robot()
    policy = Policy(contract, states_of(contract, machine), machine)
    assert policy.name == "toy"
    assert policy.reads == ("base_ang_vel", "joint_pos", "joint_vel")
    assert policy.writes == (
        "observation",
        "action",
        "joint_pos_target",
        "joint_stiffness",
        "joint_damping",
    )


def test_joints_that_the_policy_does_not_move_are_held_at_default(tmp_path: Path) -> None:
    contract = load_policy(write_toy(tmp_path))
    machine = robot(("head", *JOINTS, "tail"), default=0.7, stiffness=9.0, damping=0.9)
    states = states_of(contract, machine)
    Policy(contract, states, machine)()
    assert states.joint_pos_target[[0, 5]].tolist() == [np.float32(0.7)] * 2
    assert states.joint_stiffness.tolist() == [9.0, 10.0, 20.0, 30.0, 40.0, 9.0]


def test_a_held_joint_without_a_pose_is_refused(tmp_path: Path) -> None:
    contract = load_policy(write_toy(tmp_path))
    machine = robot(("head", *JOINTS), stiffness=float("nan"))
    with pytest.raises(PolicyError) as caught:
        Policy(contract, states_of(contract, machine), machine)
    assert str(caught.value) == (
        "policy toy does not move joint 'head', and robot toy has no stiffness to hold it with; "
        "add 'joints.stiffness' to toy.yaml"
    )


def test_clipped_and_raw_feedback(tmp_path: Path) -> None:
    weight = np.zeros((15, 4), np.float32)
    weight[0] = 10.0
    write_linear(tmp_path / "policy.onnx", 15, 4, weight=weight)
    for feedback, last in (("raw", 2.5), ("clipped", 1.0)):
        values = toy_values(action={"scale": 0.5, "clip": [-1, 1], "feedback": feedback})
        contract = load_policy(write_toy(tmp_path, values))
        machine = robot()
        states = states_of(contract, machine)
        policy = Policy(contract, states, machine)
        states.base_ang_vel = [1.0, 0.0, 0.0]
        policy()
        assert states.action.tolist() == [last] * 4
        np.testing.assert_allclose(states.joint_pos_target, [0.6, 0.7, 0.8, 0.9])


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_observation_that_is_not_finite_is_a_fault(tmp_path: Path, value: float) -> None:
    contract = load_policy(write_toy(tmp_path))
    machine = robot()
    states = states_of(contract, machine)
    policy = Policy(contract, states, machine)
    policy()
    before = states.joint_pos_target.copy(), states.action.copy()
    states.joint_vel = [0.0, 0.0, value, 0.0]
    with pytest.raises(Fault) as caught:
        policy()
    assert str(caught.value) == (
        "policy toy: the observation is not finite: term 'joint_vel' (joint_vel, b_hip) is "
        f"{value}; the network was not run"
    )
    np.testing.assert_array_equal(states.joint_pos_target, before[0])
    np.testing.assert_array_equal(states.action, before[1])


@pytest.mark.filterwarnings("ignore:overflow encountered in dot")
def test_huge_finite_values_are_no_fault(tmp_path: Path) -> None:
    contract = load_policy(write_toy(tmp_path))
    machine = robot()
    states = states_of(contract, machine)
    policy = Policy(contract, states, machine)
    states.base_ang_vel = [1e25, 0.0, 0.0]  # its square is beyond float32
    policy()
    assert np.isfinite(states.joint_pos_target).all()


def test_an_action_that_is_not_finite_is_a_fault_before_targets_change(tmp_path: Path) -> None:
    weight = np.zeros((15, 4), np.float32)
    weight[:, 2] = np.nan
    write_linear(tmp_path / "policy.onnx", 15, 4, weight=weight)
    contract = load_policy(write_toy(tmp_path))
    machine = robot()
    states = states_of(contract, machine)
    states.joint_pos_target = 5.0
    with pytest.raises(Fault) as caught:
        Policy(contract, states, machine)()
    assert str(caught.value) == (
        "policy toy: the action is not finite: joint 'b_hip' is nan; no target was written"
    )
    assert states.joint_pos_target.tolist() == [5.0] * 4


def history(values: dict[str, Any]) -> dict[str, Any]:
    for term in values["observation"]["terms"]:
        term["history"] = 3
    return values


def test_warm_ups_change_nothing_that_can_be_observed(tmp_path: Path) -> None:
    write_linear(tmp_path / "policy.onnx", 45, 4)
    values = history(toy_values())
    values["phase"] = {"period": 0.7, "stand": None}
    values["observation"]["terms"][0] = {
        "name": "sin", "state": "gait_phase", "history": 3, "index": [0, 1, 2],
    }  # fmt: skip
    contract = load_policy(write_toy(tmp_path, values))
    machine = robot()
    plain, dry = states_of(contract, machine), states_of(contract, machine)
    one, two = Policy(contract, plain, machine), Policy(contract, dry, machine)
    for tick in range(12):
        for states in (plain, dry):
            fill(states, tick)
        snapshot = dry.snapshot()
        for _ in range(tick % 3 + 1):
            two.warm_up()
        assert dry.snapshot() == snapshot
        one()
        two()
        assert plain.snapshot() == dry.snapshot()


def test_a_warm_up_on_nan_raises_nothing(tmp_path: Path) -> None:
    contract = load_policy(write_toy(tmp_path))
    machine = robot()
    states = states_of(contract, machine)
    policy = Policy(contract, states, machine)
    states.joint_pos = np.nan
    policy.warm_up()


@pytest.mark.parametrize("batch", [1, "N", 5])
@pytest.mark.parametrize("with_history", [False, True])
def test_a_batch_equals_single_robots(tmp_path: Path, batch: int | str, with_history: bool) -> None:
    size = 45 if with_history else 15
    write_linear(tmp_path / "policy.onnx", size, 4, batch=batch)
    single_dir = tmp_path / "single"
    write_linear(single_dir / "policy.onnx", size, 4)
    values = history(toy_values()) if with_history else toy_values()
    many = load_policy(write_toy(tmp_path, values))
    one = load_policy(write_toy(single_dir, values))
    machine = robot(("b_knee", "a_hip", "spare", "b_hip", "a_knee"))
    states = states_of(many, machine, 5)
    policy = Policy(many, states, machine)
    singles = [states_of(one, machine) for _ in range(5)]
    policies = [Policy(one, each, machine) for each in singles]
    for tick in range(5):
        fill(states, tick)
        policy()
        for k, (each, its) in enumerate(zip(singles, policies)):
            for name in ("joint_pos", "joint_vel", "base_ang_vel", "projected_gravity"):
                each[name] = states[name][k]
            its()
            np.testing.assert_allclose(states.action[k], each.action, atol=1e-5)
            np.testing.assert_allclose(states.joint_pos_target[k], each.joint_pos_target, atol=1e-5)


def test_a_network_for_another_number_of_robots_is_refused(tmp_path: Path) -> None:
    write_linear(tmp_path / "policy.onnx", 15, 4, batch=3)
    contract = load_policy(write_toy(tmp_path))
    machine = robot()
    with pytest.raises(PolicyError) as caught:
        Policy(contract, states_of(contract, machine, 5), machine)
    assert str(caught.value) == (
        "policy toy: obs (3 × 15, float32) is for 3 robots at once and there are 5; export it with "
        "a free batch axis"
    )


def test_an_input_of_another_size_lists_the_terms(tmp_path: Path) -> None:
    write_linear(tmp_path / "policy.onnx", 17, 4)
    values = toy_values()
    values["observation"]["terms"][2]["history"] = 2
    contract = load_policy(write_toy(tmp_path, values))
    machine = robot()
    with pytest.raises(PolicyError) as caught:
        Policy(contract, states_of(contract, machine), machine)
    assert str(caught.value) == (
        "policy toy: the observation has 19 values and the network's input 'obs' takes 17; terms: "
        "ang_vel [0:3], joint_pos [3:7], joint_vel [7:15] = 4 × 2, last_action [15:19]; correct "
        "observation.terms in policy.yaml"
    )


def test_an_output_of_another_size_names_the_joints(tmp_path: Path) -> None:
    write_linear(tmp_path / "policy.onnx", 15, 5)
    contract = load_policy(write_toy(tmp_path))
    machine = robot()
    with pytest.raises(PolicyError) as caught:
        Policy(contract, states_of(contract, machine), machine)
    assert str(caught.value) == (
        "policy toy: joints has 4 names, the network's output 'actions' 5 values: a_hip, a_knee, "
        "b_hip, b_knee; correct joints in policy.yaml"
    )


def test_names_that_the_network_has_not_are_refused(tmp_path: Path) -> None:
    values = toy_values(inputs={"observation": "observations"})
    contract = load_policy(write_toy(tmp_path, values))
    machine = robot()
    with pytest.raises(PolicyError) as caught:
        Policy(contract, states_of(contract, machine), machine)
    assert str(caught.value) == (
        "policy toy: the network has no input 'observations'; it has obs (1 × 15, float32)"
    )


def test_a_joint_that_the_robot_has_not_is_named(tmp_path: Path) -> None:
    contract = load_policy(write_toy(tmp_path))
    states = states_of(contract, robot())
    with pytest.raises(PolicyError, match="robot toy has no joint 'b_knee'; did you mean 'c_knee'"):
        Policy(contract, states, robot(("a_hip", "a_knee", "b_hip", "c_knee")))


def test_undeclared_or_wrong_policy_states_are_told(tmp_path: Path) -> None:
    contract = load_policy(write_toy(tmp_path))
    machine = robot()
    specs = {**standard_states(JOINTS), **policy_states(contract, machine.joint_names)}
    specs["observation"] = StateSpec((14,))
    with pytest.raises(PolicyError) as caught:
        Policy(contract, States(specs), machine)
    assert str(caught.value) == (
        "policy toy: state 'observation' is float32 of shape (14,); declare it as float32 with 15 "
        "elements (policy_states gives it)"
    )


def test_missing_weights_beside_the_network_are_named(tmp_path: Path) -> None:
    path = tmp_path / "policy.onnx"
    write_linear(path, 15, 4, weight=np.ones((15, 4), np.float32))
    model = onnx.load(str(path))
    onnx.save(
        model, str(path), save_as_external_data=True, location="policy.onnx.data", size_threshold=0
    )
    contract = load_policy(write_toy(tmp_path))
    machine = robot()
    Policy(contract, states_of(contract, machine), machine)()
    (tmp_path / "policy.onnx.data").unlink()
    with pytest.raises(PolicyError) as caught:
        Policy(contract, states_of(contract, machine), machine)
    assert str(caught.value) == (
        f"{path}: its weights are in policy.onnx.data, which is not beside it; copy "
        f"policy.onnx.data to {tmp_path}"
    )
    with pytest.raises(PolicyError) as caught:
        load_policy(tmp_path / "policy.yaml")
    assert str(caught.value).endswith(
        ": the weights of policy.onnx are in policy.onnx.data, which is not beside it; copy "
        f"policy.onnx.data to {tmp_path}"
    )


def test_without_onnxruntime_the_install_command_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    contract = load_policy(write_toy(tmp_path))
    machine = robot()
    states = states_of(contract, machine)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(MissingDependencyError) as caught:
        Policy(contract, states, machine)
    assert str(caught.value) == (
        "policy policy.onnx needs onnxruntime: pip install 'unicon_ros[sim]'"
    )


def test_torchscript_without_torch_gives_the_install_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "policy.pt").write_bytes(b"PK")
    values = toy_values(onnx=None, torchscript="policy.pt")
    contract = load_policy(write_toy(tmp_path, values))
    assert contract.is_torchscript
    contract = replace(
        contract, inputs={"observation": "observation"}, outputs={"action": "action"}
    )
    machine = robot()
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(MissingDependencyError) as caught:
        Policy(contract, states_of(contract, machine), machine)
    assert (
        str(caught.value) == "policy toy (TorchScript) needs torch: pip install 'unicon_ros[torch]'"
    )


def test_the_public_binding_is_used_where_the_private_one_is_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from unicon_core.policies.networks import onnx

    contract = load_policy(write_toy(tmp_path))
    machine = robot()
    fast, slow = states_of(contract, machine), states_of(contract, machine)
    one = Policy(contract, fast, machine)
    real = onnx.load_session

    class Public:
        def __init__(self, session: Any) -> None:
            self.io_binding = session.io_binding
            self.run_with_iobinding = session.run_with_iobinding

    monkeypatch.setattr(onnx, "load_session", lambda path, provider, threads: Public(real(path)))
    two = Policy(contract, slow, machine)
    for states, policy in ((fast, one), (slow, two)):
        fill(states)
        policy()
    assert fast.snapshot() == slow.snapshot()


def write_counter(path: Path, rows: int | str = 1) -> None:
    """Action = hidden, hidden' = hidden + 1 + obs[0] · 0: what is remembered can be read off."""
    write_graph(
        path,
        """actions = Identity(h_in)
        sum = ReduceSum(obs, axis)
        zero = Mul(sum, nought)
        step = Add(zero, unit)
        h_out = Add(h_in, step)""",
        ["obs", "h_in"],
        {"obs": [rows, 15], "h_in": [rows, 4], "actions": [rows, 4], "h_out": [rows, 4]},
        {"axis": [1], "nought": [0.0], "unit": [[1.0]]},
    )


COUNTS = toy_values(
    inputs={"observation": "obs"},
    outputs={"action": "actions"},
    recurrent=[{"input": "h_in", "output": "h_out"}],
)
"""Of the network of `write_counter`."""


def test_recurrent_tensors_are_fed_back_and_reset(tmp_path: Path) -> None:
    write_counter(tmp_path / "policy.onnx")
    contract = load_policy(write_toy(tmp_path, COUNTS))
    machine = robot()
    states = states_of(contract, machine)
    policy = Policy(contract, states, machine)
    for expected in (0.0, 1.0, 2.0):
        policy.warm_up()
        policy()
        assert states.action.tolist() == [expected] * 4
    policy.reset()
    policy()
    assert states.action.tolist() == [0.0] * 4


def test_each_of_many_robots_has_a_memory_of_its_own(tmp_path: Path) -> None:
    write_counter(tmp_path / "policy.onnx", "batch")
    contract = load_policy(write_toy(tmp_path, COUNTS))
    machine = robot()
    states = states_of(contract, machine, 3)
    policy = Policy(contract, states, machine)
    assert [target.shape for _, target in policy.lane.recurrent] == [(3, 4)]
    policy()
    policy.lane.recurrent[0][1][1] = 5.0
    policy()
    assert states.action.tolist() == [[1.0] * 4, [5.0] * 4, [1.0] * 4]
    policy.reset()
    policy()
    assert not states.action.any()


def test_a_memory_of_one_robot_does_not_drive_many(tmp_path: Path) -> None:
    write_counter(tmp_path / "policy.onnx")
    contract = load_policy(write_toy(tmp_path, COUNTS))
    machine = robot()
    with pytest.raises(PolicyError) as caught:
        Policy(contract, states_of(contract, machine, 2), machine)
    assert str(caught.value) == (
        "policy toy: its memory h_in (1 × 4, float32) is of one robot and there are num_robots 2; "
        "export it with a free first axis, or run one workflow for each robot"
    )


def test_an_input_that_nothing_feeds_is_named(tmp_path: Path) -> None:
    write_counter(tmp_path / "policy.onnx")
    values = toy_values(inputs={"observation": "obs"}, outputs={"action": "actions"})
    contract = load_policy(write_toy(tmp_path, values))
    machine = robot()
    with pytest.raises(PolicyError) as caught:
        Policy(contract, states_of(contract, machine), machine)
    assert str(caught.value) == (
        "policy toy: nothing feeds input h_in (1 × 4, float32); name it in 'inputs' or 'recurrent'"
    )


def test_several_inputs_and_outputs_are_asked_for(tmp_path: Path) -> None:
    write_counter(tmp_path / "policy.onnx")
    path = write_toy(tmp_path)
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    assert str(caught.value) == (
        f"{path}: the policy.yaml does not say inputs (observation or a state -> input of the "
        "network; it has obs (1 × 15, float32), h_in (1 × 4, float32)); outputs (action -> output "
        "of the network; it has actions (1 × 4, float32), h_out (1 × 4, float32)); add it to "
        "policy.yaml"
    )


def test_two_policies_in_one_set_of_states_keep_to_their_prefix(tmp_path: Path) -> None:
    walk = load_policy(write_toy(tmp_path / "walk"))
    values = toy_values(name="stand")
    values["observation"]["terms"] = values["observation"]["terms"][1:]
    write_linear(tmp_path / "stand" / "policy.onnx", 12, 4)
    stand = load_policy(write_toy(tmp_path / "stand", values))
    machine = robot()
    specs = {
        **standard_states(JOINTS),
        **policy_states(walk, machine.joint_names, prefix="walk_"),
        **policy_states(stand, machine.joint_names, prefix="stand_"),
    }
    states = States(specs)
    one = Policy(walk, states, machine, prefix="walk_")
    two = Policy(stand, states, machine, prefix="stand_")
    fill(states)
    one()
    two()
    assert states.walk_observation.size == 15
    assert states.stand_observation.size == 12
    assert one.writes[:2] == ("walk_observation", "walk_action")
    assert "walk_action" not in two.reads
    assert not np.array_equal(states.walk_action, states.stand_action)
    one()
    np.testing.assert_array_equal(states.walk_observation[11:], states.walk_observation[-4:])


def test_ticks_allocate_nothing_that_stays(tmp_path: Path) -> None:
    import tracemalloc

    write_linear(tmp_path / "policy.onnx", 45, 4)
    contract = load_policy(write_toy(tmp_path, history(toy_values())))
    machine = robot()
    states = states_of(contract, machine)
    policy = Policy(contract, states, machine)
    for _ in range(10):
        policy()
        policy.warm_up()
    tracemalloc.start()
    growth = []
    for _ in range(3):  # what others of this process keep once does not come in every window
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(700):
            policy()
            policy.warm_up()
        growth.append(tracemalloc.get_traced_memory()[0] - before)
    tracemalloc.stop()
    assert min(growth) < 700

"""Velocities, torques, filters and command slew equal a plain loop without unicon, bit-exact."""

from __future__ import annotations

import itertools
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from policy_helpers import JOINTS, robot, toy_values, write_linear, write_toy

from unicon_base.errors import Fault, PolicyError
from unicon_core.policies import Policy, PolicyContract, load_policy, policy_states
from unicon_core.policies.policy_yaml import write_policy_yaml
from unicon_core.policies.table import policy_table
from unicon_core.robots import Robot
from unicon_core.states import States, standard_states

ort = pytest.importorskip("onnxruntime", reason="the plain loop runs onnxruntime")

F = np.float32
INPUTS = 18
PERIOD = 0.02
SCALE = F([0.25, 0.5, 20.0, 3.0])
OFFSET = F([0.1, 0.2, 0.5, -0.25])
KINDS = ["position", "position", "velocity", "torque"]
ORDER = (3, 0, 2, 1)  # of the robot's joints, as places in JOINTS
MACHINE = tuple(JOINTS[i] for i in ORDER)


def values_of(
    kinds: bool = True, smooth: dict | None = None, feedback: str = "raw", clip: bool = False
) -> dict[str, Any]:
    action: dict[str, Any] = {"scale": 0.25, "feedback": feedback}
    if kinds:
        action |= {"scale": SCALE.tolist(), "offset": OFFSET.tolist(), "kind": KINDS}
    if smooth:
        action["filter"] = smooth
    if clip:
        action["clip"] = [-0.4, 0.3]
    values = toy_values(action=action)
    if kinds:
        values |= {"stiffness": [10.0, 20.0, 0.0, 0.0], "damping": [1.0, 2.0, 3.0, 0.0]}
    terms = values["observation"]["terms"]
    terms[0]["filter"] = {"moving_average": 3}
    terms[2] |= {"filter": {"low_pass": 4.0}, "clip": [-1.0, 1.0]}
    terms.insert(1, {"name": "command", "state": "velocity_command", "scale": 2.0})
    values["command"] = {"slew": [1.0, 2.0, 4.0]}
    return values


def made(folder: Path, values: dict[str, Any], rows: int | None = None) -> Any:
    """A policy, its states and its contract."""
    if not (folder / "policy.onnx").exists():
        write_linear(folder / "policy.onnx", INPUTS, 4, batch="batch")
    contract = load_policy(write_toy(folder, values))
    machine = robot(MACHINE)
    specs = {**standard_states(MACHINE), **policy_states(contract, MACHINE)}
    states = States(specs, rows)
    return Policy(contract, states, machine), states, contract


class LowPass:
    def __init__(self, alpha: float, zeros: bool) -> None:
        self.alpha, self.zeros, self.kept = alpha, zeros, None

    def __call__(self, x: np.ndarray) -> np.ndarray:
        if self.kept is None:
            self.kept = np.zeros_like(x)
            if not self.zeros:
                self.kept = x.copy()
                return self.kept
        self.kept = F(self.alpha) * x + F(1 - self.alpha) * self.kept
        return self.kept


class Mean:
    def __init__(self, n: int, zeros: bool) -> None:
        self.n, self.zeros, self.kept = n, zeros, None

    def __call__(self, x: np.ndarray) -> np.ndarray:
        if self.kept is None:
            self.kept = deque([np.zeros_like(x) if self.zeros else x.copy()] * self.n, self.n)
        self.kept.append(x.copy())
        total = self.kept[0]
        for sample in itertools.islice(self.kept, 1, None):
            total = total + sample
        return total / F(self.n)


def filter_of(said: dict | None) -> Any:
    if said is None:
        return lambda x: x
    zeros = said.get("start", "zeros") == "zeros"
    if "moving_average" in said:
        return Mean(said["moving_average"], zeros)
    alpha = said.get("alpha") or 1 - np.exp(-2 * np.pi * said["low_pass"] * PERIOD)
    return LowPass(alpha, zeros)


class PlainLoop:
    """The contract of `values_of` for one robot, written down by hand."""

    def __init__(self, folder: Path, values: dict[str, Any]) -> None:
        self.session = ort.InferenceSession(folder / "policy.onnx")
        self.action_said, self.default = values["action"], F(values["default_joint_pos"])
        self.reset()

    def reset(self) -> None:
        self.gyro, self.speed = Mean(3, False), LowPass(1 - np.exp(-2 * np.pi * 4.0 * 0.02), False)
        self.command, self.last = np.zeros(3, F), np.zeros(4, F)
        self.smooth = filter_of(self.action_said.get("filter"))

    def __call__(self, gyro: Any, command: Any, pos: Any, vel: Any) -> dict[str, np.ndarray]:
        step = F([1.0, 2.0, 4.0]) * F(PERIOD)
        self.command = self.command + np.minimum(np.maximum(command - self.command, -step), step)
        seen = [
            self.gyro(gyro) * F(0.25),
            self.command * F(2.0),
            pos - self.default,
            np.clip(self.speed(vel), -1, 1) * F(0.05),
            self.last,
        ]
        observation = np.concatenate(seen, dtype=F)
        raw = self.session.run(None, {"obs": observation[None]})[0][0]
        said = self.action_said
        clipped = np.clip(raw, F(-0.4), F(0.3)) if "clip" in said else raw
        smooth = self.smooth(clipped)
        self.last = {"raw": raw, "clipped": clipped, "filtered": smooth}[said["feedback"]].copy()
        out = {"observation": observation, "action": self.last}
        if "kind" not in said:
            return out | {"joint_pos_target": self.default + smooth * F(0.25)}
        values = smooth * SCALE + OFFSET
        target, speed, torque = pos.copy(), np.zeros(4, F), np.zeros(4, F)
        target[:2], speed[2], torque[3] = values[:2], values[2], values[3]
        rates = {"joint_vel_target": speed, "joint_effort_ff": torque}
        return out | {"joint_pos_target": target} | rates


FILTERS: list[dict | None] = [
    None,
    {"low_pass": 5.0},
    {"alpha": 0.2, "start": "first"},
    {"moving_average": 4},
    {"moving_average": 3, "start": "first"},
]


@pytest.mark.parametrize("smooth", FILTERS, ids=str)
@pytest.mark.parametrize("kinds", [False, True], ids=["positions", "mixed"])
def test_it_equals_a_plain_loop(tmp_path: Path, kinds: bool, smooth: dict | None) -> None:
    words = ["raw", "clipped", *(["filtered"] if smooth else [])]
    for feedback, clip in itertools.product(words, (False, True)):
        values = values_of(kinds, smooth, feedback, clip)
        policy, states, _ = made(tmp_path, values, rows=2)
        loops = [PlainLoop(tmp_path, values) for _ in range(2)]
        rng = np.random.default_rng(4)
        for tick in range(30):
            if tick == 20:
                policy.reset()
                for loop in loops:
                    loop.reset()
            for name in ("joint_pos", "joint_vel", "base_ang_vel", "velocity_command"):
                states[name] = rng.normal(size=states[name].shape)
            for _ in range(int(rng.integers(3))):
                policy.warm_up()
            policy()
            for row, loop in enumerate(loops):
                pos, vel = np.zeros(4, F), np.zeros(4, F)
                pos[list(ORDER)], vel[list(ORDER)] = states.joint_pos[row], states.joint_vel[row]
                wanted = loop(states.base_ang_vel[row], states.velocity_command[row], pos, vel)
                for name, value in wanted.items():
                    value = value[list(ORDER)] if name.startswith("joint") else value
                    assert states[name][row].tobytes() == value.tobytes(), (name, tick, feedback)


def test_gains_of_velocities_and_torques(tmp_path: Path) -> None:
    values = values_of() | {"stiffness": 20.0, "damping": 1.5}
    policy, states, contract = made(tmp_path, values)
    assert contract.stiffness.tolist() == [20.0, 20.0, 0.0, 0.0]
    assert contract.damping.tolist() == [1.5, 1.5, 1.5, 0.0]
    policy()
    assert states.joint_stiffness.tolist() == contract.stiffness[list(ORDER)].tolist()
    assert {"joint_vel_target", "joint_effort_ff"} <= set(policy.writes)
    assert {"joint_pos", "velocity_command"} <= set(policy.reads)
    assert "slewed_command" in policy.writes
    given = values_of() | {"stiffness": [20.0, 20.0, 0.0, 5.0], "damping": [1.0, 1.0, 1.0, 0.5]}
    policy, states, contract = made(tmp_path, given)
    states.joint_pos = [9.0, 9.0, 9.0, 9.0]
    policy()  # a torque beside a servo: that holds the default pose
    assert states.joint_pos_target[MACHINE.index("b_knee")] == F(0.4)
    assert states.joint_pos_target[MACHINE.index("b_hip")] == F(9.0)


def test_positions_alone_write_what_they_wrote(tmp_path: Path) -> None:
    policy, states, contract = made(tmp_path, values_of(kinds=False))
    states.joint_vel_target = 7.0
    policy()
    assert states.joint_vel_target.tolist() == [7.0] * 4
    assert "joint_vel_target" not in policy.writes
    other = Policy(contract, states, robot(MACHINE), every_target=True)
    other()  # another policy of the workflow may have left a velocity
    assert states.joint_vel_target.tolist() == [0.0] * 4
    assert {"joint_vel_target", "joint_effort_ff"} <= set(other.writes)


def test_what_is_not_finite_is_kept_by_no_filter(tmp_path: Path) -> None:
    values = values_of(smooth={"alpha": 0.5}, feedback="filtered")
    values["command"] = None
    one, states, _ = made(tmp_path, values)
    two, twin, _ = made(tmp_path, values)
    rng = np.random.default_rng(6)
    for tick in range(12):
        for name in ("joint_pos", "joint_vel", "base_ang_vel"):
            states[name] = twin[name] = rng.normal(size=states[name].shape)
        if tick % 3 == 2:
            states.joint_vel[1] = np.nan
            with pytest.raises(Fault, match=r"'joint_vel' .joint_vel, a_hip. is nan"):
                one()
            continue
        one()
        two()
        assert states.joint_pos_target.tobytes() == twin.joint_pos_target.tobytes()
        assert states.joint_vel_target.tobytes() == twin.joint_vel_target.tobytes()


def test_a_command_that_is_not_finite_is_a_fault_until_the_reset(tmp_path: Path) -> None:
    policy, states, _ = made(tmp_path, values_of())
    states.velocity_command = [np.nan, 0.0, 0.0]
    with pytest.raises(Fault, match=r"term 'command' .velocity_command, vx. is nan"):
        policy()
    states.velocity_command = [1.0, 0.0, 0.0]
    policy.reset()
    policy()
    np.testing.assert_allclose(states.slewed_command, [0.02, 0.0, 0.0])


def test_the_clock_stands_by_the_command_that_the_policy_sees(tmp_path: Path) -> None:
    values = values_of() | {"phase": {"period": 1.0, "offsets": [0.0], "stand": "zero"}}
    values["phase"]["stand_below"] = 0.05
    policy, states, _ = made(tmp_path, values)
    states.velocity_command = [1.0, 0.0, 0.0]
    seen = []
    for _ in range(4):
        policy()
        seen.append(bool(states.gait_phase.any()))
    assert seen == [False, False, True, True]  # 0.02, 0.04, 0.06, 0.08 m/s


def test_two_policies_have_commands_of_their_own(tmp_path: Path) -> None:
    slow, fast = values_of(), values_of()
    fast["command"] = {"slew": [5.0, float("inf"), 5.0]}
    for name, values in (("slow", slow), ("fast", fast)):
        write_linear(tmp_path / name / "policy.onnx", INPUTS, 4)
        write_toy(tmp_path / name, values)
    machine = robot(MACHINE)
    contracts: dict[str, PolicyContract] = {
        name: load_policy(tmp_path / name) for name in ("slow", "fast")
    }
    specs = dict(standard_states(MACHINE))
    for name, contract in contracts.items():
        specs |= policy_states(contract, MACHINE, prefix=f"{name}_")
    states = States(specs)
    states.velocity_command = [1.0, 1.0, -1.0]
    for name, contract in contracts.items():
        policy = Policy(contract, states, machine, prefix=f"{name}_")
        policy()
        assert f"{name}_slewed_command" in policy.writes
        assert "velocity_command" in policy.reads
    np.testing.assert_allclose(states.slow_slewed_command, [0.02, 0.04, -0.08])
    np.testing.assert_allclose(states.fast_slewed_command, [0.1, 1.0, -0.1])
    assert states.velocity_command.tolist() == [1.0, 1.0, -1.0]


def test_it_survives_being_written(tmp_path: Path) -> None:
    values = values_of(smooth={"low_pass": 5.0, "start": "first"}, feedback="filtered")
    _, _, contract = made(tmp_path / "a", values)
    again = load_policy(write_policy_yaml(contract, tmp_path / "b"))
    assert again.action.kinds == contract.action.kinds == tuple(KINDS)
    assert again.action.filter == contract.action.filter
    assert [t.filter for t in again.terms] == [t.filter for t in contract.terms]
    assert again.command == contract.command
    assert again.action.feedback == "filtered"
    np.testing.assert_array_equal(again.action.offset, OFFSET)
    table = policy_table(contract)
    for text in ("low pass 5 Hz", "mean of 3", "low pass 4 Hz", "velocity", "torque", "slew"):
        assert text in table


def test_a_mapping_names_joints_by_pattern(tmp_path: Path) -> None:
    values = values_of()
    values["action"]["kind"] = {"b_hip": "velocity", "b_k*": "torque"}
    assert made(tmp_path, values)[2].action.kinds == tuple(KINDS)
    values["action"]["kind"] = "torque"
    assert made(tmp_path, values)[2].action.kinds == ("torque",) * 4
    values["action"] |= {"kind": {"b_*": "position"}, "scale": 0.2}
    assert made(tmp_path, values)[2].action.kinds == ()


KNOWN = (
    "position, velocity or torque, a list with one for each joint, or {'*_wheel_joint': velocity}"
)
ONE_FILTER = "give one of low_pass: Hz, alpha: SHARE, moving_average: SAMPLES"


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("action.kind", "speed", f"action.kind is 'speed'; write {KNOWN}"),
        ("action.kind", ["velocity"] * 3, "action.kind has 3 words for 4 joints; give one word, "),
        (
            "action.kind",
            ["torque"] * 3 + [1],
            "action.kind.3 is 1; write position or velocity or torque",
        ),
        (
            "action.kind",
            {"*_wheel": "velocity"},
            "action.kind names '*_wheel', which is none of the joints that are moved; known: ",
        ),
        ("action.scale", [0.1, 0.1, 201.0, 1.0], "action.scale.2 is 201; a velocity has at most "),
        ("action.scale", [0.1, 13.0, 1.0, 1.0], "action.scale.1 is 13; a position has at most 12"),
        ("stiffness", [1.0, 1.0, 2.0, 0.0], "stiffness is 2 at b_hip, which is given velocities"),
        ("damping", [1.0, 1.0, 0.0, 0.0], "damping is 0 at b_hip, which is given velocities: not"),
        ("action.filter", {}, f"action.filter names no filter; {ONE_FILTER}"),
        (
            "action.filter",
            {"alpha": 0.5, "low_pass": 3.0},
            f"action.filter gives alpha and low_pass; {ONE_FILTER}",
        ),
        ("action.filter", {"cutoff": 3.0}, "action.filter: unknown key 'cutoff'; known: alpha"),
        ("action.filter", 5.0, "action.filter is 5.0; write a mapping"),
        ("action.filter", {"low_pass": 25.5}, "action.filter.low_pass is 25.5; give the cut-off f"),
        (
            "action.filter",
            {"alpha": 0.0},
            "action.filter.alpha is 0.0; write the weight of the new",
        ),
        (
            "action.filter",
            {"alpha": 1.1},
            "action.filter.alpha is 1.1; write the weight of the new",
        ),
        (
            "action.filter",
            {"moving_average": 1},
            "action.filter.moving_average is 1; write a whole",
        ),
        ("action.filter", {"moving_average": 2.5}, "action.filter.moving_average is 2.5; write a "),
        (
            "action.filter",
            {"alpha": 0.5, "start": "now"},
            "action.filter.start 'now' is not known; known: first, z",
        ),
        ("action.feedback", "filtered", "action.feedback is 'filtered'; there is no action.filter"),
        ("command", {"slew": 1.0, "rate": 1.0}, "command: unknown key 'rate'; known: slew"),
        (
            "command",
            {},
            "command: missing key 'slew'; add slew: the largest change of vx, vy, wz in [m/s², ",
        ),
        (
            "command",
            {"slew": [1.0, 2.0]},
            "command.slew is [1.0, 2.0]; write a list of those of vx, ",
        ),
        (
            "command",
            {"slew": [1.0, 0.0, 1.0]},
            "command.slew.1 is 0.0; write a change above 0 and ",
        ),
        (
            "command",
            {"slew": -1.0},
            "command.slew is -1.0; write a change above 0 and at most 1000",
        ),
    ],
)
def test_wrong_facts_are_told(tmp_path: Path, key: str, value: Any, message: str) -> None:
    values = values_of()
    place, _, last = key.rpartition(".")
    (values[place] if place else values)[last] = value
    write_linear(tmp_path / "policy.onnx", INPUTS, 4)
    path = write_toy(tmp_path, values)
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    text = str(caught.value)
    assert f": {message}" in text
    assert text.startswith(str(path))
    assert "\n" not in text


def test_a_slew_that_nobody_sees_is_refused(tmp_path: Path) -> None:
    values = toy_values(command={"slew": 1.0})
    with pytest.raises(PolicyError) as caught:
        load_policy(write_toy(tmp_path, values))
    assert str(caught.value).endswith(
        ": command limits velocity_command, and no term reads that; leave it out"
    )


def test_a_wrong_filter_of_a_term_is_told(tmp_path: Path) -> None:
    values = values_of()
    values["observation"]["terms"][0]["filter"] = {"moving_average": 1000}
    write_linear(tmp_path / "policy.onnx", INPUTS, 4)
    with pytest.raises(PolicyError) as caught:
        load_policy(write_toy(tmp_path, values))
    assert str(caught.value).endswith(
        ": observation.terms.ang_vel.filter.moving_average is 1000; write a whole number from 2 to "
        "100 [samples], or null"
    )


def test_a_robot_of_positions_refuses_velocities(tmp_path: Path) -> None:
    write_linear(tmp_path / "policy.onnx", INPUTS, 4)
    contract = load_policy(write_toy(tmp_path, values_of()))
    machine: Robot = robot(MACHINE)
    machine.transport["command"] = "position"  # type: ignore[index]
    states = States({**standard_states(MACHINE), **policy_states(contract, MACHINE)})
    with pytest.raises(PolicyError) as caught:
        Policy(contract, states, machine)
    assert str(caught.value) == (
        "policy toy gives joint 'b_hip' a velocity, and robot toy takes positions alone; choose a "
        "policy that gives positions"
    )

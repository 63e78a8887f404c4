"""What policies of other frameworks need: angles, constants, clocks, vectors, frames beside terms.

Each network copies its input to an output, so that every number is known bit for bit.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from policy_helpers import JOINTS, robot, toy_values, write_graph, write_toy

from unicon_base.errors import Fault, PolicyError, UniconError
from unicon_core.policies import Policy, import_policy, load_policy, policy_states
from unicon_core.policies.policy_yaml import contract_values, write_policy_yaml
from unicon_core.policies.table import policy_table
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import States, StateSpec, standard_states
from unicon_core.workflow import Program

pytest.importorskip("onnxruntime", reason="the networks are ONNX")

F: Any = np.float32


def write_copy(folder: Path, size: int, shape: list[int | str]) -> None:
    """Write a network whose action is 4 zeros and whose output `seen` is its input."""
    out = [size] if len(shape) == 1 else [1, size]
    action = [4] if len(shape) == 1 else [1, 4]
    write_graph(
        folder / "policy.onnx",
        "seen = Reshape(obs, flat)\nactions = Identity(zeros)",
        ["obs"],
        {"obs": shape, "seen": out, "actions": action},
        {"flat": np.array(out), "zeros": np.zeros(action)},
    )


def seen_by(
    folder: Path,
    terms: list[Any],
    size: int,
    shape: list[int | str] | None = None,
    extra: dict[str, StateSpec] | None = None,
    rows: int | None = None,
    **values: Any,
) -> tuple[Policy, States]:
    """Return a policy of these terms whose state `seen` is what the network got."""
    layout = values.pop("layout", "term_major")
    values.setdefault("outputs", {"action": "actions", "seen": "seen"})
    observation = {"terms": terms, "layout": layout}
    write_copy(folder, size, shape or [1, size])
    contract = load_policy(write_toy(folder, toy_values(observation=observation, **values)))
    written = write_policy_yaml(contract, folder / "written")
    again = contract_values(load_policy(written))
    assert {**contract_values(contract), "sha256": again["sha256"]} == again
    assert (
        yaml.safe_load(written.read_text())["observation"]["terms"][0]["name"] == terms[0]["name"]
    )
    machine = robot(JOINTS[::-1])
    specs = {**standard_states(machine.joint_names), **(extra or {})}
    specs |= policy_states(contract, machine.joint_names, extra)
    states = States(specs, rows)
    return Policy(contract, states, machine), states


def same(seen: Any, expected: Any) -> None:
    assert np.asarray(seen).tobytes() == np.asarray(expected, F).tobytes()


QUATS = [
    (1.0, 0.0, 0.0, 0.0),
    (math.cos(0.3), math.sin(0.3), 0.0, 0.0),
    (math.cos(-0.7), 0.0, math.sin(-0.7), 0.0),
    (0.0, 0.0, 0.0, 1.0),
    (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0),  # straight up: the sine is 1 and a bit
    (0.1826, 0.3651, 0.5477, 0.7303),
    (-0.5, 0.5, -0.5, 0.5),
]


@pytest.mark.parametrize("rows", [None, 7])
def test_roll_pitch_and_yaw_are_those_of_humanoid_gym(tmp_path: Path, rows: int | None) -> None:
    terms = [{"name": "euler", "state": "base_rpy", "scale": 2.0}]
    policy, states = seen_by(tmp_path, terms, 3, rows=rows)
    assert "base_quat" in policy.reads
    assert "base_rpy" in policy.writes
    for k, quat in enumerate(QUATS):
        if rows is None:
            states.base_quat = quat
        else:
            states.base_quat = QUATS
        policy()
        w, x, y, z = map(float, F(quat))
        expected = F([
            math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
            math.asin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)),
            math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
        ])  # fmt: skip
        same(states.seen if rows is None else states.seen[k], expected * F(2.0))
        matrix = _turn(2, expected[2]) @ _turn(1, expected[1]) @ _turn(0, expected[0])
        np.testing.assert_allclose(matrix, _matrix(*quat), atol=2e-3)
    assert "rad" in policy_table(policy.contract)


def _turn(axis: int, angle: float) -> np.ndarray:
    made = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    made[i, i] = made[j, j] = math.cos(angle)
    made[i, j], made[j, i] = -math.sin(angle), math.sin(angle)
    return made


def _matrix(w: float, x: float, y: float, z: float) -> np.ndarray:
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def test_a_quaternion_that_is_nan_is_a_fault(tmp_path: Path) -> None:
    policy, states = seen_by(tmp_path, [{"name": "euler", "state": "base_rpy"}], 3)
    states.base_quat = np.nan
    with pytest.raises(Fault, match=r"term 'euler' \(base_rpy, roll\) is nan"):
        policy()


def test_constants_are_terms_of_their_own(tmp_path: Path) -> None:
    gait = [2.0, 0.5, 0.5, 0.1]
    terms = [
        {"name": "gait/now", "value": gait, "scale": [1.0, 2.0, 1.0, 1.0]},
        {"name": "two", "value": [0.25, 0.25]},
        {"name": "one", "value": 3.0, "history": 2},
    ]
    policy, states = seen_by(tmp_path, terms, 8, rows=2)
    policy()
    same(states.seen, [[2.0, 1.0, 0.5, 0.1, 0.25, 0.25, 3.0, 3.0]] * 2)
    assert "constant_gait_now" in policy.writes
    table = policy_table(policy.contract)
    assert "constant 2, 0.5, 0.5, 0.1" in table
    assert "constant 0.25, 0.25" in table


def test_two_constants_of_one_name_are_refused(tmp_path: Path) -> None:
    terms = [{"name": "a b", "value": 1.0}, {"name": "a_b", "value": 2.0}]
    with pytest.raises(PolicyError, match="terms has several constants 'constant_a_b'; give each"):
        seen_by(tmp_path, terms, 2)


def test_a_constant_beyond_single_precision_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match=re.escape("value.0 is 1e+300; write a number from")):
        seen_by(tmp_path, [{"name": "a", "value": [1e300]}], 1)


def test_a_term_without_state_and_value_is_asked_for(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match=re.escape("does not say observation.terms.gait.state")):
        seen_by(tmp_path, [{"name": "gait"}], 2)


def test_frames_of_some_terms_stand_beside_others(tmp_path: Path) -> None:
    """An encoder's history in whole frames, then what has no history, as LimX's actors take it."""
    terms = [
        {"name": "gyro", "state": "base_ang_vel", "history": 3},
        {"name": "gait", "value": [2.0, 0.5], "history": 3},
        {"name": "command", "state": "velocity_command"},
        {"name": "gravity", "state": "projected_gravity", "history": 2},
    ]
    policy, states = seen_by(tmp_path, terms, 24, layout="frame_major")
    frames = []
    for k in range(4):
        states.base_ang_vel = gyro = F([k, k + 0.1, k + 0.2])
        states.velocity_command = [0.5, 0.25, k]
        states.projected_gravity = [0.0, k, -1.0]
        policy()
        frames.append([*gyro, 2.0, 0.5])
    same(states.seen, [*frames[1], *frames[2], *frames[3], 0.5, 0.25, 3, 0, 2, -1, 0, 3, -1])
    table = policy_table(policy.contract)
    for place in ("[0:15] frame[0:3]", "[0:15] frame[3:5]", "[15:18]", "[18:24] frame[0:3]"):
        assert place in table
    assert "gait" in policy.lane.observation.place_of(13)  # type: ignore[union-attr]


@pytest.mark.parametrize("shape", [[12], [1, 12], [1, 3, 4], [1, "time", 4], ["n", 3, 4]])
def test_inputs_may_be_vectors_and_have_several_axes(tmp_path: Path, shape: list[Any]) -> None:
    terms = [{"name": "q", "state": "joint_pos", "history": 3}]
    policy, states = seen_by(tmp_path, terms, 12, shape)
    expected: list[float] = []
    for k in range(3):
        states.joint_pos = [k, k + 0.1, k + 0.2, k + 0.3]
        policy()
        expected += [k + 0.3, k + 0.2, k + 0.1, k]
    same(states.seen, expected)


def test_scalars_go_in_and_come_out(tmp_path: Path) -> None:
    write_graph(
        tmp_path / "policy.onnx",
        "actions = Mul(obs, speed)\ntwice = Add(speed, speed)",
        ["obs", "speed"],
        {"obs": [4], "speed": [], "actions": [4], "twice": []},
        {},
    )
    values = toy_values(
        inputs={"observation": "obs", "speed": "speed"},
        outputs={"action": "actions", "twice": "twice"},
        observation={"terms": [{"name": "vel", "state": "joint_vel"}]},
    )
    extra, machine = {"speed": StateSpec((), initial=1.5)}, robot()
    contract = load_policy(write_toy(tmp_path, values))
    specs = standard_states(JOINTS) | extra | policy_states(contract, JOINTS, extra)
    for rows in (None, 2):
        states = States(specs, rows)
        states.joint_vel = [1.0, 2.0, 3.0, 4.0]
        Policy(contract, states, machine)()
        same(states.action, F([[1.5, 3.0, 4.5, 6.0]] * (rows or 1)))
        same(states.twice, F([3.0] * (rows or 1)))


@pytest.mark.parametrize("flat", [True, False])
def test_an_encoder_of_vectors_is_run_before_the_actor(tmp_path: Path, flat: bool) -> None:
    """The whole of LimX's layout: latent, newest frame, command."""
    batch = [] if flat else [1]
    write_graph(
        tmp_path / "encoder.onnx",
        "latent = ReduceSum(history, axes)",
        ["history"],
        {"history": [9] if flat else [1, 3, 3], "latent": [1] if flat else [1, 1, 1]},
        {"axes": np.array([0] if flat else [1, 2])},
    )
    write_copy(tmp_path, 7, [*batch, 7])
    terms = [
        {"name": "gyro", "state": "base_ang_vel", "history": 3},
        {"name": "command", "state": "velocity_command"},
    ]
    values = toy_values(
        networks={"encoder": {"onnx": "encoder.onnx", "feeds": {"history": ["observation[0:9]"]}}},
        feeds={"obs": ["encoder.latent", "observation[6:9]", "observation[9:12]"]},
        outputs={"action": "actions", "seen": "seen"},
        observation={"terms": terms, "layout": "frame_major"},
    )
    contract = load_policy(write_toy(tmp_path, values))
    states = States(standard_states(JOINTS) | policy_states(contract, JOINTS), None if flat else 2)
    policy = Policy(contract, states, robot())
    states.velocity_command = [0.5, 0.25, 2.0]
    for k in range(3):
        states.base_ang_vel = [k, 0.0, 0.5]
        policy()
    rows = 1 if flat else 2
    same(states.seen, [[0 + 1 + 2 + 1.5, 2, 0, 0.5, 0.5, 0.25, 2.0]] * rows)


def clock_values(rate: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"period": 1.0, "offsets": [0.0, np.pi], "rate": rate, **more}


@pytest.mark.parametrize("rows", [None, 2])
def test_a_command_is_the_frequency_of_the_clock(tmp_path: Path, rows: int | None) -> None:
    extra = {"gait_command": StateSpec((2,), names=("frequency", "height"))}
    terms = [{"name": "clock", "state": "gait_phase_sin"}]
    rate = {"state": "gait_command"}
    policy, states = seen_by(tmp_path, terms, 2, extra=extra, rows=rows, phase=clock_values(rate))
    assert "gait_command" in policy.reads
    phase = np.array([0.0, np.pi], F).astype(float)  # offsets are float32
    for k in range(100):
        frequency = F([3.0, 0.0, 1.7, -2.0][k // 25])
        states.gait_command = [frequency, 0.1]
        policy()
        phase = np.fmod(phase + (2.0 * np.pi * 0.02 * float(frequency) + np.pi), 2 * np.pi) - np.pi
        same(states.seen, [np.sin(phase)] * (rows or 1))
    assert "its speed times (0 + 1 · gait_command[0])" in policy_table(policy.contract)


@pytest.mark.parametrize("rows", [None, 3])
def test_a_command_puts_each_foot_ahead_of_the_clock(tmp_path: Path, rows: int | None) -> None:
    """As walk-these-ways: the command has frequency, phase, offset and bound of its gaits."""
    extra = {"gait_command": StateSpec((4,), names=("frequency", "phase", "offset", "bound"))}
    terms = [{"name": "clock", "state": "gait_phase_sin"}]
    phase = {
        "period": 1.0, "offsets": [0.0] * 4, "rate": {"state": "gait_command"},
        "shift": {"state": "gait_command", "index": [[1, 2, 3], [2], [3], [1]]},
    }  # fmt: skip
    policy, states = seen_by(tmp_path, terms, 4, extra=extra, rows=rows, phase=phase)
    assert policy.reads.count("gait_command") == 1
    gaits = {"trot": (0.5, 0.0, 0.0), "pace": (0.0, 0.5, 0.0), "bound": (0.0, 0.0, 0.5)}
    together = {"trot": [(0, 3), (1, 2)], "pace": [(0, 1), (2, 3)], "bound": [(0, 2), (1, 3)]}
    turns = 0.0
    for name, (first, second, third) in gaits.items():
        for _ in range(60):
            states.gait_command = [3.0, first, second, third]
            policy()
            turns = (turns + 0.02 * 3.0) % 1.0
            feet = np.array([first + second + third, second, third, first]) + turns
            for seen in states.seen.reshape(-1, 4):
                np.testing.assert_allclose(seen, np.sin(2.0 * np.pi * feet), atol=1e-6)
        for a, b in together[name]:
            np.testing.assert_allclose(states.seen[..., a], states.seen[..., b], atol=1e-6)
    if rows:
        assert policy.phase is not None
        states.gait_command[1, 1] = np.nan  # of one robot alone
        before = states.gait_phase_sin[0].copy()
        policy.phase()
        assert np.isfinite(states.gait_phase_sin[[0, 2]]).all()
        assert not np.array_equal(states.gait_phase_sin[0], before)
    assert "ahead by gait_command[1+2+3, 2, 3, 1]" in policy_table(policy.contract)


def test_elements_that_no_phase_adds_do_not_matter(tmp_path: Path) -> None:
    extra = {"gait_command": StateSpec((3,))}
    shift = {"state": "gait_command", "index": [[1, 1], []]}
    phase = {"period": 1.0, "offsets": [0.0, 0.0], "shift": shift}
    terms = [{"name": "clock", "state": "gait_phase_sin"}]
    policy, states = seen_by(tmp_path, terms, 2, extra=extra, phase=phase)
    states.gait_command = [np.nan, 0.125, np.inf]
    policy()
    turns = 2.0 * np.pi * np.array([0.02 + 0.25, 0.02])
    np.testing.assert_allclose(states.seen, np.sin(turns), atol=1e-6)
    states.gait_command = [0.0, np.nan, 0.0]
    with pytest.raises(Fault, match="not finite"):
        policy()


@pytest.mark.parametrize(
    ("shift", "message"),
    [
        ({"state": "velocity_command", "index": [[1]]}, "shift.index has 1 lists for 2 offsets"),
        ({"state": "velocity_command", "index": [[3], []]}, "its shift takes element 3 of state"),
        ({"state": "gait_comand", "index": [[0], []]}, "takes element 0 of state 'gait_comand'"),
        ({"state": "velocity_command", "index": [[-1], []]}, "shift.index.0.0 is -1; write"),
        ({"state": "velocity_command", "index": 1}, "shift.index is 1; write a list of elements"),
        ({"index": [[0], []]}, "phase.shift: missing key 'state'"),
    ],
)
def test_a_shift_of_the_clock_that_does_not_fit_is_refused(
    tmp_path: Path, shift: dict[str, Any], message: str
) -> None:
    phase = {"period": 1.0, "offsets": [0.0, np.pi], "shift": shift}
    with pytest.raises(PolicyError) as caught:
        seen_by(tmp_path, [{"name": "clock", "state": "gait_phase_sin"}], 2, phase=phase)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_output_sets_the_rate_of_the_clock_from_the_next_tick_on(tmp_path: Path) -> None:
    write_graph(
        tmp_path / "policy.onnx",
        "half = ReduceSum(obs, axes)\nrate = Mul(half, two)\nactions = Identity(zeros)",
        ["obs"],
        {"obs": [1, 1], "rate": [1, 1], "actions": [1, 4]},
        {"axes": np.array([1]), "two": F(2.0), "zeros": np.zeros((1, 4))},
    )
    values = toy_values(
        outputs={"action": "actions", "phase_rate": "rate"},
        observation={"terms": [{"name": "vx", "state": "velocity_command", "index": [0]}]},
        phase=clock_values({"state": "phase_rate", "scale": 0.5, "offset": 1.0}, offsets=[0.0]),
    )
    contract = load_policy(write_toy(tmp_path, values))
    states = States(standard_states(JOINTS) | policy_states(contract, JOINTS))
    policy = Policy(contract, states, robot())
    assert "phase_rate" not in policy.reads
    states.velocity_command = [0.75, 0.0, 0.0]
    for _ in range(2):
        for turns in (0.02, 0.02 + 0.02 * 1.75):
            policy()
            np.testing.assert_allclose(states.gait_phase_sin, np.sin(2 * np.pi * turns), atol=1e-6)
        policy.reset()  # the rate as well


@pytest.mark.parametrize("rows", [None, 2])
def test_the_last_elements_of_the_action_may_be_the_rate(tmp_path: Path, rows: int | None) -> None:
    shapes: dict[str, list[int | str]] = {"obs": [1, 6], "actions": [1, 6]}
    write_graph(tmp_path / "policy.onnx", "actions = Identity(obs)", ["obs"], shapes, {})
    values = toy_values(
        action={"scale": 0.25, "clip": [-0.5, 0.5], "extra": "phase_rate"},
        observation={"terms": [
            {"name": "vel", "state": "joint_vel"}, {"name": "rate", "value": [7.0, 1.75]},
        ]},
        phase=clock_values({"state": "phase_rate", "index": 1}, offsets=[0.0]),
    )  # fmt: skip
    contract = load_policy(write_toy(tmp_path, values))
    again = load_policy(write_policy_yaml(contract, tmp_path / "written"))
    assert again.action.extra == "phase_rate"
    states = States(standard_states(JOINTS) | policy_states(contract, JOINTS), rows)
    policy = Policy(contract, states, robot())
    states.joint_vel = [1.0, 2.0, 3.0, 4.0]
    for _ in range(2):
        for turns in (0.0, 0.02 * 1.75):
            policy()
            same(states.action, [[1.0, 2.0, 3.0, 4.0]] * (rows or 1))
            same(states.phase_rate, [[7.0, 1.75]] * (rows or 1))
            np.testing.assert_allclose(states.gait_phase_sin, np.sin(2 * np.pi * turns), atol=1e-6)
        policy.reset()
        assert not states.phase_rate.any()
    assert "phase_rate" in policy.writes
    assert "beyond the joints: state phase_rate" in policy_table(contract)


def test_an_action_without_more_than_the_joints_has_nothing_extra(tmp_path: Path) -> None:
    action = {"scale": 0.25, "extra": "rate"}
    with pytest.raises(PolicyError, match=r"action.extra is 'rate', and .* no more than the 4"):
        seen_by(tmp_path, [{"name": "one", "value": 1.0}], 1, action=action)
    for name in ("action", "joint_pos", "observation"):
        with pytest.raises(PolicyError, match=f"extra is '{name}', a state that is there; give"):
            seen_by(tmp_path, [{"name": "a", "value": 1}], 1, action={**action, "extra": name})
    with pytest.raises(PolicyError, match=r"action.extra is ''; write"):
        seen_by(tmp_path, [{"name": "one", "value": 1.0}], 1, action={**action, "extra": ""})


@pytest.mark.parametrize(
    ("rate", "message"),
    [
        (
            {"state": "gone"},
            "its rate takes element 0 of state 'gone', which is not there; correct",
        ),
        ({"state": "velocity_command", "index": 3}, "element 3 of state 'velocity_command'"),
        ({"state": "velocity_command", "index": -1}, "phase.rate.index is -1; write"),
        ({"index": 1}, "phase.rate: missing key 'state'"),
        ({"state": "velocity_command", "scale": "fast"}, "phase.rate.scale is 'fast'; write"),
        ({"state": "velocity_command", "hertz": 1}, "phase.rate: unknown key 'hertz'"),
        (2.0, "phase.rate is 2.0; write"),
    ],
)
def test_a_wrong_rate_gets_one_line(tmp_path: Path, rate: Any, message: str) -> None:
    terms = [{"name": "clock", "state": "gait_phase"}]
    with pytest.raises(PolicyError, match=message) as caught:
        seen_by(tmp_path, terms, 4, phase=clock_values(rate))
    assert "\n" not in str(caught.value)


def test_the_phase_of_a_motion_goes_from_0_to_1(tmp_path: Path) -> None:
    terms = [{"name": "phase", "state": "motion_phase"}]
    motion = {"duration": 0.1, "hold": 0.04}
    policy, states = seen_by(tmp_path, terms, 1, motion=motion, rows=2)
    for _ in range(2):
        done = []
        for tick in range(8):
            done.append(policy())
            expected = min(max(tick - 2, 0) * 0.02 / 0.1, 1.0)
            same(states.seen, [[expected]] * 2)
        assert done == [False] * 7 + [True]
        policy.reset()
    assert not policy.endless
    assert "motion_command" not in states


def test_wheels_are_left_out_or_zero(tmp_path: Path) -> None:
    """LimX leaves their positions out, rl_sar keeps them as zeros; both see their velocities."""
    action = {"scale": [0.25, 0.25, 0.25, 0.8], "kind": {"b_knee": "velocity"}}
    terms: list[dict[str, Any]] = [
        {"name": "out", "state": "joint_pos", "subtract": "default_joint_pos", "index": [0, 1, 2]},
        {"name": "zero", "state": "joint_pos", "subtract": "default_joint_pos",
         "scale": [1.0, 1.0, 1.0, 0.0]},
        {"name": "vel", "state": "joint_vel", "scale": 0.05},
    ]  # fmt: skip
    gains: dict[str, Any] = {"stiffness": [42.0, 42.0, 42.0, 0.0], "damping": [2.5, 2.5, 2.5, 0.8]}
    policy, states = seen_by(tmp_path, terms, 11, action=action, **gains)
    states.joint_pos = [100.0, 3.0, 2.0, 1.0]  # of b_knee, b_hip, a_knee, a_hip
    states.joint_vel = [4.0, 3.0, 2.0, 1.0]
    policy()
    apart = np.array([1.0, 2.0, 3.0], F) - np.array([0.1, 0.2, 0.3], F)
    same(states.seen, [*apart, *apart, 0.0, *(np.array([1.0, 2.0, 3.0, 4.0], F) * F(0.05))])


def test_a_skill_sees_the_last_action_of_another(tmp_path: Path) -> None:
    """In its own joint order, whatever the other's; of the tick before, as it runs first here."""
    legs = [f"{leg}_{part}_joint" for leg in ("FL", "RR", "FR", "RL") for part in PARTS]
    for name, joints, terms in (
        ("walk", legs, [{"name": "one", "value": np.arange(12.0).tolist()}]),
        ("turn", legs[::-1], [{"name": "last", "state": "walk_action"}]),
    ):
        shapes = {"obs": [1, 12], "actions": [1, 12]}
        write_graph(tmp_path / name / "policy.onnx", "actions = Identity(obs)", ["obs"], shapes, {})
        pose = [0.1, 0.8, -1.5] * 4 if name == "walk" else [-1.5, 0.8, 0.1] * 4
        facts = {"joints": joints, "default_joint_pos": pose, "stiffness": 40.0, "damping": 1.0}
        action = {"scale": 0.01}
        observation = {"terms": terms}
        values = toy_values(name=name, action=action, observation=observation, **facts)
        write_toy(tmp_path / name, values)
    both = [
        {"policy": {"policy": "turn", "drives": ["R*"]}},
        {"policy": {"policy": "walk", "drives": ["F*"]}},
    ]
    first = {"loop": {"do": {"zip": both}, "until": {"elapsed": 0.06}}}
    document: dict[str, Any] = {
        "robot": "go2",
        "platform": "fake",
        "rate": 50,
        "policies": {name: str(tmp_path / name) for name in ("walk", "turn")},
        "flow": {"chain": [first, {"policy": "turn"}]},
    }
    program = Program(**document)
    runner = Runner(program, RunOptions(speed="max", warn=lambda _: None))
    walked = np.arange(12.0)
    for seen in (0.0 * walked, walked[::-1], 0.0 * walked):  # a policy that is left is reset
        runner.tick(0)
        same(program.states["turn_action"], seen)
    program.close()
    lone: dict[str, Any] = {
        **document,
        "policies": {"turn": str(tmp_path / "turn")},
        "flow": {"policy": "turn"},
    }
    with pytest.raises(UniconError, match="term 'last': no state 'walk_action'"):
        Program(**lone)


PARTS = ("hip", "thigh", "calf")


@pytest.mark.parametrize("named", ["policy.mnn", "folder", "contract"])
def test_a_network_for_mnn_is_refused_by_name(tmp_path: Path, named: str) -> None:
    (tmp_path / "policy.mnn").write_bytes(b"\x18\x00\x00\x00")
    reference = tmp_path if named == "folder" else tmp_path / named
    if named == "contract":
        reference = tmp_path / "policy.yaml"
        reference.write_text(yaml.safe_dump(toy_values(onnx="policy.mnn")), "utf-8")
    with pytest.raises(PolicyError, match=r"policy\.mnn: is a network for MNN, .* export .* ONNX"):
        import_policy(reference, tmp_path / "out")

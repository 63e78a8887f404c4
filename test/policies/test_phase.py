"""The gait clock follows holosoma's and Unitree's programs, tick by tick."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from policy_helpers import JOINTS, robot, toy_values, write_linear, write_toy

from unicon_base.errors import PolicyError
from unicon_core.policies import GaitPhase, PhaseSpec, Policy, load_policy, policy_states
from unicon_core.policies.hints import ClockRate
from unicon_core.policies.policy_yaml import write_policy_yaml
from unicon_core.states import States, StateSpec, standard_states


def states_of(count: int, num_robots: int | None = None) -> States:
    return States(
        {
            "velocity_command": StateSpec((3,)),
            "gait_phase_sin": StateSpec((count,)),
            "gait_phase_cos": StateSpec((count,)),
            "gait_phase": StateSpec((2 * count,)),
        },
        num_robots,
    )


class HolosomaPhase:
    """The rule of holosoma's program, for one robot."""

    def __init__(self, period: float, dt: float) -> None:
        self.phase = np.array([0.0, np.pi])
        self.step = 2 * np.pi * dt / period
        self.standing = False

    def __call__(self, command: np.ndarray) -> None:
        self.phase = np.fmod(self.phase + self.step + np.pi, 2 * np.pi) - np.pi
        if np.hypot(command[0], command[1]) < 0.01 and abs(command[2]) < 0.01:
            self.phase = np.array([np.pi, np.pi])
            self.standing = True
        elif self.standing:
            self.phase = np.array([0.0, np.pi])
            self.standing = False


def test_two_legs_follow_holosoma_through_walking_standing_and_walking_again() -> None:
    states = states_of(2, 3)
    spec = PhaseSpec(1.0, (0.0, np.pi), stand=np.pi)
    clock = GaitPhase(spec, states, 0.02)
    twins = [HolosomaPhase(1.0, 0.02) for _ in range(3)]
    rng = np.random.default_rng(3)
    for tick in range(400):
        if tick % 37 == 0:
            states.velocity_command = rng.choice([0.0, 0.005, 0.5], size=(3, 3))
        clock()
        for k, twin in enumerate(twins):
            twin(states.velocity_command[k])
            np.testing.assert_allclose(states.gait_phase_sin[k], np.sin(twin.phase), atol=1e-6)
            np.testing.assert_allclose(states.gait_phase_cos[k], np.cos(twin.phase), atol=1e-6)
    assert clock.reads == ("velocity_command",)


def test_one_phase_follows_unitree() -> None:
    states = states_of(1)
    clock = GaitPhase(PhaseSpec(0.8, (0.0,)), states, 0.02)
    phase = 0.0
    for _ in range(200):
        clock()
        phase = (phase + 0.02 / 0.8) % 1.0
        expected = [np.sin(2 * np.pi * phase), np.cos(2 * np.pi * phase)]
        np.testing.assert_allclose(states.gait_phase, expected, atol=1e-5)
    assert clock.reads == ()


STAND_AND_RESUME = [
    (np.pi, None),
    (np.pi, "stand"),
    (np.pi, "clock"),
    ("freeze", None),
    ("freeze", "offsets"),
    ("freeze", "clock"),
    ("zero", None),
    ("zero", "stand"),
    ("zero", "offsets"),
]


class SwitchedClock:
    """A clock of one robot in words: what it shows while the command is zero, and after that."""

    def __init__(self, stand: float | str, resume: str | None, step: float) -> None:
        self.start, self.step = [0.0, np.pi], step
        self.shown, self.clock, self.was = list(self.start), list(self.start), False
        self.stand = stand
        self.resume = resume or {"freeze": "stand", "zero": "clock"}.get(str(stand), "offsets")

    def __call__(self, command: np.ndarray) -> tuple[list[float], list[float]]:
        still = np.hypot(command[0], command[1]) < 0.01 and abs(command[2]) < 0.01
        self.clock = [phase + self.step for phase in self.clock]
        if still:
            if not isinstance(self.stand, str):
                self.shown = [self.stand] * 2
        elif self.was and self.resume == "offsets":
            self.shown = list(self.start)
        elif self.resume == "clock":
            self.shown = self.clock
        else:
            self.shown = [phase + self.step for phase in self.shown]
        self.was = still
        lit = 0.0 if still and self.stand == "zero" else 1.0
        return [lit * np.sin(p) for p in self.shown], [lit * np.cos(p) for p in self.shown]


@pytest.mark.parametrize(("stand", "resume"), STAND_AND_RESUME)
def test_a_clock_is_switched_off_with_the_command(stand: float | str, resume: str | None) -> None:
    states = states_of(2, 3)
    clock = GaitPhase(PhaseSpec(0.7, stand=stand, resume=resume), states, 0.02)
    rng = np.random.default_rng(5)
    for _ in range(2):  # and the same again behind a reset
        twins = [SwitchedClock(stand, resume, 2 * np.pi * 0.02 / 0.7) for _ in range(3)]
        for tick in range(200):
            if tick % 13 == 0:
                states.velocity_command = rng.choice([0.0, 0.005, 0.5], size=(3, 3))
            clock()
            for k, twin in enumerate(twins):
                sines, cosines = twin(states.velocity_command[k])
                np.testing.assert_allclose(states.gait_phase_sin[k], sines, atol=1e-6)
                np.testing.assert_allclose(states.gait_phase_cos[k], cosines, atol=1e-6)
                np.testing.assert_allclose(states.gait_phase[k], [*sines, *cosines], atol=1e-6)
        clock.reset()


@pytest.mark.parametrize(
    ("phase", "message"),
    [
        (
            {"stand": "stop"},
            "phase.stand is 'stop'; write a phase in [rad] or freeze or zero or null",
        ),
        (
            {"stand": [1.0, 2.0]},
            "phase.stand is [1.0, 2.0]; write a phase in [rad] or freeze or zero or null",
        ),
        (
            {"stand": "zero", "resume": "go"},
            "phase.resume 'go' is not known; known: clock, offsets, stand",
        ),
        (
            {"resume": "clock"},
            "phase.resume says where the phases go on, and stand: does not say that they stand; "
            "add stand: a phase in [rad], freeze or zero",
        ),
        (
            {"stand": 0.0, "stand_below": 0.0},
            "phase.stand_below is 0.0; write a speed above 0 in [m/s] and [rad/s]: no command is "
            "below it",
        ),
    ],
)
def test_a_wrong_switch_of_the_clock_is_told(tmp_path: Path, phase: dict, message: str) -> None:
    path = write_toy(tmp_path, toy_values(phase={"period": 1.0, **phase}))
    with pytest.raises(PolicyError) as caught:
        load_policy(path)
    assert str(caught.value).endswith(f": {message}")


def test_the_switch_survives_being_written(tmp_path: Path) -> None:
    phase = {"period": 1.0, "stand": "zero", "resume": "stand", "stand_below": 0.1}
    contract = load_policy(write_toy(tmp_path / "a", toy_values(phase=phase)))
    again = load_policy(write_policy_yaml(contract, tmp_path / "b"))
    assert again.phase == contract.phase
    assert again.phase is not None
    assert (again.phase.stand, again.phase.resume) == ("zero", "stand")


def test_a_long_run_does_not_drift() -> None:
    states = states_of(1)
    clock = GaitPhase(PhaseSpec(0.8, (0.0,)), states, 0.02)
    for _ in range(40 * 2500):  # 40 ticks are one period
        clock()
    np.testing.assert_allclose(states.gait_phase, [0.0, 1.0], atol=1e-6)


def test_reset_starts_over() -> None:
    states = states_of(2)
    clock = GaitPhase(PhaseSpec(1.0), states, 0.02)
    clock()
    first = states.gait_phase.copy()
    clock()
    clock.reset()
    clock()
    np.testing.assert_array_equal(states.gait_phase, first)


def test_undeclared_states_are_told() -> None:
    states = States({"gait_phase_sin": StateSpec((2,))})
    with pytest.raises(PolicyError) as caught:
        GaitPhase(PhaseSpec(1.0), states, 0.02)
    assert str(caught.value) == (
        "gait phase: state 'gait_phase_cos' must be declared with 2 elements; policy_states gives "
        "it"
    )


def test_a_missing_command_is_told() -> None:
    spec = PhaseSpec(1.0, stand=np.pi, command="twist")
    with pytest.raises(PolicyError) as caught:
        GaitPhase(spec, states_of(2), 0.02)
    assert str(caught.value) == (
        "gait phase: it stands still while state 'twist' (vx, vy, wz) is zero, and there is no "
        "such state of 3 elements; correct phase.command"
    )


def test_a_missing_rate_is_told_with_its_policy(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    write_linear(tmp_path / "policy.onnx", 15, 4)
    contract = load_policy(
        write_toy(tmp_path, toy_values(phase={"period": 1.0, "rate": {"state": "tempo"}}))
    )
    states = States({**standard_states(JOINTS), **policy_states(contract, robot().joint_names)})
    with pytest.raises(
        PolicyError, match=r"policy toy: gait phase: its rate takes .* 'tempo', which"
    ):
        Policy(contract, states, robot())


def test_the_policy_block_runs_its_own_clock(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    write_linear(tmp_path / "policy.onnx", 16, 4)
    values = toy_values(phase={"period": 1.0, "stand": 3.0})
    terms = values["observation"]["terms"]
    terms[0] = {"name": "sin", "state": "gait_phase_sin"}
    terms.append({"name": "cos", "state": "gait_phase_cos"})
    contract = load_policy(write_toy(tmp_path, values))
    states = States({**standard_states(JOINTS), **policy_states(contract, robot().joint_names)})
    policy = Policy(contract, states, robot())
    states.velocity_command = [1.0, 0.0, 0.0]
    policy()
    assert states.observation[0] == pytest.approx(np.sin(2 * np.pi * 0.02))
    assert {"gait_phase_sin", "gait_phase_cos"} <= set(policy.writes)
    assert "velocity_command" in policy.reads
    assert "gait_phase_sin" not in policy.reads
    policy.reset()
    policy()
    assert states.observation[0] == pytest.approx(np.sin(2 * np.pi * 0.02))


@pytest.mark.parametrize(("rate", "begun"), [(3.0, 1), (-1.0, 6), (0.0, 6)])
def test_a_faster_clock_passes_its_first_offset_once_a_cycle(rate: float, begun: int) -> None:
    states = States({**states_of(1).layout.specs, "r": StateSpec((1,))})
    clock = GaitPhase(PhaseSpec(0.36, (0.0,), rate=ClockRate("r")), states, 0.02)
    states.r = rate
    count = 0
    for _ in range(6):  # of 60 degrees at three times the speed
        clock()
        count += clock.begins
    assert count == begun

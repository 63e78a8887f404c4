"""The integral in the shipped Go2 network: as its slow reference has it, and what it does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trainer import trainer

onnx = pytest.importorskip("onnx", reason="pip install onnx")
onnxruntime = pytest.importorskip("onnxruntime", reason="pip install onnxruntime")
pytest.importorskip("mujoco", reason="pip install mujoco")
ROOT = Path(__file__).resolve().parents[1]
NETWORK = str(ROOT / "config" / "policies" / "go2_velocity" / "policy.onnx")
integral, network = trainer("integral", "network")
ACTOR, ESTIMATE = network.weights_of(onnx.load(NETWORK))
INTEGRAL = integral.Integral(ESTIMATE)
SESSION = onnxruntime.InferenceSession(NETWORK, providers=["CPUExecutionProvider"])


def run(obs: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    actions, following = SESSION.run(None, {"obs": obs, "memory": memory})
    return actions, following


def observation(command: tuple[float, float, float], rows: int = 1) -> np.ndarray:
    """Of robots that stand upright and do not move."""
    values = np.zeros((rows, 45), np.float32)
    values[:, 5] = -1.0
    values[:, integral.COMMAND] = 2.0 * np.array(command)
    return values


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 4.0), st.sampled_from([1, 3]))
def test_the_network_is_the_actor_behind_the_slow_integral(
    seed: int, size: float, rows: int
) -> None:
    rng = np.random.default_rng(seed)
    memory = rng.normal(size=(rows, integral.NUM_MEMORY)).astype(np.float32)
    for _ in range(3):
        obs = (size * rng.normal(size=(rows, 45))).astype(np.float32)
        obs[rng.random(rows) < 0.3, integral.COMMAND] = 0.0
        told, expected = INTEGRAL(obs, memory)
        actions, following = run(obs, memory)
        np.testing.assert_allclose(following, expected, atol=2e-5, rtol=1e-4)
        np.testing.assert_allclose(actions, integral.mlp(told, ACTOR), atol=2e-3, rtol=1e-3)
        memory = following


def test_a_robot_that_stands_holds_nothing() -> None:
    memory = np.full((1, integral.NUM_MEMORY), 0.2, np.float32)
    _, following = run(observation((0.0, 0.0, 0.0)), memory)
    assert not following[:, integral.HELD].any()


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_what_is_held_grows_towards_the_command_and_stays_bounded(axis: int, sign: float) -> None:
    command = [0.0, 0.0, 0.0]
    command[axis] = sign * (0.3, 0.3, 0.8)[axis]
    memory = np.zeros((1, integral.NUM_MEMORY), np.float32)
    held = []
    for _ in range(200):  # a robot that does not move, whatever it is told
        _, memory = run(observation(tuple(command)), memory)
        held.append(sign * memory[0, integral.HELD][axis])
    assert 0.0 < held[50] <= held[199] <= integral.LARGEST + 1e-6
    assert held[199] > 0.2


def test_it_forgets_where_the_command_changes() -> None:
    memory = np.zeros((1, integral.NUM_MEMORY), np.float32)
    memory[0, integral.REFERENCE], memory[0, integral.HELD] = (0.5, 0.0, 0.0), (0.3, 0.0, 0.0)
    kept = {}
    for vx in (0.5, -0.5):
        _, following = run(observation((vx, 0.0, 0.0)), memory)
        kept[vx] = following[0, integral.HELD][0]
    assert kept[0.5] > 0.29
    assert kept[-0.5] < 0.28


@pytest.mark.parametrize("broken", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [0, 2, 6, 8, 20])
def test_a_number_that_is_none_is_forgotten(broken: float, place: int) -> None:
    obs = observation((0.4, 0.0, 0.0))
    memory = np.zeros((1, integral.NUM_MEMORY), np.float32)
    wrong = obs.copy()
    wrong[0, place] = broken
    _, memory = run(wrong, memory)
    for _ in range(5):
        actions, memory = run(obs, memory)
    assert np.isfinite(memory).all()
    assert np.isfinite(actions).all()
    assert np.abs(memory[0, integral.HELD]).max() <= integral.LARGEST + 1e-6

"""The recurrent network of `unicon bench policy` remembers, and differs by nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.samples import random_policy
from unicon_core.policies import Policy, policy_states
from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states

pytest.importorskip("onnx", reason="writes the networks")
pytest.importorskip("onnxruntime", reason="runs the networks")


def test_only_the_recurrent_one_remembers(tmp_path: Path) -> None:
    robot, actions = load_robot("go2"), {}
    for name in ("plain", "recurrent"):
        contract = random_policy(tmp_path / name, robot, recurrent=name == "recurrent")
        specs = standard_states(robot.joint_names) | policy_states(contract, robot.joint_names)
        states = States(specs)
        states["joint_vel"][...] = 1.0
        policy, taken = Policy(contract, states, robot), []
        for _ in range(3):
            states["action"][...] = 0.0
            policy()
            taken.append(states["action"].copy())
        actions[name] = taken
    plain, recurrent = actions["plain"], actions["recurrent"]
    assert plain[0].tobytes() == plain[1].tobytes()
    # Before the first call the memory is zero: the same network.
    np.testing.assert_allclose(recurrent[0], plain[0], rtol=1e-5, atol=1e-6)
    assert (recurrent[1] != recurrent[0]).any()
    assert (recurrent[2] != recurrent[1]).any()

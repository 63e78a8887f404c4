"""Every block moves robot k of a batch exactly as it moves a robot of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from unicon_core.states.standard import forwarded_states

Bench = Any

BLOCKS: dict[str, dict[str, Any]] = {
    "pose": {"to": "stand", "duration": 2.0, "fade_in": 0.1},
    "hold": {},
    "damp": {},
    "sway": {"gains": {"*": [0.1, 0.2, 0.3]}, "amplitude": [0.1, 0.2, 0.3]},
    "velocity_command": {"constant": [1, 2, 3], "ramp": 1.0},
    "joint_limits": {},
    "effort_limits": {"scale": 0.3},
    "rate_limit": {},
    "velocity_limits": {"scale": 0.02},
    "fade_in": {},
    "forward_command": {"integral": 2.0},
    "projected_gravity": {},
    "linear_map": {"source": "joint_vel", "target": "joint_effort_ff", "scale": -0.5},
    "copy": {"source": "joint_pos", "target": "joint_pos_target", "index": list(range(12))[::-1]},
}


@pytest.mark.parametrize("name", BLOCKS)
def test_robot_of_a_batch_equals_a_single_one(bench, name):
    count = 3
    extra = forwarded_states(bench().robot.joint_names)
    many = bench(num_robots=count, states=extra)
    singles = [bench(states=extra) for _ in range(count)]
    blocks = [it.block(name, **BLOCKS[name]) for it in (many, *singles)]
    rng = np.random.default_rng(7)
    for _ in range(4):
        many.randomize(rng)
        for k, single in enumerate(singles):
            for state in single.states:
                single.states[state] = many.states[state][k]
        assert len({bool(block.tick()) for block in blocks}) == 1
        for k, single in enumerate(singles):
            for state in single.states:
                np.testing.assert_allclose(
                    many.states[state][k], single.states[state], rtol=1e-6, atol=1e-7, err_msg=state
                )

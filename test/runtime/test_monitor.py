"""What the report's watcher sees: commands of every tick as one hash, falls of any robot."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from unicon_core.blocks.approach import Monitor
from unicon_core.robots import load_robot
from unicon_core.states import Layout, States
from unicon_core.states.standard import COMMAND_STATES, standard_states


def made(num_robots: int | None = None, **dtypes: str) -> States:
    specs = standard_states(load_robot("go2").joint_names)
    for name, dtype in dtypes.items():
        specs[name] = type(specs[name])(
            shape=specs[name].shape, dtype=dtype, names=specs[name].names
        )
    return States(Layout(specs, num_robots))


@pytest.mark.parametrize(
    "states",
    [made(), made(3), made(joint_vel_target="float64")],
    ids=["back to back", "three robots", "one of another type"],
)
def test_the_hash_is_of_all_commands_of_all_ticks(states: States) -> None:
    monitor, expected = Monitor(states), hashlib.sha256()
    generator = np.random.default_rng(0)
    for _ in range(3):
        for name in COMMAND_STATES:
            states[name][...] = generator.normal(size=states[name].shape)
            expected.update(states[name].tobytes())
        monitor()
    assert monitor.found()["sha256_commands"] == expected.hexdigest()


@pytest.mark.parametrize("num_robots", [None, 3])
def test_the_fall_of_any_robot_counts(num_robots: int | None) -> None:
    states = made(num_robots)
    monitor = Monitor(states)
    states.projected_gravity[...] = [0.0, 0.0, -1.0]
    monitor()
    assert not monitor.fell
    states.projected_gravity.reshape(-1, 3)[-1] = [0.9, 0.0, -0.43]
    monitor()
    assert monitor.fell

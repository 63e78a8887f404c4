"""The paper's A1 case on a Go2: the weak leg heats up, is found, and its twin sees it in time."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("onnxruntime")

from weak_runs import RL_CALF, begins_to_fall, walked

from unicon_core.metrics import aligned_mse

SEEDS = 20


def test_a_weak_calf_gets_hot_and_its_twin_tells_before_the_robot_falls() -> None:
    report, told = walked(True, 0)
    falls = begins_to_fall(told)
    assert falls is not None
    assert "the base leans" in report.faults[0]
    flagged = int(np.argmax(told["twin_flag"][:, RL_CALF]))
    assert 0 < flagged < falls
    assert told["twin_gap"][-1].argmax() == RL_CALF
    assert told["motor_temperature"][-1].argmax() == RL_CALF
    assert told["motor_temperature"][-1, RL_CALF] > 60.0


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_twenty_seeds() -> None:
    seeds = range(SEEDS)
    with ProcessPoolExecutor(2) as pool:
        weak = list(pool.map(partial(walked, True), seeds))
        sound = list(pool.map(partial(walked, False), seeds))
    falls = [begins_to_fall(told) for _, told in weak]
    assert sum(fall is not None for fall in falls) >= 18
    assert all(begins_to_fall(told) is None and not report.faults for report, told in sound)
    first = 0
    for (_, real), (_, sim) in zip(weak, sound):
        pairs = (told["joint_pos"].T[..., None] for told in (real, sim))
        first += int(aligned_mse(*pairs).loss.argmax() == RL_CALF)
    assert first == SEEDS
    flags = [told["twin_flag"][:fall, RL_CALF].any() for (_, told), fall in zip(weak, falls)]
    assert sum(flag for flag, fall in zip(flags, falls) if fall is not None) >= 16
    assert not any(told["twin_flag"].any() for _, told in sound)

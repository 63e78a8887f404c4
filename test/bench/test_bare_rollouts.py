"""The bare loop that `unicon bench sweep` compares with walks as the policy does in a program."""

from __future__ import annotations

import pytest

pytest.importorskip("mujoco")
pytest.importorskip("onnxruntime")

from benchmarks.sweep import rollout_of


def test_it_walks_as_far_as_it_is_told_and_again_to_the_bit() -> None:
    rollout = rollout_of(150)  # 3 s at 0.5 m/s
    way = rollout()
    assert 1.2 < way < 1.8
    assert rollout() == way  # a memory of the network begins anew, too

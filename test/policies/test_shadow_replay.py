"""A run with swaps replays bit-exact, though wall time and requests decide what happens in it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from shadow_helpers import ask, older, ran
from test_shadow import FIT, broken

from unicon_core.policies.shadow import ShadowedPolicy
from unicon_core.runtime import Runner
from unicon_lab.fault_record import FaultRecord
from unicon_lab.recording import open_record
from unicon_lab.replay import verify, workflow_of

pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")
pytest.importorskip("onnxruntime", reason="pip install onnxruntime")


def late(shadowed: ShadowedPolicy, _: Runner) -> None:
    """Let B look slow for the three ticks in which its time is measured at an hour."""
    tick = shadowed._tick

    def slow(number: int) -> Any:
        found = tick(number)
        shadowed._spent = 3600.0 if number else shadowed._spent
        return found

    shadowed._tick = slow  # type: ignore[method-assign]


def stop(shadowed: ShadowedPolicy, _: Runner) -> None:
    """End the run by a fault of both."""
    for policy in (shadowed.a, shadowed.b):
        policy.lane.finite = lambda: False


@pytest.mark.parametrize("phase", [None, {"period": 0.5}])
@pytest.mark.parametrize(
    "acts",
    [
        {FIT: ask, FIT + 40: ask, FIT + 44: ask, 190: stop},
        {FIT: ask, FIT + 40: late, 130: stop},
        {FIT: ask, FIT + 4: stop},
        {20: late, 60: stop},
    ],
    ids=["there and back", "too slow", "cut off in the blend", "out"],
)
def test_a_record_with_a_swap_replays_bit_exact(
    tmp_path: Path, acts: dict[int, Any], phase: Any
) -> None:
    b = older(tmp_path / "b", **({} if phase is None else {"phase": phase}))
    record = FaultRecord(str(tmp_path / "faults"), warn=str)
    run = ran(tmp_path / "w.yaml", b, 5.0, acts, record=record)
    assert len(run.events) >= 1
    path = record.write(run.report)
    assert path is not None
    found = open_record(path)
    verdict = verify(found, workflow_of(found, None, {}))
    assert verdict.first is None
    assert verdict.ticks > 50


def test_a_jump_of_another_network_is_what_a_replay_names(tmp_path: Path) -> None:
    record = FaultRecord(str(tmp_path / "faults"), warn=str)
    acts = {FIT: ask, FIT + 25: broken("jumps"), FIT + 40: stop}
    run = ran(tmp_path / "w.yaml", older(tmp_path / "b"), 5.0, acts, record=record)
    path = record.write(run.report)
    assert path is not None
    found = open_record(path)
    verdict = verify(found, workflow_of(found, None, {}))
    assert verdict.first is not None
    assert verdict.first.tick == FIT + 25

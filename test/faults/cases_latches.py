"""Cases: what an emergency stop leaves latched, for whichever start comes next."""

from __future__ import annotations

from functools import partial
from typing import Any

from faults.case import BLOCKS, WOBBLE, Case, Wants
from faults.cases_ros import BUSY, NODE_TICKS, PRESSED
from faults.fault_run import FaultRun

_REFUSED = Wants(most=10, ms=PRESSED.ms, status=(1,), reason="is latched", report=False)
_DRIVES = Wants(most=None, least=30, ms=None, status=(0,), report=False)


def _killed_on_its_answer(run: FaultRun) -> None:
    run.wait_for(lambda: "estop: " in run.peer_said())
    run.process.kill()


def _latches(name: str, wants: Wants = _REFUSED, **others: Any) -> Case:
    """A first run that ends, and a second one of the same robot."""
    return Case("latches", name, wants, spread=1, **{"again": (), "workflow": BUSY, **others})


_pressed = partial(_latches, node=True, peer=("caller", "{at}", "estop"), ticks=NODE_TICKS)

CASES = (
    _pressed("~/estop, then unicon run without ROS"),
    _pressed(
        "~/estop, then unicon run --ros in another namespace",
        again=("--ros", "--namespace", "/other"),
    ),
    _pressed("~/estop, killed on its answer, then unicon run", outside=_killed_on_its_answer),
    _pressed("~/estop, unicon latches --clear, then unicon run: it runs", _DRIVES, clear="/unicon"),
    _latches(
        "the remote without ROS, then unicon run --ros",
        workflow={**BUSY, "safety": ["finite", "joint_limits", "remote_stop"]},
        flow={"zip": [{f"{BLOCKS}:pressed": {"at": "{at}"}}, WOBBLE]},
        again=("--ros",),
    ),
    _latches("Ctrl-C, then unicon run: it runs", _DRIVES, fault={"signals": ["SIGINT"]}),
)

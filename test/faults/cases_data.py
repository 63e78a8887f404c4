"""Cases: what a robot's sensors and a policy may bring; `cases_simulated.py` has far more."""

from __future__ import annotations

from functools import partial

from faults.case import BLOCKS, NAN, WALK, WOBBLE, Case, Wants

_sensing = partial(Case, "sensors and policy")
_NO_LONGER = Wants(most=0, reason="")
_SENSORS = ("joint_pos", "joint_vel", "base_ang_vel", "projected_gravity")
_STALE = ["finite", "joint_limits", {"stale_stop": {"timeout": 0.1}}]


def _broken(value: float, state: str = "joint_pos_target") -> object:
    return {"zip": [WOBBLE, {f"{BLOCKS}:broken": {"value": value, "state": state, "at": "{at}"}}]}


CASES = (
    *(
        _sensing(
            f"NaN in {state}",
            _NO_LONGER,
            fault={"set": {state: "nan"}},
            flow=WALK,
            ticks=(25, 45),
            quick=state == "joint_pos",
        )
        for state in _SENSORS
    ),
    _sensing(
        "infinity in joint_vel",
        _NO_LONGER,
        fault={"set": {"joint_vel": 1e39}},
        flow=WALK,
        ticks=(25, 45),
    ),
    _sensing("the policy gives NaN", _NO_LONGER, flow=NAN),
    _sensing(
        "the policy gives 1e30 rad",
        # A limit is not a fault: what leaves is within the limits.
        Wants(most=None, least=20, ms=None, status=(0, 3)),
        flow=_broken(1e30),
    ),
    _sensing(
        "the base leans by 90°",
        Wants(most=0, reason="lean"),
        fault={"set": {"projected_gravity": 0.0}},
    ),
    _sensing(
        "stamps stand still, with stale_stop of 0.1 s",
        Wants(most=6, ms=300.0, reason="stale"),
        fault={"freeze": ["stamp_ns"]},
        workflow={"safety": _STALE},
    ),
    _sensing(
        "the robot falls silent (recv tells)",
        Wants(most=0, reason="made by the bench"),
        fault={"raise": "Fault"},
    ),
    _sensing("an array of another length", Wants(most=0, reason="shape"), fault={"shape": True}),
)

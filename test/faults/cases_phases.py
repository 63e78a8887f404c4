"""Cases in MuJoCo: blocks and platform, ~/estop, phases, time, velocity command."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

from faults import mishaps
from faults.case import BLOCKS
from faults.simulated_case import SimulatedCase, set_to
from unicon_core.flow import Stage

_block = partial(SimulatedCase, "blocks and platform")
_estop = partial(SimulatedCase, "~/estop", reason="emergency stop", mishap=mishaps.estop())
_phase = partial(SimulatedCase, "phases")
_time = partial(SimulatedCase, "time")
_velocity = partial(SimulatedCase, "velocity command")

RAISED = (
    *("Fault", "ValueError", "StopIteration", "MemoryError", "RecursionError"),
    *("SystemExit", "KeyboardInterrupt", "GeneratorExit"),
)
HOUR = 3_600_000_000_000

BUSY = {"pacing": {"hang": 2.0}}
"""A machine that is busy is not the fault that is looked for."""
WIND_DOWN = {"wind_down": {"chain": [{"pose": {"to": "default", "duration": 0.3}}]}}

PROGRAM = (
    *(
        _block(
            f"{error} in a block",
            reason="made by the bench",
            mishap=mishaps.raises(error),
            quick=error == "SystemExit",
        )
        for error in RAISED
    ),
    _block("a block calls itself for ever", reason="Recursion", mishap=mishaps.recurses()),
    _block(
        "ValueError in an estimator",
        reason="made by the bench",
        mishap=mishaps.raises("ValueError", Stage.ESTIMATE),
    ),
    _block(
        "ValueError in an observer",
        within=1,
        reason="made by the bench",
        mishap=mishaps.raises("ValueError", Stage.OBSERVE),
    ),
    *(
        _block(
            f"{error} in {where}", reason="made by the bench", fault={"raise": error, "in": where}
        )
        for error in ("Fault", "OSError", "SystemExit")
        for where in ("recv", "send")
    ),
)

_ONCE = {"elapsed": 60.0}
COMPOSITES: dict[str, Any] = {
    "chain": {"chain": [{"hold": {"duration": 0.1}}, "{walk}"]},
    "loop": {"loop": {"do": "{walk}", "until": _ONCE}},
    "zip": {"zip": ["{walk}", {f"{BLOCKS}:nothing": {}}]},
    "switch": {"switch": {"on": {"commanded": {}}, "cases": {"no": {"hold": {}}, "yes": "{walk}"}}},
    "every": {"every": {"n": 2, "do": "{walk}"}},
    "when": {"when": {"if": "projected_gravity[2] < 0.0", "do": "{walk}"}},
    "deferred": {"zip": ["{walk}", {"deferred": {f"{BLOCKS}:nothing": {}}}]},
    "chain of a loop of a switch of a zip": {
        "chain": [
            {"hold": {"duration": 0.1}},
            {
                "loop": {
                    "do": {
                        "switch": {
                            "on": {"commanded": {}},
                            "cases": {
                                "no": {"hold": {}},
                                "yes": {"zip": ["{walk}", {f"{BLOCKS}:nothing": {}}]},
                            },
                        }
                    },
                    "until": _ONCE,
                }
            },
        ]
    },
}
ESTOP = (
    *(_estop(f"in a {word}", flow=flow, quick=word == "loop") for word, flow in COMPOSITES.items()),
    _estop("in wait", during="wait", ticks=(2, 20), outcome="refuse", real=True, workflow=BUSY),
    _estop("in the approach", during="approach", ticks=(2, 12), real=True, workflow=BUSY),
    _estop("in the run, as a robot", ticks=(5, 40), real=True, workflow=BUSY),
    _estop(
        "in the wind-down",
        during="soft",
        ticks=(2, 12),
        workflow=WIND_DOWN,
        mishap=mishaps.both(mishaps.ends(30), mishaps.estop()),
    ),
    _estop(
        "while it damps already",
        during="damp",
        ticks=(1, 15),
        reason="made by the bench",
        mishap=mishaps.both(mishaps.breaks(30), mishaps.estop()),
    ),
)

PHASES = (
    _phase(
        "asked to end: the wind-down follows",
        outcome="soft",
        within=1,
        workflow=WIND_DOWN,
        mishap=mishaps.ends(),
    ),
    _phase(
        "NaN in the wind-down",
        during="soft",
        ticks=(2, 12),
        workflow=WIND_DOWN,
        mishap=mishaps.ends(30),
        fault=set_to("joint_pos", "nan"),
    ),
    _phase(
        "NaN in the approach",
        during="approach",
        ticks=(2, 12),
        real=True,
        workflow=BUSY,
        fault=set_to("joint_pos", "nan"),
    ),
    _phase(
        "another variant than the robot file's",
        outcome="refuse",
        during="wait",
        ticks=(1, 5),
        reason="variant",
        real=True,
        workflow=BUSY,
        fault={"variant": {"protocol": "unheard of"}},
    ),
)

TIME = (
    _time(
        "a block hangs for 200 ms: told as overruns",
        outcome="go on",
        ticks=(5, 40),
        mishap=mishaps.hangs(0.2),
        overruns=8,
        real=True,
    ),
    _time(
        "a block hangs for 0.5 s",
        within=1,
        ticks=(5, 40),
        reason="hung",
        mishap=mishaps.hangs(0.5),
        real=True,
    ),
    _time(
        "every tick takes 1.6 periods, overrun_stop",
        within=25,
        ticks=(5, 40),
        reason="missed",
        mishap=mishaps.slows(1.6),
        also=("overrun_stop",),
        real=True,
    ),
    _time("stamps jump by an hour", outcome="go on", fault=set_to("stamp_ns", HOUR, add=True)),
    _time(
        "stamps jump back by an hour", outcome="go on", fault=set_to("stamp_ns", -HOUR, add=True)
    ),
    _time("the clock jumps by an hour", outcome="go on", mishap=mishaps.jumps_clock(3600.0)),
    _time("the clock jumps back", outcome="go on", mishap=mishaps.jumps_clock(-3600.0)),
)

VELOCITY = (
    _velocity("velocity command of 1e30", outcome="go on", mishap=mishaps.velocity(1e30)),
    _velocity("velocity command NaN", outcome="zero command", mishap=mishaps.velocity(math.nan)),
    _velocity("velocity command -inf", outcome="zero command", mishap=mishaps.velocity(-math.inf)),
)

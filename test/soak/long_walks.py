"""Hours of simulated walking with all safety blocks of a robot: what trips was healthy, or fell.

By hand: `python test/soak/long_walks.py go2 3600`. Commands change every 3 s within the ranges that
the policy was trained for, the base is pushed every 5 s, and the sensors have the noise of the
training: tools/train/env.py of Go2; of G1, whose policy does not say them, half widths that are
usual for legged robots (0.2 rad/s, 0.05, 0.01 rad, 1.5 rad/s).
"""

from __future__ import annotations

import json
import math
import os
import sys
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from unicon_core.blocks import BUILTIN
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import Program, load_workflow
from unicon_core.workflow.tick_tree import ROBOT_SAFETY, TELLS

PIECE = 600.0
"""In [s]: a program is built anew after it, with other seeds."""
CHANGE = 3.0
"""In [s], of a command."""
UNIFORM = 1 / math.sqrt(3)
"""Standard deviation of what is uniform in ±1."""
MOST = 20
"""Trips after which there is nothing more to learn."""
LEAN = 0.9
"""Beyond this a robot that walks has fallen, [rad]; `tilt_stop` says 1.0."""

# More than the set of a robot: what a user may list besides.
STRICT: list[Any] = [name for name in ROBOT_SAFETY if name not in TELLS]
STRICT += [
    {"joint_limits": {"beyond": "trip", "name": "joint_trip"}},
    {"effort_limits": {"beyond": "trip", "scale": 10.0}},
    "action_stop",
    "overrun_stop",
]


@dataclass(frozen=True)
class Walker:
    """How a robot walks.

    Attributes:
        workflow: of `config/workflows/`.
        noise: half widths of uniform noise by state, in its unit.
        push: largest push in [m/s] on either axis.
        tracking: bound of `tracking_stop` in [rad]: soft joints are springs to these policies.
        height: of the base, below which it has fallen, in [m].
    """

    workflow: str
    noise: dict[str, float]
    push: float
    tracking: float
    height: float


WALKERS = {
    "go2": Walker(
        "go2_walk",
        {
            "base_ang_vel": 0.15,
            "projected_gravity": 0.04,
            "base_quat": 0.02,
            "joint_pos": 0.012,
            "joint_vel": 0.6,
        },
        push=0.5,
        tracking=1.0,
        height=0.15,
    ),
    "g1": Walker(
        "g1_walk",
        {
            "base_ang_vel": 0.2,
            "projected_gravity": 0.05,
            "base_quat": 0.025,
            "joint_pos": 0.01,
            "joint_vel": 1.5,
        },
        push=0.5,
        tracking=1.0,
        height=0.4,
    ),
}


@dataclass
class Walked:
    """What a soak found.

    Attributes:
        ticks: that were walked.
        simulated_s: the same in [s].
        wall_s: in [s].
        falls: robots that truly fell; each begins anew.
        trips: faults of a robot that had not fallen, with the seed.
        blocks: that looked on.
    """

    ticks: int = 0
    simulated_s: float = 0.0
    wall_s: float = 0.0
    falls: int = 0
    trips: list[str] = field(default_factory=list)
    blocks: list[str] = field(default_factory=list)


def soak(name: str, seconds: float, *, seed: int = 0, piece: float = PIECE) -> Walked:
    """Walk for a simulated time at full speed.

    Args:
        name: of a walker.
        seconds: of simulated time.
        seed: of the first piece; each piece and each robot after a fall has the next.
        piece: longest time of one program in [s].
    """
    walker, found = WALKERS[name], Walked()
    began = time.monotonic()
    while found.simulated_s < seconds - 0.01 and len(found.trips) < MOST:
        program = _program(walker, seed)
        left = min(piece, seconds - found.simulated_s)
        report = Runner(program, RunOptions(duration=left, speed="max", warn=_quiet)).run()
        found.ticks += report.ticks + bool(report.faults)
        found.simulated_s = round(found.ticks * program.period, 6)
        found.blocks = list(report.safety)
        if report.faults:
            if _fallen(program, walker):
                found.falls += 1
            else:
                found.trips.append(f"seed {seed}, tick {report.ticks}: {report.faults[0]}")
        seed += 1
    found.wall_s = round(time.monotonic() - began, 1)
    return found


def _program(walker: Walker, seed: int) -> Program:
    rng = np.random.default_rng(seed)
    ranges = _ranges(walker)
    times = np.arange(1.0, PIECE, CHANGE)
    rows = rng.uniform(*ranges.T, (len(times), 3))
    rows[rng.random(len(rows)) < 0.1] = 0.0  # and stands
    schedule = np.column_stack([times, rows]).round(4).tolist()
    return load_workflow(
        walker.workflow,
        {
            "flow": {"policy": "walk"},
            "scene.initial_pose": "policy:walk",
            "scene.seed": seed,
            "scene.noise": {state: half * UNIFORM for state, half in walker.noise.items()},
            "scene.push": {"every": 5.0, "velocity": walker.push},
            "commands": [{"velocity_command": {"schedule": schedule}}],
            "safety": [*STRICT, {"tracking_stop": {"bound": walker.tracking}}],
        },
    )


def _ranges(walker: Walker) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return lowest and highest command of the policy, shape (3, 2)."""
    program = load_workflow(walker.workflow)
    try:
        return np.array([[each.low, each.high] for each in program.command_bounds])
    finally:
        program.close()


def _fallen(program: Program, walker: Walker) -> bool:
    """Whether the base lies or leans, by its quaternion, which is not what `tilt_stop` reads."""
    states = program.states
    _, x, y, _ = states["base_quat"].tolist()
    upright = 1.0 - 2.0 * (x * x + y * y)
    return upright < math.cos(LEAN) or float(states["base_pos_w"][2]) < walker.height


def _quiet(_: str) -> None:
    pass


def missing() -> set[str]:
    """Return safety blocks that a soak does not have, for authors of new ones."""
    there = {each if isinstance(each, str) else next(iter(each)) for each in STRICT}
    known = {name for name, place in BUILTIN.items() if ".safety." in place}
    predicates = {"commanded", "elapsed", "settled", "tilted"}  # beside the stops, which use them
    return known - there - predicates - {"tracking_stop", "observation_range"}


if __name__ == "__main__":
    os.environ.setdefault("UNICON_FAULTS", "off")
    walked = soak(sys.argv[1], float(sys.argv[2]), seed=int((sys.argv[3:] or ["0"])[0]))
    print(json.dumps(asdict(walked), indent=2))
    if len(sys.argv) > 4:
        Path(sys.argv[4]).write_text(json.dumps(asdict(walked)) + "\n")
    sys.exit(bool(walked.trips))

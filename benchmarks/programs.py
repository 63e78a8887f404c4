"""`unicon bench batch`: cost of a tick per robot, many robots in one graph beside one robot.

Without physics (the `fake` platform) it is the tick that is measured; with them, in MuJoCo, several
robots are simulated at once, as many as there are cores. Where MJX is installed, it steps all of
them in one compiled call.
"""

from __future__ import annotations

import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.samples import Samples, random_policy, timed
from unicon_core.platforms.mujoco.batch import shares
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow
from unicon_ros.bench.report import Bench

BATCH_TICKS = 200
PHYSICS_TICKS = 100

SIZES = (1, 4, 16, 64, 256)
PHYSICS_SIZES = (1, 4, 16, 64)
MJX_TICKS = 20
MJX_SIZES = (1, 16, 64)

BATCH_BARS = (
    ("batch64", "per robot", 0.35),
    ("batch64_physics", "with physics, per robot", 0.6),
    ("batch64_mjx", "in MJX, per robot", 0.6),
)

_WORKFLOW = """\
robot: go2
platform: fake
num_robots: 1
policies: {walk: POLICY}
commands:
  - velocity_command: {constant: [0.5, 0.0, 0.0]}
flow: {policy: walk}
safety: [finite, joint_limits]
"""

# In place of the above; our own policy walks, where a random one would fall.
_PHYSICS: dict[str, Any] = {
    "platform": "mujoco",
    "scene": {"initial_pose": "policy:walk"},
    "policies": {"walk": "go2_velocity"},
}


def run_batch(rounds: int | None = None) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds, 5 unless told.
    """
    bench = Bench("batch", rounds or 5)
    kinds: list[tuple[str, tuple[int, ...], int, dict[str, Any]]] = [
        ("per robot", SIZES, BATCH_TICKS, {}),
        ("with physics, per robot", PHYSICS_SIZES, PHYSICS_TICKS, _PHYSICS),
    ]
    if find_spec("mujoco.mjx") and find_spec("jax"):
        kinds.append(("in MJX, per robot", MJX_SIZES, MJX_TICKS, _PHYSICS | {"platform": "mjx"}))
    else:
        bench.facts["MJX"] = "left out: pip install 'unicon_ros[sim-mjx]'"
    times = Samples()
    with tempfile.TemporaryDirectory() as folder:
        random_policy(Path(folder) / "policy", load_robot("go2"))
        path = Path(folder) / "batch.yaml"
        path.write_text(_WORKFLOW.replace("POLICY", "./policy"), encoding="utf-8")
        runners: dict[str, tuple[Runner, int, int]] = {}
        for kind, sizes, ticks, changed in kinds:
            for size in sizes:
                program = load_workflow(path, changed | {"num_robots": size})
                runner = Runner(program, RunOptions(speed="max"))
                runners[f"{kind}, N = {size}"] = runner, size, ticks
        for _ in range(bench.rounds):
            for name, (runner, size, ticks) in runners.items():
                took = [timed(runner.tick, time.perf_counter_ns()) for _ in range(ticks)]
                times.add(name, np.array(took) / size)
        for runner, _, _ in runners.values():
            runner.close()
    times.add_to(
        bench, *((name, f"{kind}, N = 64", f"{kind}, N = 1", bar) for name, kind, bar in BATCH_BARS)
    )
    bench.facts["threads"] = len(shares(64))
    return bench

"""`unicon bench sweep`: a rollout of a sweep beside physics and network alone, on the same cores.

A Go2 walks for 10 s with our policy, under pushes, with motors and payloads that differ in every
row. All sides have one process for each core (two at most), and take turns; a rollout of the sweep
has everything in it: scene and program begun anew, safety, figures, the row written down. Engine
`batch` runs the rows that engine `local` has just run, which have to be the same.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.samples import Samples
from unicon_core.resources import same_modules
from unicon_core.signals import SIGNALS
from unicon_ros.bench.report import Bench
from unicon_ros.ending import die_with_parent

ROLLOUTS = 2000
"""In all rounds together, of each side."""
ROUNDS = 20
SECONDS = 10.0
RATE = 50.0
MOST_CORES = 2
BAR = 1.18
BATCH_BAR = 1.0
SIDES = {"local": "sweep", "batch": "batch"}
"""Engine to the name of its case."""

_WORKFLOW = """\
robot: go2
platform: mujoco
scene: {initial_pose: "policy:walk"}
policies: {walk: go2_velocity}
commands: [{velocity_command: {constant: [0.5, 0.0, 0.0]}}]
flow: {policy: walk}
safety: [finite, joint_limits, tilt_stop]
duration: 10
"""
_SWEEP = """\
schema: unicon.sweep/1
workflow: ./walk.yaml
set: {scene.push.every: 2.0}
vary:
  scene.seed: {range: [0, 99999]}
  scene.push.velocity: {uniform: [0.05, 0.2]}
  scene.payload.mass: {uniform: [0, 1]}
  scene.joints."*".strength: {uniform: [0.9, 1.1]}
sample: random
early_stop: fall
rollouts: ROLLOUTS
"""


def run(rounds: int | None = None, rollouts: int = ROLLOUTS) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds, 20 unless told.
        rollouts: of each side in all rounds together.
    """
    from unicon_ros.sweep.engines import Wish, engine_of
    from unicon_ros.sweep.folder import Folder, require_pyarrow
    from unicon_ros.sweep.local import LocalEngine
    from unicon_ros.sweep.plan import Plan
    from unicon_ros.sweep.results import Results
    from unicon_ros.sweep.sweep_file import read_sweep

    require_pyarrow()
    bench = Bench("sweep", rounds or ROUNDS)
    cores = min(len(os.sched_getaffinity(0)), MOST_CORES)
    each = max(rollouts // bench.rounds // cores, 1) * cores
    times, ways = Samples(), []
    with tempfile.TemporaryDirectory() as name, SIGNALS.guard():
        folder = Path(name)
        (folder / "walk.yaml").write_text(_WORKFLOW, encoding="utf-8")
        count = each * (bench.rounds + 1)
        text = _SWEEP.replace("ROLLOUTS", str(count))
        (folder / "sweep.yaml").write_text(text, encoding="utf-8")
        plan = Plan(read_sweep(folder / "sweep.yaml"))
        sides: list[tuple[str, Folder, LocalEngine]] = []
        for engine in SIDES:
            out = Folder(folder / engine, plan, "")
            made = engine_of(plan, Wish(engine, cores), len(plan), out.path)
            assert isinstance(made, LocalEngine)
            sides.append((SIDES[engine], out, made))
        floor = [_Bare(folder / "walk.yaml") for _ in range(cores)]
        rows = iter(plan)
        try:
            for number in range(bench.rounds + 1):
                SIGNALS.check()
                todo = [next(rows) for _ in range(each)]
                spent: dict[str, tuple[float, float]] = {}
                for side, out, made in sides:
                    begin, before = time.perf_counter(), _cpu(made.pids)
                    for result in made.run(todo):
                        out.know(result.facts)
                        out.add(result.index, result.figures)
                    SIGNALS.check()
                    spent[side] = time.perf_counter() - begin, _cpu(made.pids) - before
                begin = time.perf_counter()
                for process in floor:
                    process.ask(each // cores)
                answers = [process.answer() for process in floor]
                spent["bare"] = time.perf_counter() - begin, sum(cpu for cpu, _ in answers)
                ways.append(answers[0][1])
                if number:  # the first one builds and warms up
                    per = 1e6 / each
                    for side, (wall, cpu) in spent.items():
                        times.add(side, wall * cores * per)
                        times.add(f"{side}, CPU", cpu * per)
            for _, out, _ in sides:
                out.flush()
            results, others = (Results(out.path) for _, out, _ in sides)
        finally:
            for process in floor:
                process.close()
            for _, out, made in sides:
                made.close()
                out.close()
        distances = [value for value in results.column("distance_m") if value is not None]
        bench.facts = {
            "rollouts of each side": each * bench.rounds,
            "processes": cores,
            "fell": sum(bool(value) for value in results.column("fell")),
            "no result": results.failed,
            "the same rows": results.sha256 == others.sha256,
            "way, sweep [m]": f"{sum(distances) / len(distances):.2f}",
            "way, bare [m]": f"{ways[-1]:.2f}",
        }
    times.add_to(bench)
    bench.ratio("cost", times.ratio("sweep", "bare"), BAR)
    bench.ratio("cost_cpu", times.ratio("sweep, CPU", "bare, CPU"), BAR)
    bench.ratio("batch_cpu", times.ratio("batch, CPU", "sweep, CPU"), BATCH_BAR)
    return bench


class _Bare:
    """One process of the floor.

    Args:
        workflow: file.
    """

    def __init__(self, workflow: Path) -> None:
        ticks = str(round(SECONDS * RATE))
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.bare_rollouts", str(workflow), ticks],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=same_modules() | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            start_new_session=True,  # as a worker: Linux gives each session its share of the CPU
            preexec_fn=die_with_parent if sys.platform == "linux" else None,
        )

    def ask(self, rollouts: int) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{rollouts}\n")
        self._process.stdin.flush()

    def answer(self) -> tuple[float, float]:
        """Return seconds of CPU, and the way in [m] of the last rollout."""
        assert self._process.stdout is not None
        cpu, way = map(float, self._process.stdout.readline().split())
        return cpu, way

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


def _cpu(pids: list[int]) -> float:
    """Return seconds of CPU that some processes and this one have spent so far."""
    ticks = os.sysconf("SC_CLK_TCK")
    spent = 0.0
    for pid in pids:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        spent += (int(fields[11]) + int(fields[12])) / ticks
    own = resource.getrusage(resource.RUSAGE_SELF)
    return spent + own.ru_utime + own.ru_stime

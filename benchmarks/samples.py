"""Samples of what a benchmark compares, in interleaved rounds, and random networks to run.

Steps take turns, loops are paced; networks and contracts have a given size and random weights.
"""

from __future__ import annotations

import json
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from unicon_base import AnyDict, imported
from unicon_base.arrays import Float64
from unicon_base.located_yaml import read_yaml
from unicon_core.policies import PolicyContract, load_policy
from unicon_core.robots import Robot
from unicon_core.runtime import TickStatistics
from unicon_ros.bench.report import Bench

Step = Callable[[], object]
BARS: AnyDict = read_yaml(Path(__file__).with_name("bars.yaml")).value
TICK, WHOLE = "recv to send", "whole tick"


def timed(step: Callable[..., object], *arguments: object) -> float:
    """Return the time of a call in [µs]."""
    begin = time.perf_counter_ns()
    step(*arguments)
    return (time.perf_counter_ns() - begin) * 1e-3


class Samples:
    """Samples of each case, by rounds."""

    def __init__(self) -> None:
        self._rounds: defaultdict[str, list[Float64]] = defaultdict(list)

    def add(self, name: str, samples: ArrayLike) -> None:
        """Add one round of a case."""
        self._rounds[name].append(np.atleast_1d(np.asarray(samples, np.float64)))

    def take(self, cases: Mapping[str, Step], samples: int, calls: int) -> None:
        """Time one round of steps that take turns, in [µs]; so many calls make a sample."""
        now, repeats = time.perf_counter_ns, range(calls)
        times = {name: np.zeros(samples) for name in cases}
        for i in range(samples):
            for name, step in cases.items():
                begin = now()
                for _ in repeats:
                    step()
                times[name][i] = (now() - begin) * 1e-3 / calls
        for name, values in times.items():
            self.add(name, values)

    def add_to(self, bench: Bench) -> None:
        """Add all cases to a benchmark, and the ratios of its `BARS` whose cases were measured."""
        for name in self.names:
            bench.case(name, self.of(name))
        for name, case, base, bar, *percent in BARS.get(bench.name, ()):
            if {case, base} <= self._rounds.keys():
                bench.ratio(name, self.ratio(case, base, *percent), bar)

    @property
    def names(self) -> list[str]:
        """The cases, in the order in which they came."""
        return list(self._rounds)

    def of(self, name: str) -> Float64:
        """Return all samples of a case."""
        return np.concatenate(self._rounds[name])

    def ratio(self, one: str, other: str, percent: float = 50.0) -> float:
        """Return the median over the rounds of the ratio of two cases' percentiles."""
        return float(np.median(self.ratios(one, other, percent)))

    def ratios(self, one: str, other: str, percent: float = 50.0) -> Float64:
        """Return the ratio of two cases' percentiles in each round, shape (rounds,)."""
        above, below = (
            np.array([np.percentile(samples, percent) for samples in self._rounds[name]])
            for name in (one, other)
        )
        found: Float64 = above / below
        return found


@dataclass(frozen=True)
class Paced:
    """What was measured of a loop.

    Attributes:
        late: start minus deadline of each tick in [µs].
        took: time of the work of each tick in [µs].
        share: of a core, in [%].
    """

    late: Float64
    took: Float64
    share: float


def paced(
    ticks: int, rate: float, wait: Callable[[int], object], work: Step = lambda: None
) -> Paced:
    """Run a loop with absolute deadlines.

    Args:
        rate: ticks per second in [Hz].
        wait: returns at a time of `time.perf_counter_ns`.
        work: what a tick does.
    """
    period = round(1e9 / rate)
    late, took = np.zeros((2, ticks))
    now = time.perf_counter_ns
    cpu, begin = time.process_time_ns(), now()
    due = begin + period
    for i in range(ticks):
        wait(due)
        woken = now()
        work()
        took[i] = now() - woken
        late[i] = woken - due
        due += period
    share = (time.process_time_ns() - cpu) / (now() - begin)
    return Paced(late * 1e-3, took * 1e-3, share * 100.0)


def tick_times(statistics: TickStatistics, first: int) -> dict[str, Float64]:
    """Return from recv to the end of send, and all of each tick that a run has kept, in [µs].

    Args:
        statistics: of the run.
        first: ticks at the beginning that are left out.
    """
    rows = statistics.kept()[first:]
    whole = np.asarray((rows[:, 1] - rows[:, 2]) * 1e-3, np.float64)
    return {TICK: statistics.durations_us()[first:], WHOLE: whole}


def unsaid(line: str) -> None:
    """Take what a run would tell."""


def sleep_until(due: int) -> None:
    """Sleep until a time of `time.perf_counter_ns`, as plain loops do."""
    remaining = due - time.perf_counter_ns()
    if remaining > 0:
        time.sleep(remaining * 1e-9)


HIDDEN = (512, 256, 128)  # sizes of the hidden layers

CLIP = 100.0
"""legged_gym's bound of an observation."""


def random_policy(
    folder: Path,
    robot: Robot,
    history: int = 1,
    recurrent: bool = False,
    hidden: Sequence[int] = HIDDEN,
    chunk: int = 1,
) -> PolicyContract:
    """Write and load a multilayer perceptron with ELU layers and a dynamic batch axis.

    Args:
        folder: where its two files go.
        robot: its joints are the policy's, in their order.
        history: frames of every term.
        recurrent: whether the last hidden layer adds a product with what it was a tick before.
        hidden: sizes of the hidden layers.
        chunk: rows of an answer.

    Raises:
        MissingDependencyError: the package onnx, which writes the file, is absent.
    """
    onnx = imported("onnx", "unicon bench")
    from onnx import numpy_helper, parser

    n = robot.num_joints
    sizes = [(9 + 3 * n) * history, *hidden, n * chunk]
    random, arrays, steps, last = np.random.default_rng(0), {}, list[str](), "obs"
    for i, (rows, columns) in enumerate(pairwise(sizes)):
        arrays[f"w{i}"] = random.normal(0.0, 0.5 / np.sqrt(rows), (rows, columns))
        arrays[f"b{i}"] = np.zeros(columns)
        out = f"h{i}" if i < len(hidden) or chunk > 1 else "actions"
        steps.append(f"{out} = Gemm ({last}, w{i}, b{i})")
        if recurrent and i == len(hidden) - 1:
            # Random as well, and it shrinks what it is multiplied with.
            square = 0.5 / np.sqrt(columns), (columns, columns)
            arrays["u"] = np.random.default_rng(1).normal(0.0, *square)
            steps += ["before = MatMul (h_in, u)", f"sum = Add ({out}, before)"]
            out = "sum"
        if i < len(hidden):
            last = f"e{i}"
            steps.append(f"{last} = Elu ({out})")
    given, told = f"float[batch,{sizes[0]}] obs", f"float[batch,{n}] actions"
    if chunk > 1:
        shape = f"shape = Constant <value_ints = [1, {chunk}, {n}]> ()"
        steps += [shape, f"actions = Reshape (h{len(hidden)}, shape)"]
        told = f"float[1,{chunk},{n}] actions"
    if recurrent:
        steps.append(f"h_out = Identity ({last})")
        given += f", float[1,{hidden[-1]}] h_in"
        told += f", float[1,{hidden[-1]}] h_out"
    head = '<ir_version: 8, opset_import: ["": 17]>'
    network = parser.parse_model("\n".join([f"{head} mlp ({given}) => ({told}) {{", *steps, "}"]))
    network.graph.initializer.extend(
        numpy_helper.from_array(array.astype(np.float32), name) for name, array in arrays.items()
    )
    folder.mkdir(parents=True, exist_ok=True)
    onnx.save(network, folder / "policy.onnx")
    contract: AnyDict = read_yaml(Path(__file__).with_name("policy.yaml")).value
    for term in contract["observation"]["terms"]:
        term |= {"clip": [-CLIP, CLIP], "history": history}
    if recurrent:
        contract["recurrent"] = [{"input": "h_in", "output": "h_out"}]
    contract |= {
        "joints": list(robot.joint_names),
        "default_joint_pos": robot.default_joint_pos.tolist(),
        "stiffness": [30.0] * n,
        "damping": [1.0] * n,
    }
    (folder / "policy.yaml").write_text(json.dumps(contract), "utf-8")
    return load_policy(folder, robot=robot)

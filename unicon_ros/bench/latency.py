"""`unicon bench latency`: our controllers beside plain ROS 2 pipelines, over real DDS.

Every variant is real processes on this host: a robot with states at 500 Hz and a controller with
identity control (q_d = q) at 50 Hz, as in the UniCon paper's table of latencies. The controller's
rate is off by a third of a percent, so that the phase between states and commands sweeps through
all its values: locked, it alone would decide the result. Variants are interleaved in rounds.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_ros import compat
from unicon_ros.bench.domains import free_domain
from unicon_ros.bench.floor import c_level_floor
from unicon_ros.bench.report import Bench

__all__ = ["VARIANTS", "Variant", "run"]

PIPELINES = "unicon_ros.bench.pipelines"
PHASE_DRIFT = 1.0033
SECONDS = 3.0
PATIENCE = 20.0  # s until a robot or observer must have ended

Samples = dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Variant:
    """One way to close the loop.

    Attributes:
        name: row of the table.
        measuring: pipeline and its variant that ends by itself: the robot, or an observer.
        controller: pipeline and its variant, or None where one process is both.
        best_effort: QoS of all topics.
        about: what it is, for the documentation.
    """

    name: str
    measuring: tuple[str, str]
    controller: tuple[str, str] | None
    best_effort: bool = False
    about: str = ""


VARIANTS = (
    Variant("plain, two processes", ("plain", "robot"), ("plain", "controller")),
    Variant("plain, one process", ("plain", "both"), None),
    Variant("plain, fast robot", ("fast_robot", ""), ("plain", "controller")),
    Variant("plain, EventsExecutor", ("fast_robot", ""), ("plain", "events")),
    Variant("plain, triggered by state", ("fast_robot", ""), ("plain", "triggered")),
    Variant("thread per bridge", ("fast_robot", ""), ("threads", "")),
    Variant("unicon, free tick", ("fast_robot", ""), ("unicon_bridged", "deadline")),
    Variant("unicon, on state", ("fast_robot", ""), ("unicon_bridged", "state")),
    Variant("unicon, on state, best effort", ("fast_robot", ""), ("unicon_bridged", "state"), True),
    Variant("unicon, local, ROS a mirror", ("observer", ""), ("unicon_local", "")),
)

RATIOS = (
    # name, row, its variant, row of the baseline, its variant, bar
    ("end_to_end", "end_to_end", "unicon, on state", "end_to_end", "plain, two processes", 0.25),
    (
        "end_to_end_best_effort",
        "end_to_end",
        "unicon, on state, best effort",
        "end_to_end",
        "plain, two processes",
        0.2,
    ),
    (
        "end_to_end_triggered",
        "end_to_end",
        "unicon, on state",
        "end_to_end",
        "plain, triggered by state",
        0.7,
    ),
    (
        "local",
        "state_to_command",
        "unicon, local, ROS a mirror",
        "state_to_command",
        "plain, two processes",
        0.01,
    ),
    ("mirror", "mirror", "unicon, local, ROS a mirror", "recv", "plain, two processes", 0.7),
    ("cpu", "cpu", "unicon, on state", "cpu", "plain, two processes", 0.3),
)


@dataclass
class _Options:
    rate: float
    state_rate: float
    joints: int
    seconds: float
    folder: Path
    environment: dict[str, str] = field(default_factory=dict)


def run(
    rounds: int | None = None,
    *,
    rate: float = 50.0,
    state_rate: float = 500.0,
    joints: int = 20,
    seconds: float = SECONDS,
    only: Callable[[Variant], bool] | None = None,
) -> Bench:
    """Run the comparison; Ctrl-C ends it with the rounds that are whole.

    Args:
        rounds: interleaved rounds, 3 unless told.
        rate: commands per second.
        state_rate: states per second.
        joints: number of joints.
        seconds: measured time of one variant in one round in [s].
        only: which variants to run; all if None.

    Raises:
        MissingDependencyError: rclpy is not installed.
    """
    compat.import_rclpy("unicon bench latency")
    rounds = rounds or 3
    variants = [variant for variant in VARIANTS if only is None or only(variant)]
    results: list[dict[str, Samples]] = []
    with tempfile.TemporaryDirectory() as folder:
        options = _Options(rate, state_rate, joints, seconds, Path(folder), _environment())
        try:
            for number in range(rounds):
                label = f"round {number + 1} of {rounds}"
                results.append(_round(variants, options, label))
        except KeyboardInterrupt:
            _say(f"stopped; {len(results)} whole rounds are kept\n")
    bench = _bench(results, options)
    floor = c_level_floor(free_domain(), state_rate) if results else None
    if floor is not None:
        bench.fact("one hop of DDS in C (ddsperf, 512 B)", floor)
    return bench


def _round(variants: list[Variant], options: _Options, label: str) -> dict[str, Samples]:
    samples = {}
    for i, variant in enumerate(variants):
        _say(f"\r{label}: {i + 1} of {len(variants)}, {variant.name}\x1b[K")
        # A second try: discovery on a busy machine may outlast the patience once.
        samples[variant.name] = _measure(variant, options) or _measure(variant, options) or {}
    _say("\r\x1b[K")
    return samples


def _measure(variant: Variant, options: _Options) -> Samples | None:
    """Run one variant once; None where it did not come to an end."""
    options.environment["ROS_DOMAIN_ID"] = str(free_domain())
    measured = options.folder / "measured.npz"
    controlled = options.folder / "measured_controller.npz"
    for path in (measured, controlled):
        path.unlink(missing_ok=True)
    with _process(variant.controller, controlled, variant, options) as controller:
        with _process(variant.measuring, measured, variant, options) as measuring:
            assert measuring is not None
            try:
                measuring.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                return None
        if controller is not None:
            controller.send_signal(signal.SIGTERM)
            controller.wait(PATIENCE)
    if not measured.exists() or not controlled.exists():
        return None
    return _samples(variant, dict(np.load(measured)), dict(np.load(controlled)), options)


def _samples(
    variant: Variant, measured: dict[str, Any], controlled: dict[str, Any], options: _Options
) -> Samples:
    """Return the rows of one variant in [µs]; the first half second, discovery, is left out."""
    if not measured["received"].size:
        return {}
    start = int(measured["received"][0]) + 500_000_000
    kept = measured["received"] >= start
    latency = (measured["received"] - measured["stamp"])[kept] * 1e-3
    share = np.array([float(controlled["cpu_share"]) * 100.0])
    if variant.measuring[0] == "observer":
        # Its controller's stamps are of the driver's clock, not of the wall.
        settled = np.arange(controlled["end"].size) > options.rate  # a second
        inside = (controlled["end"] - controlled["stamp"])[settled] * 1e-3
        return {"mirror": latency, "state_to_command": inside, "cpu": share}
    # What was sent when the robot had ended already is nobody's loss.
    ticks = (controlled["end"] >= start) & (controlled["end"] <= measured["received"][-1])
    part = {name: controlled[name][ticks] for name in ("stamp", "seen", "begin", "end")}
    expected = max(len(part["stamp"]), 1)
    lost = max(expected - len(latency), 0)
    stale = int((np.diff(part["stamp"]) == 0).sum())
    return {
        "recv": (part["seen"] - part["stamp"]) * 1e-3,
        "send": (part["end"] - part["begin"]) * 1e-3,
        "state_to_command": (part["end"] - part["stamp"]) * 1e-3,
        "end_to_end": latency,
        "cpu": share,
        "lost": np.array([100.0 * lost / expected]),
        "stale": np.array([100.0 * stale / expected]),
    }


UNITS = {"cpu": " [% of a core]", "lost": " [%]", "stale": " [%]"}


def _bench(results: list[dict[str, Samples]], options: _Options) -> Bench:
    bench = Bench("latency", seed=0, rounds=len(results))
    bench.facts.update(
        rate_hz=options.rate * PHASE_DRIFT,
        state_rate_hz=options.state_rate,
        joints=options.joints,
        seconds=options.seconds,
        qos="reliable, keep last 1, unless the row says best effort",
        rmw=os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp"),
        rows="Recv: state made → in the controller's hands; Send: publishing the command; "
        "end_to_end: state made → its command at the robot",
    )
    if not results:
        return bench
    for variant in VARIANTS:
        for row in results[0].get(variant.name, {}):
            parts = [r[variant.name][row] for r in results if row in r.get(variant.name, {})]
            bench.case(f"{variant.name}: {row}{UNITS.get(row, '')}", np.concatenate(parts))
    for name, row, ours, base_row, base, bar in RATIOS:
        pairs = [
            (r[ours][row], r[base][base_row])
            for r in results
            if row in r.get(ours, {}) and base_row in r.get(base, {})
        ]
        if pairs:
            value = float(np.median([np.median(a) / np.median(b) for a, b in pairs]))
            bench.ratio(name, value, bar)
            low, high = _interval(pairs)
            bench.fact(f"{name}, 95 % interval", f"{low:.3g} to {high:.3g}")
    return bench


def _interval(pairs: list[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of the ratio of medians, rounds resampled within."""
    generator = np.random.default_rng(0)

    def median(values: NDArray[np.float64]) -> float:
        return float(np.median(generator.choice(values, len(values))))

    draws = [
        float(np.median([median(ours) / median(base) for ours, base in pairs])) for _ in range(500)
    ]
    low, high = np.percentile(draws, [2.5, 97.5])
    return float(low), float(high)


def _environment() -> dict[str, str]:
    """Return the environment of the pipelines: loopback only, without the wheels' leftovers."""
    values = dict(os.environ)
    if values.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None) is not None:
        values.pop("LD_LIBRARY_PATH", None)
    values["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    return values


@contextmanager
def _process(
    pipeline: tuple[str, str] | None, out: Path, variant: Variant, options: _Options
) -> Iterator[subprocess.Popen[bytes] | None]:
    if pipeline is None:
        yield None
        return
    module, kind = pipeline
    command = [sys.executable, "-m", f"{PIPELINES}.{module}", "--variant", kind]
    command += ["--rate", f"{options.rate * PHASE_DRIFT}", "--state-rate", f"{options.state_rate}"]
    command += ["--joints", f"{options.joints}", "--seconds", f"{options.seconds}"]
    command += ["--out", str(out)] + (["--best-effort"] if variant.best_effort else [])
    process = subprocess.Popen(
        command, env=options.environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
            deadline = time.monotonic() + 5.0
            while process.poll() is None and time.monotonic() < deadline:
                time.sleep(0.05)
            process.kill()
        process.wait()


def _say(text: str) -> None:
    print(text, end="", file=sys.stderr, flush=True)

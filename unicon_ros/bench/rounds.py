"""Rounds: loops that take turns, the ratios of what they gave, and what stands beside them.

Beside them stand the paper's table of latencies, and one hop of DDS in C.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from unicon_base import AnyDict
from unicon_base.arrays import Float64
from unicon_base.located_yaml import read_yaml
from unicon_core.signals import SIGNALS, Interrupted
from unicon_ros.bench.loops import Loop, breathe
from unicon_ros.bench.report import Bench
from unicon_ros.cli.console import CLEAR, is_terminal

SEED = 0

TABLES: AnyDict = read_yaml(Path(__file__).with_name("latency.yaml")).value

Rows = dict[str, Float64]
"""What one variant gave in one round: row to samples."""

Claim = tuple[str, str, str, str, str, float | None]
"""Name of a ratio, row, its variant, row of the baseline, its variant, and bar; None: a fact."""

UNITS = {"cpu": " [% of a core]", "lost": " [%]", "stale": " [%]"}
"""Units of rows that are not in µs."""


def take_turns(
    makers: Mapping[str, Callable[[], Loop]], rounds: int, seconds: float
) -> tuple[int, dict[str, Loop]]:
    """Let loops take their turns; Ctrl-C ends it with the rounds that are whole.

    Call it within `SIGNALS.guard()`.

    Args:
        makers: name of each loop to what makes it.
        rounds: how many turns each has.
        seconds: measured time of one turn.

    Returns:
        How many rounds are whole, and the loops, which have ended.

    Raises:
        UniconError: a loop does not start, or a process of it has ended.
    """
    loops: dict[str, Loop] = {}
    whole = 0
    try:
        for i, (name, make) in enumerate(makers.items()):
            SIGNALS.check()
            _say(f"start: {i + 1} of {len(makers)}, {name}")
            held = list(loops.values())
            loops[name] = loop = make()
            loop.start(meanwhile=partial(breathe, held))
            breathe(held)
        for number in range(rounds):
            label = f"round {number + 1} of {rounds}"
            if not is_terminal():
                _say(label)
            for i, (name, loop) in enumerate(loops.items()):
                SIGNALS.check()
                if is_terminal():
                    _say(f"{label}: {i + 1} of {len(makers)}, {name}")
                loop.run(seconds)
            whole += 1
    except Interrupted:
        _say(f"stopped; {whole} whole rounds are kept")
    finally:
        for loop in loops.values():
            loop.end()
        for loop in loops.values():
            loop.close()
        if is_terminal():
            _say("")
    return whole, loops


def _say(text: str) -> None:
    """Tell how far it is: in one line of a terminal, else a line each."""
    begin, end = (CLEAR, "") if is_terminal() else ("", "\n")
    print(f"{begin}{text}", end=end, file=sys.stderr, flush=True)


def rounds_of(whole: int, loops: Mapping[str, Loop]) -> list[dict[str, Rows]]:
    """Return what loops gave, variant to rows, of each whole round; after `take_turns`."""
    samples = {name: loop.samples() for name, loop in loops.items()}
    return [{name: each[i] for name, each in samples.items()} for i in range(whole)]


def interval(ratios: ArrayLike) -> str:
    """Return the 95 % bootstrap interval of the median over rounds."""
    draws = np.random.default_rng(SEED).choice(ratios, (1000, np.size(ratios)))
    return _between(np.median(draws, axis=1))


def _between(drawn: Float64 | list[float]) -> str:
    low, high = np.percentile(drawn, [2.5, 97.5])
    return f"{low:.3g} to {high:.3g}"


def add_rows(
    bench: Bench, results: list[dict[str, Rows]], name: str, rows: Sequence[str] = ()
) -> None:
    """Add the rows of a variant to a benchmark; those that are named, or all.

    Args:
        bench: is added to.
        results: of each whole round, variant to row to samples.
        name: of the variant.
        rows: that are told; all if empty.
    """
    found = [result[name] for result in results if name in result]
    for row in dict.fromkeys(row for each in found for row in each):
        if not rows or row in rows:
            parts = [each[row] for each in found if row in each]
            bench.case(f"{name}: {row}{UNITS.get(row, '')}", np.concatenate(parts))


def add_ratios(bench: Bench, results: list[dict[str, Rows]], claims: Iterable[Claim]) -> None:
    """Add ratios, each the median over the rounds that have both sides, with its interval.

    They are of means: latencies of an executor have several humps, between which a median jumps.
    """
    for name, row, ours, base_row, base, bar in claims:
        found = [
            np.mean(r[ours][row]) / np.mean(r[base][base_row])
            for r in results
            if row in r.get(ours, {}) and base_row in r.get(base, {})
        ]
        if not found:
            continue
        value, between = float(np.median(found)), interval(found)
        if bar is None:
            bench.facts[name] = f"{value:.3g} ({between})"
        else:
            bench.ratio(name, value, bar)
            bench.facts[f"{name}, 95 % interval"] = between


Pooled = tuple[str, str, str, str, float | None, float]
"""Name of a ratio, row, our variant, the baseline's, percentile or None for the mean, and bar."""


def add_pooled_ratios(
    bench: Bench, results: list[dict[str, Rows]], claims: Iterable[Pooled]
) -> None:
    """Add ratios of a percentile of all samples, or of their mean, each with its interval.

    A round has too few commands for a tail. The 95 % interval is a bootstrap over whole rounds, of
    which each keeps both sides: what slows the machine in a round slows both.
    """
    rng = np.random.default_rng(SEED)
    for name, row, ours, base, percentile, bar in claims:
        pairs = [
            (r[ours][row], r[base][row])
            for r in results
            if row in r.get(ours, {}) and row in r.get(base, {})
        ]
        if not pairs:
            continue
        count = len(pairs)
        draws = rng.integers(count, size=(1000, count))
        drawn = [_ratio([pairs[i] for i in draw], percentile) for draw in draws]
        bench.ratio(name, _ratio(pairs, percentile), bar)
        bench.facts[f"{name}, 95 % interval"] = _between(drawn)


def _ratio(pairs: Sequence[tuple[Float64, Float64]], percentile: float | None) -> float:
    """Return the ratio of the two sides' percentile, or mean, over all rounds."""
    ours, base = (
        side.mean() if percentile is None else np.percentile(side, percentile)
        for side in map(np.concatenate, zip(*pairs))
    )
    return float(ours / base)


PAPER_ROWS = {"Recv": "recv", "Send": "send", "End-to-end": "state_to_command"}
"""The paper's row to ours."""


def beside_paper(bench: Bench, variants: Iterable[str]) -> None:
    """Add the paper's table, and the same rows of variants that were measured, as facts.

    Args:
        bench: with the cases of the variants, each `VARIANT: ROW`.
        variants: names; those without a command have no such rows and are left out.
    """
    bench.facts |= TABLES["paper"]
    for name in variants:
        if f"{name}: {PAPER_ROWS['End-to-end']}" in bench.cases:
            rows = [f"{word} {_told(bench, f'{name}: {row}')}" for word, row in PAPER_ROWS.items()]
            bench.facts[f"here, {name}"] = ", ".join(rows)


def _told(bench: Bench, name: str) -> str:
    case = bench.cases.get(name)
    if case is None:
        return "–"
    numbers = {key: f"{case[key]:.{0 if case[key] >= 20.0 else 1}f}" for key in case}
    return f"{numbers['mean']} ± {numbers['std']} ({numbers['p50']}, {numbers['p99']})"


_LOOPBACK = (
    '<CycloneDDS><Domain id="any"><General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto"
    '</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain>'
    "</CycloneDDS>"
)
_LINE = re.compile(r"size \d+ mean .* 50% ([\d.]+)us .* 99% ([\d.]+)us")


def c_level_floor(domain: int, rate: float = 500.0) -> str | None:
    """Return p50 and p99 of one hop in C as text, or None where `ddsperf` is not installed.

    ddsperf sends pings of 512 bytes and halves their way there and back; its last second is taken.

    Args:
        domain: DDS domain of its own.
        rate: pings per second.
    """
    if shutil.which("ddsperf") is None:
        return None
    environment = {**os.environ, "CYCLONEDDS_URI": _LOOPBACK}
    common = ["ddsperf", "-i", str(domain)]
    pong = subprocess.Popen(
        [*common, "-D", "6", "pong", "waitset"],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        ping = subprocess.run(
            [*common, "-D", "4", "ping", f"{rate:g}Hz", "size", "512", "waitset"],
            env=environment,
            capture_output=True,
            text=True,
            timeout=30,
        )
    finally:
        pong.terminate()
        pong.wait()
    found = _LINE.findall(ping.stdout)
    return f"p50 {found[-1][0]} µs, p99 {found[-1][1]} µs" if found else None

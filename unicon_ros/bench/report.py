"""Bench: what every `unicon bench` writes, as JSON for tools, as a table, and as a picture.

And ROS domains for benchmarks and tests: those nobody on this machine is in, to share no topic.
"""

from __future__ import annotations

import json
import math
import os
import platform
import random
import socket
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import metadata
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from unicon_base import AnyDict, UniconError
from unicon_core.drawing import as_png, require
from unicon_core.page import plain, write_file
from unicon_core.text_table import aligned

KEPT = 8
"""So many domains, the latest, stay ours though nobody is in them yet."""

_kept: dict[int, socket.socket] = {}

# Above 101 the ports would reach into Linux's ephemeral ones.
_DOMAINS = range(1, 102)


def free_domain() -> int:
    """Return a random domain whose first participant's port is free (RTPS 2.2, section 9.6.1)."""
    return free_domains(1)[0]


def free_domains(count: int) -> list[int]:
    """Return that many random domains, no two alike; taken ones where too few are free."""
    domains = random.SystemRandom().sample(_DOMAINS, len(_DOMAINS))
    free = list(islice(filter(_is_ours, domains), count))
    while len(_kept) > max(count, KEPT):
        _kept.pop(next(iter(_kept))).close()
    return [*free, *(domain for domain in domains if domain not in free)][:count]


def loopback_environment() -> dict[str, str]:
    """Return an environment for processes of ours: loopback only, a free domain of its own.

    What the ROS wheels leave in it for one interpreter only is not handed on.
    """
    values = dict(os.environ)
    if values.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None) is not None:
        values.pop("LD_LIBRARY_PATH", None)
    values["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    values["ROS_DOMAIN_ID"] = str(free_domain())
    return values


def stay_on_loopback() -> None:
    """Let this process's nodes stay on loopback, in a free domain, where nobody has chosen."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(free_domain()))


def _is_free(domain: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", 7400 + 250 * domain + 10))
        except OSError:
            return False
    return True


def _is_ours(domain: int) -> bool:
    """Return whether nobody is in a domain, nor has asked for it; from now on we have.

    A process takes seconds until it is in. Of two that asked at once and got the same, one would
    hear the other's emergency stop. The mark is a name that goes with the process, on Linux only.
    """
    if domain in _kept:
        return _is_free(domain)
    mark = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        mark.bind(f"\0unicon domain {domain}")
    except OSError:
        mark.close()
        return False
    if not _is_free(domain):
        mark.close()
        return False
    _kept[domain] = mark
    return True


PACKAGES = ("numpy", "mujoco", "onnxruntime", "rosbags", "rclpy", "pyzmq", "numba", "daqp", "mink")
"""Packages whose version may move a number."""


@dataclass
class Bench:
    """The cases and ratios of one benchmark run.

    Args:
        name: the benchmark's name on the command line.
        rounds: how many times the cases were run in turns.
        seed: seed of everything random in it.

    Attributes:
        cases: case to its statistics.
        ratios: name to value, bar, and whether it holds.
        facts: what is not a time or a claim, name to value.
    """

    name: str
    rounds: int
    seed: int = 0
    cases: dict[str, dict[str, float]] = field(default_factory=dict)
    ratios: dict[str, dict[str, float | bool | str]] = field(default_factory=dict)
    facts: AnyDict = field(default_factory=dict)

    def case(self, name: str, samples_us: ArrayLike) -> None:
        """Add the statistics of one case.

        Args:
            name: the case; with its unit in brackets where that is not µs.
            samples_us: one value for each repetition in [µs], any shape.

        Raises:
            ValueError: no samples, or a second case of that name.
        """
        samples = np.asarray(samples_us, np.float64).ravel()
        if not samples.size:
            raise ValueError(f"case {name!r} has no samples")
        if name in self.cases:
            raise ValueError(f"case {name!r} was added before")
        self.cases[name] = {
            "p50": float(np.percentile(samples, 50)),
            "p99": float(np.percentile(samples, 99)),
            **{key: float(getattr(samples, key)()) for key in ("mean", "std", "min", "max")},
            "samples": samples.size,
        }

    def ratio(self, name: str, value: float, bar: float, *, at_least: bool = False) -> bool:
        """Add a ratio and return whether it holds.

        Args:
            name: name of the ratio.
            value: what was measured in this run.
            bar: the claim: `value` at most this.
            at_least: the claim is `value` at least `bar`.
        """
        value = float(value)
        holds = math.isfinite(value) and (value >= bar if at_least else value <= bar)
        claim = "at least" if at_least else "at most"
        self.ratios[name] = {"value": value, "bar": float(bar), "holds": holds, "claim": claim}
        return holds

    @property
    def holds(self) -> bool:
        """True where every ratio holds."""
        return all(bool(ratio["holds"]) for ratio in self.ratios.values())

    def to_json(self) -> str:
        """Return everything as JSON; numbers that are not finite become null."""
        values = {
            "bench": self.name,
            "machine": {
                "cpu": _cpu(),
                "cores": _cores(),
                "system": f"{platform.system()} {platform.release()}",
                "load_1min": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
            },
            "versions": _package_versions(),
            "seed": self.seed,
            "rounds": self.rounds,
            "cases": self.cases,
            "ratios": self.ratios,
            "facts": self.facts,
        }
        return json.dumps(plain(values), indent=2, ensure_ascii=False)

    def table(self) -> str:
        """Return cases and ratios as aligned text."""
        lines = [f"bench {self.name}: {self.rounds} rounds, {machine()}"]
        rows = [("case [µs]", "p50", "p99", "mean ± std", "samples")]
        for name, case in self.cases.items():
            p50, p99, mean, std = (_number(case[key]) for key in ("p50", "p99", "mean", "std"))
            rows.append((name, p50, p99, f"{mean} ± {std}", str(case["samples"])))
        if self.cases:
            lines += ["", *aligned(rows, right=range(1, 5), underlined=False)]
        if self.facts:
            facts = [(name, str(value)) for name, value in self.facts.items()]
            lines += ["", *aligned(facts, underlined=False)]
        if self.ratios:
            rows_of_ratios = [("ratio", "value", "bar", "")]
            for name, ratio in self.ratios.items():
                sign = "≥" if ratio["claim"] == "at least" else "≤"
                verdict = "holds" if ratio["holds"] else "MISSED"
                bar = f"{sign} {_number(float(ratio['bar']))}"
                rows_of_ratios.append((name, _number(float(ratio["value"])), bar, verdict))
            lines += ["", *aligned(rows_of_ratios, right=range(1, 4), underlined=False)]
        return "\n".join(lines)


def machine() -> str:
    """Return CPU and cores in words."""
    return f"{_cpu()}, {_cores()} cores"


def _package_versions() -> dict[str, str]:
    """Return the versions of Python and of those PACKAGES that are installed."""
    versions = {"python": platform.python_version()}
    for package in PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            versions[package] = metadata.version(package)
    return versions


def _cpu() -> str:
    with suppress(OSError), open("/proc/cpuinfo", encoding="utf-8") as file:
        for line in file:
            if line.lower().startswith(("model name", "hardware")):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _number(value: float) -> str:
    if not math.isfinite(value):
        return str(value)
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def plot(bench: Bench, path: Path) -> None:
    """Write the picture.

    Dots stand where a value is; the length of a bar would say nothing on a logarithmic axis, which
    has no zero.

    Args:
        bench: what was measured; cases in other units than [µs] are left out.
        path: of the PNG.

    Raises:
        MissingDependencyError: matplotlib is not installed.
        UniconError: the benchmark's cases are not times, or the picture cannot be written.
    """
    require("--plot")
    from matplotlib.figure import Figure

    rows = {name: case for name, case in bench.cases.items() if "[" not in name}
    if not all("p50" in case for case in rows.values()):
        raise UniconError(f"bench {bench.name} measures no times to plot; leave --plot out")
    if bench.name == "latency":
        rows = {
            name: case for name, case in rows.items() if name.endswith(("end_to_end", "mirror"))
        }
    figure = Figure(figsize=(9.0, 0.42 * len(rows) + 1.2), layout="constrained")
    axes = figure.add_subplot()
    labels = list(rows)[::-1]
    p50 = [rows[label]["p50"] for label in labels]
    p99 = [rows[label]["p99"] for label in labels]
    colours = ["tab:blue" if "unicon" in label or "fused" in label else "0.65" for label in labels]
    axes.hlines(labels, p50, p99, color=colours, linewidth=1.5)
    axes.scatter(p50, labels, color=colours, zorder=3)
    axes.scatter(p99, labels, color=colours, marker="|", zorder=3)
    for place, value in enumerate(p50):
        look: AnyDict = {"textcoords": "offset points", "ha": "center", "fontsize": 7}
        axes.annotate(_number(value), (value, place), xytext=(0, 4), **look)
    label = "µs (dot: p50, end of the line: p99), log scale"
    axes.set(xscale="log", xlabel=label)
    axes.set_title(f"unicon bench {bench.name}, {bench.rounds} rounds")
    axes.grid(alpha=0.3)
    write_file(path, as_png(figure))

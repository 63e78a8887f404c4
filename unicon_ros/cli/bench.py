"""`unicon bench NAME`: side by side comparisons in one run; ratios, never absolute promises."""

from __future__ import annotations

import argparse
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import unicon_ros
from unicon_core.errors import UniconError
from unicon_core.page import write_file
from unicon_ros.cli.options import argument, command, flag

BENCHES = {
    "batch": "benchmarks.batch",
    "bridge": "benchmarks.bridge",
    "faults": "faults.bench_faults",
    "latency": "unicon_ros.bench.latency",
    "policy": "benchmarks.policy",
    "reach": "benchmarks.reach",
    "record": "benchmarks.record",
    "retarget": "benchmarks.retarget",
    "safety": "benchmarks.safety",
    "simulators": "benchmarks.simulators",
    "sloc": "benchmarks.sloc",
    "start": "benchmarks.start",
    "stores": "benchmarks.stores",
    "sweep": "benchmarks.sweep",
    "tick": "benchmarks.tick",
    "timing": "benchmarks.timing",
    "view": "benchmarks.view",
}
"""Bench to its module; all but `latency` are in a checkout only."""

CHECKOUT = Path(unicon_ros.__file__).resolve().parents[1]
"""Where this package lies; the benches that are not shipped lie beside it, in a checkout."""

_OPTIONS: dict[str, dict[str, dict[str, Any]]] = {
    "faults": {
        "quick": {"action": "store_true", "help": "a handful of cases only"},
        "only": {"help": "cases only whose group or name has this in it"},
        "ticks": {"type": int, "metavar": "N", "help": "random ticks of each fault, 5 unless told"},
        "document": {"help": "Markdown file whose rows of what was run are replaced"},
    },
    "latency": {
        "rate": {"type": float, "help": "commands per second"},
        "state_rate": {"type": float, "help": "states per second"},
        "joints": {"type": int, "help": "number of joints"},
        "seconds": {"type": float, "help": "measured time of a variant in a round"},
    },
    "record": {"seconds": {"type": float, "help": "time of a run, 10 s unless told"}},
    "sweep": {"rollouts": {"type": int, "metavar": "N", "help": "of each side, 2,000 unless told"}},
    "view": {
        "seconds": {"type": float, "help": "time of a run, 10 s unless told"},
        "sink": {"help": "word of --view, page unless told"},
    },
}
"""Bench to its own options: name to what `add_argument` takes."""


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(commands, "bench", bench, "compare side by side", __doc__)
    benches = parser.add_subparsers(dest="bench", metavar="NAME", required=True)
    for name in BENCHES:
        each = benches.add_parser(name, help=f"see {BENCHES[name]}")
        argument(each, "--rounds", "N", "interleaved rounds", type=int)
        argument(each, "--json", "FILE", "write the result as JSON")
        argument(each, "--plot", "FILE.png", "plot the cases (needs matplotlib)")
        flag(each, "--assert", "exit 1 where a ratio misses", dest="strict")
        for option, settings in _OPTIONS.get(name, {}).items():
            each.add_argument(f"--{option.replace('_', '-')}", **settings)


def bench(arguments: argparse.Namespace) -> int:
    """Run the command; exit status 0 when it ran, with `--assert` 1 where a ratio misses."""
    if arguments.rounds is not None and arguments.rounds < 1:
        raise UniconError(f"--rounds {arguments.rounds}: give a number >= 1")
    given = {name: getattr(arguments, name) for name in _OPTIONS.get(arguments.bench, {})}
    options = {name: value for name, value in given.items() if value is not None}
    result = _module(arguments.bench).run(rounds=arguments.rounds, **options)
    print(result.table())
    if arguments.json:
        write_file(Path(arguments.json), f"{result.to_json()}\n".encode())
    if arguments.plot:
        from unicon_ros.bench.report import plot

        plot(result, Path(arguments.plot))
    return 1 if arguments.strict and not result.holds else 0


def _module(name: str) -> ModuleType:
    """Return a bench's module.

    Raises:
        UniconError: the bench is not shipped and this is no checkout.
    """
    module = BENCHES[name]
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if (error.name or "") not in module:
            raise
    folders = [CHECKOUT, CHECKOUT / "test"]
    if not (CHECKOUT / "benchmarks" / "__init__.py").is_file():
        raise UniconError(
            f"bench {name}: only `latency` is part of the installed package; clone the repository, "
            "`pip install -e .` there, and run the bench in that environment"
        )
    sys.path += [str(folder) for folder in folders]
    return import_module(module)

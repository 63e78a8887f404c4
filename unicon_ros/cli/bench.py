"""`unicon bench NAME`: side by side comparisons in one run; ratios, never absolute promises."""

from __future__ import annotations

import argparse
from importlib import import_module
from pathlib import Path
from typing import Any

from unicon_core.errors import UniconError

BENCHES = {
    "batch": "unicon_ros.bench.batch",
    "bridge": "unicon_ros.bench.bridge",
    "faults": "unicon_ros.bench.faults.bench_faults",
    "latency": "unicon_ros.bench.latency",
    "policy": "unicon_ros.bench.policy",
    "reach": "unicon_ros.bench.reach",
    "record": "unicon_ros.bench.record",
    "retarget": "unicon_ros.bench.retarget",
    "safety": "unicon_ros.bench.safety",
    "simulators": "unicon_ros.bench.simulators",
    "sloc": "unicon_ros.bench.sloc",
    "start": "unicon_ros.bench.start",
    "stores": "unicon_ros.bench.stores",
    "sweep": "unicon_ros.bench.sweep",
    "tick": "unicon_ros.bench.tick",
    "timing": "unicon_ros.bench.timing",
    "view": "unicon_ros.bench.view",
}

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
    parser = commands.add_parser("bench", help="compare side by side", description=__doc__)
    parser.set_defaults(function=bench)
    benches = parser.add_subparsers(dest="bench", metavar="NAME", required=True)
    for name in BENCHES:
        each = benches.add_parser(name, help=f"see {BENCHES[name]}")
        each.add_argument("--rounds", type=int, metavar="N", help="interleaved rounds")
        each.add_argument("--json", metavar="FILE", help="write the result as JSON")
        each.add_argument("--plot", metavar="FILE.png", help="plot the cases (needs matplotlib)")
        each.add_argument(
            "--assert", action="store_true", dest="strict", help="exit 1 where a ratio misses"
        )
        for option, settings in _OPTIONS.get(name, {}).items():
            each.add_argument(f"--{option.replace('_', '-')}", **settings)


def bench(arguments: argparse.Namespace) -> int:
    """Run the command; exit status 0 when it ran, with `--assert` 1 where a ratio misses."""
    if arguments.rounds is not None and arguments.rounds < 1:
        raise UniconError(f"--rounds {arguments.rounds}: give a number >= 1")
    given = {name: getattr(arguments, name) for name in _OPTIONS.get(arguments.bench, {})}
    options = {name: value for name, value in given.items() if value is not None}
    result = import_module(BENCHES[arguments.bench]).run(rounds=arguments.rounds, **options)
    print(result.table())
    try:
        if arguments.json:
            Path(arguments.json).write_text(result.to_json() + "\n", encoding="utf-8")
        if arguments.plot:
            from unicon_ros.bench.plot import plot

            plot(result, Path(arguments.plot))
    except OSError as error:
        raise UniconError(f"cannot write {error.filename}: {error.strerror}") from error
    return 1 if arguments.strict and not result.holds else 0

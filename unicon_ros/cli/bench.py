"""`unicon bench NAME`: side by side comparisons in one run; ratios, never absolute promises."""

from __future__ import annotations

import argparse
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import unicon_ros
from unicon_base import UniconError
from unicon_core.page import write_file
from unicon_ros.cli.options import argument, command, flag, option, several

BENCHES = {
    "batch": "benchmarks.programs",
    "bridge": "benchmarks.bridge",
    "diagnose": "benchmarks.diagnose",
    "faults": "faults.bench_faults",
    "latency": "unicon_ros.bench.latency",
    "policy": "benchmarks.loops",
    "reach": "benchmarks.reach",
    "record": "benchmarks.runs",
    "retarget": "benchmarks.retarget",
    "safety": "benchmarks.runs",
    "simulators": "benchmarks.programs",
    "sloc": "benchmarks.sloc",
    "start": "benchmarks.programs",
    "stores": "benchmarks.stores",
    "sweep": "benchmarks.sweep",
    "tick": "benchmarks.tick",
    "timing": "benchmarks.loops",
    "view": "benchmarks.runs",
}
"""Bench to its module; all but `latency` are in a checkout only."""

CHECKOUT = Path(unicon_ros.__file__).resolve().parents[1]
"""Where this package lies; the benches that are not shipped lie beside it, in a checkout."""

SHARED = (
    *("json", "plot", "strict"),
    *("command", "bench", "function", "quiet", "verbose"),
)
"""What is parsed of every bench and not for it."""
_SECONDS = option("--seconds", type=float, help="time of a run, 10 s unless told")


def bench(arguments: argparse.Namespace) -> int:
    """Run the command; exit status 0 when it ran, with `--assert` 1 where a ratio misses."""
    if arguments.rounds is not None and arguments.rounds < 1:
        raise UniconError(f"--rounds {arguments.rounds}: give a number >= 1")
    given = vars(arguments).items()
    options = {name: each for name, each in given if name not in SHARED and each is not None}
    module, own = _module(arguments.bench), f"run_{arguments.bench}"
    run = getattr(module, own) if hasattr(module, own) else module.run  # of several, or of one
    result = run(**options)
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


# Bench to its own options, which its `run` takes.
_OPTIONS = {
    "diagnose": (
        flag("--quick", "40 records"),
        option("--only", help="records only with this in ROBOT/PLANT/KIND"),
        argument("--rows", "FILE", "JSON lines that a run adds to, and continues"),
        argument("--sizes", "FILE.yaml", "find the sizes of faults and write them"),
    ),
    "faults": (
        flag("--quick", "a handful of cases only"),
        option("--only", help="cases only whose group or name has this in it"),
        argument("--ticks", "N", "random ticks of each fault, 5 unless told", type=int),
        argument("--markdown", "FILE.md", "write the tables of what was run"),
    ),
    "latency": (
        option("--rate", type=float, help="commands per second"),
        option("--state-rate", type=float, help="states per second"),
        option("--joints", type=int, help="number of joints"),
        option("--seconds", type=float, help="measured time of a variant in a round"),
        flag("--budget", "what the time of our tick goes to, who takes it and when"),
        flag("--strongest", "the strongest plain controllers and ours alone, 5,400 commands each"),
    ),
    "record": (_SECONDS,),
    "sweep": (argument("--rollouts", "N", "of each side, 2,000 unless told", type=int),),
    "view": (_SECONDS,),
}

add = several(
    "bench",
    "compare side by side",
    __doc__,
    "NAME",
    *(
        command(
            name,
            bench,
            f"see {module}",
            None,
            argument("--rounds", "N", "interleaved rounds", type=int),
            argument("--json", "FILE", "write the result as JSON"),
            argument("--plot", "FILE.png", "plot the cases (needs matplotlib)"),
            option(
                "--assert", action="store_true", help="exit 1 where a ratio misses", dest="strict"
            ),
            *_OPTIONS.get(name, ()),
        )
        for name, module in BENCHES.items()
    ),
)

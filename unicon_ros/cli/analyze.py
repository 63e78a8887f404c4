"""`unicon analyze REAL SIM --out DIR`: how far the simulator is from the robot, as a report."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Any

from unicon_core.errors import UniconError
from unicon_ros.cli.fit import add_fit, run_fit
from unicon_ros.cli.workflow_arguments import positive


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = commands.add_parser(
        "analyze", help="compare a real run with a simulated one", description=__doc__
    )
    parser.add_argument("real", metavar="REAL", help="record (.mcap) or .npz of the robot")
    parser.add_argument(
        "sim", metavar="SIM", nargs="?", help="record (.mcap) or .npz of the simulator"
    )
    parser.add_argument("--out", metavar="DIR", required=True, help="folder for the report")
    for side, who in (("", "real"), ("sim-", "simulated")):
        parser.add_argument(
            f"--{side}from", type=_time, default=0.0, metavar="S", dest=f"{who}_from",
            help=f"begin S seconds after the {who} run's first sample",
        )  # fmt: skip
        parser.add_argument(
            f"--{side}to", type=_time, default=math.inf, metavar="S", dest=f"{who}_to",
            help=f"end S seconds after the {who} run's first sample",
        )  # fmt: skip
    parser.add_argument(
        "--max-shift",
        type=_time,
        metavar="S",
        help="largest shift in time (default: any that leaves half of the shorter run)",
    )
    parser.add_argument(
        "--rate", type=positive, metavar="HZ", help="compare at this rate (default: the slower's)"
    )
    parser.add_argument("--whole", action="store_true", help="compare what comes after a fall, too")
    add_fit(parser)
    parser.set_defaults(function=_analyze)


def _time(text: str) -> float:
    value = float(text)
    if not 0.0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not a time >= 0 in [s]")
    return value


def _analyze(arguments: argparse.Namespace) -> int:
    """Run the command; exit status 0."""
    if arguments.sim is None and arguments.fit is None:
        raise UniconError("unicon analyze REAL needs SIM, or --fit; give a record of the simulator")
    status = 0
    if arguments.fit is not None:
        status = run_fit(arguments, _folder(arguments.out))
        if arguments.sim is None:
            return status
    from unicon_ros.analysis.comparison import compare_runs
    from unicon_ros.analysis.read import read_run
    from unicon_ros.analysis.report import write_report
    from unicon_ros.analysis.together import Options, bring_together
    from unicon_ros.report.drawing import require

    require("unicon analyze")
    folder = _folder(arguments.out)
    runs = []
    for who in ("real", "sim"):
        path = Path(getattr(arguments, who))
        _tell(f"reading {path}{_size(path)}")
        long = {"sim": "simulated"}.get(who, who)
        runs.append(
            read_run(path, (getattr(arguments, f"{long}_from"), getattr(arguments, f"{long}_to")))
        )
    real, sim = runs
    _tell(f"comparing {len(real.time):,} samples with {len(sim.time):,}")
    options = Options(arguments.max_shift, arguments.rate, arguments.whole)
    comparison = compare_runs(bring_together(real, sim, options))
    result = write_report(comparison, (real, sim), folder, _tell)
    for text in [*_list(result["findings"]), *_list(result["notes"])]:
        print(text)
    print(f"report  {folder / 'report.html'}")
    return status


def _folder(text: str) -> Path:
    folder = Path(text)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UniconError(
            f"cannot make the folder {folder}: {error.strerror}; give another to --out"
        ) from error
    return folder


def _size(path: Path) -> str:
    try:
        return f" ({path.stat().st_size / 1e6:,.1f} MB)" if path.is_file() else ""
    except OSError:
        return ""


def _list(value: Any) -> list[str]:
    return list(value)


def _tell(text: str) -> None:
    print(f"unicon analyze: {text}", file=sys.stderr)

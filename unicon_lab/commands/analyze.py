"""`unicon analyze REAL SIM --out DIR`: how far the simulator is from the robot, as a report."""

from __future__ import annotations

import argparse
import math
from dataclasses import asdict
from pathlib import Path

from unicon_base import UniconError, cannot
from unicon_core.page import write_file, write_json
from unicon_lab.commands.diagnose import replays
from unicon_ros.cli.console import note, print_table
from unicon_ros.cli.options import argument, command, flag, group, listed, positive, seconds


def _analyze(arguments: argparse.Namespace) -> int:
    """Run the command; exit status 0."""
    if arguments.sim is None and arguments.fit is None:
        raise UniconError("unicon analyze REAL needs SIM, or --fit; give a record of the simulator")
    status = 0
    if arguments.fit is not None:
        status = _fit(arguments, _folder(arguments.out))
        if arguments.sim is None:
            return status
    from unicon_core.drawing import require
    from unicon_lab.analysis.comparison import compare_runs, signals_of
    from unicon_lab.analysis.paired_runs import bring_together
    from unicon_lab.analysis.report import HEADS, chain_rows, write_report
    from unicon_lab.analysis.run import read_run

    require("unicon analyze")
    folder = _folder(arguments.out)
    runs = []
    for who in ("real", "sim"):
        path = Path(getattr(arguments, who))
        _tell(f"reading {path}")
        span = getattr(arguments, f"{who}_from"), getattr(arguments, f"{who}_to")
        runs.append(read_run(path, span, signals_of))
    real, sim = runs
    options = arguments.max_shift, arguments.rate, arguments.whole
    comparison = compare_runs(bring_together(real, sim, *options))
    result = write_report(comparison, (real, sim), folder, _tell)
    for text in [*result["findings"], *result["notes"]]:
        print(text)
    print_table([HEADS, *chain_rows(result["divergence"])], underlined=True, right=(1, 3, 4, 5))
    print(f"report  {folder / 'report.html'}")
    return status


def _folder(text: str) -> Path:
    folder = Path(text)
    with cannot(f"make the folder {folder}", "give another to --out"):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def _tell(text: str) -> None:
    note(f"unicon analyze: {text}")


def _fit(arguments: argparse.Namespace, folder: Path) -> int:
    """Fit, write overlay and JSON into a folder, and print what was found.

    A fit that is not better for what it has not seen gets no overlay.

    Returns:
        The exit status: 1 where parameters were found that are not better.

    Raises:
        UniconError: REAL is not a record, or lacks what is needed.
    """
    from unicon_core.robots import load_robot
    from unicon_core.robots.load import JOINT_PHYSICS
    from unicon_lab.diagnose.fit import fit_record
    from unicon_lab.recording import open_record

    if arguments.processes < 0:
        raise UniconError(f"--processes is {arguments.processes}; give 1 or more")
    real = Path(arguments.real)
    if real.suffix == ".npz":
        raise UniconError(
            f"{real}: a fit replays records; make one of it: unicon bag import {real} real.mcap"
        )
    record = open_record(real)
    robot = load_robot(arguments.robot) if arguments.robot else None
    found, text = fit_record(
        record,
        real.name,
        robot=robot,
        words=[*JOINT_PHYSICS] if arguments.fit is True else arguments.fit,
        joints=arguments.fit_joints,
        hung=arguments.hung,
        window=arguments.fit_window,
        processes=arguments.processes,
        tell=_tell,
    )
    name = (robot.name if robot else record.facts.get("robot")) or "robot"
    path = folder / f"{name}_fitted.yaml"
    overlay = path.name if found.better else None
    if found.better:
        write_file(path, text.encode())
    content = asdict(found) | {"overlay": overlay, "better": found.better}
    write_json(folder / "fit.json", content)
    for each in found.parameters:
        unit = JOINT_PHYSICS[each.word]
        interval = f"{each.after:.4g} ± {each.deviation:.2g} {unit}".rstrip()
        print(f"{each.joint:24} {each.word:9} {each.before:.4g} -> {interval}")
    for cause in found.causes:
        half = (cause.high - cause.low) / 2.0
        print(f"{cause.name:34} {cause.size:+.4g} ± {half:.2g} {cause.unit}".rstrip(), end="")
        print(f": {cause.remedy}" if cause.remedy else ", which no overlay of joints can say")
    if not found.parameters:
        print("no parameter of a joint explains more than noise would")
    print(
        f"mean square   {found.before:.4g} -> {found.after:.4g} rad² ({found.windows[0]} windows)"
    )
    worse = bool(found.parameters) and not found.better
    print(
        f"held out      {found.held_before:.4g} -> {found.held_after:.4g} rad² "
        f"({found.windows[1]} windows){': NOT better' if worse else ''}"
    )
    earlier = f"; {path} is of an earlier fit" if path.exists() else ""
    print(f"overlay  {path if found.better else f'none{earlier}'}")
    return int(worse)


add = command(
    "analyze",
    _analyze,
    "compare a real run with a simulated one",
    __doc__,
    argument("real", "REAL", "record (.mcap) or .npz of the robot"),
    argument("sim", "SIM", "record (.mcap) or .npz of the simulator", nargs="?"),
    argument("--out", "DIR", "folder for the report", required=True),
    *(
        argument(
            f"--{side}{word}",
            "S",
            f"{verb} S seconds after the {run} run's first sample",
            type=seconds,
            default=default,
            dest=f"{who}_{word}",
        )
        for who, side, run in (("real", "", "real"), ("sim", "sim-", "simulated"))
        for word, verb, default in (("from", "begin", 0.0), ("to", "end", math.inf))
    ),
    argument(
        "--max-shift",
        "S",
        "largest shift in time (default: any that leaves half of the shorter run)",
        type=seconds,
    ),
    argument("--rate", "HZ", "compare at this rate (default: the slower's)", type=positive),
    flag("--whole", "compare what comes after a fall, too"),
    group(
        "fit",
        "estimates joints of the simulator from REAL alone",
        argument(
            "--fit",
            "WORDS",
            "write a robot overlay: strength, friction, armature, delay, or some of them, "
            "separated by commas",
            nargs="?",
            type=listed,
            const=True,  # all words, which are not known before NumPy is loaded
        ),
        argument(
            "--fit-joints", "PATTERNS", "of these joints (default: all)", type=listed, default="*"
        ),
        *replays("--fit-window"),
    ),
)

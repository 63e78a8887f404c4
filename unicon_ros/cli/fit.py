"""`unicon analyze REAL --fit`: a robot overlay whose simulator does as the robot did."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from unicon_core.errors import UniconError
from unicon_ros.cli.workflow_arguments import positive


def add_fit(parser: argparse.ArgumentParser) -> None:
    """Add the options of a fit to those of `unicon analyze`."""
    group = parser.add_argument_group("fit", "estimates joints of the simulator from REAL alone")
    group.add_argument(
        "--fit",
        nargs="?",
        const=True,  # all words, which are not known before NumPy is loaded
        metavar="WORDS",
        help="write a robot overlay: strength, friction, armature, delay, or some of them, "
        "separated by commas",
    )
    group.add_argument(
        "--fit-joints", default="*", metavar="PATTERNS", help="of these joints (default: all)"
    )
    group.add_argument(
        "--fit-window", type=positive, default=0.2, metavar="S", help="of a replay (default: 0.2)"
    )
    group.add_argument("--robot", metavar="ROBOT", help="its file (default: the record's)")
    group.add_argument(
        "--processes", type=int, default=0, metavar="N", help="at once (default: one for each core)"
    )


def run_fit(arguments: argparse.Namespace, folder: Path) -> int:
    """Fit, write overlay and JSON into a folder, and print what was found.

    A fit that is not better for what it has not seen gets no overlay.

    Returns:
        The exit status: 1 where figures were found that are not better.

    Raises:
        UniconError: REAL is not a record, or lacks what is needed.
    """
    from unicon_core.robots import load_robot
    from unicon_core.robots.joint_physics import JOINT_PHYSICS
    from unicon_ros.identify import fit_record
    from unicon_ros.recording import open_record

    if arguments.processes < 0:
        raise UniconError(f"--processes is {arguments.processes}; give 1 or more")
    real = Path(arguments.real)
    if real.suffix == ".npz":
        raise UniconError(
            f"{real}: a fit replays records; make one of it: unicon bag import {real} real.mcap"
        )
    asked = JOINT_PHYSICS if arguments.fit is True else arguments.fit.split(",")
    record = open_record(real)
    robot = load_robot(arguments.robot) if arguments.robot else None
    found, text = fit_record(
        record,
        real.name,
        robot=robot,
        words=[word.strip() for word in asked if word.strip()],
        joints=[each.strip() for each in arguments.fit_joints.split(",") if each.strip()],
        window=arguments.fit_window,
        processes=arguments.processes,
        tell=lambda line: print(f"unicon analyze: {line}", file=sys.stderr),
    )
    name = (robot.name if robot else record.facts.get("robot")) or "robot"
    path = folder / f"{name}_fitted.yaml"
    overlay = path.name if found.better else None
    try:
        if found.better:
            path.write_text(text, encoding="utf-8")
        content: dict[str, Any] = asdict(found) | {"overlay": overlay, "better": found.better}
        (folder / "fit.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
    except OSError as error:
        raise UniconError(f"cannot write {path}: {error.strerror}; give another --out") from error
    for each in found.parameters:
        unit = JOINT_PHYSICS[each.word]
        interval = f"{each.after:.4g} ± {each.deviation:.2g} {unit}".rstrip()
        print(f"{each.joint:24} {each.word:9} {each.before:.4g} -> {interval}")
    if not found.parameters:
        print("no figure of a joint explains more than noise would: the simulator is as it should")
    print(
        f"aligned MSE   {found.before:.4g} -> {found.after:.4g} rad² ({found.windows[0]} windows)"
    )
    worse = bool(found.parameters) and not found.better
    print(
        f"held out      {found.held_before:.4g} -> {found.held_after:.4g} rad² "
        f"({found.windows[1]} windows){': NOT better' if worse else ''}"
    )
    earlier = f"; {path} is of an earlier fit" if path.exists() else ""
    print(f"overlay  {path if found.better else f'none{earlier}'}")
    return int(worse)

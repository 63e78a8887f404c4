"""Options of how a workflow runs, for `unicon run` and `unicon replay`."""

from __future__ import annotations

import argparse

from unicon_ros.cli.workflow_arguments import (
    add_view_options,
    port,
    positive,
    quality,
)
from unicon_ros.view import SINKS


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what says how a workflow runs."""
    parser.add_argument("--duration", type=positive, metavar="S", help="end after S seconds")
    parser.add_argument(
        "--speed",
        choices=("real", "max"),
        default="real",
        help="pace to the wall clock (real) or tick as fast as possible (max, simulators)",
    )
    parser.add_argument(
        "--ros",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="mirror states to ROS 2 topics (default: what the workflow says, else no)",
    )
    parser.add_argument("--map", metavar="MAP", help="message map: name in config/maps/, or a path")
    parser.add_argument("--namespace", metavar="NS", help="ROS namespace")
    parser.add_argument(
        "--frame-prefix",
        metavar="PREFIX",
        default="",
        help="what stands before the names of all ROS frames, such as robot1/",
    )
    parser.add_argument(
        "--part", metavar="NAME", default="", help="run one part of a workflow that has parts"
    )
    parser.add_argument(
        "--record",
        metavar="FILE.mcap|FOLDER/",
        help="record every state of every tick, and the messages of the map",
    )
    parser.add_argument(
        "--record-split",
        metavar="1GB|60s",
        default="",
        help="record to a bag folder whose files are that large or long, or both: 1GB,10min",
    )
    parser.add_argument(
        "--record-frames",
        metavar="all|NAME,…",
        default="",
        help="record pictures and clouds too: of all cameras and scanners, or of these handles",
    )
    parser.add_argument(
        "--record-jpeg",
        metavar="QUALITY",
        type=quality,
        default=0,
        help="record raw pictures as JPEG of that quality, 1 to 100 (default: as they are)",
    )
    parser.add_argument(
        "--faults",
        metavar="DIR",
        help="where the record of a fault goes, or off (default: $UNICON_FAULTS, else "
        "~/.local/state/unicon/faults)",
    )
    parser.add_argument("--trace", metavar="FILE.json", help="write every block of every tick")
    parser.add_argument(
        "--report",
        metavar="FILE.json|FILE.html",
        help="write the report: its figures, or one page with pictures",
    )
    parser.add_argument("--picture", metavar="FILE.png", help="draw path, velocities and joints")
    parser.add_argument(
        "--view",
        nargs="?",
        const="page",
        choices=(*SINKS, "window"),
        help="show the run: a page in the browser (default), Foxglove, meshcat, or the simulator's "
        "own window",
    )
    add_view_options(parser)
    parser.add_argument(
        "--metrics",
        metavar="PORT",
        type=port,
        help="tell figures to Prometheus at http://127.0.0.1:PORT/metrics",
    )
    parser.add_argument(
        "--force",
        metavar="CODE",
        action="append",
        default=[],
        help="go on with an error of `unicon check` of this code; may be repeated",
    )
    parser.add_argument(
        "--yes", action="store_true", help="a robot moves once its gates hold, without being asked"
    )
    parser.add_argument(
        "--dry",
        action="store_true",
        help="run everything on the live robot and send nothing, at the end either; a simulated "
        "robot gets limp joints",
    )
    parser.add_argument(
        "--fetch",
        nargs="?",
        const="",
        metavar="DIR|URL",
        help="fetch the models and policies that are missing first, of GitHub or of a mirror",
    )
    parser.add_argument(
        "--ros-args",
        nargs=argparse.REMAINDER,
        default=[],
        help="everything after this goes to ROS (remaps, parameters)",
    )

"""`unicon bag info|recover|export|import`: looks into recordings, mends and converts them."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from unicon_core.errors import UniconError
from unicon_ros.cli.workflow_arguments import positive

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = commands.add_parser(
        "bag", help="look into recordings, mend and convert them", description=__doc__
    )
    kinds = parser.add_subparsers(dest="bag", metavar="WHAT", required=True)

    info = kinds.add_parser("info", help="what is in it: topics, ticks, workflow, versions")
    info.add_argument("path", type=Path, metavar="BAG", help="a file, or a bag folder")
    info.add_argument("--json", action="store_true", help="print all of it as JSON")
    info.set_defaults(function=_info)

    recover = kinds.add_parser("recover", help="finish what a killed run left")
    recover.add_argument(
        "path", type=Path, nargs="+", metavar="FILE.mcap.partial|FOLDER", help="what it left"
    )
    recover.set_defaults(function=_recover)

    export = kinds.add_parser("export", help="write states to .npz, .csv or .parquet")
    export.add_argument("path", type=Path, metavar="BAG", help="a recording or fault record")
    export.add_argument("out", type=Path, metavar="OUT", help="ends in .npz, .csv or .parquet")
    export.add_argument("--states", nargs="+", default=[], metavar="STATE", help="these alone")
    export.add_argument(
        "--moment", default="sent", help="received, input, tuned or sent (default: sent)"
    )
    export.set_defaults(function=_export)

    read = kinds.add_parser("import", help="make a recording of ticks of a bag or an .npz")
    read.add_argument("path", type=Path, metavar="BAG", help="a ROS bag, or an .npz of UniCon")
    read.add_argument("out", type=Path, metavar="OUT.mcap", help="the recording to write")
    read.add_argument("--robot", required=True, help="whose states they are: a name, or a file")
    read.add_argument(
        "--map", help="of a bag: the message map whose `subscribe` is meant (default: ros_robot)"
    )
    read.add_argument(
        "--joints", nargs="+", default=[], metavar="JOINT", help="of an .npz: its order of joints"
    )
    read.add_argument(
        "--rate", type=positive, metavar="HZ", help="ticks a second (default: as it was recorded)"
    )
    read.set_defaults(function=_import)


def _info(arguments: argparse.Namespace) -> int:
    from unicon_ros.recording.info import info_of, info_text

    info = info_of(arguments.path)
    print(json.dumps(info, indent=2) if arguments.json else info_text(info))
    return 0


def _recover(arguments: argparse.Namespace) -> int:
    from unicon_ros.recording.recover import recover, recover_folder

    for path in arguments.path:
        if path.is_dir():
            for file, messages in recover_folder(path):
                print(f"{file}: {messages} messages")
            continue
        done = recover(path)
        if done is None:
            print(f"{path}: its run was killed before a message was in it; it is deleted")
        else:
            print(f"{done[0]}: {done[1]} messages")
    return 0


def _export(arguments: argparse.Namespace) -> int:
    from unicon_ros.recording import open_record
    from unicon_ros.recording.export import export

    record = open_record(arguments.path)
    ticks = export(record, arguments.out, arguments.states, arguments.moment)
    print(f"{arguments.out}: {ticks} ticks")
    return 0


def _import(arguments: argparse.Namespace) -> int:
    from unicon_core.robots import load_robot
    from unicon_ros.recording.import_bag import MAP, import_bag
    from unicon_ros.recording.import_npz import import_npz

    source, out, rate = arguments.path, arguments.out, arguments.rate
    if out.suffix != ".mcap":
        raise UniconError(f"cannot import to {out}; give a name that ends in .mcap")
    robot = load_robot(arguments.robot)
    if source.suffix == ".npz":
        if arguments.map:
            raise UniconError(f"{source}: --map goes with a bag; leave it out")
        ticks = import_npz(source, out, robot, arguments.joints, rate)
    else:
        if arguments.joints:
            raise UniconError(f"{source}: --joints goes with an .npz; leave it out")
        ticks = import_bag(source, out, robot, arguments.map or MAP, rate)
    print(f"{out}: {ticks} ticks")
    return 0

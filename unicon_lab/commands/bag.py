"""`unicon bag info|recover|export|import`: looks into recordings, mends and converts them."""

from __future__ import annotations

import argparse
from dataclasses import fields
from pathlib import Path

from unicon_base import UniconError
from unicon_lab.datasets import WRITERS
from unicon_ros.cli.console import note, print_json
from unicon_ros.cli.options import argument, command, flag, group, option, positive, several


def _info(arguments: argparse.Namespace) -> int:
    from unicon_lab.recording.info import info_of, info_text

    info = info_of(arguments.path)
    print_json(info) if arguments.json else print(info_text(info))
    return 0


def _recover(arguments: argparse.Namespace) -> int:
    from unicon_lab.recording.recover import recover, recover_folder

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
    if arguments.lerobot:
        return _export_dataset(arguments)
    from unicon_lab.recording import open_record
    from unicon_lab.recording.info import export

    if arguments.out is not None:
        raise UniconError("--out goes with --lerobot; add it, or give BAG and OUT alone")
    if len(arguments.paths) != 2:
        raise UniconError(
            f"{len(arguments.paths)} names; give BAG and OUT, or any number of recordings with "
            "--lerobot --out DIR"
        )
    path, out = arguments.paths
    ticks = export(open_record(path), out, arguments.states, arguments.moment)
    print(f"{out}: {ticks} ticks")
    return 0


def _export_dataset(arguments: argparse.Namespace) -> int:
    from unicon_lab.datasets.export import Wanted, export_dataset

    if arguments.out is None:
        raise UniconError("--lerobot: give the folder of the data set: --out DIR")
    if arguments.moment != "sent":
        raise UniconError("--moment goes without --lerobot: a data set has what was sent")
    if arguments.fps < 0:
        raise UniconError(f"--fps {arguments.fps}: give 1 or more frames a second")
    wanted = Wanted(**{each.name: getattr(arguments, each.name) for each in fields(Wanted)})
    print("\n".join(export_dataset(arguments.paths, arguments.out, wanted)))
    return 0


def _import(arguments: argparse.Namespace) -> int:
    from unicon_core.robots import load_robot
    from unicon_lab.recording.import_bag import MAP, import_bag
    from unicon_lab.recording.imported import import_npz

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
        ticks = import_bag(
            source, out, robot, arguments.map or MAP, rate, lambda line: note(f"unicon bag: {line}")
        )
    print(f"{out}: {ticks} ticks")
    return 0


add = several(
    "bag",
    "look into recordings, mend and convert them",
    __doc__,
    "WHAT",
    command(
        "info",
        _info,
        "what is in it: topics, ticks, workflow, versions",
        None,
        argument("path", "BAG", "a file, or a bag folder", type=Path),
        flag("--json", "print all of it as JSON"),
    ),
    command(
        "recover",
        _recover,
        "finish what a killed run left",
        None,
        argument("path", "FILE.mcap.partial|FOLDER", "what it left", type=Path, nargs="+"),
    ),
    command(
        "export",
        _export,
        "write states to .npz, .csv or .parquet, or recordings as a data set",
        None,
        argument(
            "paths",
            "BAG",
            "a recording or fault record, then the name of what is written, which ends in .npz, "
            ".csv or .parquet; with --lerobot any number of recordings",
            type=Path,
            nargs="+",
        ),
        argument("--states", "STATE", "these alone", nargs="+", default=[]),
        option("--moment", default="sent", help="received, input, tuned or sent (default: sent)"),
        group(
            "data sets for learning",
            None,
            flag("--lerobot", "one LeRobot data set, format v3.0"),
            argument("--out", "DIR", "folder of the data set", type=Path),
            argument("--fps", "N", "frames a second (default: the camera's)", type=int, default=0),
            option(
                "--task", default="", help="what is done, in words (default: the workflow's name)"
            ),
            argument(
                "--actions",
                "STATE",
                "states that make up the action (default: what was commanded)",
                nargs="+",
                default=[],
            ),
            argument("--cameras", "NAME", "pictures of these alone (default: all)", nargs="*"),
            argument("--phases", "PHASE", "whose ticks (default: run)", nargs="+", default=["run"]),
            option(
                "--no-video",
                action="store_false",
                dest="video",
                help="pictures in the Parquet files, as PNG or JPEG",
            ),
            option(
                "--writer",
                default="auto",
                choices=WRITERS,
                help="who writes: the package lerobot where it is installed (auto)",
            ),
        ),
    ),
    command(
        "import",
        _import,
        "make a recording of ticks of a bag or an .npz",
        None,
        argument("path", "BAG", "a ROS bag, or an .npz of UniCon", type=Path),
        argument("out", "OUT.mcap", "the recording to write", type=Path),
        option("--robot", required=True, help="whose states they are: a name, or a file"),
        option(
            "--map",
            help="of a bag: the message map whose `subscribe` is meant (default: ros_robot)",
        ),
        argument("--joints", "JOINT", "of an .npz: its order of joints", nargs="+", default=[]),
        argument("--rate", "HZ", "ticks a second (default: as it was recorded)", type=positive),
    ),
)

"""Where message definitions come from: Jazzy's as plain data, and those of installed packages.

Installed are `share/PACKAGE/msg/NAME.msg` of the ament prefixes.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from functools import cache
from importlib import resources
from pathlib import Path

from unicon_base import AnyDict, AnyMapping, alternatives
from unicon_base.packages import share_folder, shares
from unicon_msgs_map.errors import MessageTypeError

SHIPPED = resources.files("unicon_msgs_map") / "msg"
"""Folder of the definitions that ship with us."""


def installed_files(full: str) -> list[Path]:
    """Return the files to register for a type `pkg/msg/Name`; none where it is not installed.

    One, since its parts are looked for when they are laid out; of a package that ships with us too
    all of them, so that ours and theirs cannot contradict each other unseen.
    """
    package, kind, name = full.split("/")
    folder = _folder(package)
    if kind != "msg" or folder is None or not (folder / f"{name}.msg").is_file():
        return []
    shipped = (SHIPPED / package).is_dir()
    return sorted(folder.glob("*.msg")) if shipped else [folder / f"{name}.msg"]


def unknown_type(full: str, known: Iterable[str]) -> MessageTypeError:
    """Return the error for a type that is nowhere, of those that are known elsewhere."""
    known = list(known)
    package = full.split("/")[0]
    same = {name for name in known if name.startswith(f"{package}/")}
    folder = _folder(package)
    if folder is not None:
        same |= {f"{package}/msg/{file.stem}" for file in folder.glob("*.msg")}
    looked = shares() if folder is None else f"looked in {folder}"
    return MessageTypeError(
        f"message type {full!r} is unknown; {alternatives(full, same or known, limit=12)}; "
        f"{looked}; or name its .msg file under 'messages'"
    )


def _folder(package: str) -> Path | None:
    share = share_folder(package)
    return share / "msg" if share is not None and (share / "msg").is_dir() else None


FILE = "jazzy.json"
"""In the folder `msg`. Names, types, bounds and constants of ROS's common interfaces, as rosbags
0.11 tells them; `UNICON_WRITE_GOLDEN=1 pytest test/map/test_map_ready_made.py` writes it anew."""


@cache
def ready_made() -> AnyMapping:
    """Return name to (constants, fields), laid out as rosbags' `fielddefs`; read in 2 ms."""
    types: AnyDict = json.loads((SHIPPED / FILE).read_text("utf-8"))
    return types

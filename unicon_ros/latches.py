"""Latches: what keeps a node from moving by itself though its process is a new one, as files.

    unicon latches                          what is latched on this machine
    unicon latches --clear /robot1/unicon   lets go; the node may start again

A node that was stopped by ~/estop, or that ended with status 3, may be started again by whoever
watches processes. So each node has a file for either, by its ROS domain and its fully qualified
name, which counts until the machine boots. A file that cannot be read counts as latched.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from unicon_core.outlet import Outlet
from unicon_core.resources import user_folder

__all__ = ["ESTOP", "FAULT", "Latch", "Latched", "boot_id", "clearing", "latch_folder", "latches"]

ESTOP, FAULT = "estop", "fault"
"""Kinds: no start at all before ~/clear_estop; no start by itself."""

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
PATIENCE = 1.0
"""For the medium in [s]."""


@dataclass(frozen=True)
class Latched:
    """What a file says.

    Attributes:
        node: fully qualified name.
        domain: its ROS_DOMAIN_ID.
        kind: `estop` or `fault`.
        reason: one line.
        at: UTC time.
        boot: the boot that it counts for, "" where the system does not tell.
    """

    node: str
    domain: int
    kind: str
    reason: str = ""
    at: str = ""
    boot: str = ""


def latch_folder() -> Path | None:
    """Return where they are kept: `UNICON_LATCHES`, else the user's state folder, if there is one.

    Like fault records: `$XDG_STATE_HOME/unicon/latches`, `~/.local/state/unicon/latches`.
    """
    return user_folder("latches", os.environ.get("UNICON_LATCHES", ""))


def boot_id() -> str:
    """Return what tells this boot of the machine from others, "" where the system does not say."""
    try:
        return BOOT_ID.read_text("ascii").strip()
    except (OSError, ValueError):
        return ""


def clearing(node: str) -> str:
    """Return the command that lets go of the latches of a node."""
    return f"unicon latches --clear {node}"


def latches() -> list[tuple[Path, Latched]]:
    """Return the latches that count, with their files, by name."""
    folder = latch_folder()
    files = sorted(folder.glob("*.json")) if folder is not None else []
    return [(path, latched) for path in files if (latched := _read(path)) is not None]


def _read(path: Path) -> Latched | None:
    """Return what a file says; None where there is none or it is of another boot."""
    domain, *names, kind = path.name.removesuffix(".json").split(".")
    unread = Latched("/" + "/".join(names), int(domain) if domain.isdecimal() else 0, kind)
    try:
        told = json.loads(path.read_text("utf-8"))
        found = Latched(**{**asdict(unread), **told})
        if not all(type(value) is type(getattr(unread, k)) for k, value in asdict(found).items()):
            raise ValueError("wrong types")
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, TypeError) as error:
        reason = f"{path} cannot be read ({type(error).__name__}), which counts as latched"
        return Latched(unread.node, unread.domain, kind, reason)
    return found if found.boot == boot_id() else None


class Latch:
    """One kind of latch of one node.

    Args:
        node: fully qualified name.
        domain: its ROS_DOMAIN_ID.
        kind: `ESTOP` or `FAULT`.
        warn: takes warnings, one line each.

    Attributes:
        path: the file, None where there is no place for one.
        trouble: why the last one could not be kept, "" if it could.
    """

    def __init__(self, node: str, domain: int, kind: str, warn: Callable[[str], None]) -> None:
        folder = latch_folder()
        name = ".".join([str(domain), *node.strip("/").split("/"), kind, "json"])
        self.path = None if folder is None else folder / name
        self.trouble = ""
        self._latched, self._warn = Latched(node, domain, kind), warn
        self._outlet: Outlet[str] = Outlet(self._write)

    def read(self) -> Latched | None:
        """Return what is latched, None if nothing is."""
        return None if self.path is None else _read(self.path)

    def set(self, reason: str) -> None:
        """Latch; a thread writes it, so that a tick may ask for it."""
        self._outlet(reason)

    def kept(self) -> bool:
        """Wait until what was set is written, 1 s at most; return whether it is."""
        if not self._outlet.flush(PATIENCE):
            self.trouble = f"the medium took nothing for {PATIENCE:g} s"
        return not self.trouble

    def release(self) -> str:
        """Let go; return why that could not be, or ""."""
        self._outlet.flush(PATIENCE)
        try:
            if self.path is not None:
                self.path.unlink(missing_ok=True)
        except OSError as error:
            return f"{self.path} cannot be removed ({error.strerror}); remove it by hand"
        return ""

    def close(self) -> None:
        """Let what waits be written."""
        self._outlet.close()

    def _write(self, reason: str) -> None:
        self.trouble = ""
        if self.read() is not None:  # the first one stays, however many follow
            return
        at = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        told = asdict(self._latched) | {"reason": reason, "at": at, "boot": boot_id()}
        try:
            if self.path is None:
                raise OSError(0, "there is no folder for it; set UNICON_LATCHES")
            self.path.parent.mkdir(parents=True, exist_ok=True)
            new = self.path.with_suffix(f".{os.getpid()}")
            new.write_text(json.dumps(told) + "\n", "utf-8")
            new.replace(self.path)
        except OSError as error:
            self.trouble = error.strerror or str(error)
            self._warn(
                f"the latch of {self._latched.node} lasts for this process only: "
                f"{self.path or 'no folder'}: {self.trouble}"
            )

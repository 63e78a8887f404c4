"""Latches: what keeps a robot or a node from moving though the process is a new one, as files.

    unicon latches                                        what is latched on this machine
    unicon latches --clear /robot1/unicon                 lets go; the node may start again
    unicon latches --clear unitree_go/domain0/10.0.0.2    lets go; the robot may be driven again

An emergency stop latches the robot, by what its platform reaches it by: every start on it is
refused, with or without ROS. A node that was stopped by ~/estop, or that ended with status 3, may
be started again by a supervisor of processes, so it has a file for either, by its ROS domain and
its fully qualified name. A file counts until the machine boots. One that cannot be read counts as
latched.
"""

from __future__ import annotations

import fcntl
import ipaddress
import json
import os
import socket
import struct
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote, unquote

from unicon_base import AnyMapping, PlatformError, TextSink
from unicon_base.resources import user_folder
from unicon_core.non_blocking_writer import NonBlockingWriter

if TYPE_CHECKING:
    from unicon_core.robots import Robot


_SIOCGIFADDR, _SIOCGIFFLAGS = 0x8915, 0x8913


def flags_of(interface: str) -> int:
    """Return the flags of a network interface, such as IFF_UP, of netdevice(7); 0 without it."""
    with suppress(OSError):
        return int(struct.unpack_from("H", _asked(interface, _SIOCGIFFLAGS), 16)[0])
    return 0


def ipv4_of(interface: str) -> str:
    """Return the IPv4 address of a network interface, which is given by it or by its name.

    Raises:
        PlatformError: it has none.
    """
    with suppress(ValueError):
        return str(ipaddress.IPv4Address(interface))
    try:
        found = _asked(interface, _SIOCGIFADDR)
    except OSError as error:
        raise PlatformError(
            f"network interface {interface!r} has no IPv4 address ({error.strerror}); see ip addr"
        ) from error
    return socket.inet_ntoa(found[20:24])


def _asked(interface: str, what: int) -> bytes:
    """Return the kernel's `ifreq` of an interface."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        return fcntl.ioctl(asked.fileno(), what, struct.pack("256s", interface.encode()[:15]))


ESTOP, FAULT = "estop", "fault"
"""Kinds: no start at all before ~/clear_estop; no start by itself."""

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
PATIENCE = 1.0
"""For the medium in [s]."""

ROBOT = "robot"
"""What the name of a robot's file begins with."""
ANY = "any"
"""An interface that the middleware chooses, so that it may be the one that another start names."""
REACHED = ("domain", "address", "channel", "device", "port", "hand_id")
"""Options of platforms, and facts of robot files, that tell one robot from others."""


@dataclass(frozen=True)
class Latched:
    """What a file says.

    Attributes:
        node: fully qualified name; "" of a robot's own.
        domain: its ROS_DOMAIN_ID.
        kind: `estop` or `fault`.
        reason: one line.
        at: UTC time.
        boot: the boot that it counts for, "" where the system does not tell.
        robot: as of `robot_key`; of a node's the robots that it drove, with commas between them.
    """

    node: str
    domain: int
    kind: str
    reason: str = ""
    at: str = ""
    boot: str = ""
    robot: str = ""

    @property
    def owner(self) -> str:
        """The node, or the robot."""
        return self.node or self.robot

    @property
    def robots(self) -> tuple[str, ...]:
        """The robots, one by one."""
        return tuple(filter(None, self.robot.split(",")))


def robot_key(platform: str, protocols: Sequence[str], options: AnyMapping, robot: Robot) -> str:
    """Return what tells a robot from others before anything is opened, such as `arx/can0`.

    No public protocol that is spoken here tells a serial number reliably, so it is the protocol
    with domain, address and port. A platform that does not say that it speaks the robot's has its
    own name, the robot file's and what it is given.

    Args:
        platform: its name.
        protocols: that it speaks.
        options: of the platform, from the workflow.
        robot: its file.
    """
    transport, protocol = robot.transport, robot.transport.get("protocol")
    spoken = protocol in protocols
    facts = {**transport, "channel": transport.get("interface")} if spoken else {}
    parts = [str(protocol)] if spoken else [platform, robot.name]
    for key in REACHED:
        value = options.get(key)
        value = facts.get(key) if value in (None, "") else value
        if key == "address" and value is None and parts[-1].startswith("domain"):
            value = ANY
        if value is not None:
            word = str(value).strip("/").replace("/", "-")
            parts.append({"address": _address, "domain": "domain{}".format}.get(key, str)(word))
    return "/".join(parts)


def _address(value: str) -> str:
    """Return the IPv4 address behind a name of an interface or `localhost`, else the text."""
    if value == "localhost":
        return "127.0.0.1"
    try:
        return ipv4_of(value)
    except PlatformError:
        return value


def of_robot(key: str) -> Latched | None:
    """Return what is latched of a robot, None if nothing is.

    Args:
        key: as of `robot_key`.
    """
    asked = key.split("/")
    for _, latched in latches():
        there = latched.robot.split("/")
        if latched.node or len(there) != len(asked):
            continue
        if all(one == other or ANY in (one, other) for one, other in zip(there, asked)):
            return latched
    return None


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


def clearing(owner: str) -> str:
    """Return the command that lets go of the latches of a node or of a robot."""
    return f"unicon latches --clear {owner}"


def latches() -> list[tuple[Path, Latched]]:
    """Return the latches that count, with their files, by name."""
    folder = latch_folder()
    files = sorted(folder.glob("*.json")) if folder is not None else []
    return [(path, latched) for path in files if (latched := _read(path)) is not None]


def _read(path: Path) -> Latched | None:
    """Return what a file says; None where there is none or it is of another boot."""
    domain, *names, kind = path.name.removesuffix(".json").split(".")
    if domain == ROBOT:
        unread = Latched("", 0, kind, robot=unquote(".".join(names)))
    else:
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
        return replace(unread, reason=reason)
    return found if found.boot == boot_id() else None


class Latch:
    """One kind of latch of one node, or of one robot.

    Args:
        node: fully qualified name; "" for a robot.
        domain: its ROS_DOMAIN_ID.
        kind: `ESTOP` or `FAULT`.
        warn: takes warnings, one line each.
        robot: as of `robot_key`.

    Attributes:
        robot: what was given; of a node's it may be set before it is latched.
        path: the file, None where there is no place for one.
        trouble: why the last one could not be kept, "" if it could.
    """

    def __init__(self, node: str, domain: int, kind: str, warn: TextSink, robot: str = "") -> None:
        folder = latch_folder()
        name = (
            [str(domain), *node.strip("/").split("/")] if node else [ROBOT, quote(robot, safe="")]
        )
        self.path = None if folder is None else folder / ".".join([*name, kind, "json"])
        self.trouble, self.robot = "", robot
        self._latched, self._warn = Latched(node, domain, kind), warn
        self._outlet = NonBlockingWriter(self._write)

    def read(self) -> Latched | None:
        """Return what is latched, None if nothing is."""
        return None if self.path is None else _read(self.path)

    def set(self, reason: str) -> None:
        """Latch; a thread writes it, so that a tick may ask for it."""
        self._outlet(reason)

    def kept(self, patience: float = PATIENCE) -> bool:
        """Wait until what was set is written; return whether it is.

        Args:
            patience: how long at most in [s].
        """
        if not self._outlet.flush(patience):
            self.trouble = f"the medium took nothing for {patience:.1g} s"
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
        told["robot"] = self.robot
        try:
            if self.path is None:
                raise OSError(0, "there is no folder for it; set UNICON_LATCHES")
            self.path.parent.mkdir(parents=True, exist_ok=True)
            new = self.path.with_suffix(f".{os.getpid()}-{threading.get_ident()}")
            new.write_text(json.dumps(told) + "\n", "utf-8")
            new.replace(self.path)
        except OSError as error:
            self.trouble = error.strerror or str(error)
            self._warn(
                f"the latch of {self._latched.node or self.robot} lasts for this process only: "
                f"{self.path or 'no folder'}: {self.trouble}"
            )

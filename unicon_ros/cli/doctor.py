"""`unicon doctor`: what of this machine a run depends on, with remedies; first thing in a report.

Exit status 1 where something keeps runs from working; warnings and notes are no failure.
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import resource
import shutil
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

import unicon_core
from unicon_base import PlatformError, UniconError, cannot
from unicon_core.latches import Latched, clearing, flags_of, ipv4_of, latch_folder, latches
from unicon_core.pacing import REAL_TIME
from unicon_core.text_table import aligned
from unicon_ros.cli.console import print_json, print_table, print_text
from unicon_ros.cli.options import argument, command, flag

OLDEST = (3, 10)
PACKAGES = {
    "mujoco": "sim",
    "onnxruntime": "sim",
    "rclpy": "ros",
    "rosbags": "bags",
    "viser": "view",
    "matplotlib": "plots",
    "pyarrow": "sweep",
    "zmq": "zmq",
    "daqp": "ik",
    "cyclonedds": "hw-unitree",
    "can": "hw-arx",
    "torch": "torch",
}
"""What is imported, and the extra that brings it."""
DISTRIBUTIONS = {"zmq": "pyzmq", "can": "python-can"}
WATCHED = 0.3
"""Time in [s] over which stolen time is counted."""
STOLEN = 2.0
"""Per cent of stolen time from which ticks come late."""
FEW_FILES = 1024
"""Open files that a run with ROS and a page comes close to."""
MANY_FILES = 200
"""Of Fast DDS in /dev/shm, more than the processes that live would have."""
LITTLE = 1e9
"""Free bytes below which recordings end early: a Go2 with all states takes some 1 MB/s."""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        area: what it belongs to.
        name: what it is.
        level: `ok`; `note`, where nothing needs to be done; `warning`; `error`, where runs fail.
        said: what was found.
        remedy: what to do, "" for nothing.
    """

    area: str
    name: str
    level: str
    said: str
    remedy: str = ""


def examine() -> Iterator[Finding]:
    """Yield what was found, area by area."""
    for look in (_python, _packages, _ros, _network, _robots, _time, _scheduling, _left, _disks):
        area = look.__name__.strip("_")
        try:
            for name, said, remedy, level in look():
                yield Finding(area, name, level if remedy else "ok", said, remedy)
        except Exception as error:  # one that fails hides no other
            yield Finding(area, "", "warning", f"{type(error).__name__}: {error}", "report this")


# Name, what was found, the remedy, and the level where there is one.
_Rows = Iterator[tuple[str, str, str, str]]


def _python() -> _Rows:
    version, least = platform.python_version(), ".".join(map(str, OLDEST))
    remedy = f"install Python {least} or newer" if sys.version_info < OLDEST else ""
    yield "Python", f"{version}, {sys.executable}", remedy, "error"
    system = f"{platform.system()} {platform.release()}, {platform.machine()}"
    yield "system", system, "" if sys.platform == "linux" else "run on Linux", "error"
    place = Path(unicon_core.__path__[0]).parent
    yield "unicon_ros", f"{unicon_core.__version__}, {place}", "", "ok"
    compiler = shutil.which("cc") or shutil.which("gcc")
    remedy = "" if compiler else "only C programs that share states need it: apt install gcc"
    yield "C compiler", compiler or "none", remedy, "note"


def _packages() -> _Rows:
    for module, extra in PACKAGES.items():
        if find_spec(module) is None:
            yield module, "not installed", f"pip install 'unicon_ros[{extra}]'", "note"
            continue
        try:
            version = metadata.version(DISTRIBUTIONS.get(module, module))
        except metadata.PackageNotFoundError:  # of an installation of ROS
            version = "installed"
        yield module, version, "", "ok"


def _ros() -> _Rows:
    there = find_spec("rclpy") is not None
    sourced = os.environ.get("ROS_DISTRO", "") or ("as wheels" if there else "not at hand")
    remedy = "" if there else "for --ros: source an installation, or pip install 'unicon_ros[ros]'"
    yield "ROS 2", sourced, remedy, "note"
    domain = os.environ.get("ROS_DOMAIN_ID", "")
    fits = not domain or (domain.isdecimal() and int(domain) <= 232)
    remedy = "" if fits else "export ROS_DOMAIN_ID=0, or another number up to 101"
    yield "domain", domain or "0 (ROS_DOMAIN_ID is not set)", remedy, "error"
    middleware = os.environ.get("RMW_IMPLEMENTATION", "the distribution's own")
    yield "middleware", middleware, "", "ok"
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    if os.environ.get("ROS_LOCALHOST_ONLY") == "1":
        reach = "LOCALHOST (ROS_LOCALHOST_ONLY)"
    yield "discovery", reach, "", "ok"


def _network() -> _Rows:
    for _, name in socket.if_nameindex():
        flags = flags_of(name)
        try:
            address = ipv4_of(name)
        except PlatformError:
            address = "no IPv4 address"
        up, multicast, loopback = flags & 0x1, flags & 0x1000, flags & 0x8
        said = f"{address}, {'up' if up else 'down'}, multicast {'on' if multicast else 'off'}"
        poor = up and not multicast and not loopback
        remedy = f"robots behind DDS are not found: ip link set {name} multicast on" if poor else ""
        yield name, said, remedy, "warning"


def _robots() -> _Rows:
    """Which interface reaches the addresses that robot files have."""
    import ipaddress

    from unicon_base.resources import list_config
    from unicon_core.robots import load_robot

    by_address: dict[str, list[str]] = {}
    for name in list_config("robots"):
        with suppress(Exception):  # `unicon robots` tells what is wrong with a file
            address = load_robot(name).transport.get("address")
            ipaddress.IPv4Address(address)
            by_address.setdefault(str(address), []).append(name)
    for address, names in by_address.items():
        own = _source_of(address)
        near = own and ipaddress.IPv4Address(address) in ipaddress.ip_network(f"{own}/24", False)
        said = f"{address} from {own}" if near else f"{address}: no interface is on its network"
        beside = f"{address.rpartition('.')[0]}.222"  # which vendors' examples use as well
        remedy = f"give an interface an address there: ip addr add {beside}/24 dev NAME"
        yield ", ".join(names), said, "" if near else remedy, "note"


def _source_of(address: str) -> str:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        try:
            asked.connect((address, 9))  # of UDP: nothing is sent
            return str(asked.getsockname()[0])
        except OSError:
            return ""


def _time() -> _Rows:
    source = _text(Path("/sys/devices/system/clocksource/clocksource0/current_clocksource"))
    slow = source in ("hpet", "acpi_pm")  # each look at them takes 1 µs and more
    remedy = "let the kernel use tsc or the hypervisor's clock: clocksource=tsc" if slow else ""
    yield "clock source", source or "not said", remedy, "warning"
    by_systemd = Path("/run/systemd/timesync/synchronized").exists()
    if by_systemd or shutil.which("chronyc"):
        yield "clock of the day", "synchronised", "", "ok"
    else:
        remedy = "for several computers on one robot: apt install chrony"
        yield "clock of the day", "nothing is known to synchronise it", remedy, "note"


def _scheduling() -> _Rows:
    cores = len(os.sched_getaffinity(0))
    remedy = "" if cores > 1 else "ROS and the tick share one: give it two"
    yield "cores", f"{cores} of {os.cpu_count()}", remedy, "warning"
    paths = Path("/sys/devices/system/cpu").glob("cpu*/cpufreq/scaling_governor")
    governors = {_text(path) for path in paths}
    saves = governors - {"performance", ""}
    remedy = "ticks begin late after idling: cpupower frequency-set -g performance" if saves else ""
    yield "CPU governor", ", ".join(sorted(governors)) or "not said", remedy, "warning"
    before, begun = _stolen(), time.monotonic()
    time.sleep(WATCHED)
    share = 100.0 * (_stolen() - before) / ((time.monotonic() - begun) * (os.cpu_count() or 1))
    poor = share >= STOLEN
    remedy = (
        "the host gives this machine's time to others: ask for cores of its own" if poor else ""
    )
    yield "stolen time", f"{share:.1f} %", remedy, "warning"
    root = os.geteuid() == 0
    allowed = root or resource.getrlimit(resource.RLIMIT_RTPRIO)[0] != 0
    remedy = "" if allowed else f"pacing.priority needs {REAL_TIME}, then log in again"
    yield "real-time priority", "allowed" if allowed else "refused", remedy, "warning"
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if root or limit == resource.RLIM_INFINITY:
        yield "memory lock", "unlimited", "", "ok"
    else:
        remedy = "pacing.lock_memory needs '<user> - memlock unlimited' in limits.conf"
        yield "memory lock", f"{limit >> 20} MiB", remedy, "note"
    files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    yield "open files", str(files), "ulimit -n 4096" if files < FEW_FILES else "", "warning"


def _stolen() -> float:
    """Return the time that the host took from all cores, in [s]; proc_stat(5)."""
    fields = _text(Path("/proc/stat")).partition("\n")[0].split()
    return int(fields[8]) / os.sysconf("SC_CLK_TCK") if len(fields) > 8 else 0.0


def _left() -> _Rows:
    """What runs have left: latches, and shared memory of those that died."""
    from unicon_core.states.backends.shm.files import segments

    found = [latched for _, latched in latches()]
    for each in found:
        said = f"{each.kind}: {each.reason}"
        yield f"latch of {each.owner}", said, clearing(each.owner), "warning"
    if not found:
        yield "latches", "none", "", "ok"
    dead = ", ".join(each.name for each in segments() if not each.alive)
    remedy = "unicon states --clean" if dead else ""
    yield "shared memory of dead runs", dead or "none", remedy, "note"
    files = sum(name.startswith(("fastrtps_", "fastdds_")) for name in os.listdir("/dev/shm"))
    remedy = "what dead processes left: fastdds shm clean" if files > MANY_FILES else ""
    yield "shared memory of Fast DDS", f"{files} files", remedy, "note"


def _disks() -> _Rows:
    from unicon_base.resources import assets_cache, assets_roots, user_folder
    from unicon_core.assets.manifest import asset_folder, load_assets, named

    assets = load_assets()
    each = named([*assets], assets)
    here = sum(asset_folder(asset) is not None for asset in each)
    where = ", ".join(map(str, assets_roots())) or "no folder yet"
    remedy = "" if here else "public models and policies: unicon assets list"
    yield "assets", f"{here} of {len(each)} in {where}", remedy, "note"
    for name, folder in (("faults", user_folder("faults")), ("cache", assets_cache())):
        place = next((p for p in (folder, *folder.parents) if p.exists()), None) if folder else None
        if place is None:
            yield name, "there is no home folder", "set HOME", "warning"
            continue
        free, able = shutil.disk_usage(place).free, os.access(place, os.W_OK)
        said = f"{free / 1e9:.1f} GB free at {place}" + ("" if able else ", not writable")
        remedy = "make room or give write access" if not able or free < LITTLE else ""
        yield name, said, remedy, "warning"


def _text(path: Path) -> str:
    try:
        return re.sub(r"\s+$", "", path.read_text("ascii", "replace"))
    except OSError:
        return ""


MARKS = {"ok": "", "note": "·", "warning": "!", "error": "✗"}


def _doctor(arguments: argparse.Namespace) -> int:
    from unicon_ros.cli.doctor import examine

    found = [*examine()]
    if arguments.json:
        print_json([asdict(each) for each in found])
    else:
        rows = [(MARKS[e.level], e.area, e.name, e.said) for e in found]
        for line, each in zip(aligned(rows, underlined=False, width=1 << 20), found):
            print_text(line.rstrip())
            if each.remedy:
                print_text(f"     {each.remedy}")
        worse = [each for each in found if each.level in ("warning", "error")]
        print(f"\n{len(worse)} of {len(found)} need a look" if worse else "\nnothing is wrong")
    return int(any(each.level == "error" for each in found))


HEAD = ("node or robot", "domain", "latched", "since", "reason")


def _latches(arguments: argparse.Namespace) -> int:
    if arguments.clear is not None:
        return _clear(arguments.clear, arguments.domain)
    if arguments.domain is not None:
        raise UniconError("latches: --domain goes with --clear NAME; add it, or leave it out")
    found = [each for _, each in latches()]
    if not found:
        print(f"nothing is latched in {latch_folder()}")
        return 0
    rows = [
        (e.owner, str(e.domain) if e.node else "-", e.kind, e.at or "?", e.reason) for e in found
    ]
    print_table([HEAD, *rows], underlined=True)
    return 0


def _said(latched: Latched) -> str:
    return f"{latched.node} (domain {latched.domain})" if latched.node else latched.robot


def _clear(name: str, domain: int | None) -> int:
    """Let go of what a node or a robot has latched, and what the other has by the same press."""
    found = latches()
    named = [e for _, e in found if name in (e.owner, *e.robots)]
    named = [e for e in named if domain is None or e.domain == domain]
    robots = {robot for each in named for robot in each.robots}
    chosen = [(p, e) for p, e in found if e in named or (not e.node and e.robot in robots)]
    if not chosen:
        known = ", ".join(dict.fromkeys(_said(e) for _, e in found))
        where = f"of domain {domain} " if domain is not None else ""
        raise UniconError(
            f"no latch of {name!r} {where}in {latch_folder()}; latched: {known or 'nothing'}"
        )
    for path, each in chosen:
        with cannot(f"remove {path}", "do so by hand"):
            path.unlink(missing_ok=True)
        print(f"{_said(each)}: {each.kind} cleared")
    print("a node that runs keeps its emergency stop until ~/clear_estop")
    return 0


add = command(
    "doctor",
    _doctor,
    "examine this machine: packages, ROS, network, clock, permissions",
    __doc__,
    flag("--json", "print JSON"),
)
add_latches = command(
    "latches",
    _latches,
    "list emergency stops that are latched, or let go",
    "Emergency stops and faults that keep robots and nodes from being started.",
    argument(
        "--clear",
        "NAME",
        "let go: the node NAME, such as /robot1/unicon, or the robot may be started again",
    ),
    argument("--domain", "N", "of --clear: in this ROS domain", type=int),
)

"""What of this machine a run depends on, each with its remedy: for `unicon doctor`.

Nothing is changed and nothing is sent beyond this machine; a socket is connected to a robot's
address only to ask the kernel for the route.
"""

from __future__ import annotations

import ipaddress
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
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

import unicon_core
from unicon_core.interfaces import flags_of, ipv4_of
from unicon_core.runtime.pacing import REAL_TIME

__all__ = ["Finding", "examine"]

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
            for name, level, said, remedy in look():
                yield Finding(area, name, level, said, remedy)
        except Exception as error:  # one that fails hides no other
            yield Finding(area, "", "warning", f"{type(error).__name__}: {error}", "report this")


_Row = tuple[str, str, str, str]


def _python() -> Iterator[_Row]:
    version = platform.python_version()
    old = sys.version_info < OLDEST
    remedy = f"install Python {'.'.join(map(str, OLDEST))} or newer" if old else ""
    yield "Python", "error" if old else "ok", f"{version}, {sys.executable}", remedy
    system = f"{platform.system()} {platform.release()}, {platform.machine()}"
    linux = sys.platform == "linux"
    yield "system", "ok" if linux else "error", system, "" if linux else "run on Linux"
    yield (
        "unicon_ros",
        "ok",
        f"{unicon_core.__version__}, {Path(unicon_core.__path__[0]).parent}",
        "",
    )
    compiler = shutil.which("cc") or shutil.which("gcc") or ""
    remedy = "" if compiler else "only C programs that share states need it: apt install gcc"
    yield "C compiler", "ok" if compiler else "note", compiler or "none", remedy


def _packages() -> Iterator[_Row]:
    for module, extra in PACKAGES.items():
        install = f"pip install 'unicon_ros[{extra}]'"
        if find_spec(module) is None:
            yield module, "note", "not installed", install
            continue
        try:
            version = metadata.version(DISTRIBUTIONS.get(module, module))
        except metadata.PackageNotFoundError:  # of an installation of ROS
            version = "installed"
        yield module, "ok", version, ""


def _ros() -> Iterator[_Row]:
    there = find_spec("rclpy") is not None
    distribution = os.environ.get("ROS_DISTRO", "")
    sourced = distribution or ("as wheels" if there else "not at hand")
    remedy = "" if there else "for --ros: source an installation, or pip install 'unicon_ros[ros]'"
    yield "ROS 2", "ok" if there else "note", sourced, remedy
    domain = os.environ.get("ROS_DOMAIN_ID", "")
    fits = not domain or (domain.isdecimal() and int(domain) <= 232)
    remedy = "" if fits else "export ROS_DOMAIN_ID=0, or another number up to 101"
    yield "domain", "ok" if fits else "error", domain or "0 (ROS_DOMAIN_ID is not set)", remedy
    middleware = os.environ.get("RMW_IMPLEMENTATION", "the distribution's own")
    yield "middleware", "ok", middleware, ""
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    if os.environ.get("ROS_LOCALHOST_ONLY") == "1":
        reach = "LOCALHOST (ROS_LOCALHOST_ONLY)"
    yield "discovery", "ok", reach, ""


def _network() -> Iterator[_Row]:
    for _, name in socket.if_nameindex():
        flags = flags_of(name)
        try:
            address = ipv4_of(name)
        except Exception:
            address = "no IPv4 address"
        up, multicast, loopback = flags & 0x1, flags & 0x1000, flags & 0x8
        said = f"{address}, {'up' if up else 'down'}, multicast {'on' if multicast else 'off'}"
        poor = up and not multicast and not loopback
        remedy = f"robots behind DDS are not found: ip link set {name} multicast on" if poor else ""
        yield name, "warning" if poor else "ok", said, remedy


def _robots() -> Iterator[_Row]:
    """Which interface reaches the addresses that robot files have."""
    from unicon_core.resources import list_config
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
        remedy = f"give an interface an address there: ip addr add {_beside(address)}/24 dev NAME"
        yield ", ".join(names), "ok" if near else "note", said, "" if near else remedy


def _source_of(address: str) -> str:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        try:
            asked.connect((address, 9))  # of UDP: nothing is sent
            return str(asked.getsockname()[0])
        except OSError:
            return ""


def _beside(address: str) -> str:
    """Return an address on the network of another, which vendors' examples use as well."""
    return f"{address.rpartition('.')[0]}.222"


def _time() -> Iterator[_Row]:
    source = _text(Path("/sys/devices/system/clocksource/clocksource0/current_clocksource"))
    slow = source in ("hpet", "acpi_pm")  # each look at them takes 1 µs and more
    remedy = "let the kernel use tsc or the hypervisor's clock: clocksource=tsc" if slow else ""
    yield "clock source", "warning" if slow else "ok", source or "not said", remedy
    synchronised = Path("/run/systemd/timesync/synchronized").exists() or bool(
        shutil.which("chronyc")
    )
    remedy = "for several computers on one robot: apt install chrony" if not synchronised else ""
    said = "synchronised" if synchronised else "nothing is known to synchronise it"
    yield "clock of the day", "ok" if synchronised else "note", said, remedy


def _scheduling() -> Iterator[_Row]:
    cores = len(os.sched_getaffinity(0))
    yield (
        "cores",
        "ok" if cores > 1 else "warning",
        f"{cores} of {os.cpu_count()}",
        ("" if cores > 1 else "ROS and the tick share one: give it two"),
    )
    governors = {
        _text(path)
        for path in Path("/sys/devices/system/cpu").glob("cpu*/cpufreq/scaling_governor")
    }
    saves = bool(governors - {"performance", ""})
    yield (
        "CPU governor",
        "warning" if saves else "ok",
        ", ".join(sorted(governors)) or "not said",
        ("ticks begin late after idling: cpupower frequency-set -g performance" if saves else ""),
    )
    before, begun = _stolen(), time.monotonic()
    time.sleep(WATCHED)
    share = 100.0 * (_stolen() - before) / ((time.monotonic() - begun) * (os.cpu_count() or 1))
    poor = share >= STOLEN
    yield (
        "stolen time",
        "warning" if poor else "ok",
        f"{share:.1f} %",
        ("the host gives this machine's time to others: ask for cores of its own" if poor else ""),
    )
    allowed = os.geteuid() == 0 or resource.getrlimit(resource.RLIMIT_RTPRIO)[0] != 0
    yield (
        "real-time priority",
        "ok" if allowed else "warning",
        "allowed" if allowed else "refused",
        ("" if allowed else f"pacing.priority needs {REAL_TIME}, then log in again"),
    )
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    free = limit == resource.RLIM_INFINITY or os.geteuid() == 0
    yield (
        "memory lock",
        "ok" if free else "note",
        "unlimited" if free else f"{limit >> 20} MiB",
        ("" if free else "pacing.lock_memory needs '<user> - memlock unlimited' in limits.conf"),
    )
    files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    few = files < FEW_FILES
    yield "open files", "warning" if few else "ok", str(files), "ulimit -n 4096" if few else ""


def _stolen() -> float:
    """Return the time that the host took from all cores, in [s]; proc_stat(5)."""
    fields = _text(Path("/proc/stat")).partition("\n")[0].split()
    return int(fields[8]) / os.sysconf("SC_CLK_TCK") if len(fields) > 8 else 0.0


def _left() -> Iterator[_Row]:
    """What runs have left: latches, and shared memory of those that died."""
    from unicon_core.latches import clearing, latches
    from unicon_core.states.backends.shm.files import segments

    found = [latched for _, latched in latches()]
    for each in found:
        yield (
            f"latch of {each.owner}",
            "warning",
            f"{each.kind}: {each.reason}",
            clearing(each.owner),
        )
    if not found:
        yield "latches", "ok", "none", ""
    dead = [each.name for each in segments() if not each.alive]
    yield (
        "shared memory of dead runs",
        "note" if dead else "ok",
        ", ".join(dead) or "none",
        ("unicon states --clean" if dead else ""),
    )
    fast = [*Path("/dev/shm").glob("fastrtps_*"), *Path("/dev/shm").glob("fastdds_*")]
    many = len(fast) > 200
    yield (
        "shared memory of Fast DDS",
        "note" if many else "ok",
        f"{len(fast)} files",
        ("what dead processes left: fastdds shm clean" if many else ""),
    )


def _disks() -> Iterator[_Row]:
    from unicon_core.assets import asset_folder, load_assets, named
    from unicon_core.resources import assets_cache, assets_roots, user_folder

    assets = load_assets()
    each = named([*assets], assets)
    here = [asset.name for asset in each if asset_folder(asset) is not None]
    where = ", ".join(map(str, assets_roots())) or "no folder yet"
    yield (
        "assets",
        "ok" if here else "note",
        f"{len(here)} of {len(each)} in {where}",
        ("" if here else "public models and policies: unicon assets list"),
    )
    for name, folder in (("faults", user_folder("faults")), ("cache", assets_cache())):
        place = next((p for p in (folder, *folder.parents) if p.exists()), None) if folder else None
        if place is None:
            yield name, "warning", "there is no home folder", "set HOME"
            continue
        free, able = shutil.disk_usage(place).free, os.access(place, os.W_OK)
        bad = not able or free < LITTLE
        said = f"{free / 1e9:.1f} GB free at {place}" + ("" if able else ", not writable")
        yield (
            name,
            "warning" if bad else "ok",
            said,
            "make room or give write access" if bad else "",
        )


def _text(path: Path) -> str:
    try:
        return re.sub(r"\s+$", "", path.read_text("ascii", "replace"))
    except OSError:
        return ""

"""The floor of the latency comparison: DDS in C, by ddsperf of Cyclone, where it is installed."""

from __future__ import annotations

import os
import re
import shutil
import subprocess

_LOOPBACK = (
    '<CycloneDDS><Domain id="any"><General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto"
    '</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain>'
    "</CycloneDDS>"
)
_LINE = re.compile(r"size \d+ mean .* 50% ([\d.]+)us .* 99% ([\d.]+)us")


def c_level_floor(domain: int, rate: float = 500.0) -> str | None:
    """Return p50 and p99 of one hop in C as text, or None where `ddsperf` is not installed.

    ddsperf sends pings of 512 bytes and halves their way there and back; its last second is taken.

    Args:
        domain: DDS domain of its own.
        rate: pings per second.
    """
    if shutil.which("ddsperf") is None:
        return None
    environment = {**os.environ, "CYCLONEDDS_URI": _LOOPBACK}
    common = ["ddsperf", "-i", str(domain)]
    pong = subprocess.Popen(
        [*common, "-D", "6", "pong", "waitset"],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        ping = subprocess.run(
            [*common, "-D", "4", "ping", f"{rate:g}Hz", "size", "512", "waitset"],
            env=environment,
            capture_output=True,
            text=True,
            timeout=30,
        )
    finally:
        pong.terminate()
        pong.wait()
    found = _LINE.findall(ping.stdout)
    return f"p50 {found[-1][0]} µs, p99 {found[-1][1]} µs" if found else None

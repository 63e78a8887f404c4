"""What `unicon bench latency` is compared with elsewhere: the paper's table, and one hop in C."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterable

from unicon_ros.bench.report import Bench

ROWS = {"Recv": "recv", "Send": "send", "End-to-end": "state_to_command"}
"""The paper's row to ours."""

DEFINITIONS = (
    "Recv: time to obtain the latest states, here from their stamp on; Send: time to transmit the "
    "command; End-to-end: from the stamp of the states to the send of the command that depends on "
    "them (our state_to_command); mean ± std (p50, p99) in µs"
)

THEIRS = {
    "SDK (sync)": "Recv 1261 ± 150, Send 1011 ± 72, End-to-end 1805 ± 1559",
    "SDK (async)": "Recv –, Send 1001 ± 65, End-to-end 1447 ± 936",
    "ROS 2": "Recv 50 ± 88, Send 587 ± 179, End-to-end 1658 ± 882",
    "UniCon": "Recv 63 ± 15, Send 190 ± 45, End-to-end 732 ± 749",
}
"""The paper's table, on its machine; no p50 and p99 are told."""


def beside_paper(bench: Bench, variants: Iterable[str]) -> None:
    """Add the paper's table, and the same rows of variants that were measured, as facts.

    Args:
        bench: with the cases of the variants, each `VARIANT: ROW`.
        variants: names; those without a command have no such rows and are left out.
    """
    bench.facts["the paper's rows"] = DEFINITIONS
    for name, told in THEIRS.items():
        bench.facts[f"paper, {name}"] = told
    for name in variants:
        if f"{name}: {ROWS['End-to-end']}" in bench.cases:
            rows = [f"{word} {_told(bench, f'{name}: {row}')}" for word, row in ROWS.items()]
            bench.facts[f"here, {name}"] = ", ".join(rows)


def _told(bench: Bench, name: str) -> str:
    case = bench.cases.get(name)
    if case is None:
        return "–"
    numbers = {key: f"{case[key]:.{0 if case[key] >= 20.0 else 1}f}" for key in case}
    return f"{numbers['mean']} ± {numbers['std']} ({numbers['p50']}, {numbers['p99']})"


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

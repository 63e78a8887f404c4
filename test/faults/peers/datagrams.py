"""Sends noise to the ports of DDS for some seconds. Arguments: LOG RUNS_LOG AT.

To those of the first participants of the domain on loopback (RTPS 2.2, section 9.6.1): random
bytes, and random bytes behind the head of a packet of Fast DDS.
"""

from __future__ import annotations

import os
import socket
import sys
import time
from pathlib import Path

import numpy as np

from faults.command_log import FAULT, RECV, CommandLog

PATIENCE = 30.0  # s until the run has begun
LASTS = 1.6  # s
HEAD = b"RTPS\x02\x03\x01\x0f"


def main() -> None:
    """Run until all is sent."""
    log, runs, at = CommandLog(Path(sys.argv[1])), CommandLog(Path(sys.argv[2])), int(sys.argv[3])
    first = 7400 + 250 * int(os.environ["ROS_DOMAIN_ID"])
    ports = (first, *range(first + 10, first + 18))
    rng = np.random.default_rng(at)
    end = time.monotonic() + PATIENCE
    while runs.of(RECV).size <= at and time.monotonic() < end:
        time.sleep(0.002)
    log.add(FAULT)
    count, end = 0, time.monotonic() + LASTS
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        while time.monotonic() < end:
            for port in ports:
                noise = rng.bytes(int(rng.integers(1, 400)))
                out.sendto(HEAD + noise if rng.integers(2) else noise, ("127.0.0.1", port))
                count += 1
            time.sleep(0.002)
    print(f"{count} datagrams", flush=True)


main()

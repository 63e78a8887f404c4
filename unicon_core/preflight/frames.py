"""How often a robot tells: its frames are counted, where its driver speaks the robot's protocol."""

from __future__ import annotations

import time

from unicon_core.platforms.platform import CountsArrivals, WaitsForData
from unicon_core.preflight.result import PreflightResult
from unicon_core.workflow import Program

SECONDS = 0.5
"""For so long they are counted."""
SHARE = 0.5
"""Of the promise that must be kept: a network that loses a few, or a busy machine, is no reason."""
LOOKING = 0.001
"""Between two looks at a platform that cannot wait for them, [s]."""


def tell_frames(program: Program, result: PreflightResult) -> None:
    """Add how often frames come, beside what the robot file promises (`transport.rate_hz`).

    The gate `rate` is content with new data in every tick, and a tick may be ten times slower than
    the robot is: this sees a robot in a slow mode, or a network that loses most of it. A platform
    that does not declare the robot's protocol, such as one over topics, has another rate.

    Args:
        program: whose platform has been received from.
        result: is added to.

    Raises:
        Fault: of the platform.
    """
    platform, transport = program.platform, program.robot.transport
    promised = transport.get("rate_hz")
    if not isinstance(platform, CountsArrivals) or not isinstance(promised, (int, float)):
        return
    if transport.get("protocol") not in platform.facts.protocols:
        return
    platform.recv()  # what had come before
    count, begun = platform.arrivals(), time.perf_counter()
    while time.perf_counter() - begun < SECONDS:
        if isinstance(platform, WaitsForData):
            platform.wait(LOOKING)
        else:
            time.sleep(LOOKING)
        platform.recv()
    hz = (platform.arrivals() - count) / (time.perf_counter() - begun)
    told = f"{hz:.3g} frames a second, {promised:g} are promised"
    good = hz >= SHARE * promised
    if not good:
        told += (
            f"; see whether the robot is in another mode and the network loses frames, or correct "
            f"rate_hz of {program.robot.path.name}"
        )
    result.add("frames", good, told)

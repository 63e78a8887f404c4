"""A headset without a headset: an operator of arithmetic shows up at the page of block `webxr`.

    unicon run g1_vr                                      # in one terminal
    python examples/emulated_headset.py                   # in another one: takes hold after 2 s
    python examples/emulated_headset.py --hands           # bare hands, which open and close

It sends the bytes that the page in a headset sends (unicon_hardware/peripherals/webxr/webxr.py),
at 72 Hz: both hands go in circles while the clutch is closed, and the left thumbstick walks.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import time

import numpy as np
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from unicon_hardware.peripherals.webxr.webxr import ANSWER, BUTTONS, FRAME, PARTS, PING

SIDES = ("left", "right")
FINGERS = {"thumb": (0.02, 0.04, -0.01), "index": (0.09, 0.025, 0.0), "middle": (0.095, 0.0, 0.0)}
FINGERS |= {"ring": (0.09, -0.02, 0.0), "pinky": (0.08, -0.04, 0.0)}
"""Where the fingers of a left hand begin, in [m] from the wrist: x to the tips, y to the thumb."""
BONES = {"thumb": (0.035, 0.03, 0.025)}
"""Lengths behind that in [m]; of other fingers 0.045, 0.027, 0.022."""


class Operator:
    """Where head and hands are at a time, in our axes: x forward, y left, z up.

    Args:
        hands: bare hands in place of controllers.
        radius: of the circles in [m].
        frequency: of the circles in [Hz].
        forward: push of the left thumbstick, 0 to 1, a second behind `begin`.
        begin: when the clutch is closed, in [s].
        ahead: how far hands go ahead first, off the robot's thighs, and up by half of it, in [m].
    """

    def __init__(
        self,
        hands: bool,
        radius: float,
        frequency: float,
        forward: float,
        begin: float = 2.0,
        ahead: float = 0.0,
    ) -> None:
        self.hands, self.radius, self.frequency = hands, radius, frequency
        self.forward, self.begin, self.ahead = forward, begin, ahead

    def place(self, side: int, t: float) -> tuple[float, float, float]:
        """Return where a hand is at a time, in [m]: ahead of the thighs it circles across."""
        beyond = max(0.0, t - self.begin - 0.5)
        ahead = self.ahead * min(1.0, 0.5 * beyond)
        radius = self.radius * min(1.0, 0.5 * beyond)
        phase = 2.0 * math.pi * self.frequency * beyond
        sign = 1.0 - 2.0 * side
        y, z = radius * math.sin(phase), radius * (1.0 - math.cos(phase))
        return 0.35 + ahead, sign * (0.2 + y), 1.1 + 0.5 * ahead + z

    def closed(self, t: float) -> bool:
        """Return whether the clutch is; bare hands close it for a moment, for `toggle`."""
        return self.begin <= t and (not self.hands or t < self.begin + 0.3)

    def joints(self, side: int, t: float) -> np.ndarray:
        """Return the poses of a bare hand's joints, shape (25, 7); it opens and closes."""
        poses = np.tile(np.array([0, 0, 0, 1, 0, 0, 0], np.float32), (25, 1))
        sign = 1.0 - 2.0 * side
        bend = 0.6 - 0.6 * math.cos(2.0 * math.pi * 0.25 * max(0.0, t - self.begin - 2.0))
        row = 1
        for finger, (x, y, z) in FINGERS.items():
            if finger != "thumb":
                poses[row, :3] = 0.3 * x, -sign * y, z  # metacarpal
                row += 1
            at, angle = np.array([x, -sign * y, z]), 0.0
            poses[row, :3] = at
            for bone in BONES.get(finger, (0.045, 0.027, 0.022)):
                angle += bend if finger != "thumb" else 0.4 * bend
                at = at + bone * np.array([math.cos(angle), 0.0, -math.sin(angle)])
                row += 1
                poses[row, :3] = at
                poses[row, 3:] = math.cos(0.5 * angle), 0.0, math.sin(0.5 * angle), 0.0
            row += 1
        if self.closed(t):
            poses[19, :3] = poses[4, :3] + (0.0, 0.0, 0.01)  # the ring finger meets the thumb
        poses[:, :3] += self.place(side, t)
        return poses

    def frame(self, number: int, t: float, page_ms: float) -> bytes:
        """Return the message of a time."""
        made = np.zeros((), FRAME)
        made["version"], made["number"], made["time"] = 1, number, page_ms
        poses = np.tile(np.array([0, 0, 0, 1, 0, 0, 0], np.float32), (55, 1))
        poses[PARTS["head"], :3] = 0.0, 0.0, 1.6
        tracked = ["head"]
        for side, name in enumerate(SIDES):
            part = f"{name}_hand" if self.hands else f"{name}_controller"
            tracked.append(part)
            if self.hands:
                poses[PARTS[part]] = self.joints(side, t)
            else:
                poses[PARTS[part], :3] = self.place(side, t)
                made["buttons"][side, BUTTONS.index("squeeze")] = float(self.closed(t))
        if not self.hands and t > self.begin + 1.0:
            made["axes"][0, 3] = -self.forward  # thumbstick y is positive to the back
        made["flags"] = sum(1 << list(PARTS).index(part) for part in tracked)
        made["poses"] = theirs(poses)
        return made.tobytes()


def theirs(poses: np.ndarray) -> np.ndarray:
    """Return poses in WebXR's axes, x right, y up, z back, quaternion xyzw; shape (…, 7)."""
    turned = np.empty_like(poses)
    for at, ours in ((0, poses[..., :3]), (3, poses[..., 4:])):
        turned[..., at], turned[..., at + 1] = -ours[..., 1], ours[..., 2]
        turned[..., at + 2] = -ours[..., 0]
    turned[..., 6] = poses[..., 3]
    return turned


async def show_up(
    address: str, operator: Operator, seconds: float, rate: float = 72.0, patience: float = 20.0
) -> int:
    """Send frames until the time is over or the page goes; return how many were sent."""
    began = time.monotonic()
    while True:
        try:
            socket = await connect(
                address.replace("http", "ws", 1).rstrip("/") + "/poses",
                origin=address.rstrip("/"),
                compression=None,
            )
            break
        except OSError:
            if time.monotonic() - began > patience:
                raise
            await asyncio.sleep(0.1)
    start = time.monotonic()

    async def answer() -> None:
        async for data in socket:
            if len(data) == PING.size:
                await socket.send(ANSWER.pack(*PING.unpack(data), 1e3 * (time.monotonic() - start)))

    answering = asyncio.ensure_future(answer())
    sent = 0
    try:
        while (t := time.monotonic() - start) < seconds:
            await socket.send(operator.frame(sent, t, 1e3 * (time.monotonic() - start)))
            sent += 1
            await asyncio.sleep(max(0.0, start + sent / rate - time.monotonic()))
    except ConnectionClosed:
        pass
    finally:
        answering.cancel()
        await socket.close()
    return sent


def main() -> None:
    """Show up, and say how many frames were sent."""
    parser = argparse.ArgumentParser(description="An operator of arithmetic for block webxr.")
    parser.add_argument("--address", default="http://127.0.0.1:8443/")
    parser.add_argument("--hands", action="store_true", help="bare hands, not controllers")
    parser.add_argument("--radius", type=float, default=0.06, help="of the circles in [m]")
    parser.add_argument("--frequency", type=float, default=0.4, help="of the circles in [Hz]")
    parser.add_argument("--forward", type=float, default=0.0, help="left thumbstick, 0 to 1")
    parser.add_argument("--begin", type=float, default=2.0, help="when it takes hold, in [s]")
    parser.add_argument("--ahead", type=float, default=0.22, help="hands before that, in [m]")
    parser.add_argument("--seconds", type=float, default=20.0)
    given = parser.parse_args()
    shape = given.radius, given.frequency, given.forward, given.begin, given.ahead
    operator = Operator(given.hands, *shape)
    sent = asyncio.run(show_up(given.address, operator, given.seconds))
    print(f"{sent} frames were sent")


if __name__ == "__main__":
    main()

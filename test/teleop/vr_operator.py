"""An operator of numbers, for tests: writes a headset's states and ticks `teleop`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from unicon_core.robots import load_robot
from unicon_core.states import States, StateSpec
from unicon_core.workflow.autowire import BuildContext, autowire
from unicon_hardware.peripherals.webxr.webxr import BUTTONS, PARTS, webxr
from unicon_manipulation.headset import HeadsetControls
from unicon_manipulation.teleop.operator import FINGERS
from unicon_manipulation.teleop.teleop import Teleop

PERIOD = 0.02
BOX = [[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]
OURS = (0.25, 0.2, 0.1, 1.0, 0.0, 0.0, 0.0)
"""Where the robot's left hand is at first; the right one is at -y."""


class Operator:
    """A headset that is heard, whose hands are where a test puts them."""

    def __init__(self, period: float = PERIOD, **options: Any) -> None:
        self.period = period
        given = {"box": BOX, **options}
        names = [given.get("left", "left_hand"), given.get("right", "right_hand")]
        specs = {
            **webxr.declares(),  # type: ignore[attr-defined]
            **HeadsetControls.declares(),
            **Teleop.declares(**given),
            **{f"{name}_pose": StateSpec((7,)) for name in names if name},
            "stamp_ns": StateSpec((), "int64"),
        }
        self.states = States(specs)
        self.context = BuildContext(self.states, load_robot("go2"), period)
        self.tick: Any = autowire(Teleop, "teleop", self.context, given).tick
        for name, side in zip(names, (1.0, -1.0)):
            if name:
                self.states[f"{name}_pose"][...] = OURS
                self.states[f"{name}_pose"][1] *= side
        self.stamp, self.age = 1_000_000_000, 0.01
        self.states["webxr_head"][...] = (0.0, 0.0, 1.6, 1.0, 0.0, 0.0, 0.0)
        self.heard(True)
        self.track("head")

    def heard(self, yes: bool) -> None:
        """Come, or go."""
        self.states["webxr_alive"] = int(yes)

    def track(self, *parts: str, lost: tuple[str, ...] = ()) -> None:
        """Have these parts tracked, and those not."""
        valid = self.states["webxr_valid"]
        for names, value in ((parts, 1), (lost, 0)):
            for name in names:
                valid[list(PARTS).index(name)] = value

    def controller(
        self,
        position: tuple[float, ...] = (0.3, 0.2, 1.0),
        quat: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0),
        side: str = "left",
    ) -> None:
        """Put a controller somewhere."""
        self.states[f"webxr_{side}_controller"][...] = (*position, *quat)
        self.track(f"{side}_controller")

    def press(self, value: float = 1.0, button: str = "squeeze", side: str = "left") -> None:
        """Press a button so far."""
        self.states[f"webxr_{side}_buttons"][BUTTONS.index(button)] = value

    def hand(
        self,
        position: tuple[float, ...] = (0.3, 0.2, 1.0),
        pinched: bool = False,
        side: str = "left",
        finger: str = "ring",
    ) -> None:
        """Put a bare hand somewhere: all of its joints, but the thumb's tip."""
        joints = self.states[f"webxr_{side}_hand"]
        joints[:, :3] = position
        joints[:, 3:] = (1.0, 0.0, 0.0, 0.0)
        joints[4, 0] += 0.1
        joints[FINGERS[finger], :3] = joints[4, :3]
        joints[FINGERS[finger], 1] += 0.01 if pinched else 0.08
        self.track(f"{side}_hand")

    def go(self, ticks: int = 1, frame: bool = True) -> None:
        """Tick; with a new frame of the headset in each, or with none."""
        states = self.states
        for _ in range(ticks):
            states["stamp_ns"] += round(1e9 * self.period)
            if frame:
                self.stamp += round(1e9 * self.period)
                self.age = 0.01
            else:
                self.age += self.period
            states["webxr_stamp_ns"] = self.stamp
            states["webxr_age"] = self.age
            self.tick()

    def engage(self, side: str = "left") -> None:
        """Take hold, with a controller that is open at first."""
        self.press(0.0, side=side)
        self.go()
        self.press(1.0, side=side)
        self.go()
        assert self.engaged(side)

    def engaged(self, side: str = "left") -> bool:
        """Return whether the clutch is."""
        return bool(self.states["teleop_engaged"][("left", "right").index(side)])

    def target(self, name: str = "left_hand") -> np.ndarray:
        """Return a copy of a target."""
        return np.array(self.states[f"{name}_target"], np.float64)

    def velocity(self, name: str = "left_hand") -> np.ndarray:
        """Return a copy of a target's velocity."""
        return np.array(self.states[f"{name}_target_velocity"], np.float64)


def turned(axis: tuple[float, float, float], angle: float) -> tuple[float, ...]:
    """Return the quaternion wxyz of a turn."""
    s = math.sin(0.5 * angle)
    return (math.cos(0.5 * angle), *(s * v for v in axis))


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """Return the angle between two quaternions in [rad]."""
    return 2.0 * math.acos(min(1.0, abs(float(np.dot(a, b)))))

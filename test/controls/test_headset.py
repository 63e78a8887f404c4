"""`headset_controls`: a headset's controllers as sticks and buttons; nothing while it is gone."""

from __future__ import annotations

import math

import numpy as np
import pytest

from unicon_base.errors import WorkflowError
from unicon_core.blocks.velocity_command import Drive
from unicon_core.states import States, StateSpec
from unicon_core.states.standard import BUTTONS
from unicon_hardware.peripherals.webxr.webxr import BUTTONS as THEIRS
from unicon_hardware.peripherals.webxr.webxr import PARTS, webxr
from unicon_manipulation.headset import HeadsetControls

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "stand_in"


class Rig:
    """A headset's states, and the block behind them."""

    def __init__(self) -> None:
        specs = {**webxr.declares(), **HeadsetControls.declares()}  # type: ignore[attr-defined]
        self.states = States({**specs, "velocity_command": StateSpec((3,))})
        controls = [self.states[name] for name in ("sticks", "buttons", "controls_alive")]
        self.tick = HeadsetControls(*controls, states=self.states)
        self.drive = Drive(*controls, self.states["velocity_command"], speed=(1.0, 0.5, 2.0))
        self.states["webxr_alive"] = 1

    def go(self, *tracked: str) -> None:
        self.states["webxr_valid"][...] = [part in tracked for part in PARTS]
        self.tick()
        self.drive()

    def pressed(self) -> set[str]:
        return {name for name, value in zip(BUTTONS, self.states["buttons"]) if value}


def test_thumbsticks_drive_and_let_go_when_the_headset_goes():
    rig = Rig()
    rig.states["webxr_left_axes"][...] = (0.0, 0.0, 1.0, -1.0)  # right, ahead
    rig.states["webxr_right_axes"][...] = (0.0, 0.0, -1.0, 0.0)
    rig.go("left_controller", "right_controller")
    np.testing.assert_array_equal(rig.states["sticks"], [1.0, 1.0, -1.0, 0.0])
    np.testing.assert_allclose(rig.states["velocity_command"], [1.0, -0.5, 2.0])
    rig.go("left_controller")
    np.testing.assert_allclose(rig.states["velocity_command"], [1.0, -0.5, 0.0])
    rig.go("left_hand", "right_hand")
    assert (rig.states["velocity_command"] == 0.0).all()
    rig.go("left_controller", "right_controller")
    rig.states["webxr_alive"] = 0
    rig.go("left_controller", "right_controller")
    assert (rig.states["velocity_command"] == 0.0).all()
    assert rig.states["controls_alive"] == 0


def test_what_is_not_a_number_pushes_nothing():
    rig = Rig()
    rig.states["webxr_left_axes"][...] = math.nan
    rig.states["webxr_right_axes"][...] = (0.0, 0.0, 40.0, 0.0)
    rig.go("left_controller", "right_controller")
    np.testing.assert_array_equal(rig.states["sticks"], [0.0, 0.0, 1.0, 0.0])


def test_buttons_have_the_names_of_their_places():
    rig = Rig()
    for side, expected in (
        ("left", {"squeeze": "L1", "trigger": "L2", "thumbstick": "F1", "a": "X", "b": "Y"}),
        ("right", {"squeeze": "R1", "trigger": "R2", "thumbstick": "F2", "a": "A", "b": "B"}),
    ):
        for theirs, ours in expected.items():
            rig.states[f"webxr_{side}_buttons"][...] = [name == theirs for name in THEIRS]
            rig.go("left_controller", "right_controller")
            assert rig.pressed() == {ours}
            rig.states[f"webxr_{side}_buttons"][...] = 0.0
    rig.tick.reset()
    assert rig.pressed() == set()


def test_a_device_that_is_not_there_is_told():
    states = States(HeadsetControls.declares())  # type: ignore[attr-defined]
    controls = [states[name] for name in ("sticks", "buttons", "controls_alive")]
    with pytest.raises(WorkflowError, match="no state 'vive_alive'; list the device"):
        HeadsetControls(*controls, states=states, device="vive")

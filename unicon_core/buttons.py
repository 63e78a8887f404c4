"""Buttons of a remote, gamepad or keyboard."""

from __future__ import annotations

from typing import Literal, get_args

Button = Literal[
    "R1",
    "L1",
    "start",
    "select",
    "R2",
    "L2",
    "F1",
    "F2",
    "A",
    "B",
    "X",
    "Y",
    "up",
    "right",
    "down",
    "left",
]
BUTTONS: tuple[Button, ...] = get_args(Button)
"""The elements of `buttons`, in the order of Unitree's remote."""

"""Checks of a robot file's models and transport, for the validator."""

from __future__ import annotations

from pathlib import PurePath
from typing import Any

from unicon_core.located_yaml import Located, Where
from unicon_core.robots.checks import (
    Problems,
    check_keys,
    check_mapping,
    check_number,
    check_one_of,
    check_text,
    wrong,
)
from unicon_core.robots.robot import MODEL_FORMATS
from unicon_core.states.standard import BUTTONS

# position: the vendor closes the loop, so that there are no gains to give.
COMMANDS = ("position", "torque")


def check_models(located: Located, models: Any) -> Problems:
    """Paths below the file's folder or a configuration folder; a workflow may name any."""
    remedy = "write {mjcf: PATH, urdf: PATH}, {} where there is none"
    if not isinstance(models, dict):
        yield from check_mapping(located, ("models",), models, remedy)
        return
    yield from check_keys(located, ("models",), models, (), MODEL_FORMATS)
    for kind in MODEL_FORMATS:
        if kind in models:
            yield from _model(located, kind, models[kind])


def _model(located: Located, kind: str, model: Any) -> Problems:
    where: Where = ("models", kind)
    if not isinstance(model, str) or not model.strip():
        yield from check_text(located, where, model)
        return
    path = PurePath(model.removeprefix("assets:"))
    if path.is_absolute() or ".." in path.parts or model.startswith("~"):
        yield wrong(
            located,
            where,
            f"{model!r} leads out of its folder; put it beside the robot file, or let the "
            "workflow name it: scene: {model: PATH}",
        )
    if path.suffix and (path.suffix.lower() == ".urdf") != (kind == "urdf"):
        other = "mjcf" if kind == "urdf" else "urdf"
        yield wrong(located, where, f"{model!r} does not look so; write {other}: …")


def check_transport(located: Located, transport: Any) -> Problems:
    if not isinstance(transport, dict):
        yield from check_mapping(located, ("transport",), transport, "write {protocol: …, …}")
        return
    if "protocol" not in transport:
        yield located.error(
            ("transport",), "transport: missing key 'protocol'; add it, null where not known"
        )
    elif transport["protocol"] is not None:
        yield from check_text(located, ("transport", "protocol"), transport["protocol"])
    command = transport.get("command", "torque")
    yield from check_one_of(located, ("transport", "command"), command, COMMANDS)
    yield from _finite(located, ("transport",), transport)
    buttons = transport.get("stop_buttons")
    if buttons is not None and not (
        isinstance(buttons, list) and buttons and all(name in BUTTONS for name in buttons)
    ):
        yield wrong(
            located,
            ("transport", "stop_buttons"),
            f"is {str(buttons)[:60]}; write a list of {', '.join(BUTTONS)}, or null if not known",
        )
    motors = transport.get("motors")
    numbers = isinstance(motors, list) and all(type(n) is int and n >= 0 for n in motors)
    if motors is not None and not numbers:
        yield wrong(
            located,
            ("transport", "motors"),
            f"is {str(motors)[:60]}; write the motor number of each joint, or null if not known",
        )
    rate = transport.get("rate_hz")
    is_number = isinstance(rate, (int, float)) and not isinstance(rate, bool)
    if rate is not None and not is_number:
        yield from check_number(located, ("transport", "rate_hz"), rate)
    elif rate is not None and rate <= 0:
        yield wrong(
            located, ("transport", "rate_hz"), f"{rate} is not above 0; write null if not known"
        )


def _finite(located: Located, where: Where, value: Any) -> Problems:
    """No figure of a transport is NaN or infinite, however deep: it would go to the motors."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _finite(located, (*where, key), part)
    elif isinstance(value, list):
        for i, part in enumerate(value):
            yield from _finite(located, (*where, i), part)
    elif isinstance(value, float):
        yield from check_number(located, where, value)

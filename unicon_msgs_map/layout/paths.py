"""Paths and references of mapping files, parsed once: for the mapping's reader and the layouts.

On the message side (keys of `fields`):

    header.stamp  twist.twist.linear  position            fields, nested
    axes[1]  motor_state[:12].q  data[3:6]  points[0].positions   elements and half-open slices
    transforms[child_frame_id=base_link].transform        the element whose field has that text
                                                          (subscriptions only)

On our side (values of `fields`):

    joint_pos  velocity_command[0]  joint_pos[3:6]        a state, one element, a slice
    joint_pos[FR_hip_joint]                               the element of that name
    $joint_names                                          a variable given at build time
    =base_link  =0.01  0.01  true  [0, 0, 1]              a constant: text after `=`, or a YAML
                                                          number, boolean or list
"""

from __future__ import annotations

import re
from dataclasses import dataclass

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_STEP = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)(?:\[([^\[\]]*)\])?(?:\.|\Z)")
_REFERENCE = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)(?:\[([^\[\]]*)\])?\Z")
_NUMBER = re.compile(r"[0-9]{1,6}\Z")
_SLICE = re.compile(r"([0-9]{0,6}):([0-9]{0,6})\Z")


class PathError(ValueError):
    """A path or reference does not parse; the caller knows the file and adds it."""


@dataclass(frozen=True)
class Key:
    """Selects the element whose string `field` equals `value`."""

    field: str
    value: str


# One element, a half-open range (stop None: to the end), or a key.
Selector = int | tuple[int, int | None] | Key
# Steps of field name and selector (None: the whole field).
Path = tuple[tuple[str, Selector | None], ...]


@dataclass(frozen=True)
class Reference:
    """What stands on our side of a field.

    Attributes:
        kind: `state`, `variable` or `const`.
        name: of the state or variable; empty for a constant.
        index: element, range or element name of a state; None is the whole.
        value: of a constant: text, number, boolean or list of them.
    """

    kind: str
    name: str = ""
    index: int | tuple[int, int | None] | str | None = None
    value: object = None

    def __str__(self) -> str:
        if self.kind == "const":
            return f"={self.value}"
        mark = "$" if self.kind == "variable" else ""
        if self.index is None:
            return mark + self.name
        if isinstance(self.index, tuple):
            start, stop = self.index
            return f"{mark}{self.name}[{start or ''}:{'' if stop is None else stop}]"
        return f"{mark}{self.name}[{self.index}]"


def parse_path(text: str) -> Path:
    """Parse a message path.

    Raises:
        PathError: it does not parse.
    """
    steps: list[tuple[str, Selector | None]] = []
    position = 0
    while position < len(text):
        match = _STEP.match(text, position)
        if match is None:
            break
        steps.append((match[1], _selector(match[2], text)))
        position = match.end()
    if not steps or position < len(text) or text.endswith("."):
        raise PathError(
            f"message path {text!r} does not parse; write it like header.stamp, axes[1], "
            "motor_state[:12].q or transforms[child_frame_id=base_link].transform"
        )
    return tuple(steps)


def parse_reference(value: object) -> Reference:
    """Parse a state reference, `$variable` or constant.

    Raises:
        PathError: it does not parse.
    """
    if not isinstance(value, str):
        return Reference("const", value=value)
    if value.startswith("="):
        return Reference("const", value=value[1:])
    mark = value.startswith("$")
    match = _REFERENCE.match(value[1:] if mark else value)
    if match is None or (mark and match[2] is not None):
        raise PathError(
            f"{value!r} does not parse; write a state such as joint_pos, velocity_command[0] or "
            "joint_pos[3:6], a variable such as $joint_names, or a constant such as =base_link"
        )
    if mark:
        return Reference("variable", match[1])
    return Reference("state", match[1], _index(match[2], value))


def _selector(text: str | None, path: str) -> Selector | None:
    if text is None:
        return None
    if "=" in text:
        field, _, value = text.partition("=")
        if _NAME.fullmatch(field.strip()):
            return Key(field.strip(), value.strip())
    else:
        index = _index(text, path)
        if not isinstance(index, str):
            return index
    raise PathError(
        f"[{text}] in message path {path!r} selects nothing; write [3], [:12] or [field=text]"
    )


def _index(text: str | None, whole: str) -> int | tuple[int, int | None] | str | None:
    if text is None:
        return None
    text = text.strip()
    if _NUMBER.match(text):
        return int(text)
    match = _SLICE.match(text)
    if match:
        start, stop = int(match[1] or 0), int(match[2]) if match[2] else None
        if stop is not None and stop <= start:
            raise PathError(f"[{text}] in {whole!r} is an empty range; stop must exceed start")
        return (start, stop)
    if not text or text.startswith("-") or text.replace(":", "").isdigit():
        raise PathError(f"[{text}] in {whole!r} selects nothing; count from 0, as in [3] or [:12]")
    return text

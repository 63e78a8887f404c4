"""The code behind `Encoder.encode`: slots of a template become one flat Python function.

Up to eight numbers of a field go through `struct` (`packs.py`), longer arrays through a copy
(`copies.py`). This is `joint_states` of the default map, whose constants stand in `buffer`:

    def encode():
        # 428 bytes
        v_stamp_ns_0 = in_stamp_ns[0]
        v_stamp_ns_0_sec, v_stamp_ns_0_nanosec = divmod(v_stamp_ns_0, 1000000000)
        pack0(buffer, 4, v_stamp_ns_0_sec & 0xffffffff, v_stamp_ns_0_nanosec)
        into0[...] = from0  # joint_pos, joint_vel, joint_effort
        return bytes(buffer)
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping

from unicon_core.generated import define
from unicon_msgs_map.codec.binding import Bound
from unicon_msgs_map.codec.copies import Copy, as_copy, copy_lines
from unicon_msgs_map.codec.packs import Packs
from unicon_msgs_map.layout.template import Slot, Template


def generate(
    template: Template,
    bounds: Mapping[int, Bound],
    checksum: Callable[[], int] | None = None,
) -> tuple[Callable[[], bytes], str]:
    """Return the encode function and its source.

    Args:
        template: bytes and slots.
        bounds: state per field number.
        checksum: computes the last four bytes from the others, where the message has one.
    """
    copies: list[Copy] = []
    scalars: list[Slot] = []
    for key, slots in _by_field(template.slots).items():
        found = as_copy(slots, bounds[key[0]])
        if found is None:
            scalars += slots
        else:
            copies.append(found)
    writer = Packs(template, bounds)
    body = writer.loads(scalars)
    if copies or checksum:
        body += writer.packs_into(scalars)
        lines, names = copy_lines(copies, template.data)
        writer.space |= names
        body += lines
        if checksum:
            writer.space |= {"checksum": checksum, "sign": struct.Struct("<I").pack_into}
            body.append(f"sign(buffer, {len(template.data) - 4}, checksum())")
        body.append("return bytes(buffer)")
    else:
        body.append(f"return {writer.pack(scalars)}")
    head = ["def encode():", f"    # {len(template.data)} bytes"]
    source = "\n".join(head + ["    " + line for line in body]) + "\n"
    encode: Callable[[], bytes] = define(source, writer.space, "<encode>")["encode"]
    return encode, source


def _by_field(slots: list[Slot]) -> dict[tuple[int, str], list[Slot]]:
    groups: dict[tuple[int, str], list[Slot]] = {}
    for slot in slots:
        key = (slot.source, slot.primitive.name if slot.primitive else slot.kind)
        groups.setdefault(key, []).append(slot)
    return groups

"""Mutations of files for the fuzz: of parsed YAML trees, of text, of bytes and of ONNX messages."""

from __future__ import annotations

import copy
import math
import random
import struct
import zlib
from typing import Any

import yaml

from unicon_lab.recording.records import CHUNK, CHUNK_HEAD

__all__ = ["mutate_bytes", "mutate_mcap", "mutate_onnx", "mutate_text", "mutate_tree", "to_text"]

SENTINEL = "unicon_pwned"
"""A file of this name appears in the working folder where something of a file was executed."""

CODE = (
    f'x""";open("{SENTINEL}","w").write("hi");"""',
    f"x';open('{SENTINEL}','w').write('hi');'",
    f"x\"); open('{SENTINEL}', 'w').close(); (\"",
    f"__import__('os').system('touch {SENTINEL}')",
    f"a\n    open('{SENTINEL}', 'w')",
    f"$(touch {SENTINEL})",
    f"{{open('{SENTINEL}','w')}}",
    "os:system",
    "subprocess:Popen",
    "builtins:exec",
    "().__class__.__base__.__subclasses__()",
    "tick.__class__",
)
NUMBERS: tuple[Any, ...] = (
    0, -1, 1, 2, 3, 0.5, -0.0, 1e-30, -1e30, 1e308, 5e-324, math.nan, math.inf, -math.inf,
    2**31, 2**31 - 1, 2**32, 2**63, 2**63 - 1, -(2**63), 2**64 - 1, 10**400, 99999, 1000000, True,
)  # fmt: skip
TEXTS: tuple[Any, ...] = (
    "", " ", "x", "tick", "None", "nan", "inf", "1:30", "0100", "0o17", "1_000", ".inf", "yes",
    "2020-99-99", "~", "*", ".*", "(", "[", "=", "=x", "$x", "$joint_names", "a/b", "//", "/x",
    "..", "../x", "../../../../etc/passwd", "/etc/passwd", "/dev/zero", "/dev/stdin", "~/x",
    "assets:../x", "robot_descriptions:os", "x" * 300, "x" * 20000, "9" * 400, "9" * 5000,
    "9**9**9", "not " * 500 + "tick", "-" * 100000 + "1", "(" * 300, "tick" + " + tick" * 400,
    "a\x00b", "a\x07b", "a\x1b[2J", "\u2028", "\u202e", "é", "日本", "\U0001f600", "\r\n",
    "policy:x", "joint_pos[999]", "joint_pos[0:99999999]", "9.9e999", "99999999.2f", "%n", "{0}",
)  # fmt: skip
OTHERS: tuple[Any, ...] = (
    None, [], {}, [None], ["a"], [[]], [{}], {"a": 1}, {"": None}, [1, 2, 3],
)  # fmt: skip
SNIPPETS = (
    "&a [*a]", "*nobody", "!!python/object/apply:os.system ['x']", "!!python/tuple [1]",
    "!!set {a}", "!!binary x", "1:30", "0100", "0o777", "1_000", "<<: {a: 1}", "? [a]\n: b", "---",
    "%YAML 1.1", "\t", "'", '"', "{", "]", "- - - -", "[" * 200, "9" * 500, ".nan", "!!float x",
    "|",
    ">", "a: b: c",
)  # fmt: skip


def hostile(dice: random.Random) -> Any:
    """Return a value that no file should hold."""
    kind = dice.randrange(8)
    if kind < 3:
        return dice.choice(NUMBERS)
    if kind < 5:
        return dice.choice(TEXTS)
    if kind == 5:
        return copy.deepcopy(dice.choice(OTHERS))
    if kind == 6:
        return dice.choice(CODE)
    value: Any = dice.choice((1, "x", None))
    for _ in range(dice.choice((1, 3, 10, 60, 200))):
        value = [value] if dice.random() < 0.5 else {"a": value}
    return value


def places(tree: Any, limit: int = 4000) -> list[tuple[Any, Any]]:
    """Return each container of a tree with each of its keys."""
    found: list[tuple[Any, Any]] = []
    todo = [tree]
    while todo and len(found) < limit:
        here = todo.pop()
        if isinstance(here, dict):
            found += [(here, key) for key in here]
            todo += here.values()
        elif isinstance(here, list):
            found += [(here, i) for i in range(len(here))]
            todo += here
    return found


def mutate_tree(tree: Any, dice: random.Random) -> Any:
    """Return a copy of a tree with one to four changes."""
    tree = copy.deepcopy(tree)
    for _ in range(dice.choice((1, 1, 1, 2, 4))):
        spots = places(tree)
        if not spots:
            return hostile(dice)
        owner, key = dice.choice(spots)
        kind = dice.randrange(10)
        if kind < 4:
            owner[key] = hostile(dice)
        elif kind == 4:
            del owner[key]
        elif kind == 5:
            owner[key] = copy.deepcopy(dice.choice(spots)[0])
        elif kind == 6 and isinstance(owner, dict):
            owner[dice.choice((*TEXTS, *CODE, 1, -1, "unknown"))] = owner[key]
        elif kind == 6:
            owner.insert(key, copy.deepcopy(owner[key]))
        elif kind == 7 and isinstance(owner[key], (int, float)):
            factor = dice.choice((-1, 0, 2, 1e9, 1e-9))
            try:
                owner[key] = owner[key] * factor
            except OverflowError:
                owner[key] = 0
        elif kind == 8 and isinstance(owner, dict):
            other = dice.choice(list(owner))
            owner[key], owner[other] = owner[other], owner[key]
        elif isinstance(owner[key], str):
            text = owner[key]
            at = dice.randrange(len(text) + 1)
            owner[key] = text[:at] + dice.choice((*TEXTS[:30], *CODE)) + text[at:]
        else:
            owner[key] = [owner[key]] * dice.choice((1, 2, 5))
    return tree


class _Dumper(yaml.SafeDumper):
    """Writes shared values out in full; cycles cannot occur."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def to_text(tree: Any) -> str:
    """Return a tree as YAML."""
    return yaml.dump(tree, Dumper=_Dumper, sort_keys=False, allow_unicode=True)


def mutate_text(text: str, dice: random.Random) -> str:
    """Return YAML text with snippets put in, lines moved, doubled or dropped."""
    lines = text.split("\n")
    for _ in range(dice.choice((1, 1, 2, 3))):
        at = dice.randrange(len(lines))
        kind = dice.randrange(6)
        if kind == 0:
            lines[at] += " " + dice.choice(SNIPPETS)
        elif kind == 1:
            before, colon, _ = lines[at].partition(":")
            lines[at] = f"{before}{colon} {dice.choice(SNIPPETS)}"
        elif kind == 2:
            lines.insert(at, lines[at])
        elif kind == 3:
            del lines[at]
            lines = lines or [""]
        elif kind == 4:
            lines[at] = " " * dice.randrange(9) + lines[at].lstrip()
        else:
            other = dice.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
    return "\n".join(lines)


def mutate_bytes(raw: bytes, dice: random.Random) -> bytes:
    """Return bytes that were cut, stretched, doubled or flipped."""
    data = bytearray(raw)
    for _ in range(dice.choice((1, 1, 2, 8))):
        at = dice.randrange(len(data)) if data else 0
        kind = dice.randrange(6)
        if kind == 0:
            del data[at:]
        elif kind == 1 and data:
            data[at] ^= 1 << dice.randrange(8)
        elif kind == 2 and data:
            data[at] = dice.randrange(256)
        elif kind == 3:
            del data[at : at + dice.randrange(1, 40)]
        elif kind == 4:
            data[at:at] = dice.randbytes(dice.randrange(1, 20))
        else:
            data[at:at] = data[at : at + dice.randrange(1, 200)]
    return bytes(data)


def mutate_mcap(raw: bytes, dice: random.Random) -> bytes:
    """Change one record of a recording; a chunk's checksum is made right again."""
    at, records = 8, []
    while at + 9 <= len(raw) - 8:
        opcode, length = struct.unpack_from("<BQ", raw, at)
        records.append((at, opcode, length))
        at += 9 + length
    at, opcode, length = dice.choice(records)
    body, rest = raw[at + 9 : at + 9 + length], raw[at + 9 + length :]
    if opcode == CHUNK and dice.random() < 0.8:
        head = list(CHUNK_HEAD.unpack_from(raw, at))
        inner = mutate_bytes(raw[at + CHUNK_HEAD.size : at + 9 + length], dice)
        head[4], head[5], head[7] = len(inner), zlib.crc32(inner), len(inner)
        body = CHUNK_HEAD.pack(*head)[9:] + inner
    else:
        body = mutate_bytes(body, dice)
    told = len(body) if dice.random() < 0.8 else dice.choice((0, 1, length + 1, 1 << 31, 1 << 63))
    kind = opcode if dice.random() < 0.8 else dice.randrange(256)
    return raw[:at] + struct.pack("<BQ", kind, told) + body + rest


def mutate_onnx(raw: bytes, dice: random.Random) -> bytes:
    """Return an ONNX model with fields of its messages changed."""
    import onnx

    model = onnx.ModelProto()
    model.ParseFromString(raw)
    for _ in range(dice.choice((1, 1, 2, 4))):
        message: Any = model
        for _ in range(dice.randrange(1, 9)):
            inner = [
                child
                for field, value in message.ListFields()
                for child in (value if _repeated(field) else [value])
                if hasattr(child, "ListFields")
            ]
            if not inner or dice.random() < 0.15:
                break
            message = dice.choice(inner)
        _change(message, dice)
    return model.SerializeToString()


def _repeated(field: Any) -> bool:
    return bool(field.is_repeated if hasattr(field, "is_repeated") else field.label == 3)


def _change(message: Any, dice: random.Random) -> None:
    fields = list(message.DESCRIPTOR.fields)
    present = [field for field, _ in message.ListFields()]
    field = dice.choice(present if present and dice.random() < 0.8 else fields)
    name = field.name
    try:
        if dice.random() < 0.2:
            message.ClearField(name)
        elif field.message_type is not None:
            if _repeated(field):
                items = getattr(message, name)
                if len(items) and dice.random() < 0.5:
                    items.append(dice.choice(list(items)))
                elif len(items):
                    del items[dice.randrange(len(items))]
                else:
                    items.add()
            else:
                getattr(message, name).SetInParent()
        else:
            value = _scalar(field, dice)
            if _repeated(field):
                items = getattr(message, name)
                if len(items) and dice.random() < 0.7:
                    items[dice.randrange(len(items))] = value
                else:
                    items.append(value)
            else:
                setattr(message, name, value)
    except (TypeError, ValueError):
        message.ClearField(name)


def _scalar(field: Any, dice: random.Random) -> Any:
    kind = field.cpp_type
    if kind in (field.CPPTYPE_FLOAT, field.CPPTYPE_DOUBLE):
        return dice.choice((0.0, -1.0, math.nan, math.inf, 1e30))
    if kind == field.CPPTYPE_STRING:
        text = dice.choice((*TEXTS, *CODE, "obs", "actions", "Loop", "If", "Gemm", "Tanh", "Conv"))
        return text.encode("utf-8", "replace") if field.type == field.TYPE_BYTES else text
    if kind == field.CPPTYPE_ENUM:
        return dice.randrange(0, 24)
    return dice.choice((0, 1, 2, 7, -1, 12, 45, 255, 2**16, 2**31 - 1))

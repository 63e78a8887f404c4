"""Decoders: the bytes of one ROS message in, state arrays written; for bridges and replays.

Two paths, one meaning. The careful path (`careful.py`) walks the payload with every length checked,
applies the declared policies, and compiles what it found. The fast path is one generated function
that reads at those offsets as long as every structural byte is the same. It compares length and
structural bytes first, and returns True when it wrote the states, None when the structure differs
(walk again), and False when a value needs the careful path. It writes only after every check has
passed. This one reads a `cmd_vel` of the default map:

    def decode(raw):
        if len(raw) != size: return None
        g0, v0, v1, v2, = unpack(raw)      # of "<4s2d24xd": header, vx, vy, wz
        if g0 != G0: return None
        if not -single_max <= v0 <= single_max: return False  # NaN too; and so v1, v2
        w0[e0_0] = v0                      # memoryviews of velocity_command, and so v1, v2
        return True

Everything but its own words is bound as a value. The lines about numbers come from `bulk.py`.
Layouts that the payloads of a topic have had are remembered, each with its fast path.
"""

from __future__ import annotations

import struct
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from unicon_base.generated import define
from unicon_msgs_map.codec.binding import Arrays, Names, Variables
from unicon_msgs_map.codec.bulk import Code, castable, read_in_bulk
from unicon_msgs_map.codec.careful import (
    COVARIANCE,
    STAMP,
    Rejected,
    Run,
    apply,
    orientation,
    select,
)
from unicon_msgs_map.codec.targets import Target, bind_targets
from unicon_msgs_map.layout.messages import HEADER, TIME, Primitive, Struct
from unicon_msgs_map.layout.paths import Path, parse_path
from unicon_msgs_map.layout.walker import Malformed, WalkedFields, Want, walk
from unicon_msgs_map.spec import SubscribeSpec

SCALAR_LIMIT = 8  # numbers of one field that are still read one by one
PIECES_LIMIT = 8  # structural pieces that are still compared one by one
BRIDGE = 16  # padding and unread bytes between structural ones that are compared along, [B]


def merge(hard: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return byte ranges in ascending order, touching and overlapping ones united."""
    merged: list[tuple[int, int]] = []
    for start, end in sorted(hard):
        if merged and start <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(end, merged[-1][1]))
        else:
            merged.append((start, end))
    return merged


@lru_cache(maxsize=256)
def _maker(source: str) -> Callable[..., Callable[[bytes], bool | None]]:
    """Return what binds the constants of one payload: compiling takes 300 µs, calling this 3.

    Payloads that are built alike yield the same source, such as those of a publisher that keeps
    changing its joint order, or of two robots. Their functions share one code, so the constants
    are cells: as globals they would spoil each other's caches of Python's interpreter.
    """
    maker: Callable[..., Callable[[bytes], bool | None]] = define(source, {}, "<decode>")["make"]
    return maker


def compile_fast(
    raw: bytes, order: str, hard: list[tuple[int, int]], runs: list[Run], reject: bool, loose: bool
) -> Callable[[bytes], bool | None]:
    """Generate and return the function for payloads that are built like one.

    Args:
        raw: the payload that was walked.
        order: its byte order for `struct`.
        hard: byte ranges that fix the layout, merged.
        runs: what to read and where to write it.
        reject: whether numbers that are not finite are refused.
        loose: compare structural bytes only, not the padding between them.
    """
    code = Code(raw, order, reject)
    bulk: dict[Primitive, list[Run]] = {}
    for number, run in enumerate(runs):
        many = run.kind == "number" and len(run.offsets) > SCALAR_LIMIT
        if many and run.primitive is not None and castable(run):
            bulk.setdefault(run.primitive, []).append(run)
        else:
            code.add(number, run)
    for number, (primitive, members) in enumerate(bulk.items()):
        read_in_bulk(code, number, primitive, members)
    guards = hard if loose else _bridged(hard, sorted(o for r in runs for o in r.offsets))
    body = ["if len(raw) != size: return None"]
    if len(guards) > PIECES_LIMIT:
        body += ["stage[:] = raw", *_mask(code, guards), *_unpack(code, [])]
    else:
        body += _unpack(code, guards)
        if "staged" in code.space:
            body.append("stage[:] = raw")
    body += [*code.checks, *code.work, *code.writes, "return True"]
    lines = [
        f"def make({', '.join(code.space)}):",
        "    def decode(raw):",
        *(f"        {line}" for line in body),
        "    return decode",
    ]
    function = _maker("\n".join(lines))(**code.space)
    vars(function)["space"] = code.space  # what it writes to by address stays alive with it
    return function


def _bridged(hard: list[tuple[int, int]], read: list[int]) -> list[tuple[int, int]]:
    """Return the pieces to compare, near ones united where nothing between them is read."""
    guards: list[tuple[int, int]] = []
    for start, end in hard:
        before = guards[-1][1] if guards else -BRIDGE - 1
        if start - before <= BRIDGE and bisect_left(read, before) == bisect_left(read, start):
            guards[-1] = (guards[-1][0], end)
        else:
            guards.append((start, end))
    return guards


def _mask(code: Code, guards: list[tuple[int, int]]) -> list[str]:
    """Compare many structural pieces at once: 300 ns for a payload of 1 kB."""
    mask = np.zeros(len(code.raw), np.uint8)
    for start, end in guards:
        mask[start:end] = 255
    kept = bytearray(len(code.raw))
    code.stage()
    code.space |= {
        "bitwise_and": np.bitwise_and,
        "mask": mask,
        "masked": np.frombuffer(kept, np.uint8),
        "kept": kept,
        "structure": (np.frombuffer(code.raw, np.uint8) & mask).tobytes(),
    }
    return ["bitwise_and(staged, mask, masked)", "if kept != structure: return None"]


def _unpack(code: Code, guards: list[tuple[int, int]]) -> list[str]:
    pieces = [(offset, form, name) for offset, (form, name) in code.reads.items()]
    tests = []
    for number, (start, end) in enumerate(guards):
        pieces.append((start, f"{end - start}s", f"g{number}"))
        code.space[f"G{number}"] = code.raw[start:end]
        tests.append(f"g{number} != G{number}")
    whole, position, names = code.order, 0, []
    for offset, form, name in sorted(pieces):
        whole += f"{offset - position}x{form}"
        names.append(name)
        position = offset + struct.calcsize(code.order + form)
    whole += f"{len(code.raw) - position}x"
    code.space["unpack"] = struct.Struct(whole).unpack
    lines = [f"{', '.join(names)}, = unpack(raw)"] if names else []
    return [*lines, f"if {' or '.join(tests)}: return None"] if tests else lines


KEPT_LAYOUTS = 4  # publishers with layouts of their own that may alternate on one topic
IMU = "sensor_msgs/msg/Imu"


@dataclass(frozen=True)
class _Layout:
    size: int
    structure: tuple[bytes, ...]
    fast: Callable[[bytes], bool | None]
    runs: list[Run]


class Decoder:
    """State arrays from one message type; make it with `Decoder.build`.

    Attributes:
        spec: the mapping entry.
        received: number of accepted messages.
        rejected: number of refused ones.
        last_error: why the last refused message was refused; empty if none was.
        targets: what it writes and requires.
        fast: the fast path of the last layout.
        derived: how often a layout was derived.
        stamp: one element, stamp of the last message in [ns].
        kept: the layouts that are remembered, the latest first.
    """

    def __init__(self, spec: SubscribeSpec, message: Struct, targets: list[Target]) -> None:
        self.spec, self._message, self.targets = spec, message, targets
        self.fast: Callable[[bytes], bool | None] = _miss
        self.derived = self.received = self.rejected = 0
        self.last_error = ""
        self.stamp = [0]
        self.kept: list[_Layout] = []
        self._loose = False
        self._orientation = ""
        self._want = Want()
        for target in targets:
            self._want.add(target.number, target.field.steps, message)
        stamp = _stamp_path(message)
        if stamp:
            self._want.add(STAMP, stamp, message)

    @classmethod
    def build(
        cls,
        spec: SubscribeSpec,
        arrays: Arrays,
        names: Names | None = None,
        variables: Variables | None = None,
    ) -> Decoder:
        """Prepare a mapping entry against arrays, which are written in place from then on.

        Args:
            spec: topic, type, fields and policies.
            arrays: state arrays by name, any shape; elements count in C order.
            names: element names per state; they order arrays that come with names, unless the
                `$variable` on the message's names is as long as the selection.
            variables: values of `$name`: lists of element names.

        Raises:
            MapStateError: a state, variable, size or dtype does not fit.
            MessageTypeError: the type or a path in it is unknown.
        """
        message = spec.messages.struct(spec.type)
        targets = bind_targets(spec, message, arrays, names or {}, variables or {})
        return cls(spec, message, targets)

    @property
    def stamp_ns(self) -> int:
        """Stamp of the last accepted message in [ns]; 0 where the type carries none."""
        return self.stamp[0]

    def elements(self, state: str) -> set[int]:
        """Return which elements of a state, in C order, a message may write."""
        bounds = [target.bound for target in self.targets if target.bound is not None]
        return {e for bound in bounds if bound.field.source.name == state for e in bound.elements}

    def decode(self, raw: bytes) -> bool:
        """Write the states that a message carries.

        Args:
            raw: encapsulation header and body, either byte order.

        Returns:
            Whether the message was accepted. If not, nothing was written, `rejected` counts it
            and `last_error` describes it. Never raises on any bytes.
        """
        try:
            if self.fast(raw):
                self.received += 1
                return True
        except FloatingPointError:  # somebody's np.seterr: a subnormal in a cast, nothing wrong
            pass
        try:
            with np.errstate(all="ignore"):
                self.read(bytes(raw))
        except (Malformed, Rejected) as error:
            self.rejected += 1
            self.last_error = f"{self.spec.topic} ({self.spec.type}): {error}"
            return False
        self.received += 1
        return True

    def lapse(self) -> None:
        """Set every element that this decoder writes to zero, time stamps excepted.

        Where the map says `on_timeout: unset`, to NaN.
        """
        value = float("nan") if self.spec.on_timeout == "unset" else 0
        for target in self.targets:
            if target.bound is not None and not target.is_time:
                target.bound.flat[list(target.bound.elements)] = value

    def need_orientation(self, state: str) -> None:
        """Refuse messages without an orientation from now on.

        A robot that balances by one that is not there would be blind: a quaternion whose norm is
        not 1, or an Imu that says it has none (-1 in `orientation_covariance`).

        Args:
            state: that the quaternion is written to.
        """
        self._orientation = state
        if self.spec.type == IMU:
            self._want.add(COVARIANCE, parse_path("orientation_covariance[0]"), self._message)
        self.kept.clear()
        self.fast = _miss

    def read(self, raw: bytes) -> None:
        """Write the states that a message carries.

        Raises:
            Malformed: it is not a message of this type.
            Rejected: the policies of the entry refuse it; nothing was written.
        """
        for kept in self.kept:
            done = kept.fast(raw)
            if done is not None:
                self.fast, runs = kept.fast, kept.runs
                break
        else:
            found = walk(raw, self._message, self._want)
            runs = select(found, self.spec, self.targets, self.stamp)
            if self._orientation:
                runs += orientation(found, runs, self._orientation)
            self._remember(raw, found, runs)
            done = self.fast(raw)
        if not done:
            apply(raw, runs, self.spec.nonfinite)

    def _remember(self, raw: bytes, found: WalkedFields, runs: list[Run]) -> None:
        self.derived += 1
        hard = merge(found.hard)
        structure = tuple(raw[start:end] for start, end in hard)
        if any(kept.size == len(raw) and kept.structure == structure for kept in self.kept):
            # Only padding or unread bytes differ: from now on they are not compared.
            self._loose = True
            self.kept.clear()
        reject = self.spec.nonfinite == "reject"
        self.fast = compile_fast(raw, found.order, hard, runs, reject, self._loose)
        self.kept.insert(0, _Layout(len(raw), structure, self.fast, runs))
        del self.kept[KEPT_LAYOUTS:]


def _miss(_: bytes) -> bool | None:
    return None


def _stamp_path(message: Struct) -> Path:
    for path, owner in (("header.stamp", HEADER), ("stamp", TIME), ("clock", TIME)):
        steps = parse_path(path)
        kind = message.fields.get(steps[0][0])
        if isinstance(kind, Struct) and kind.name == owner:
            return steps
    return ()

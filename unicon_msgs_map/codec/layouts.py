"""Layouts that the payloads of one topic have had so far, each with its fast path; for decoders.

A payload of a new layout is walked with every length checked, the declared policies are applied,
and a fast path is compiled from what was found. It is read that way as long as the layout stays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from unicon_msgs_map.codec.careful import COVARIANCE, STAMP, Run, apply, orientation, select
from unicon_msgs_map.codec.fast import compile_fast, merge
from unicon_msgs_map.codec.targets import Target
from unicon_msgs_map.layout.messages import HEADER, TIME, Struct
from unicon_msgs_map.layout.paths import Path, parse_path
from unicon_msgs_map.layout.walker import WalkedFields, Want, walk
from unicon_msgs_map.spec import SubscribeSpec

KEPT_LAYOUTS = 4  # publishers with layouts of their own that may alternate on one topic
IMU = "sensor_msgs/msg/Imu"


@dataclass(frozen=True)
class _Layout:
    size: int
    structure: tuple[bytes, ...]
    fast: Callable[[bytes], bool | None]
    runs: list[Run]


class Layouts:
    """Reads payloads carefully, and remembers how to read the like of them fast.

    Args:
        spec: the mapping entry.
        message: its type.
        targets: what it writes and requires.

    Attributes:
        spec: the mapping entry.
        targets: what it writes and requires.
        fast: the fast path of the last layout.
        derived: number of times that a layout was derived anew.
        stamp: one element, stamp of the last message in [ns].
        kept: the layouts that are remembered, the latest first.
    """

    def __init__(self, spec: SubscribeSpec, message: Struct, targets: list[Target]) -> None:
        self.spec, self._message, self.targets = spec, message, targets
        self.fast: Callable[[bytes], bool | None] = _miss
        self.derived = 0
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

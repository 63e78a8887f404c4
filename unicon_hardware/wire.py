"""Wire: frames of a robot in and out, and what wires are made of: counts, sockets, layouts.

class MyWire(Wire):
    def take(self): ...             # newest good frame into the states; how many came
    def put(self): ...              # command states to the motors
    def wait(self, timeout): ...    # until a frame is there
    def close(self): ...            # let go of sockets
"""

from __future__ import annotations

import math
import select
import socket
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from unicon_base import Fault, PlatformError
from unicon_base.arrays import Array, Float64
from unicon_core.states import States
from unicon_hardware.modes import ModeGuard

Readings: TypeAlias = Mapping[str, Array] | States


def ahead(number: int, last: int) -> int:
    """Return by how much a number of 32 bits, which may wrap, is ahead of the last one."""
    return (number - last + (1 << 31)) % (1 << 32) - (1 << 31)


def newer(number: int, last: int) -> bool:
    """Return whether a frame number of 32 bits, which may wrap, is behind the last one."""
    return ahead(number, last) > 0


def known(states: States, name: str) -> Any:
    """Return a state, or None where there is none of that name."""
    return states[name] if name in states else None  # noqa: SIM401  no mapping


def frame_type(fields: str, **types: np.dtype[Any]) -> np.dtype[Any]:
    """Return the packed layout that a table of fields declares: `"mode u1, poses <f4 55x7"`.

    Args:
        fields: name, NumPy type and, of arrays, shape of each.
        types: layouts that stand for a type, by name.
    """
    table = [field.split() for field in fields.split(",")]
    return np.dtype(
        [
            (name, types.get(kind, kind), *(tuple(map(int, n.split("x"))) for n in shape))
            for name, kind, *shape in table
        ]
    )


class Counts:
    """What came in and what was clamped, for reports and error messages.

    Attributes:
        good: frames that were taken.
        refused: reason to number of frames that were not.
        last: the newest of these reasons with its figures, "" for none.
        clamped: commands of ours in which a figure was beyond what the robot or the format takes.
    """

    def __init__(self) -> None:
        self.good = self.clamped = 0
        self.refused: Counter[str] = Counter()
        self.last = ""

    def refuse(self, reason: str, detail: object = "") -> None:
        """Count a frame that is not taken.

        Args:
            reason: a few words, the same for all alike: `wrong CRC`.
            detail: figures of this one.
        """
        self.refused[reason] += 1
        self.last = f"{reason} ({detail})" if detail else reason

    def __str__(self) -> str:
        """Return what was refused: `3 wrong CRC, 1 short`; "" for nothing."""
        return ", ".join(f"{number} {reason}" for reason, number in self.refused.items())


class Wire:
    """The connection to a robot; it is called in the tick and never waits.

    Whatever arrives, `take` raises nothing but `Fault`: a frame of another length, checksum or
    origin is counted and left. An old one is not new: a robot that repeats itself is silent.

    Attributes:
        counts: of what came in.
        where: address or topic, for messages.
        modes: what the motors report; None where it is not to be looked at.
        clock_ms: of the frame that was taken last, by the robot's own clock, 32 bits in [ms]; None
            where the frames have none.
    """

    counts: Counts
    where: Any
    modes: ModeGuard | None = None
    clock_ms: Any = None

    def take(self) -> int:
        """Bring the newest good frame into the states; return how many good ones have come.

        Raises:
            Fault: the robot says that it will not go on.
        """
        raise NotImplementedError

    def put(self) -> None:
        """Send the command states, which are finite; what the format cannot hold is clamped.

        Raises:
            Fault: it cannot be sent.
        """
        raise NotImplementedError

    def wait(self, timeout: float) -> bool:
        """Return True once a frame is there, False after `timeout` in [s]."""
        raise NotImplementedError

    def close(self) -> None:
        """Let go; the damping command has been sent."""
        raise NotImplementedError

    def prepare(self) -> str:
        """Do the next step towards taking commands, as `Prepares`; return "" at the end."""
        return ""

    def commanders(self) -> dict[str, int]:
        """Return where the robot takes commands, with the number of others that send there."""
        return {}

    def warm_up(self) -> None:
        """Do what `put` does, but send nothing, to warm the caches."""


class Answers:
    """Which of several motors have answered since all did last, for wires that ask each.

    As text it is those that have not, for `Wire.where`.

    Args:
        labels: of the motors, each with its address.

    Attributes:
        heard: which have answered, shape (n,).
    """

    # How many missing motors the text names.
    NAMED = 3

    def __init__(self, labels: Sequence[str]) -> None:
        self._labels = labels
        self.heard = np.zeros(len(labels), bool)

    def complete(self) -> bool:
        """Return whether all have, and begin again if so."""
        complete = bool(self.heard.all())
        self.heard &= not complete
        return complete

    def __str__(self) -> str:
        missing = [label for label, heard in zip(self._labels, self.heard) if not heard]
        if len(missing) in (0, len(self._labels)):
            return f"all {len(self._labels)} motors ({self._labels[0]}, …)"
        more = f" and {len(missing) - self.NAMED} more" if len(missing) > self.NAMED else ""
        return f"{', '.join(missing[: self.NAMED])}{more}"


class Speed:
    """Velocity of joints whose robot measures angles alone: the mean over the last while.

    One step of a finger's coarse angle would be a jerk.

    Args:
        over: how far the two angles are apart at least, once that much is known, in [s].
    """

    # Two measurements that are closer are taken as so far apart, [ns].
    SHORTEST_NS = 1_000_000

    def __init__(self, over: float) -> None:
        self._over = round(over * 1e9)
        self._past: deque[tuple[int, Float64]] = deque()

    def __call__(self, stamp_ns: int, angles: Float64) -> Float64:
        """Return it in [rad/s], shape (n,); zero for the first angles.

        Args:
            stamp_ns: when the angles were measured, [ns].
            angles: in [rad], shape (n,); they are kept.
        """
        past = self._past
        past.append((stamp_ns, angles))
        while len(past) > 2 and stamp_ns - past[1][0] >= self._over:
            past.popleft()
        before, then = past[0]
        speed: Float64 = (angles - then) / (max(stamp_ns - before, self.SHORTEST_NS) * 1e-9)
        return speed


def turned(
    source: Readings, into: Readings, joints: Readings, waist: int, sign: float = 1.0
) -> None:
    """Write the readings of an IMU above a joint about z as one below it would have them.

    For an IMU in the torso, above a waist joint (H1, H1-2, Atom). With the waist angle θ and its
    rate θ', torso to pelvis is a turn about z: R_pelvis = R_torso Rz(θ)ᵀ and
    ω_pelvis = Rz(θ) ω_torso - (0, 0, θ') (unitreerobotics/unitree_rl_gym
    deploy/deploy_real/common/rotation_helper.py: transform_imu_data). The accelerometer keeps its
    place, only its axes are turned.

    Args:
        source: quaternion wxyz, angular velocity in [rad/s], specific force in [m/s²], by state.
        into: takes the same.
        joints: `joint_pos` in [rad] and `joint_vel` in [rad/s].
        waist: number of the joint.
        sign: -1 from below the joint to above it.
    """
    angle, rate = (sign * float(joints[name][waist]) for name in ("joint_pos", "joint_vel"))
    c, s = math.cos(angle), math.sin(angle)
    half_c, half_s = math.cos(angle / 2), math.sin(angle / 2)
    w, x, y, z = source["base_quat"].tolist()
    # q ⊗ conj(cos(θ/2), 0, 0, sin(θ/2))
    into["base_quat"][...] = (
        w * half_c + z * half_s,
        x * half_c - y * half_s,
        y * half_c + x * half_s,
        z * half_c - w * half_s,
    )
    for state, less in (("base_ang_vel", rate), ("base_lin_acc", 0.0)):
        x, y, z = source[state].tolist()
        into[state][...] = (c * x - s * y, s * x + c * y, z - less)


class Udp:
    """A bound socket whose peer is fixed; it gives the newest datagrams and never waits.

    Datagrams of others are counted in `strangers` and left.

    Args:
        local: address and port to bind; port 0 for any.
        peer: address and port of the robot.
        what: in front of messages.
        counts: count those of others, too.

    Raises:
        PlatformError: it cannot be bound.
    """

    # Bytes of a datagram.
    LARGEST = 65536
    # Datagrams that are looked at in a tick: a flood must not hold it up.
    MOST = 64

    def __init__(
        self, local: tuple[str, int], peer: tuple[str, int], what: str, counts: Counts | None = None
    ) -> None:
        self._what, self.peer, self._counts = what, peer, counts or Counts()
        self.strangers = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.fileno, self.close = self._socket.fileno, self._socket.close
        try:
            self._socket.setblocking(False)
            self._socket.bind(local)
        except OSError as error:
            self.close()
            raise PlatformError(
                f"{what}: cannot listen at {local[0]}:{local[1]}: {error.strerror}; end the "
                "program that does, or check the network interface (ip addr)"
            ) from error
        self._buffer = bytearray(self.LARGEST)

    @property
    def port(self) -> int:
        """The port that it is bound to."""
        return int(self._socket.getsockname()[1])

    @property
    def source(self) -> str:
        """The address of this machine from which the peer is reached, as the routes are now.

        Raises:
            PlatformError: there is no way to it.
        """
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect(self.peer)  # sends nothing
            except OSError as error:
                raise PlatformError(
                    f"{self._what}: no way to {self.peer[0]}: {error.strerror}; plug the cable in, "
                    "and give this machine an address in the robot's network (ip addr)"
                ) from error
            return str(probe.getsockname()[0])

    def received(self) -> list[bytes]:
        """Return what the peer has sent since the last call, the oldest first."""
        came = self.datagrams()
        found = [datagram for datagram, sender in came if sender == self.peer]
        if strangers := len(came) - len(found):
            self.strangers += strangers
            self._counts.refused["of a stranger"] += strangers
        return found

    def datagrams(self) -> list[tuple[bytes, tuple[str, int]]]:
        """Return what anybody has sent since the last call, with the senders, the oldest first.

        For a robot's end, which answers to the sender of a command: set `peer`.
        """
        found: list[tuple[bytes, tuple[str, int]]] = []
        for _ in range(self.MOST):
            try:
                size, sender = self._socket.recvfrom_into(self._buffer)
            except BlockingIOError:
                break
            except OSError:  # such as a refused port, reported by an earlier datagram of ours
                continue
            found.append((bytes(self._buffer[:size]), sender))
        return found

    def send(self, data: bytes | bytearray | memoryview) -> None:
        """Send a datagram to the peer.

        Raises:
            Fault: the network does not take it.
        """
        try:
            self._socket.sendto(data, self.peer)
        except ConnectionRefusedError:  # of an earlier one: the peer is not there (yet)
            pass
        except OSError as error:
            raise Fault(
                f"{self._what}: cannot send to {self.peer[0]}:{self.peer[1]}: {error.strerror}"
            ) from error

    def wait(self, timeout: float) -> bool:
        """Return True once a datagram is there, False after `timeout` in [s]."""
        return bool(select.select([self._socket], [], [], timeout)[0])

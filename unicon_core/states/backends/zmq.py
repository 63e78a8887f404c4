"""A message queue: groups of states for other processes and other machines, through ZeroMQ.

    writer = ZmqWriter("tcp://*:7001", "measured", group, states, keys="keys")       # on the robot
    reader = ZmqReader("tcp://robot:7001", "measured", group, states, keys="keys")   # at a desk

One PUB/SUB pair for each group, and either end may bind. Both keep the newest message alone
(CONFLATE), so that a reader which is slow, stopped or dead changes nothing for the writer. A frame
says who wrote what and when, in front of the group's packed bytes; now and then it carries the
layout in words behind them, for a reader that has another one.

PUB/SUB says nothing of the other end: who reads, and whether anybody does, a writer never learns,
and a reader knows only what comes. Who may write is told by the address, or by keys.
"""

from __future__ import annotations

import math
import secrets
import select
import struct
import time
from pathlib import Path

from unicon_base.errors import StateError
from unicon_core.non_blocking_writer import NonBlockingWriter
from unicon_core.states.backends.zmq_socket import LOOKS, SILENCE, Endpoint, Freshness
from unicon_core.states.groups import Copies, difference, groups_from_json, groups_hash, groups_json
from unicon_core.states.layout import Layout
from unicon_core.states.states import States

MAGIC = b"UNICONZQ"
VERSION = 1
BYTE_ORDER = 0x01020304

HEAD = struct.Struct("=8sIIQQq32sQ")
"""magic, version, byte order; epoch (random, of this start of the writer), number of the value,
when it was sent in [ns] of the writer's clock, SHA-256 of the group as `groups_hash` makes it,
length of the JSON behind the group's bytes. In the writer's byte order, as those bytes are."""

WORDS = 500_000_000
"""ns from one time at which the layout is told in words to the next: at the first value, and then
in each value of WINDOW ns, since a reader looks at some values only."""
WINDOW = 25_000_000

LAYOUT_FACTOR, LAYOUT_SPARE = 8, 4096
"""A foreign layout is read up to so many times the length of the reader's own, and so many bytes:
any client of the port chooses that text, and 1 MiB of it takes 1.8 s to read."""
PARSE_PERIOD = 500_000_000
"""ns from one foreign layout that is parsed, by a thread, to the next one."""

LONGEST = 300  # characters of what another one's layout says
JUST_NOW = 1_000_000
"""ns since a value was found, by `wait` as a rule, in which no newer one is looked for: to find
nothing costs as much as a value."""

# Time asleep counts, or a suspended machine would call everything late from then on.
_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)


class ZmqWriter:
    """Publishes one group; nobody is waited for.

    Args:
        address: `tcp://HOST:PORT`, `tcp://*:PORT` (every network of this machine) or `ipc://PATH`.
        name: of the group; a reader of another name refuses it.
        group: its layout.
        states: where its states are read.
        bind: readers come here; else this end goes to where a reader is bound.
        keys: folder with CURVE keys; None: without.
        without_keys: listen without them beyond this machine, too.

    Attributes:
        address: with the port, where it was left open (`tcp://127.0.0.1:*`).

    Raises:
        MissingDependencyError: pyzmq is not installed.
        StateError: the address cannot be had, a key is missing, or the group's states differ.
    """

    def __init__(
        self,
        address: str,
        name: str,
        group: Layout,
        states: States,
        *,
        bind: bool = True,
        keys: str | Path | None = None,
        without_keys: bool = False,
    ) -> None:
        text = groups_json({name: group}).encode()
        frame = bytearray(HEAD.size + group.nbytes + len(text))
        memory = memoryview(frame)
        digest = bytes.fromhex(groups_hash({name: group}))
        epoch = secrets.randbits(64)
        HEAD.pack_into(frame, 0, MAGIC, VERSION, BYTE_ORDER, epoch, 0, 0, digest, 0)
        body = HEAD.size + group.nbytes
        frame[body:] = text
        self._copies = Copies(states, group, memory[HEAD.size : body]).pairs
        self._short, self._long = memory[:body], memory
        self._count = memory[24:40].cast("q")  # number and time
        self._words = memory[HEAD.size - 8 : HEAD.size].cast("Q")
        self._length = len(text)
        self._until = self._next = 0
        what = f"store zmq, group {name!r}"
        size = len(frame)
        self._end = Endpoint(
            what, address, publish=True, bind=bind, size=size, keys=keys, without_keys=without_keys
        )
        self.address = self._end.address
        self._send, self._flags = self._end.socket.send, self._end.zmq.NOBLOCK

    def publish(self) -> None:
        """Publish the states as they are now."""
        for packed, state in self._copies:
            packed[:] = state
        now = time.clock_gettime_ns(_CLOCK)
        self._count[0] += 1
        self._count[1] = now
        if now >= self._next:
            self._next, self._until = now + WORDS, now + WINDOW
            self._end.rejoin()
        if now < self._until:
            self._words[0] = self._length
            self._send(self._long, self._flags)
        else:
            self._words[0] = 0
            self._send(self._short, self._flags)

    def close(self) -> None:
        """Let go; what is on the way is dropped."""
        self._end.close()


class ZmqReader:
    """Takes the newest value of one group, of one writer, where it is fresh; for one thread.

    A new writer is watched for 0.05 s before its values are taken, and is followed when the one
    before has been silent for 0.5 s (`freshness.py` says why). Values are taken as they are: NaN
    is the business of safety.

    Args:
        address: as of `ZmqWriter`.
        name: of the group.
        group: its layout as it is here.
        states: into which values are copied.
        bind: writers come here.
        late: a value that took so much longer than the fastest one is not taken, [s].
        keys: folder with CURVE keys; None: without.
        without_keys: listen without them beyond this machine, too.

    Attributes:
        address: with the port.
        refused: why frames of another layout are not taken, with the first state that differs; ""
            where none came since a value was taken.
        garbage: messages that are not frames of this version.
        freshness: counts the values that did not pass: `late`, `reordered`, `rivals`, `lost`.

    Raises:
        MissingDependencyError: pyzmq is not installed.
        StateError: the address cannot be had, a key is missing, or the group's states differ.
    """

    def __init__(
        self,
        address: str,
        name: str,
        group: Layout,
        states: States,
        *,
        bind: bool = False,
        late: float = 0.2,
        keys: str | Path | None = None,
        without_keys: bool = False,
    ) -> None:
        what = f"store zmq, group {name!r}"
        if not (math.isfinite(late) and late > 0.0):
            raise StateError(f"{what}: late is {late}; give seconds above 0")
        self._what = f"{what} at {address}"
        self._name, self._group = name, group
        self._digest = bytes.fromhex(groups_hash({name: group}))
        scratch = memoryview(bytearray(group.nbytes))
        copies = Copies(states, group, scratch)
        copies.pack()  # so that `restore` leaves the states as they are until one is taken
        self._copies, self._scratch = copies.pairs, scratch
        self._body = HEAD.size + group.nbytes
        self.freshness = Freshness(late)
        self._oldest = round(late * 1e9)
        self._held = b""  # a frame that passed and has not been taken
        self._held_number = self._held_stamp = self._held_at = 0
        self._told = b""  # hash of the layout that was refused last
        self._foreign: NonBlockingWriter[tuple[bytes, bytes, int]] = NonBlockingWriter(
            self._parse, capacity=1
        )
        self._next_parse = self._next_rejoin = 0
        self._started = time.clock_gettime_ns(_CLOCK)
        self.number = self.stamp_ns = self.skipped = self.garbage = 0
        self.refused = ""
        length = len(groups_json({name: group}).encode())
        self._longest = LAYOUT_FACTOR * length + LAYOUT_SPARE
        size = self._body + length
        self._end = Endpoint(
            what, address, publish=False, bind=bind, size=size, keys=keys, without_keys=without_keys
        )
        self.address = self._end.address
        zmq, socket = self._end.zmq, self._end.socket
        self._receive, self._flags, self._again = socket.recv, zmq.NOBLOCK, zmq.Again
        self._poll = select.poll()
        self._poll.register(socket.getsockopt(zmq.FD), select.POLLIN)

    def take(self) -> bool:
        """Copy the newest value into the states; False where it has been taken before."""
        if not self._held or time.monotonic_ns() - self._held_at > JUST_NOW:
            self._look()
        frame = self._held
        if not frame:
            return False
        self._held = b""
        if time.monotonic_ns() - self._held_stamp > self._oldest:  # nobody took it in time
            self.freshness.late += 1
            return False
        self._scratch[:] = frame[HEAD.size : self._body]
        self.number, self.stamp_ns = self._held_number, self._held_stamp
        self.restore()
        self.skipped = self.freshness.skipped
        return True

    def restore(self) -> None:
        """Copy the value that was taken last into the states once more, if there was one."""
        if self.number:
            for packed, state in self._copies:
                state[:] = packed

    def wait(self, timeout: float) -> bool:
        """Return True when a value is there that has not been taken, False after `timeout` [s].

        It sleeps whole milliseconds, rounded up.
        """
        end = time.monotonic() + timeout
        while True:
            all_seen = self._look()
            if self._held:
                return True
            left = end - time.monotonic()
            if left <= 0.0:
                return False
            if all_seen:  # else the next message would not make it readable
                self._poll.poll(left * 1e3)

    def alive(self) -> bool:
        """Return whether a writer lives: False where no value has passed for 0.5 s.

        The first half second counts as alive, since nothing can have come.

        Raises:
            StateError: the one that writes has other states.
        """
        self._look()
        now = time.clock_gettime_ns(_CLOCK)
        if self.freshness.live(now):
            return True
        if self.refused:
            raise StateError(self.refused)
        return now - self._started < SILENCE * 1e9

    def close(self) -> None:
        """Let go."""
        self._foreign.close()
        self._end.close()

    def _look(self) -> bool:
        """Look at what has come; a value that passes is held.

        Returns:
            True where nothing is left.
        """
        for _ in range(LOOKS):
            try:
                frame = self._receive(self._flags)
            except self._again:
                now = time.clock_gettime_ns(_CLOCK)
                self.freshness.nothing(now)
                if now >= self._next_rejoin:
                    self._next_rejoin = now + WORDS
                    self._end.rejoin()
                return True
            if self._passes(frame):
                return False
        return False

    def _passes(self, frame: bytes) -> bool:
        if len(frame) < HEAD.size:
            self.garbage += 1
            return False
        magic, version, order, epoch, number, sent, digest, length = HEAD.unpack_from(frame)
        if magic != MAGIC or order != BYTE_ORDER or version != VERSION:
            self.garbage += 1
            return False
        if digest != self._digest:
            self._refuse(frame, digest, length)
            return False
        if len(frame) != self._body + length:
            self.garbage += 1
            return False
        if not self.freshness.passes(epoch, number, sent, time.clock_gettime_ns(_CLOCK)):
            return False
        self.freshness.skipped += bool(self._held)  # the one that waited was not taken
        self._held, self._held_number = frame, number
        self._held_at = time.monotonic_ns()
        self._held_stamp = self._held_at - self.freshness.delay
        self.refused = ""
        return True

    def _refuse(self, frame: bytes, digest: bytes, length: int) -> None:
        """Refuse a frame of another layout; what it says of its layout is parsed by a thread."""
        if not length or (self.refused and digest == self._told):
            return
        if length > len(frame) - HEAD.size:
            self.garbage += 1
            return
        if length > self._longest:
            self._told = digest
            self.refused = (
                f"{self._what}: the other end describes its layout in {length} bytes, of which at "
                f"most {self._longest} are read: it is not this group"
            )
            return
        now = time.monotonic_ns()
        if now >= self._next_parse:
            self._next_parse = now + PARSE_PERIOD
            self._foreign((digest, frame[-length:], self._held_at))

    def _parse(self, foreign: tuple[bytes, bytes, int]) -> None:
        """Find the first difference of a foreign layout (hash, JSON, when a value passed last)."""
        digest, text, held_at = foreign
        try:
            theirs = groups_from_json(text.decode())
            if bytes.fromhex(groups_hash(theirs)) != digest:
                raise ValueError
        except (StateError, ValueError, RecursionError):
            self.garbage += 1
            return
        if self._name in theirs:
            what = difference(self._group, theirs[self._name])
        else:
            what = f"the other end has group {', '.join(map(repr, theirs)) or 'none'}"
        if self._held_at == held_at:  # no value has passed meanwhile
            self._told, self.refused = digest, f"{self._what}: {what[:LONGEST]}"

"""Links: how groups of states reach the other parts of a workflow, by the word of its `store:`.

    store: shm                                  # processes of one machine
    store: {zmq: {address: tcp://192.168.123.18:5600, keys: keys}}   # machines; the first binds

Blocks know nothing of it: a `Publisher` sends groups of local states at its place in the tick, and
an `Incoming` brings another part's states into local ones at the tick's beginning.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from unicon_base.errors import Fault, StateError
from unicon_base.schema.marks import Key, Write, positive
from unicon_core.states.backends import Reader, Writer
from unicon_core.states.groups import Groups
from unicon_core.states.layout import StateSpec
from unicon_core.states.states import States

AGAIN_NS, REFUSED_NS = 50_000_000, 1_000_000_000
"""How often a part that is not there is looked for, and one that does not fit, in [ns]."""


@dataclass(frozen=True)
class Store:
    """What `store:` says.

    Attributes:
        backend: `shm` or `zmq`.
        name: of the segments, a part's behind it; of `zmq` what an error calls it.
        address: of `zmq`: `tcp://HOST:PORT` or `ipc://PATH`.
        keys: folder of CURVE keys for `zmq`, or None.
        parts: all parts in their order; the first one binds.
    """

    backend: Literal["shm", "zmq"]
    name: str
    address: str = ""
    keys: Path | None = None
    parts: tuple[str, ...] = ("",)

    def segment(self, part: str) -> str:
        """Return the name of a part's segment."""
        return f"{self.name}-{part}" if part else self.name

    def place(self, part: str, group: int) -> str:
        """Return the address at which a part publishes its group of that number."""
        index = 2 * self.parts.index(part) + group
        if self.address.startswith("ipc://"):
            return f"{self.address}-{index}"
        host, _, port = self.address.rpartition(":")
        return f"{host}:{int(port) + index}"


LONGEST_SILENCE = 3600.0
"""Of `silent.after` in [s]: what is longer is `then: hold`."""


@dataclass(frozen=True)
class Silent:
    """What a part does when another one is silent.

    Attributes:
        after: without a value for that long, [s].
        then: `neutral` sets the states that came from there, `hold` leaves them as they are,
            `fault` ends the run.
        values: state to its neutral value, in place of its initial one.
    """

    after: Annotated[float, positive(LONGEST_SILENCE, "s")] = 0.2
    then: Literal["neutral", "hold", "fault"] = "neutral"
    values: Annotated[Mapping[str, Any], Key("set"), Write("{STATE: VALUE}")] = field(
        default_factory=dict
    )


def open_writers(store: Store, part: str, groups: Groups, states: States) -> dict[str, Writer]:
    """Return what publishes each group of a part.

    Raises:
        StateError: another run publishes under that name.
        MissingDependencyError: the backend is not installed.
    """
    if not groups:
        return {}
    if store.backend == "shm":
        from unicon_core.states.backends.shm import Segment, ShmWriter

        segment = Segment.create(store.segment(part), groups)
        return {name: ShmWriter(segment, name, states) for name in groups}
    from unicon_core.states.backends.zmq import ZmqWriter

    binds = part == store.parts[0]
    return {
        name: ZmqWriter(
            store.place(part, k),
            name,
            group,
            states,
            bind=binds,
            keys=store.keys,
            without_keys=True,  # `check` refuses that
        )
        for k, (name, group) in enumerate(groups.items())
    }


def open_reader(
    store: Store, part: str, here: str, groups: Groups, name: str, states: States, late: float
) -> Reader | None:
    """Return what takes one group of another part, None while nobody publishes it.

    Args:
        store: how states travel.
        part: which publishes.
        here: this part.
        groups: all groups of that part.
        name: of the group.
        states: into which values are copied.
        late: values on the way for that much longer than others are refused, [s].

    Raises:
        StateError: its states are others than here.
    """
    if store.backend == "shm":
        from unicon_core.states.backends.shm import ShmReader, segment_path

        if not segment_path(store.segment(part)).exists():  # asked in a tick: in microseconds
            return None
        return ShmReader(store.segment(part), name, states, groups[name])
    from unicon_core.states.backends.zmq import ZmqReader

    place = store.place(part, list(groups).index(name))
    binds = here == store.parts[0]
    return ZmqReader(
        place,
        name,
        groups[name],
        states,
        bind=binds,
        late=late,
        keys=store.keys,
        without_keys=True,  # `check` refuses that
    )


class Publisher:
    """Publishes one group at its place in the tick: a block.

    Args:
        writer: of the group.
        group: its states.
        name: of the block.
    """

    endless = True

    def __init__(self, writer: Writer, group: Sequence[str], name: str) -> None:
        self.name, self.reads = name, tuple(group)
        self._publish, self.close = writer.publish, writer.close

    def __call__(self) -> None:
        self._publish()


class Incoming:
    """Brings the groups of another part into the states, and minds its silence.

    Before the first value, and when none came for `silent.after`, its states are neutral, held, or
    the run is at fault, as declared. Whatever the other part sends, this one goes on: another
    layout is told once and counts as silence.

    Args:
        part: which publishes.
        groups: those of its groups that are wanted.
        open_reader: opens one of them by name; None while nobody publishes it.
        states: of this part.
        silent: what to do when it is silent.
        tell: takes one line when it falls silent and when it is heard again.

    Attributes:
        heard: it is, just now; None before the first look.
        refused: why what is there is not taken, or "".
        quiet: tells nothing: somebody waits for it.
    """

    endless = True

    def __init__(
        self,
        part: str,
        groups: Groups,
        open_reader: Callable[[str], Reader | None],
        states: States,
        silent: Silent,
        tell: Callable[[str], None],
    ) -> None:
        self.name = f"from {part}"
        self.part, self.groups = part, dict(groups)
        self.writes = tuple(name for group in groups.values() for name in group.specs)
        self.silent = silent
        self._open, self._tell = open_reader, tell
        self._readers: dict[str, Reader | None] = dict.fromkeys(groups)
        self._after_ns = round(silent.after * 1e9)
        self._tried_ns = dict.fromkeys(groups, -REFUSED_NS)
        self.refused = ""
        self.heard: bool | None = None
        self.quiet = False
        self._ever, self._neutral_always = False, silent.then != "hold"
        self._neutral = [
            (states[name], neutral_value(states.spec(name), name, silent.values))
            for name in self.writes
        ]

    def open(self) -> None:
        """Open all readers now: sockets and their threads take milliseconds, too long for a tick.

        Raises:
            StateError: an address cannot be had, or a key is missing.
        """
        try:
            for name in self.groups:
                self._readers[name] = self._open(name)
        except BaseException:
            self.close()
            raise

    def __call__(self) -> None:
        """Take what has come.

        Raises:
            Fault: the part is silent, and that is declared a fault.
        """
        now = time.monotonic_ns()
        fresh = True
        for name, reader in self._readers.items():
            if reader is None:
                reader = self._find(name, now)
            if reader is None:
                fresh = False
                continue
            if not reader.take():
                # As if it had been written in this tick: who amends it finds it as it came.
                reader.restore()
            if now - reader.stamp_ns > self._after_ns:  # the newest may be old
                fresh = False
                if now - self._tried_ns[name] > AGAIN_NS:
                    self._tried_ns[name] = now
                    self._follow(reader)
        if fresh is not self.heard:
            self._turn(fresh)
        if not fresh and (self._neutral_always or not self._ever):
            for view, value in self._neutral:
                view[...] = value

    def _find(self, name: str, now: int) -> Reader | None:
        if now - self._tried_ns[name] < (REFUSED_NS if self.refused else AGAIN_NS):
            return None
        self._tried_ns[name] = now
        try:
            reader = self._readers[name] = self._open(name)
        except StateError as error:
            self._refuse(error)
            return None
        return reader if reader is not None and reader.take() else None

    def _follow(self, reader: Reader) -> None:
        """Take a new writer up where the old one has died; tell of one that does not fit."""
        try:
            reader.alive()
        except StateError as error:
            self._refuse(error)

    def _refuse(self, error: StateError) -> None:
        if not self.refused:  # told once, until it is heard again
            self.refused = str(error)
            self._tell(f"part {self.part!r} is not heard: {self.refused}")

    def _turn(self, fresh: bool) -> None:
        before, self.heard = self.heard, fresh
        self._ever = self._ever or fresh
        if fresh:
            self.refused = ""
            if before is False and not self.quiet:
                self._tell(f"part {self.part!r} is heard")
            return
        after = f"{self.silent.after:g} s"
        if before is None and not self.quiet:
            self._tell(f"part {self.part!r} is not heard yet: its states are neutral")
        elif before and self.silent.then == "fault":
            raise Fault(f"part {self.part!r} has been silent for {after}")
        elif before:
            now = "are neutral" if self._neutral_always else "stay as they were"
            self._tell(f"part {self.part!r} has been silent for {after}: its states {now}")

    def wait(self, timeout: float) -> bool:
        """Return True when its first group has a new value, False after `timeout` in [s]."""
        reader = next(iter(self._readers.values()))
        if reader is None:
            time.sleep(min(timeout, AGAIN_NS * 1e-9))
            return False
        return reader.wait(timeout)

    def close(self) -> None:
        """Let go."""
        for reader in self._readers.values():
            if reader is not None:
                reader.close()


def neutral_value(spec: StateSpec, name: str, values: Mapping[str, Any]) -> Any:
    """Return the neutral value of a state: the declared one, else its initial value.

    Raises:
        StateError: the declared one does not fit.
    """
    if name not in values:
        return np.reshape(np.broadcast_to(spec.initial, spec.shape), spec.shape)
    try:
        with np.errstate(over="ignore"):  # too large is infinite
            value = np.broadcast_to(np.asarray(values[name], spec.dtype), spec.shape)
        finite = all(map(math.isfinite, value.ravel().tolist()))
    except (OverflowError, TypeError, ValueError):
        finite = False
    if not finite:
        raise StateError(
            f"the neutral value {values[name]!r:.60} of {name} does not fit shape {spec.shape}; "
            "give as many finite numbers"
        )
    return value

"""Parts: one workflow whose blocks run in several processes or machines, as the file says it.

    store: {zmq: {address: tcp://192.168.123.18:5600, keys: keys}}     # or shm, on one machine
    parts:
      robot: {publishes: [joint_pos, base_quat], silent: {after: 0.2}}
      desk: {publishes: [velocity_command], silent: {after: 1.0, then: hold}}
    commands:
      - {velocity_command: {}, on: desk}        # all else is the first part's

The first part has the platform and every block that does not say `on:`. `unicon run WORKFLOW --part
NAME` runs one part; without `--part` all of it runs in one process, as if nothing had been divided.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

from unicon_base import StateError, TextSink, WorkflowError, alternatives
from unicon_base.schema.marks import Checked, Matches, Size, Write
from unicon_core.states import Layout, States
from unicon_core.states.groups import groups_of, subset
from unicon_core.states.links import Incoming, Silent, Store, neutral_value, open_reader
from unicon_core.workflow.document import WorkflowDocument, read_part


def _wrong_address(address: str) -> str:
    tcp = re.fullmatch(r"tcp://[^\s/]+:([0-9]{1,5})", address)
    if (tcp and 0 < int(tcp[1]) < 65_000) or re.fullmatch(r"ipc://[^\0]+", address):
        return ""
    return (
        f"is {address!r:.60}, which is not an address; write tcp://HOST:PORT (the first part's), "
        "or ipc://PATH on one machine"
    )


Address = Annotated[str, Checked(_wrong_address), Write("tcp://HOST:PORT")]


@dataclass(frozen=True)
class QueueFile:
    """A message queue between processes or machines.

    Attributes:
        address: of the first part.
        keys: folder of CURVE keys, from the workflow's on.
    """

    address: Address
    keys: str | None = None


@dataclass(frozen=True)
class SegmentsFile:
    """Shared memory of one machine.

    Attributes:
        name: of the segments; the workflow's unless given.
    """

    name: str | None = None


@dataclass(frozen=True)
class StoreFile:
    """How states reach other processes.

    Attributes:
        shm: shared memory: its name, or {name: NAME}.
        zmq: a message queue: its address, or {address: ADDRESS, keys: FOLDER}.
    """

    shm: str | SegmentsFile | None = None
    zmq: Address | QueueFile | None = None

    def __post_init__(self) -> None:
        """Refuse both, and none.

        Raises:
            WorkflowError: they are given.
        """
        if (self.shm is None) == (self.zmq is None):
            raise WorkflowError("give either shm or zmq, and what it is")


StoreWord = Annotated[
    Literal["local", "shm"] | StoreFile, Write("local, shm or {zmq: ADDRESS}; ROS is ros: true")
]
"""What `store:` says."""


@dataclass(frozen=True)
class PartFile:
    """What a workflow says of one part.

    Attributes:
        publishes: states that it gives to the others.
        silent: what it does when another part is silent.
    """

    publishes: list[str] | None = None
    silent: Silent | None = None


PartFiles = Annotated[
    Mapping[Annotated[str, Matches(r"[^\W\d]\w*", "letters and digits")], PartFile | None],
    Size(2),
    Write("{robot: …, desk: …}, at least two"),
]
"""Name of a part to what it says."""


@dataclass(frozen=True)
class Part:
    """One part of a workflow.

    Attributes:
        name: of the part.
        publishes: states that it gives to the others.
        silent: what it does when another part is silent.
    """

    name: str
    publishes: tuple[str, ...]
    silent: Silent


@dataclass(frozen=True)
class Parts:
    """All parts of a workflow, in their order; the first one has the platform.

    Attributes:
        parts: by name.
        store: how their states travel.
    """

    parts: Mapping[str, Part]
    store: Store

    @property
    def first(self) -> str:
        """The part with the platform."""
        return next(iter(self.parts))

    def groups(self, part: str, layout: Layout) -> dict[str, Layout]:
        """Return the groups that a part publishes."""
        return groups_of(subset(layout, self.parts[part].publishes))

    def check(self, layout: Layout, document: WorkflowDocument) -> None:
        """Refuse what the parts publish twice, unknown states, and values that do not fit.

        Raises:
            WorkflowError: with its place.
        """
        owners: dict[str, str] = {}
        for part in self.parts.values():
            where = ("parts", part.name, "publishes")
            for state in part.publishes:
                if state not in layout.specs:
                    known = alternatives(state, layout.specs)
                    raise document.error(f"no state {state!r}; {known}", *where)
                if state == "tick":
                    raise document.error("each part counts its own ticks; leave tick out", *where)
                if state in owners:
                    raise document.error(
                        f"parts {owners[state]!r} and {part.name!r} both publish {state!r}; a "
                        "state has one writer: leave it to one of them",
                        *where,
                    )
                owners[state] = part.name
        for part in self.parts.values():
            for state in part.silent.values:
                if owners.get(state, part.name) == part.name:
                    theirs = [name for name, owner in owners.items() if owner != part.name]
                    raise document.error(
                        f"{state!r} does not come from another part; {alternatives(state, theirs)}",
                        "parts",
                        part.name,
                        "silent",
                        "set",
                    )
                try:
                    neutral_value(layout.specs[state], state, part.silent.values)
                except StateError as error:
                    place = ("parts", part.name, "silent", "set", state)
                    raise document.error(str(error), *place) from error

    def incoming(self, here: str, states: States, tell: TextSink) -> list[Incoming]:
        """Return what brings the states of the other parts into those of this one.

        Over `zmq` parts talk with the first one alone.

        Raises:
            StateError: an address cannot be had, or a key is missing.
            MissingDependencyError: the backend is not installed.
        """
        arrivals = []
        for part in self.parts:
            if part == here or (self.store.backend == "zmq" and self.first not in (part, here)):
                continue
            groups = self.groups(part, states.layout)
            silent = self.parts[here].silent
            own = {k: v for k, v in silent.values.items() if k in self.parts[part].publishes}
            if groups:
                opened = partial(
                    open_reader, self.store, part, here, groups, states=states, late=silent.after
                )
                silent = Silent(silent.after, silent.then, own)
                arrivals.append(Incoming(part, groups, opened, states, silent, tell))
        if self.store.backend == "zmq":
            for arrival in arrivals:
                arrival.open()
        return arrivals


def read_store(document: WorkflowDocument) -> Store | None:
    """Return what `store:` says of the whole workflow, None for local memory alone.

    Raises:
        WorkflowError: no such backend, or it is not described well.
    """
    said: str | StoreFile | None = read_part(
        document, StoreWord | None, document.values.get("store"), "store"
    )
    if said is None or said == "local":
        return None
    shm, zmq = ("", None) if isinstance(said, str) else (said.shm, said.zmq)
    if zmq is None:
        name = shm.name if isinstance(shm, SegmentsFile) else shm
        return _named(document, Store("shm", name or document.name))
    queue = QueueFile(zmq) if isinstance(zmq, str) else zmq
    try:
        keys = queue.keys and (document.path.parent / Path(queue.keys).expanduser()).resolve()
    except (RuntimeError, ValueError) as error:  # of somebody who is not there; a zero byte
        text = f"store.zmq.keys: {queue.keys!r} is not a folder: {error}"
        raise document.error(text, "store") from error
    return Store("zmq", document.name, queue.address, keys or None)


def _named(document: WorkflowDocument, store: Store) -> Store:
    """Return a store whose segments can have their names.

    Raises:
        WorkflowError: they cannot.
    """
    if store.backend == "shm":
        from unicon_core.states.backends.shm import segment_path  # of Linux alone

        try:
            for part in store.parts:
                segment_path(store.segment(part))
        except StateError as error:
            raise document.error(f"{error}, at most 100: store: {{shm: NAME}}", "store") from error
    return store


def read_parts(document: WorkflowDocument) -> Parts | None:
    """Return the parts of a workflow, None where it is not divided.

    Raises:
        WorkflowError: a key is wrong, or there are too few parts.
    """
    given: Mapping[str, PartFile | None] | None = read_part(
        document, PartFiles | None, document.values.get("parts"), "parts"
    )
    if given is None:
        return None
    files = {name: PartFile() if said is None else said for name, said in given.items()}
    parts = {
        name: Part(name, tuple(said.publishes or ()), said.silent or Silent())
        for name, said in files.items()
    }
    store = read_store(document) or Store("shm", document.name)
    return Parts(parts, _named(document, replace(store, parts=tuple(parts))))

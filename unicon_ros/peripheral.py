"""Peripheral: a device in a process of its own, as the tick sees it.

Of a peripheral `webxr` the states are `webxr_alive` (1 while it is there), `webxr_stamp_ns` (when
its values were true), `webxr_NAME_handle` of each ring of frames, and its values. Each goes back to
its initial value, the neutral one: in the next tick where the process says that the device is gone,
after `stale` seconds and at most `GLANCE` more where nothing comes, after `LOOK` or earlier where
the process has died.
"""

from __future__ import annotations

import json
import os
import select
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from unicon_base import AnyDict, AnyMapping, Fault, TextSink, UniconError
from unicon_base.schema.marks import positive
from unicon_core.flow import Block, Stage
from unicon_core.handles import FrameRing
from unicon_core.platforms.child.pipe import Pipe
from unicon_core.states import Layout, States, StateSpec
from unicon_core.states.backends.shm import ShmWatcher, remove_dead
from unicon_core.states.groups import Copies, subset
from unicon_core.workflow.autowire import BuildContext
from unicon_ros.peripheral_process import GROUP, START, handle_state

if TYPE_CHECKING:
    from unicon_ros.bridge.images import FrameMessage

GLANCE, LOOK = 0.02, 0.25
"""How often it is looked how old the values are, and whether the process lives and what it says, in
[s]; values themselves are looked at in every tick."""

CLOSING = 2.0
"""How long the process may take to end, in [s]."""

FIRST, LONGEST = 1.0, 30.0
"""Shortest and longest wait before a process that has died is started again, in [s]; it doubles
with each process that has not lived for the longest one."""

Count = Annotated[int, positive()]
"""Of pixels, or of pictures a second."""
Stale = Annotated[float, positive(10.0, "s")]
"""So long nothing may come, in [s]."""


def short(text: str, room: int) -> str:
    """Return as much of a text as has room in a wish, [B]."""
    while len(packed := json.dumps(text)) > room:
        text = text[: len(text) * room // len(packed)]
    return text


def peripheral_states(
    name: str, values: Mapping[str, StateSpec], frames: Iterable[str] = ()
) -> dict[str, StateSpec]:
    """Return the states of a peripheral, for `declares`.

    Args:
        name: of the peripheral.
        values: its own, under their whole names; `initial` is the neutral value.
        frames: names of its rings; "" for an only one, whose state is `NAME_handle`.
    """
    handles = {
        handle_state(name, ring): StateSpec(
            (), "int64", description=f"number of the newest frame of {ring or name}, 0 if none"
        )
        for ring in frames
    }
    return {
        f"{name}_alive": StateSpec((), "int32", description=f"1 while {name} is heard"),
        f"{name}_stamp_ns": StateSpec(
            (), "int64", "ns", description=f"when the values of {name} were true, CLOCK_MONOTONIC"
        ),
        **handles,
        **values,
    }


def peripheral_block(
    context: BuildContext,
    name: str,
    module: str,
    options: AnyMapping,
    *,
    values: Iterable[str],
    frames: Mapping[str, FrameMessage] | None = None,
    stale: float = 0.2,
    data: AnyMapping | None = None,
    environment: Mapping[str, str] | None = None,
    kind: type[Peripheral] | None = None,
) -> Block:
    """Return the block of a peripheral, in stage recv: records have what it told.

    In a dry run nothing is opened.

    Args:
        context: of the workflow.
        name: of the peripheral.
        module: that its process runs, which calls `serve`.
        options: for the device, as of JSON.
        values: names of its states besides those that every peripheral has.
        frames: ring to the layout of its frames.
        stale: so long nothing may come, in [s].
        data: further objects for the device, which can be pickled.
        environment: of the process; None for ours.
        kind: class of the tick; None for `Peripheral` itself.

    Raises:
        UniconError: what the process says when it cannot begin.
    """
    frames = frames or {}
    names = (*peripheral_states(name, {}, frames), *values)
    if context.dry:
        return Block(name, bool, writes=names, endless=True, stage=Stage.RECV)
    layout = subset(context.states.layout, names)
    given = {"name": name, "options": dict(options), "data": dict(data or {})}
    tick = (kind or Peripheral)(
        context.states,
        layout,
        module,
        given,
        frames,
        stale,
        context.period,
        context.tell,
        environment,
    )
    return Block(name, tick, writes=names, endless=True, stage=Stage.RECV, close=tick.close)


@dataclass(frozen=True, eq=False)
class FrameSource:
    """Where frames come from.

    Attributes:
        ring: they lie in it.
        message: layout of each.
    """

    ring: FrameRing
    message: FrameMessage


class Peripheral:
    """The tick of a peripheral.

    Args:
        states: of the workflow.
        layout: of what the device tells, some of these states.
        module: that its process runs.
        given: name, options and data.
        frames: ring to the layout of its frames.
        stale: so long nothing may come, in [s].
        period: of a tick in [s].
        tell: takes a line for the operator.
        environment: of the process; None for ours.

    Attributes:
        first: what the process told when it began; another one once it was started again.
        rings: of its frames, by name.
        sources: the same by the name of a ring's handle without `_handle`, such as `front`.
        process: it.
        started: how often it was.
        heard: takes what the process says besides notes.

    Raises:
        UniconError: what the process says when it cannot begin.
    """

    def __init__(
        self,
        states: States,
        layout: Layout,
        module: str,
        given: AnyMapping,
        frames: Mapping[str, FrameMessage],
        stale: float,
        period: float,
        tell: TextSink,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._states, self._layout, self._module = states, layout, module
        self._name, self._tell, self._environment = str(given["name"]), tell, environment
        self._stale_ns, self._every = round(stale * 1e9), max(1, round(GLANCE / period))
        self._left, self._glances = self._every, 0
        self._rounds = max(1, round(LOOK / max(GLANCE, period)))
        self._wait, self.started = FIRST, 0
        self._closed, self._news, self._began = False, "", 0.0
        self._ending = threading.Lock()
        self._neutral = States(layout)
        self._pairs = Copies(states, layout, memoryview(self._neutral.buffer.data).cast("B")).pairs
        self.heard: Callable[[AnyDict], object] = bool
        self.rings: dict[str, FrameRing] = {}
        self.sources: dict[str, FrameSource] = {}
        self._watcher: ShmWatcher | None = None
        self._take: Callable[[], bool] = bool
        self._thread: threading.Thread | None = None
        try:
            for ring, message in frames.items():
                made = self.rings[ring] = FrameRing.create(len(message.template))
                stem = handle_state(self._name, ring).removesuffix("_handle")
                self.sources[stem] = FrameSource(made, message)
            paths = {ring: str(made.path) for ring, made in self.rings.items()}
            self._given = {**given, "layout": layout.to_json(), "rings": paths}
            self.first = self._start()
        except BaseException:
            for made in self.rings.values():
                made.close()
            raise

    def _start(self) -> AnyDict:
        """Start the process and wait until it is ready; also from a thread beside the ticks."""
        self.started += 1
        segment = f"{self._name}-{os.getpid()}-{id(self) & 0xFFFFFF:x}-{self.started}"
        given = {**self._given, "segment": segment}
        pipe = Pipe(self._name, given, self._module, self._environment)
        try:
            first = pipe.answer(START)
            watcher = ShmWatcher(segment, GROUP, self._states, self._layout)
            watcher.unlink()  # a killed process leaves nothing
        except BaseException:
            pipe.close(0.0)
            remove_dead(segment)
            raise
        assert pipe.process.stdin is not None
        os.set_blocking(pipe.process.stdin.fileno(), False)  # `wish` waits for nobody
        self._pipe, self.process = pipe, pipe.process
        self._began = time.monotonic()
        self._watcher, self._take = watcher, watcher.take
        return first

    def __call__(self) -> bool:
        """Take what is new; what is lost or too old goes back to its neutral value.

        Returns whether a value may be another one now.
        """
        self._left -= 1
        if self._left:
            return self._take()
        self._left = self._every
        return self._glance()

    def _glance(self) -> bool:
        took, watcher = self._take(), self._watcher
        if watcher is None:
            return False
        old = not took and time.monotonic_ns() - watcher.stamp_ns > self._stale_ns
        if old:
            self._lapse()
        self._glances += 1
        if self._glances < self._rounds:
            return took or old
        self._glances = 0
        self._look()
        return True

    def _lapse(self) -> None:
        for neutral, state in self._pairs:
            state[:] = neutral

    def _look(self) -> None:
        """See whether the process lives, and what it says."""
        watcher = self._watcher
        if watcher is None:
            return
        pipe = self._pipe
        self.listen()
        if self._news:
            self._tell(self._news)
            self._news = ""
        if pipe.process.poll() is None:
            if time.monotonic() - self._began > LONGEST:
                self._wait = FIRST
            return
        self._lapse()
        self._watcher, self._take = None, bool
        self._tell(
            f"{pipe.end}; its values are neutral, and it is started again in {self._wait:g} s"
        )
        watcher.close()
        pipe.close(0.0)
        self._thread = threading.Thread(target=self._again, name=f"{self._name} again", daemon=True)
        self._thread.start()

    def listen(self) -> None:
        """Take what the process has said; it does so by itself every quarter of a second."""
        if self._watcher is None:
            return
        while told := self._pipe.words():
            line = told.get("note") or told.get("error") or told.get("fault")
            if line:
                self._tell(str(line))
            else:
                self.heard(told)

    def _again(self) -> None:
        while not self._closed:
            time.sleep(self._wait)
            self._wait = min(2.0 * self._wait, LONGEST)
            if self._closed:
                return
            with suppress(UniconError, Fault, OSError):
                self.first = self._start()
                where = self.first.get("address", "")
                self._news = f"{self._name}: its process runs again{where and f': {where}'}"
                if self._closed:  # meanwhile
                    self._end()
                return

    def wish(self, what: str, *given: object) -> bool:
        """Tell the process a wish; False where it is lost.

        One that has no room in its pipe is lost; so is one of more than 4096 B, of which a part
        alone could have room, as nothing behind that part would be understood.
        """
        return self._watcher is not None and self._pipe.tell(what, *given, most=select.PIPE_BUF)

    def close(self) -> None:
        """End the process, kill it where it hangs, and let the frames go; safe to call twice."""
        if self._closed:
            return
        self._closed = True
        self._end()
        for ring in self.rings.values():
            ring.close()

    def _end(self) -> None:
        with self._ending:
            watcher, self._watcher, self._take = self._watcher, None, bool
        if watcher is not None:
            self._pipe.close(CLOSING)
            watcher.close()

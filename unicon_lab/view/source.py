"""The ring of a run, as a viewer's process reads it; and what it sends back."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from unicon_base import AnyDict
from unicon_base.arrays import Array, Int64
from unicon_core.handles import FrameRing
from unicon_core.states import Layout, States
from unicon_core.states.states import aligned_buffer
from unicon_lab.view.shown import DEAD_MAN, DRIVING, GIVEN_BACK, HEAD
from unicon_ros.peripheral_process import Feed


class Snapshot:
    """One tick, copied out of the ring.

    Attributes:
        handle: its number in the ring.
        tick: its number in the run.
        wall_ns: time of the day, [ns].
        phase: its number in `Shown.phases`.
        paused: the simulator stands still.
        late_ns: how late the tick before it began.
        busy_ns: how long that one took.
        overruns: of the run so far.
        driving: a viewer's velocity is the command.
        robots: of a batch; the states are those of the first.
        counters: of the graph, int64.
        states: views by name.
        buffer: of all robots' states, uint8.
    """

    def __init__(self, layout: Layout, size: int) -> None:
        self.handle = self.tick = self.wall_ns = self.phase = self.late_ns = self.busy_ns = 0
        self.overruns, self.robots, self.paused, self.driving = 0, 1, False, False
        self._raw = aligned_buffer(size)  # its start, as the states' own, is aligned to 8 B
        self._begin = size - layout.nbytes
        states = States(layout, buffer=aligned_buffer(layout.nbytes))
        self.buffer = states.buffer
        many = layout.num_robots is not None
        self.states: Mapping[str, Array] = {
            name: states[name][0, ...] if many else states[name] for name in states
        }
        self.counters: Int64 = self._raw[HEAD.size : self._begin].view(np.int64)

    def take(self, ring: FrameRing, handle: int) -> bool:
        """Copy a frame; False when it was overwritten meanwhile."""
        frame = ring.frame(handle)
        if frame is None:
            return False
        self._raw[:] = frame
        if not ring.holds(handle):
            return False
        head = HEAD.unpack_from(self._raw.data)
        self.tick, stamp, self.phase, paused, self.late_ns, self.busy_ns = head[:6]
        self.wall_ns = time.time_ns() - (time.perf_counter_ns() - stamp)
        self.overruns, driving, self.robots = head[6:9]
        self.paused, self.driving, self.handle = bool(paused), bool(driving), handle
        self.buffer[:] = self._raw[self._begin :]
        return True


@dataclass(frozen=True)
class Answered:
    """What became of an act."""

    number: int
    done: bool
    text: str


class Source(Protocol):
    """Where a sink finds what it shows.

    Attributes:
        texts: `waits_for`, `faults` (lines) and `notes` (what the run has told of late).
        answers: to acts, the newest last; the sink takes them out.
        span: first and last moment of a recording in [s]; None of a live run.
    """

    texts: AnyDict
    answers: list[Answered]
    span: tuple[float, float] | None

    def latest(self) -> Snapshot | None:
        """Return the newest tick; None before the first. Valid until the next call."""
        ...

    def since(self, handle: int) -> Iterator[Snapshot]:
        """Yield each tick behind one, as far as they are still there; each valid until the next."""
        ...


class LiveSource:
    """Source of a run.

    Args:
        layout: of its states.
        ring: of its ticks.
    """

    span = None

    def __init__(self, layout: Layout, ring: FrameRing) -> None:
        self._ring = ring
        self._latest, self._each = (Snapshot(layout, ring.nbytes) for _ in range(2))
        self.texts: AnyDict = {"waits_for": "", "faults": [], "notes": []}
        self.answers: list[Answered] = []

    def latest(self) -> Snapshot | None:
        """Return the newest tick; None before the first. Valid until the next call."""
        for _ in range(3):
            handle = self._ring.latest
            if not handle:
                return None
            if handle == self._latest.handle or self._latest.take(self._ring, handle):
                return self._latest
        return self._latest if self._latest.handle else None

    def since(self, handle: int) -> Iterator[Snapshot]:
        """Yield each tick behind one, as far as they are still there; each valid until the next."""
        newest = self._ring.latest
        for number in range(max(handle, newest - self._ring.slots + 2, 0) + 1, newest + 1):
            if self._each.take(self._ring, number):
                yield self._each

    def hear(self, feed: Feed) -> bool:
        """Take what the run has told; return whether texts are among it."""
        wishes, feed.wishes = feed.wishes, []
        for what, *given in wishes:
            if what == "answer":
                self.answers.append(Answered(*given))
            elif what == "texts":
                self.texts |= given[0]
        return any(what == "texts" for what, *_ in wishes)


class Remote:
    """What a viewer sends to the run; its methods may be called in any thread.

    Args:
        feed: of this process; None of a recording, which nobody can drive.
    """

    def __init__(self, feed: Feed | None) -> None:
        self._feed, self._lock = feed, threading.Lock()
        self._velocity = np.zeros(3, np.float32)
        self._mode = self._touch = self._estop = self._acts = self._heard_ns = self._body = 0
        self._pull = np.zeros((2, 3), np.float32)

    def touch(self) -> None:
        """Begin to drive: `drive` counts from here on. After a stall it has to be called again."""
        with self._lock:
            self._touch += 1
            self._mode, self._body, self._heard_ns = DRIVING, 0, time.monotonic_ns()
            self._velocity[:] = 0.0
            self._publish()

    def drive(self, velocity: Array) -> None:
        """Command a velocity, [m/s, m/s, rad/s]; it counts for `DEAD_MAN` seconds.

        What is not finite is not taken. After so long a silence a viewer has to touch again.
        """
        velocity = np.asarray(velocity, np.float32)
        if velocity.shape != (3,) or not np.isfinite(velocity).all():
            return
        with self._lock:
            now = time.monotonic_ns()
            if self._mode != DRIVING or now - self._heard_ns > DEAD_MAN * 1e9:
                return
            self._velocity[:] = velocity
            self._heard_ns = now
            self._publish()

    def pull(self, body: int, place: ArrayLike = 0.0, goal: ArrayLike = 0.0) -> None:
        """Drag a body of a simulated robot while this viewer drives; body 0 releases it.

        Args:
            body: its number in `Shown.bodies`.
            place: where it is held, in its frame in [m], shape (3,).
            goal: where that point is dragged to, in the world in [m], shape (3,).
        """
        with self._lock:
            self._body, self._pull[0], self._pull[1] = body, place, goal
            self._publish()

    def let_go(self) -> None:
        """Give the command back to the workflow."""
        with self._lock:
            self._mode, self._body = GIVEN_BACK, 0
            self._publish()

    def estop(self) -> None:
        """Press the emergency stop."""
        with self._lock:
            self._estop += 1
            self._publish()

    def act(self, name: str, /, **arguments: Any) -> int:
        """Wish `start`, `stop`, `reset`, `pause`, `step`, `swap`, `skill` (name), `push` (velocity:
        forwards and to the left [m/s]) or `set_parameter` (name, value); return the number under
        which the answer comes."""
        with self._lock:
            self._acts += 1
            if self._feed is not None:
                self._feed.words(act=[name, self._acts, arguments])
            self._publish()
            return self._acts

    def pages(self, count: int) -> None:
        """Report how many browsers look."""
        if self._feed is not None:
            self._feed.words(pages=count)

    def beat(self) -> None:
        """Tell that this process lives; not that a driver does."""
        with self._lock:
            self._publish()

    def _publish(self) -> None:
        if self._feed is not None:
            self._feed.publish(
                self._heard_ns,
                view_velocity=self._velocity,
                view_mode=self._mode,
                view_touch=self._touch,
                view_estop=self._estop,
                view_acts=self._acts,
                view_pull_body=self._body,
                view_pull_place=self._pull[0],
                view_pull_goal=self._pull[1],
            )


class Wheel:
    """Hands the robot to one viewer; its methods may be called in any thread.

    A velocity is sent only when the driver's page was heard, so that the run's own dead-man counts
    from there. A driver who is lost, by silence, a hidden page or a closed one, leaves the
    command at zero; he has to take the wheel again, and the first to ask gets it.

    Args:
        remote: what drives.
        bounds: lowest and highest vx, vy [m/s] and wz [rad/s].
        drags: bodies may be dragged, so that there is something to do without bounds.

    Attributes:
        driver: number of the viewer who drives; None for nobody.
        velocity: what he commands, shape (3,).
        lost: why the last driver was lost; "" when nobody was, or somebody drives again.
    """

    def __init__(
        self, remote: Remote, bounds: Sequence[tuple[float, float]], drags: bool = False
    ) -> None:
        self._remote, self._lock = remote, threading.RLock()
        self._low, self._high = np.array(bounds, float).reshape(-1, 2).T
        self._heard, self._drags = 0.0, drags
        self.driver: int | None = None
        self.velocity = np.zeros(3)
        self.lost = ""

    def take(self, viewer: int, now: float) -> str:
        """Let a viewer drive, from standstill.

        Args:
            viewer: its number.
            now: time in [s].

        Returns:
            "" or why not.
        """
        with self._lock:
            self.look(now)
            if not len(self._low) and not self._drags:
                return "this workflow reads no velocity command: there is nothing to drive"
            if self.driver is not None and self.driver != viewer:
                return f"viewer {self.driver} drives; ask for the wheel to be let go"
            self.driver, self.lost, self._heard = viewer, "", now
            self.velocity[:] = 0.0
            self._remote.touch()
            return ""

    def let_go(self, viewer: int) -> None:
        """Give the command back to the workflow, where this viewer drives."""
        with self._lock:
            if self.driver == viewer:
                self.driver = None
                self._remote.let_go()

    def steer(self, viewer: int, velocity: Sequence[float], now: float) -> bool:
        """Command a velocity; False where this viewer does not drive.

        Args:
            viewer: its number.
            velocity: brought into the bounds; what is not finite is not taken.
            now: time in [s].
        """
        wanted = np.asarray(velocity, float)
        with self._lock:
            self.look(now)
            if self.driver != viewer or wanted.shape != (3,) or not np.isfinite(wanted).all():
                return False
            if len(self._low):
                self.velocity[:] = np.clip(wanted, self._low, self._high)
            return self.heard(viewer, now)

    def pull(self, viewer: int, now: float, body: int, *ends: ArrayLike) -> bool:
        """Drag a body, as of `Remote.pull`; False where this viewer does not drive."""
        with self._lock:
            self.look(now)
            if self.driver != viewer:
                return False
            self._remote.pull(body, *ends)
            return True

    def heard(self, viewer: int, now: float) -> bool:
        """Note that a viewer's page answered; True where it drives on."""
        with self._lock:
            self.look(now)
            if self.driver != viewer:
                return False
            self._heard = now
            self._remote.drive(self.velocity)
            return True

    def look(self, now: float) -> None:
        """Take the wheel from a driver whose page was silent for `DEAD_MAN` seconds."""
        with self._lock:
            if self.driver is not None and now - self._heard > DEAD_MAN:
                self.lose(self.driver, "was silent")

    def lose(self, viewer: int, why: str) -> None:
        """Take the wheel from a driver at once: his page is closed, or hidden."""
        with self._lock:
            if self.driver == viewer:
                self.velocity[:] = 0.0
                self._remote.pull(0)
                self._remote.drive(self.velocity)
                self.driver = None
                self.lost = f"the page of viewer {viewer}, who drove, {why}: velocity zero"


class Sink(Protocol):
    """What shows a source; made as `Sink(shown, source, remote, options)`.

    Attributes:
        address: where it is seen.
    """

    address: str

    def poll(self) -> None:
        """Show what is new; called about 60 times a second, always in the same thread."""
        ...

    def close(self) -> None:
        """Close what is open."""
        ...

"""A platform in a process of its own: a vendor's SDK keeps its threads, its DDS and its crashes.

    platform: {child: mujoco}
    platform: {child: my_robot, silence: 0.05, watchdog: 0.2}

The parent publishes the command states at `send` and takes the measured ones at `recv`, both
through shared memory (`states/backends/shm/`). A simulator is ticked in step: `recv` waits for
the answer to the last command, so that a run is bit-exact. A robot's process runs freely,
and `recv` takes the newest.

Either side may die or hang at any moment. The parent then faults within `silence`, and the child
damps and ends within `watchdog` of the last command, at once where the parent has died.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import AnyMapping, Fault, PlatformError
from unicon_base.arrays import Float64
from unicon_core.platforms.child.pipe import Pipe
from unicon_core.platforms.kit.command import FiniteCheck
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.signals import SIGNALS
from unicon_core.states import States
from unicon_core.states.backends.shm import Segment, ShmReader, ShmWriter, remove_dead
from unicon_core.states.groups import COMMAND, MEASURED, subset
from unicon_core.terrain.words import Terrain

SILENCE = {True: 1.0, False: 0.02}
"""Default of `silence` in [s], of a simulator (as `pacing.hang`: a busy machine is no danger) and a
robot; two ticks where those are longer."""

WATCHDOG = {True: 2.0, False: 0.1}
"""Default of `watchdog` in [s], of a simulator (a pause of the parent harms nobody) and a robot;
three ticks where those are longer."""

START = 60.0
"""Longest time to start in [s]: drivers connect, simulators read their models."""

DAMPING = 5.0
"""How long a child that still answers may take to damp and close, in [s]."""

HUNG = 0.5
"""The same for one that does not answer any more; then it is killed."""

# How often a child that is waited for is looked at, in [s]: a death is noticed within it.
_LOOK = 0.005


class ChildPlatform:
    """The parent's side; facts and abilities are those of the child's platform.

    Args:
        factory: of the platform that runs in the child; importable by its name there.
        facts: as it declares them.
        states: of the parent.
        robot: the robot.
        period: of a tick in [s].
        arguments: further arguments of the factory, which can be pickled.
        silence: the longest wait for the child in [s]; at least two ticks are waited.
        watchdog: the child damps when no command came for that long in [s].

    Attributes:
        process: the child.

    Raises:
        UniconError: what the child's platform raised when it was built, as if it were here.
        PlatformError: the child did not start.
    """

    def __init__(
        self,
        factory: Callable[..., Any],
        facts: Facts,
        states: States,
        robot: Robot,
        period: float,
        arguments: AnyMapping,
        *,
        silence: float | None = None,
        watchdog: float | None = None,
    ) -> None:
        self.facts = facts
        self._silence = max(SILENCE[facts.simulated] if silence is None else silence, 2.0 * period)
        self._watchdog = max(
            WATCHDOG[facts.simulated] if watchdog is None else watchdog, 3.0 * period
        )
        self._due = 0
        self._reported: AnyMapping = {}
        self._closed = self._hung = self._done = False
        self._told = True  # its end, in an error: nothing is to be told twice
        name = f"{facts.name or 'platform'}-{os.getpid()}-{id(self) & 0xFFFF:x}"
        self._child_segment = f"{name}-child"
        self._segment = Segment.create(name, {COMMAND: subset(states.layout, facts.reads)})
        try:
            self._commands = ShmWriter(self._segment, COMMAND, states)
            given = {
                "factory": _place(factory),
                "layout": states.layout.to_json(),
                "robot": robot,
                "period": period,
                "arguments": dict(arguments),
                "parent": name,
                "segment": self._child_segment,
                "watchdog": self._watchdog,
            }
            self._pipe = Pipe(f"platform {facts.name!r}", given)
            self.process = self._pipe.process
            told = self._pipe.answer(START, SIGNALS.check)
            self.facts = told["facts"]
            self._info: AnyMapping = told["info"]
            self._reader = ShmReader(self._child_segment, MEASURED, states)
            # No other process finds them, and a killed one leaves nothing.
            self._segment.unlink()
            self._reader.unlink()
        except BaseException:
            self.close()
            raise
        if told["model_path"] is not None:
            self.model_path: Path = told["model_path"]
        self.terrain: Terrain | None = told["terrain"]
        self._finite = FiniteCheck(
            {state: states[state] for state in self.facts.reads}, robot.joint_names
        )
        self._due = 1
        self._told = False
        for ability in told["abilities"]:  # the protocols look for methods
            asked = getattr(self, f"_{ability}", partial(self._ask, ability))
            setattr(self, ability, asked)
        if facts.simulated:
            self.pause = self._pause
        else:
            self.recv = self._newest  # type: ignore[method-assign]

    # -- in a tick --------------------------------------------------------------------------------

    def recv(self) -> bool | None:
        """Take the simulator's answer to the last command; wait for it where it is not there yet.

        Raises:
            Fault: the child has died, hangs, or tells of a fault.
        """
        reader = self._reader
        if reader.number == self._due:  # a second look in one tick
            reader.restore()
            return None
        if reader.take():
            return None
        return self._wait()

    def _newest(self) -> bool | None:
        """Take the robot's newest data; `recv` of what runs freely."""
        reader = self._reader
        if reader.take():
            return None
        # It takes data far more often than a tick: what has not come is looked into at once.
        silent_ns = time.monotonic_ns() - reader.stamp_ns
        return self._look(hung=silent_ns > self._silence * 1e9)

    def _wait(self) -> bool | None:
        end = time.monotonic() + self._silence
        while not self._reader.wait(min(max(end - time.monotonic(), 0.0), _LOOK)):
            if self._look(hung=time.monotonic() >= end):
                return True
        self._reader.take()
        return None

    def _look(self, *, hung: bool) -> bool:
        """Look after the child, of which nothing new came; True where it is done.

        Raises:
            Fault: it has died, tells of a fault, or hangs.
        """
        gone = self.process.poll() is not None
        told = self._pipe.words()
        self._done = self._done or "done" in told
        if self._done:
            return True
        if gone or told:
            self._told = True
            raise Fault(told.get("fault") or self._pipe.end)
        if hung:
            self._told = self._hung = True
            raise Fault(
                f"platform {self.facts.name!r}: its process {self.process.pid} has not "
                f"answered for {self._silence:g} s: it hangs or was stopped (platform.silence)"
            )
        return False

    def send(self) -> bool | None:
        """Publish the command states.

        Raises:
            Fault: a command is not finite.
        """
        self._finite()
        self._commands.publish()
        self._due += 1
        return None

    # -- what the platform can do besides ---------------------------------------------------------

    def _reset(self) -> None:
        self._settle()
        self._ask("reset")
        self._due += 1

    def _push(self, velocity: Float64) -> None:
        self._ask("push", np.asarray(velocity, np.float64).tolist())

    def _pause(self) -> None:
        self._settle()
        self._pipe.tell("pause")

    def _settle(self) -> None:
        """Wait for the answer to the last command, which comes before the next wish there too."""
        if self._reader.number != self._due and not self._reader.take():
            self._wait()

    def _variant(self) -> Any:
        if not self._reported:  # then it does not change any more
            self._reported = self._ask("variant")
        return self._reported

    def info(self) -> AnyMapping:
        """Return what the child's platform told when it was built, and the process."""
        return {**self._info, "process": self.process.pid}

    # -- its end, and what it is asked ------------------------------------------------------------

    def _ask(self, what: str, *given: object) -> Any:
        """Return what a method of the child's platform returns, or raise what it raises.

        Raises:
            UniconError: of the method, or the child does not answer.
            Fault: of the method, or the child has ended.
        """
        self._pipe.tell(what, *given)
        self._told = True  # by what is raised here
        told = self._pipe.answer(DAMPING)
        if "value" not in told:  # its last words
            raise Fault(f"platform {self.facts.name!r} has gone while it was asked for its {what}")
        self._told = False
        return told["value"]

    def close(self) -> None:
        """Let the child damp and end; kill it where it hangs. Safe to call twice.

        Raises:
            Fault: the child has failed or died, which nobody has been told yet.
            PlatformError: the child could not damp.
        """
        if self._closed:
            return
        self._closed = True
        built = vars(self)  # where it failed, the pipe or the reader is not there
        pipe: Pipe | None = built.get("_pipe")
        reader: ShmReader | None = built.get("_reader")
        words = {}
        if pipe is not None:
            words = pipe.close(HUNG if self._hung else DAMPING)
        if reader is not None:
            reader.close()
        self._segment.close()
        remove_dead(self._child_segment)
        if pipe is None or reader is None or self._hung:
            return
        if "fault" in words and not self._told:
            raise Fault(words["fault"])
        if "closing" in words:
            raise PlatformError(f"platform {self.facts.name!r}: {words['closing']}")
        if "closed" not in words and not self._told:
            raise Fault(f"{pipe.end} and has not closed")


def _place(factory: Callable[..., Any]) -> str:
    """Return `module:name` of a factory, by which the child imports it.

    Raises:
        PlatformError: it has none.
    """
    module = getattr(factory, "__module__", None)
    name = getattr(factory, "__qualname__", "")
    if module in (None, "__main__") or not name.replace(".", "_").isidentifier():
        raise PlatformError(
            f"platform {name or factory!r} cannot run in a child, which could not import it; put "
            "its factory into a module, or leave out child"
        )
    return f"{module}:{name}"

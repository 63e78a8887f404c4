"""Process of a child platform: ticks it by what the parent publishes; started by `ChildPlatform`.

It reads a description of itself from stdin, then one line for each wish; stdin's end asks it to
close. It damps and ends too when no command came within the watchdog's time, when its parent has
died, and on SIGTERM.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pkgutil import resolve_name
from typing import Any

from unicon_base import Fault, UniconError
from unicon_core.models.find import terrain_of
from unicon_core.platforms.child.pipe import ALARM, LONGEST, Parent, text_of
from unicon_core.platforms.child.platform import START
from unicon_core.platforms.platform import Platform, info_of
from unicon_core.states import Layout, States
from unicon_core.states.backends.shm import Segment, ShmReader, ShmWriter
from unicon_core.states.groups import COMMAND, MEASURED, subset

ABILITIES = ("reset", "push", "require", "variant", "commanders", "prepare", "arrivals")
"""What a platform can do for its parent besides a tick: methods of its protocols.

A call goes through the pipe, and what the method returns or raises comes back. None is called once
commands are sent but those of simulators. A new ability needs its word here and nothing else."""

# How often a robot's data are taken, in [s]; a command is sent at once.
_ROBOT_LOOK = 0.001

# How often a simulator that waits for commands looks whether its parent lives, in [s].
_LOOK = 0.005


def main() -> int:
    """Run; 0 after an orderly end, 3 after a fault."""
    parent = Parent(START)
    tell = parent.tell
    # A vendor's code may raise anything, SystemExit too; whatever it is, the robot is damped.
    try:
        driver = _Driver(parent)
    except UniconError as error:
        tell(error=str(error)[:LONGEST], kind=type(error).__name__)
        return 1
    except BaseException as error:
        factory = parent.given["factory"]
        tell(error=f"platform {factory} raised {text_of(error)}", kind="PlatformError")
        return 1
    signal.signal(signal.SIGTERM, driver.stop)
    platform = driver.platform
    status = 0
    try:
        tell(
            facts=replace(platform.facts, examine=None),
            info=dict(info_of(platform)),
            model_path=getattr(platform, "model_path", None),
            terrain=terrain_of(platform),
            abilities=[name for name in ABILITIES if hasattr(platform, name)],
        )
        if driver.run():
            tell(done=True)
    except BaseException as error:
        status = 3
        text = text_of(error)
        known = isinstance(error, Fault)
        tell(fault=text if known else f"platform {platform.facts.name!r} raised {text}")
    signal.alarm(ALARM)
    try:
        platform.close()  # damps first
        tell(closed=True)
    except BaseException as error:
        status = 3
        tell(closing=f"closing: {text_of(error)}")
    driver.close()
    return status


class _Driver:
    """The platform, and the two segments between which it stands."""

    def __init__(self, parent: Parent) -> None:
        self._parent = parent
        given = parent.given
        factory: Any = resolve_name(given["factory"])
        self._states = States(Layout.from_json(given["layout"]))
        self._commands = ShmReader(given["parent"], COMMAND, self._states)
        self._commands.unlink()  # nothing is left of a parent that is killed from here on
        self.platform: Platform = factory(
            self._states, given["robot"], given["period"], **given["arguments"]
        )
        facts = self.platform.facts
        self._watchdog = given["watchdog"]
        self._stepped = facts.simulated
        self._stopped = False
        self._heard = 0.0
        try:
            measured = subset(self._states.layout, facts.writes)
            self._segment = Segment.create(given["segment"], {MEASURED: measured})
            self._writer = ShmWriter(self._segment, MEASURED, self._states)
            self.platform.recv()
            self._writer.publish()
        except BaseException:
            self.platform.close()  # it is open by now
            raise

    def stop(self, *_: object) -> None:
        """Ask to end."""
        self._stopped = True

    def run(self) -> bool:
        """Tick until the parent closes; True when the platform is done.

        Raises:
            Fault: of the platform, or the parent is silent.
        """
        platform = self.platform
        commands = self._commands
        writer = self._writer
        slice_ = _LOOK if self._stepped else _ROBOT_LOOK
        recv = platform.recv
        send = platform.send
        publish = writer.publish
        stepped = self._stepped
        self._heard = 0.0
        looked = time.monotonic()
        while not self._stopped:
            signal.alarm(ALARM)
            came = commands.wait(slice_)
            if not self._obey():
                return False
            if came:
                commands.take()
                if send():
                    return True
                self._heard = time.monotonic()
            if came or not stepped:
                if recv():
                    return True
                publish()
            if came:
                continue
            now = time.monotonic()
            if self._heard and now - self._heard > self._watchdog:
                raise Fault(
                    f"platform {platform.facts.name!r}: no command came for {self._watchdog:g} s, "
                    "its process damped (platform.watchdog)"
                )
            if now - looked > _LOOK:
                looked = now
                if not commands.alive():
                    return False
        return False

    def _obey(self) -> bool:
        """Do what the parent wishes; False when it closes."""
        wishes = self._parent.wishes()
        for what, *given in wishes or ():
            self._do(what, given)
        return wishes is not None

    def _do(self, what: str, given: list[Any]) -> None:
        if what == "pause":
            self._heard = 0.0  # until the next command
            return
        try:
            value = getattr(self.platform, what)(*given)
            if what == "reset":
                self.platform.recv()
                self._writer.publish()
        except UniconError as error:
            self._parent.tell(error=str(error), kind=type(error).__name__)
        else:
            self._parent.tell(value=dict(value) if isinstance(value, Mapping) else value)

    def close(self) -> None:
        """Let go of both segments."""
        self._commands.close()
        self._segment.close()


if __name__ == "__main__":
    # No destructors: simulators and vendors' libraries print tracebacks when Python tears them
    # down.
    status = main()
    sys.stderr.flush()
    os._exit(status)

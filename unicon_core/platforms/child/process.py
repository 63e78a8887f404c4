"""Process of a child platform: ticks it by what the parent publishes; started by `ChildPlatform`.

It reads a description of itself from stdin, then one line for each wish; stdin's end asks it to
close. It damps and ends too when no command came within the watchdog's time, when its parent has
died, and on SIGTERM.
"""

from __future__ import annotations

import json
import os
import pickle
import select
import signal
import sys
import time
from dataclasses import replace
from importlib import import_module
from typing import Any

from unicon_core.errors import Fault, UniconError
from unicon_core.platforms.child.platform import START
from unicon_core.platforms.platform import (
    Platform,
    Prepares,
    Pushable,
    ReportsVariant,
    RequiresStates,
    Resettable,
    SeesCommanders,
    info_of,
)
from unicon_core.states import Layout, States
from unicon_core.states.backends.shm import Segment, ShmReader, ShmWriter
from unicon_core.states.groups import COMMAND, MEASURED, subset

__all__ = ["main"]

_ROBOT_LOOK = 0.001
"""How often a robot's data are taken, in [s]; a command is sent at once."""

_LOOK = 0.005
"""How often a simulator that waits for commands looks whether its parent lives, in [s]."""


_ALARM = 10
"""In [s]: the kernel ends a process that hangs so long, as its parent would if it still lived."""

LONGEST = 1000
"""Characters of an error that are told."""


def main() -> int:
    """Run; 0 after an orderly end, 3 after a fault."""
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTSTP):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(round(START) + _ALARM)
    told = os.dup(1)
    os.dup2(2, 1)  # what libraries print is not for the parent
    size = int.from_bytes(_exactly(8), "little")
    given = pickle.loads(_exactly(size))  # of our own parent, through our own pipe

    def tell(**words: Any) -> None:
        try:
            packed = pickle.dumps(words)
            os.write(told, len(packed).to_bytes(8, "little") + packed)
        except OSError:
            pass  # nobody is there to be told

    # A vendor's code may raise anything, SystemExit too; whatever it is, the robot is damped.
    try:
        driver = _Driver(given)
    except UniconError as error:
        tell(error=str(error)[:LONGEST], kind=type(error).__name__)
        return 1
    except BaseException as error:
        tell(error=f"platform {given['factory']} raised {_text(error)}", kind="PlatformError")
        return 1
    signal.signal(signal.SIGTERM, driver.stop)
    platform = driver.platform
    abilities: dict[str, Any] = {
        "reset": Resettable,
        "push": Pushable,
        "require": RequiresStates,
        "variant": ReportsVariant,
        "prepare": Prepares,
        "commanders": SeesCommanders,
    }
    status = 0
    try:
        tell(
            facts=replace(platform.facts, examine=None),
            info=dict(info_of(platform)),
            model_path=getattr(platform, "model_path", None),
            abilities=[name for name, kind in abilities.items() if isinstance(platform, kind)],
        )
        if driver.run(tell):
            tell(done=True)
    except BaseException as error:
        status = 3
        text = _text(error)
        known = isinstance(error, Fault)
        tell(fault=text if known else f"platform {platform.facts.name!r} raised {text}")
    signal.alarm(_ALARM)
    try:
        platform.close()  # damps first
        tell(closed=True)
    except BaseException as error:
        status = 3
        tell(closing=f"closing: {_text(error)}")
    driver.close()
    return status


def _text(error: BaseException) -> str:
    """Return an exception in one short line: a pipe that nobody reads holds no long one."""
    kind = "" if isinstance(error, Fault) else type(error).__name__
    try:
        text = " ".join(str(error).split())
    except Exception:  # its text cannot be had
        text = ""
    whole = ": ".join(filter(None, (kind, text)))
    return whole if len(whole) <= LONGEST else f"{whole[:LONGEST]}…"


class _Driver:
    """The platform, and the two segments between which it stands."""

    def __init__(self, given: dict[str, Any]) -> None:
        module, name = given["factory"].split(":")
        factory: Any = import_module(module)
        for part in name.split("."):
            factory = getattr(factory, part)
        self._states = States(Layout.from_json(given["layout"]))
        self._commands = ShmReader(given["parent"], COMMAND, self._states)
        self._commands.unlink()  # nothing is left of a parent that is killed from here on
        self.platform: Platform = factory(
            self._states, given["robot"], given["period"], **given["arguments"]
        )
        facts = self.platform.facts
        self._watchdog = given["watchdog"]
        self._stepped = facts.simulated
        self._stopped, self._wishes, self._heard = False, b"", 0.0
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

    def run(self, tell: Any) -> bool:
        """Tick until the parent closes; True when the platform is done.

        Raises:
            Fault: of the platform, or the parent is silent.
        """
        platform, commands, writer = self.platform, self._commands, self._writer
        slice_ = _LOOK if self._stepped else _ROBOT_LOOK
        recv, send, publish, stepped = platform.recv, platform.send, writer.publish, self._stepped
        self._heard, looked = 0.0, time.monotonic()
        while not self._stopped:
            signal.alarm(_ALARM)
            came = commands.wait(slice_)
            if not self._obey(tell):
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

    def _obey(self, tell: Any) -> bool:
        """Do what the parent wishes; False when it closes."""
        while select.select([0], [], [], 0.0)[0]:
            read = os.read(0, 1 << 16)
            if not read:
                return False
            *lines, self._wishes = (self._wishes + read).split(b"\n")
            for line in lines:
                what, value = json.loads(line)
                self._do(what, value, tell)
        return True

    def _do(self, what: str, value: Any, tell: Any) -> None:
        platform = self.platform
        if what == "pause":
            self._heard = 0.0  # until the next command
            return
        if what == "push":
            assert isinstance(platform, Pushable)
            platform.push(value)
            return
        try:
            if what == "reset":
                assert isinstance(platform, Resettable)
                platform.reset()
                platform.recv()
                self._writer.publish()
            elif what == "variant":
                assert isinstance(platform, ReportsVariant)
                tell(variant=dict(platform.variant()))
                return
            elif what == "prepare":
                assert isinstance(platform, Prepares)
                tell(prepare=platform.prepare())
                return
            elif what == "commanders":
                assert isinstance(platform, SeesCommanders)
                tell(commanders=dict(platform.commanders()))
                return
            else:
                assert isinstance(platform, RequiresStates)
                platform.require(value)
        except UniconError as error:
            tell(error=str(error), kind=type(error).__name__)
        else:
            tell(ok=True)

    def close(self) -> None:
        """Let go of both segments."""
        self._commands.close()
        self._segment.close()


def _exactly(count: int) -> bytes:
    data = b""
    while len(data) < count:
        read = os.read(0, count - len(data))
        if not read:
            raise SystemExit(1)  # the parent died
        data += read
    return data


if __name__ == "__main__":
    # No destructors: simulators and vendors' libraries print tracebacks when Python tears them
    # down.
    status = main()
    sys.stderr.flush()
    os._exit(status)

"""Both ends of the pipe between a process of ours and a child, such as a platform's.

What is exchanged in a tick goes through shared memory instead; see `ChildPlatform`.
"""

from __future__ import annotations

import json
import os
import pickle
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from unicon_base import AnyDict, AnyMapping, Fault, PlatformError, UniconError, errors
from unicon_base.resources import same_modules
from unicon_core.signals import signal_name

PLATFORM = "unicon_core.platforms.child.process"
"""Module that runs a platform."""


class Pipe:
    """The parent's end.

    Args:
        what: the platform or policy, for messages.
        given: what the child reads first, which can be pickled.
        module: that runs in the child.
        environment: of the child, with our modules; None for ours.

    Attributes:
        process: the child.

    Raises:
        PlatformError: something given cannot be pickled.
    """

    def __init__(
        self,
        what: str,
        given: AnyMapping,
        module: str = PLATFORM,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._what = what
        self._rest = b""
        try:
            packed = pickle.dumps(given)
        except (AttributeError, TypeError, pickle.PicklingError) as error:
            raise PlatformError(
                f"{what} cannot run in a child: {error}; leave out child"
            ) from error
        self.process = subprocess.Popen(
            [sys.executable, "-m", module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            env=same_modules() if environment is None else dict(environment),
            start_new_session=True,  # Ctrl-C and Ctrl-Z are the parent's: it damps in order
        )
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self._into, self._out_of = self.process.stdin, self.process.stdout
        with suppress(BrokenPipeError):  # its first words tell why
            self._into.write(len(packed).to_bytes(8, "little") + packed)

    def tell(self, what: str, *given: object, most: int | None = None) -> bool:
        """Say a wish; False where the child has gone, or has no room in a pipe that never waits.

        Args:
            what: it is.
            given: with it.
            most: bytes that may be said; a longer wish is not.
        """
        line = json.dumps([what, *given]).encode() + b"\n"
        if most is not None and len(line) > most:
            return False
        with suppress(BrokenPipeError):  # `recv` tells of a child that has died
            return self._into.write(line) is not None
        return False

    def words(self) -> AnyDict:
        """Return what the child has written since the last look, {} for nothing whole."""
        while select.select([self._out_of], [], [], 0.0)[0]:
            read = os.read(self._out_of.fileno(), 1 << 16)
            if not read:
                break
            self._rest += read
        size = int.from_bytes(self._rest[:8], "little")
        if len(self._rest) < 8 + size or not size:
            return {}
        words = self._rest[8 : 8 + size]
        self._rest = self._rest[8 + size :]
        try:
            told = pickle.loads(words)  # of our own child, through our own pipe
        except Exception:  # in which its platform may have written
            told = None
        if isinstance(told, dict):
            return told
        return {"fault": f"{self._what}: its process wrote garbage into its pipe"}

    def answer(self, patience: float, look: Callable[[], object] = bool) -> AnyDict:
        """Return what the child answers.

        Args:
            patience: how long to wait in [s].
            look: called meanwhile.

        Raises:
            UniconError: the error that it tells of.
            Fault: the fault that it tells of.
        """
        end = time.monotonic() + patience
        told = self.words()
        while not told:
            if time.monotonic() > end or self.process.poll() is not None:
                told = self.words()
                break
            look()
            select.select([self._out_of], [], [], 0.1)
            told = self.words()
        if not told:
            gone = self.process.poll() is not None
            how = "ended at once" if gone else f"did not answer within {patience:g} s"
            raise PlatformError(
                f"{self._what}: its process {how}; see what it wrote above, or run without it"
            )
        if "error" in told:
            kind = getattr(errors, told["kind"], PlatformError)
            kind = kind if issubclass(kind, UniconError) else PlatformError
            error = kind.__new__(kind)  # some are made of other words than their text
            Exception.__init__(error, told["error"])
            raise error
        if "fault" in told:
            raise Fault(told["fault"])
        return told

    @property
    def end(self) -> str:
        """How the child has ended, in words."""
        status = self.process.returncode or 0
        how = (
            f"was killed by {signal_name(-status)}" if status < 0 else f"ended with status {status}"
        )
        return f"{self._what}: its process {self.process.pid} {how}"

    def close(self, patience: float) -> AnyDict:
        """Let the child end, kill it where it hangs; return its last words.

        Args:
            patience: how long it may take in [s].
        """
        process = self.process
        words = AnyDict()
        with suppress(OSError):
            self._into.close()  # which asks it to close
        try:
            process.wait(patience)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            words["closing"] = "it did not end, and was killed"
        while told := self.words():
            words |= told
        self._out_of.close()
        return words


ALARM = 10
"""In [s]: the kernel ends a process that hangs so long, as its parent would if it still lived."""

LONGEST = 1000
"""Characters of an error that are told."""


class Parent:
    """What it gave first, what it wishes, and what it is told.

    Ctrl-C and Ctrl-Z are the parent's, and what libraries print goes to stderr.

    Args:
        patience: how long the start may take in [s]; the kernel ends what hangs longer.

    Attributes:
        given: what it gave.
    """

    def __init__(self, patience: float) -> None:
        for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTSTP):
            signal.signal(number, signal.SIG_IGN)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(round(patience) + ALARM)
        self._told = os.dup(1)
        self._telling = threading.Lock()
        os.dup2(2, 1)  # what libraries print is not for the parent
        size = int.from_bytes(_exactly(8), "little")
        self.given: AnyDict = pickle.loads(_exactly(size))  # through our own pipe
        self._rest = b""

    def tell(self, **words: Any) -> None:
        """Tell it something; nothing where nobody is there to be told. From any thread."""
        packed = pickle.dumps(words)
        with self._telling, suppress(OSError):
            os.write(self._told, len(packed).to_bytes(8, "little") + packed)

    def wishes(self) -> list[list[Any]] | None:
        """Return what it wishes since the last look, each `[what, *given]`; None: it has closed."""
        found: list[list[Any]] = []
        while select.select([0], [], [], 0.0)[0]:
            read = os.read(0, 1 << 16)
            if not read:
                return None
            *lines, self._rest = (self._rest + read).split(b"\n")
            found += map(json.loads, lines)
        return found


def text_of(error: BaseException) -> str:
    """Return an exception in one short line: a pipe that nobody reads holds no long one."""
    kind = "" if isinstance(error, Fault) else type(error).__name__
    try:
        text = " ".join(str(error).split())
    except Exception:  # its text cannot be had
        text = ""
    whole = ": ".join(filter(None, (kind, text)))
    return whole if len(whole) <= LONGEST else f"{whole[:LONGEST]}…"


def _exactly(count: int) -> bytes:
    data = b""
    while len(data) < count:
        read = os.read(0, count - len(data))
        if not read:
            raise SystemExit(1)  # the parent died
        data += read
    return data

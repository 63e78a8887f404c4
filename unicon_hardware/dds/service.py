"""What is heard on topics of robots: `Inlet`, for the tick; and services, asked step by step.

Messages of services are rosbags' objects, not for the hot path.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Iterator
from typing import Any, ClassVar, TypeVar

from unicon_base import Fault
from unicon_hardware.dds.participant import Participant, Reader
from unicon_hardware.wire import Counts
from unicon_msgs_map.layout.messages import shared_messages

T = TypeVar("T")


class Inlet:
    """Messages of the sender of the first good one, until that sender has gone.

    Args:
        reader: of the topic.
        frames: checks and reads messages: `good` counts what it refuses; where `read` returns
            False, the message before is read.
        counts: gets the good ones, and those of others.
        where: topic and domain, for messages.
        forget: called when the sender has gone: another one may follow.
        anyone: messages of all senders are read, as a robot does with commands.
    """

    def __init__(
        self,
        reader: Reader,
        frames: Any,
        counts: Counts,
        where: str,
        forget: Callable[[], None] = lambda: None,
        *,
        anyone: bool = False,
    ) -> None:
        self._reader, self._frames, self._counts, self._where = reader, frames, counts, where
        self._forget, self._anyone = forget, anyone
        self._source: int | None = None
        self._ahead = 0
        self._fault: Fault | None = None

    def wait(self, timeout: float) -> bool:
        """Return True once something is there, False after `timeout` in [s]."""
        return bool(self._ahead or self._fault) or self._reader.wait(timeout)

    def read_ahead(self) -> None:
        """Do now what `take` would do; `take` then returns it, or raises its fault."""
        if self._fault is None:
            try:
                self._ahead += self._take()
            except Fault as fault:
                self._fault = fault

    def take(self) -> int:
        """Read the newest good message; return how many good ones have come."""
        fault, ahead = self._fault, self._ahead
        self._fault, self._ahead = None, 0
        if fault is not None:
            raise fault
        return ahead + self._take()

    def _take(self) -> int:
        good: list[bytes] = []
        for raw, info in self._reader.take():
            source = info.publication_handle
            if not info.valid_data:
                if source == self._source:
                    self._anew()
            elif self._own(source) and self._frames.good(raw):
                self._source = source
                good.append(raw)
        number = len(good)
        while good and not self._frames.read(good.pop()):
            number -= 1
        self._counts.good += number
        return number

    def _anew(self) -> None:
        self._source = None
        self._forget()

    def _own(self, source: int) -> bool:
        if self._anyone or self._source in (None, source):
            return True
        if self._source not in self._reader.sources:  # it has gone, and another robot has come
            self._anew()
            return True
        self._counts.refuse("another sender", f"{self._where} has two")
        return False


class ServiceEnd:
    """One end of a service, for a client; a vendor's class says its messages.

    Args:
        participant: of the robot's domain.
        service: its name.

    Attributes:
        request, response: type of the message, and its topic with `{}` for the service.
        serves: it is a server's.
    """

    request: ClassVar[tuple[str, str]]
    response: ClassVar[tuple[str, str]]
    serves: ClassVar[bool] = False
    _asked: Any = None

    def __init__(self, participant: Participant, service: str) -> None:
        messages, ends = shared_messages(), (self.request, self.response)
        self.service = service
        (reads, reader), (writes, writer) = ends if self.serves else ends[::-1]
        self._writer = participant.writer(writer.format(service), messages.struct(writes))
        self._reader = participant.reader(reader.format(service), messages.struct(reads))
        self._store, self._reads = messages.store, reads
        self._types: Any = messages.store.types

    @property
    def there(self) -> bool:
        """Whether the other end is."""
        return self._writer.matched and bool(self._reader.sources)

    def heard(self) -> Iterator[Any]:
        """Give what has come; what is no message is left."""
        for raw, info in self._reader.take():
            if info.valid_data:
                try:
                    said = self._store.deserialize_cdr(raw, self._reads)
                except Exception:  # whatever rosbags makes of garbage
                    continue
                yield said

    def _say(self, message: Any) -> None:
        self._writer.write(bytes(self._store.serialize_cdr(message, message.__msgtype__)))


class Procedure:
    """What brings a robot to where it takes commands: called once a tick until it returns "".

    Args:
        what: in front of messages.

    Attributes:
        timeout: for an answer, a service or a state to be there, in [s]; as the vendors' programs.
        done: it has been gone through.
    """

    timeout = 5.0

    def __init__(self, what: str) -> None:
        self.done = False
        self._what, self._steps = what, self._procedure()

    def __call__(self) -> str:
        """Go on without waiting; return what is waited for, "" at the end.

        Raises:
            Fault: the robot refuses, or does not do it in time.
        """
        if self.done:
            return ""
        missing = next(self._steps, "")
        self.done = not missing
        return missing

    def _procedure(self) -> Generator[str, None, None]:
        """Give what is waited for, until it is done."""
        raise NotImplementedError

    def _until(
        self,
        reached: Callable[[], T | None],
        doing: str,
        otherwise: Callable[[], str],
        ask: Callable[[], object] = int,
        every: float = math.inf,
    ) -> Generator[str, None, T]:
        """Return what is reached once there is something.

        Args:
            reached: returns it.
            doing: is waited for.
            otherwise: returns the message of the fault.
            ask: asks for it, first at once.
            every: asks again after so long, [s].
        """
        end, due = time.monotonic() + self.timeout, 0.0
        while not (found := reached()):
            now = time.monotonic()
            if now > end:
                raise Fault(f"{self._what}: {otherwise()}")
            if now >= due:
                ask()
                due = now + every
            yield doing
        return found

    def _pause(self, doing: str, seconds: float) -> Generator[str, None, None]:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            yield doing

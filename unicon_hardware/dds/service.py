"""Services of robots, asked step by step; messages as rosbags' objects, not for the hot path."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Iterator
from typing import Any, ClassVar, TypeVar

from unicon_base.errors import Fault
from unicon_hardware.dds.participant import Participant
from unicon_msgs_map.layout.messages import shared_messages

T = TypeVar("T")


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

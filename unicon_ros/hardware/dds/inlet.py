"""Inlet: takes the newest good message of one sender of a DDS topic, for wires of robots.

inlet = Inlet(reader, frames.good, frames.read, counts, "rt/lowstate of DDS domain 0")
inlet.take()    # what came is read into the arrays; how many good ones
"""

from __future__ import annotations

from collections.abc import Callable

from unicon_core.errors import Fault
from unicon_ros.hardware.dds.participant import Reader
from unicon_ros.hardware.wire import Counts


class Inlet:
    """Messages of whoever sent the first good one, until that sender has gone.

    Args:
        reader: of the topic.
        good: whether a message may be read; it counts what it refuses.
        read: reads a message; where it returns False, the one before it is read.
        counts: gets the good ones, and those of others.
        where: topic and domain, for messages.
        forget: called when the sender has gone: the next one begins anew.
        anyone: whoever sends is read, as a robot does with commands.
    """

    def __init__(
        self,
        reader: Reader,
        good: Callable[[bytes], bool],
        read: Callable[[bytes], bool],
        counts: Counts,
        where: str,
        forget: Callable[[], None] = lambda: None,
        *,
        anyone: bool = False,
    ) -> None:
        self._reader, self._good, self._read = reader, good, read
        self._counts, self._where, self._forget = counts, where, forget
        self._anyone = anyone
        self._source: int | None = None
        self._ahead = 0
        self._fault: Fault | None = None

    def wait(self, timeout: float) -> bool:
        """Return True once something is there, False after `timeout` in [s]."""
        return bool(self._ahead) or self._fault is not None or self._reader.wait(timeout)

    def read_ahead(self) -> None:
        """Do now what `take` would do; it tells of it, of a fault too, when it is called."""
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
            if not info.valid_data:
                if info.publication_handle == self._source:
                    self._anew()
            elif self._own(info.publication_handle) and self._good(raw):
                self._source = info.publication_handle
                good.append(raw)
        number = len(good)
        while good and not self._read(good.pop()):
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

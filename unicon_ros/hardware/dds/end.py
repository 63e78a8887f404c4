"""DdsEnd: one end of a robot's topics, for wires of drivers and for faces of emulators.

class MyWire(DdsEnd):
    def __init__(self, …):
        super().__init__(Participant(domain, address, LABEL), f"rt/state of DDS domain {domain}")
        with self.closing():
            self.listen("rt/state", message, frames)
            self.speak("rt/cmd", message, encoder.encode)

It has `take`, `wait`, `put`, `warm_up`, `commanders` and `close` of a `Wire`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from unicon_msgs_map.layout.messages import Struct
from unicon_ros.hardware.dds.inlet import Inlet
from unicon_ros.hardware.dds.participant import Participant, Writer
from unicon_ros.hardware.wire import Counts


class Checked(Protocol):
    """What looks at messages and reads them, such as `Frames`."""

    def good(self, raw: bytes) -> bool:
        """Tell whether a message may be read; count what may not."""
        ...

    def read(self, raw: bytes) -> bool:
        """Read a good one; where it is refused nothing is written."""
        ...


class DdsEnd:
    """Topics that are listened to, and topics that are spoken on.

    Args:
        participant: of the robot's domain; it is closed with this.
        where: topic and domain, for messages.
        counts: of what comes in; another one where frames were made with it before.
        ahead: `warm_up` reads what is there already, so that what is read into must be arrays of
            the wire's own until `take` is called.

    Attributes:
        counts: of what came in.
        where: topic and domain.
    """

    def __init__(
        self,
        participant: Participant,
        where: str,
        counts: Counts | None = None,
        *,
        ahead: bool = False,
    ) -> None:
        self.participant, self.where = participant, where
        self.counts = Counts() if counts is None else counts
        self._ahead = ahead
        self._inlets: list[Inlet] = []
        self._outlets: list[tuple[Writer, Callable[[], bytes]]] = []
        self._commands: list[str] = []

    @contextmanager
    def closing(self) -> Iterator[None]:
        """Close it where what is built inside fails."""
        try:
            yield
        except BaseException:
            self.close()
            raise

    def listen(
        self,
        topic: str,
        message: Struct,
        frames: Checked,
        *,
        name: str = "",
        forget: Callable[[], None] = lambda: None,
        anyone: bool = False,
    ) -> None:
        """Read a topic; see `Inlet`."""
        reader = self.participant.reader(topic, message, name)
        inlet = Inlet(
            reader, frames.good, frames.read, self.counts, self.where, forget, anyone=anyone
        )
        self._inlets.append(inlet)

    def speak(
        self, topic: str, message: Struct, encode: Callable[[], bytes], *, name: str = ""
    ) -> None:
        """Write what `encode` returns to a topic, each time that `put` is called."""
        self._outlets.append((self.participant.writer(topic, message, name), encode))

    def watch(self, *topics: str) -> None:
        """Begin to see who else commands on these topics, for `commanders`."""
        self.participant.watch()
        self._commands += topics

    def take(self) -> int:
        """Bring the newest good message of each topic into the arrays; return how many came."""
        return sum(inlet.take() for inlet in self._inlets)

    def wait(self, timeout: float) -> bool:
        """Return True once something is there on the first topic, False after `timeout` in [s]."""
        return self._inlets[0].wait(timeout)

    def put(self) -> None:
        """Write to all topics.

        Raises:
            Fault: CycloneDDS refuses it.
        """
        for writer, encode in self._outlets:
            raw = encode()
            writer.write(raw + bytes(-len(raw) % 4))

    def warm_up(self) -> None:
        """Read ahead, and do what `put` does, but send nothing to the robot."""
        if self._ahead:
            for inlet in self._inlets:
                inlet.read_ahead()
        for writer, encode in self._outlets:
            writer.warm_up(encode())

    @property
    def reach(self) -> dict[str, object]:
        """Options `address` and `domain` of a platform for the other end; see `Face`."""
        participant = self.participant
        where = {} if participant.address is None else {"address": participant.address}
        return {**where, "domain": participant.domain}

    @property
    def matched(self) -> bool:
        """Whether somebody reads each of its topics."""
        return all(writer.matched for writer, _ in self._outlets)

    def commanders(self) -> dict[str, int]:
        """Return the topics that are watched, with the number of others that write there."""
        return {topic: self.participant.others(topic) for topic in self._commands}

    def close(self) -> None:
        """Leave the domain."""
        self.participant.close()

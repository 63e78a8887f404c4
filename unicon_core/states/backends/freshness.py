"""Which values of a message queue may pass: one live sender, in order, and not late.

Clocks of two machines differ, so that nobody can tell how long a value was under way; by how much
longer than the fastest one, everybody can. The smallest (arrival − sent) of a sender is its offset.
After a cut link TCP delivers what it kept, in order and whole, and only this tells it from news.
"""

from __future__ import annotations

from dataclasses import dataclass

SILENCE = 0.5
"""s without a value after which a sender is not live any more, and another one may follow it."""

SETTLE = 0.05
"""s for which a sender is watched before its values pass: the first one tells nothing of its age,
and what a link has kept comes at once."""

STEADY = 1000
"""Time in which an offset grows by one, while no value is as fast: both clocks may be slewed by
500 ppm (adjtimex(2)), and a minimum that is kept for ever would make every value late in the end.
The price: a link that is slower for good is refused for minutes, then taken as it is."""


@dataclass
class _Sender:
    """One start of a writer; times in [ns], `sent` of its clock, the others of ours."""

    epoch: int
    first: int
    number: int
    sent: int
    offset: int
    at: int  # when the offset was brought up to date
    fresh_at: int = 0  # when its newest value came that was not late

    def live(self, now: int) -> bool:
        return now - self.fresh_at < SILENCE * 1e9


class Freshness:
    """Judges the values of one group, each told by epoch, number and times.

    Args:
        late: by how much longer than the fastest a value may take, [s].

    Attributes:
        delay: by how much longer the value took that passed last, [ns].
        late, reordered, rivals: values that did not pass: they took too long; they came again or
            in another order; they are of another sender while one lives.
        skipped: values that nobody looked at, because newer ones had come.
        lost: values that had not come when they were late and somebody looked; reckoned at an even
            rate, since only the next value tells of them.
    """

    def __init__(self, late: float) -> None:
        self._longest = round(late * 1e9)
        self._present: _Sender | None = None
        self._other: _Sender | None = None  # the one before, or one that waits
        self._looked = 0
        self.delay = self.late = self.reordered = self.rivals = self.skipped = self.lost = 0

    def nothing(self, now: int) -> None:
        """Note that there was nothing to be seen."""
        self._looked = now

    def live(self, now: int) -> bool:
        """Return whether the present sender lives."""
        return self._present is not None and self._present.live(now)

    def passes(self, epoch: int, number: int, sent: int, now: int) -> bool:
        """Judge a value that has just been seen.

        Args:
            epoch: of the sender.
            number: of the value, from 1.
            sent: when, by the sender's clock, [ns].
            now: by our clock, [ns].
        """
        sender = self._present
        if sender is None or sender.epoch != epoch:
            sender = self._another(epoch, number, sent, now)
        if sender is None:
            self.rivals += 1
            return False
        if number <= sender.number or sent < sender.sent:
            self.reordered += 1
            return False
        way, offset = now - sent, sender.offset + (now - sender.at) // STEADY
        if way < offset:
            offset = way
        sender.offset, sender.at, delay = offset, now, way - offset
        if number != sender.number + 1 and sender is self._present:
            self._count_gap(sender, number, sent)
        sender.number, sender.sent = number, sent
        if delay > self._longest:
            self.late += 1
            return False
        sender.fresh_at = now
        if sender is not self._present:
            if self.live(now):
                self.rivals += 1
                return False
            if now - sender.first < SETTLE * 1e9:
                return False
            # The one before is remembered: what it sent may still come, late.
            self._present, self._other = sender, self._present
        self.delay = delay
        return True

    def _another(self, epoch: int, number: int, sent: int, now: int) -> _Sender | None:
        """Return who sent it, not the present one; None where one more is live already."""
        other = self._other
        if other is not None and other.epoch == epoch:
            return other
        if other is not None and other.live(now):
            return None
        self._other = _Sender(epoch, now, number - 1, sent, now - sent, now)
        return self._other

    def _count_gap(self, sender: _Sender, number: int, sent: int) -> None:
        missing = number - sender.number - 1
        due = self._looked - self._longest - sender.offset  # what was sent before was lost
        share = min(max((due - sender.sent) / max(sent - sender.sent, 1), 0.0), 1.0)
        lost = int(missing * share)
        self.lost += lost
        self.skipped += missing - lost

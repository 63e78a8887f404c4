"""Agreement: how robots that see one another agree on the moment of their start, for meetings.

The first in the list of those that are ready names a moment; the others repeat it. Where
all have done so half a second before it, the first one stays with it, else it takes it back; the
others stay with it where they still hear so shortly before. So nobody begins because of a word that
was taken back, as long as words take less than `DECIDE - COMMIT - FRESH` and ticks come in time.

There is neither a clock nor a socket here: times come in, words go out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

HERE, READY, BEGUN = 0, 1, 2
"""Stages: somebody is there, stands where its flow begins, has begun."""

LEAD_NS = 1_000_000_000
"""A moment that is named is so far ahead, [ns]."""
DECIDE_NS = 500_000_000
"""So long before it, it is kept or taken back, [ns]."""
COMMIT_NS = 150_000_000
"""So long before it, those who repeated it stay with it, [ns]."""
FRESH_NS = 250_000_000
"""A word counts for so long, [ns]."""


@dataclass(frozen=True)
class Word:
    """What one tells the others.

    Attributes:
        stage: `HERE`, `READY` or `BEGUN`.
        impatient: it has waited for its whole time-out, and would begin without those who lack.
        moment_ns: at which it would begin, 0 for none.
    """

    stage: int = HERE
    impatient: bool = False
    moment_ns: int = 0


class Agreement:
    """One robot's side.

    Args:
        robots: names of all, in the same order everywhere.
        me: which this is.
        timeout_ns: how long others are waited for once this one is ready, in [ns].
        alone: begin without who lacks then.

    Attributes:
        mine: the word to tell.
        moment_ns: the moment that will not change any more, 0 before that.
        lacking: name of each that is not ready.
        expired: others were waited for too long.
        late: this one missed the moment that all had agreed on.
        among: those that begin together.
    """

    def __init__(self, robots: Sequence[str], me: str, timeout_ns: int, alone: bool) -> None:
        self._robots, self._me, self._timeout, self._alone = tuple(robots), me, timeout_ns, alone
        self.mine = Word()
        self.moment_ns = self._moment = self._since = 0
        self.lacking: tuple[str, ...] = tuple(name for name in robots if name != me)
        self.among: tuple[str, ...] = ()
        self.expired = self.late = False
        self._leader = ""  # whose moment is repeated, or named

    def __call__(self, now_ns: int, ready: bool, heard: Mapping[str, Word]) -> None:
        """Take what was heard, and say what to tell.

        Args:
            now_ns: by the clock that all share.
            ready: this robot stands where its flow begins.
            heard: fresh words of the others by name; who is not heard lacks.
        """
        if self.moment_ns:
            return
        if not ready:
            self.mine = Word()
            return
        self._since = self._since or now_ns
        self.expired = now_ns - self._since > self._timeout
        there = [name for name in self._robots if name == self._me or self._goes(heard.get(name))]
        self.lacking = tuple(name for name in self._robots if name not in there)
        if self._leader == self._me and self._moment:
            self._decide(now_ns, there, heard)
        elif there[0] == self._me:
            self._name(now_ns, there, heard)
        else:
            self._follow(now_ns, there, heard)
        self.mine = Word(READY, self.expired, self._moment)

    def _goes(self, word: Word | None) -> bool:
        """Return whether somebody is ready, or has begun just now at the moment that is meant."""
        if word is None:
            return False
        begins = word.stage == BEGUN and self._moment != 0 and word.moment_ns == self._moment
        return word.stage == READY or begins

    def _name(self, now_ns: int, there: list[str], heard: Mapping[str, Word]) -> None:
        """Name a moment, where all are there or somebody goes without those who lack."""
        self._leader, self._moment = self._me, 0
        others = [heard[name] for name in there if name != self._me]
        impatient = self.expired or any(word.impatient for word in others)
        if not self.lacking or (self._alone and impatient):
            self._moment, self.among = now_ns + LEAD_NS, tuple(there)

    def _decide(self, now_ns: int, there: list[str], heard: Mapping[str, Word]) -> None:
        """Keep the moment that this one has named, or take it back."""
        left = self._moment - now_ns
        if not set(self.among) <= set(there) or left <= COMMIT_NS:
            self._moment = 0
        elif left <= DECIDE_NS:
            others = (heard[name].moment_ns for name in self.among if name != self._me)
            if all(moment == self._moment for moment in others):
                self.moment_ns = self._moment
            else:
                self._moment = 0

    def _follow(self, now_ns: int, there: list[str], heard: Mapping[str, Word]) -> None:
        """Repeat the moment that another one names, and stay with it in the end.

        Where the lists of robots differ, the other one may lack nobody: who does takes up no
        moment. One that was taken up stays, no matter which robot is lost behind its decision.
        """
        if not (self._moment and self._leader in there):
            self._leader = there[0]
        named = heard[self._leader].moment_ns
        left = named - now_ns
        if named != self._moment:  # a new one; of one that comes too late or from nowhere nothing
            takes = self._alone or not self.lacking
            self._moment = named if takes and DECIDE_NS < left <= 2 * LEAD_NS else 0
        elif self._moment and left <= COMMIT_NS:
            self.among = tuple(n for n in there if n == self._me or heard[n].moment_ns == named)
            self.late = left <= 0
            self.moment_ns = self._moment

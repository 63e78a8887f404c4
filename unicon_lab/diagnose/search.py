"""Search: which changes of the plant explain a motion, one after the other, and how surely.

All changes are fitted alone, by their derivatives; the best few are followed to where they fit
best, at first in some windows. Those that come near the best, and matter, are fitted in all
windows. The best of them, prior odds and BIC's price of a parameter counted, becomes a cause if it
is far more probable than none, and all others are fitted beside it again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from unicon_base.arrays import Float64, Int64
from unicon_lab.diagnose.motion import Motion
from unicon_lab.diagnose.plant import KINDS, Place, step_of
from unicon_lab.diagnose.replays import RunOfAll, derivatives
from unicon_lab.diagnose.windows import Fitted, Settled

FOLLOWED, OF_A_KIND = 6, 2
"""Changes that are followed to their best size, of these, and of one kind."""
PARTS = (0.5, 1.5, 4.0), (1.0, 4.0), (1.0,)
"""Parts of a fitted step that are tried, in each turn: contacts resist more than a derivative says,
and less far away."""
CLEAR = 8.0
"""Log odds against no change from which there is a cause: 1 in 3000, since some 70 are tried."""
ALIKE = 3.0
"""Log odds within which a record does not tell two causes apart: 20 to 1."""
SAME = 0.99
"""Cosine between derivatives from which two changes count as alike: their steps are finite."""
DAMPING = ("damping", -1), ("viscous friction", -1)
"""Changes that are the same where all joints have the same gain: a motor brakes as a bearing."""
MOST, MOST_REFERENCE = 4, 6
"""Causes of one record, and changes of a reference."""
HOPE = 3.0
"""What a fit by derivatives promises is exceeded by at most so much."""
ENOUGH, MANY = 36, 60
"""Windows from which on every second one is enough to find and follow candidates; above `MANY`
every third."""
NEAR, RIVALS = 0.7, 3
"""Part of what the best candidate adds to the log-likelihood, from which others are fitted in all
windows too, and how many at most with it."""
HALF = 0.5
"""Part of the least change that matters, from which a candidate is fitted in all windows."""
HOPELESS = 8.0
"""Log odds by which a candidate may lag behind what it needs, and is followed still."""
BESIDE = 0.03
"""Share of the square error that found causes explain, and beside a reference of all of it, which
the next one has to explain too: less may be noise. In healthy walks in PyBullet the best explained
up to 0.01."""
CALMER, OF_LEFT = 0.8, 0.15
"""In a record of which less is to explain than this part of what a reference leaves, a cause has to
explain this share of that: one of 22 healthy walks in PyBullet seemed to have friction."""
UNSURE = 0.5
"""Standard deviation of a reference's share of a size, as a part of it; the share is taken off."""
BIAS_FOUND = 0.03
"""As of `Kind.bias` where velocities at the beginning of windows were found: walks of a Go2 gave
3.91 kg for 4, -0.299 for -0.3 and 7.97 ms for 8."""


@dataclass(eq=False)
class Candidate:
    """A set of changes that is followed: those found before, and one more.

    Attributes:
        place: the one that is new.
        change: sizes of all.
        answers: of the windows with them; at first of some windows.
        slope: derivative of the answers by the new one, there.
        log, level: likelihood there, and what it is judged against; see `Settled.level`.
        begins: of windows there; see `Plant.replayed`.
        fitted: the fit from there, in the order of `change`.
        odds: log odds against the changes before.
    """

    place: Place
    change: dict[Place, float]
    answers: Float64
    slope: Float64
    log: float
    level: float
    begins: Float64
    fitted: Fitted | None = None
    odds: float = -math.inf


@dataclass(eq=False)
class Found:
    """What a search found.

    Attributes:
        causes: each with those that a record does not tell from it, the more probable first.
        change: sizes of all causes, fitted together.
        deviation: half of the 95 % interval of each.
        shown: window and channel of `Motion.answers` that show each cause most, and the answers
            there without and with it, shape (2, l).
        before, after: mean square of what is left of the joints in [rad²], without and with it.
        probability: of each cause against all that were followed, and none.
        complete: whether the search came to its end.
    """

    causes: list[tuple[Place, list[Place]]] = field(default_factory=list)
    change: dict[Place, float] = field(default_factory=dict)
    deviation: dict[Place, float] = field(default_factory=dict)
    probability: dict[Place, float] = field(default_factory=dict)
    shown: dict[Place, tuple[int, int, Float64]] = field(default_factory=dict)
    before: float = 0.0
    after: float = 0.0
    complete: bool = False


class Search:
    """A search in one motion.

    Args:
        motion: what was measured.
        places: changes that are tried.
        limbs: of each joint, shape (n,).
        run: replays changes.
        tell: takes a line now and then.
        reference: search in a motion without the trouble, which has ended; what it found is no
            cause. It is uncertain too, so intervals are wider.
        most: causes.

    Attributes:
        motion: what was measured.
        found: what there is up to now.
        left: mean square of what is left of the answers, in the scale of the first motion.
    """

    found: Found
    left: float
    motion: Motion
    _scale: Float64
    _left: Float64

    def __init__(
        self,
        motion: Motion,
        places: Sequence[Place],
        limbs: Int64,
        run: RunOfAll,
        tell: Callable[[str], object],
        reference: Search | None = None,
        most: int = MOST,
    ) -> None:
        self._wider, self._reference, self._most = 1.0, reference, most
        if reference is not None:
            run.base = reference.found.change
            ratio = len(motion.starts) / len(reference.motion.starts)
            self._wider = math.sqrt(1.0 + ratio)
        self.motion, self._places, self._run, self._tell = motion, places, run, tell
        self._real = motion.answers
        self._windows = Settled(motion, run)
        count = len(motion.starts)
        self._some = np.arange(count) % (1 + (count >= ENOUGH) + (count > MANY)) == 0
        self._limbs = limbs
        self._slopes: dict[Place, list[Float64]]
        self._few: Settled
        self._small = set[Place]()
        self.found = Found()

    def go(self) -> Found:
        """Search to the end; `found` has what there is when it is interrupted."""
        found = self.found
        now = self._windows.begin()
        found.before = found.after = self._square(now)
        at: dict[Place, float] = {}
        reference = self._reference
        self._scale = reference._scale if reference else self._windows.likelihood.scale
        whole = self.left = self._error(now)
        few = self._few = self._windows.part(self._some, now)
        first = few.begins, now[self._some]
        self._slopes = derivatives(self._places, self._limbs, few.run, *first)
        for _ in range(2 * self._most):  # a cause may be dropped for another one, and come again
            if len(found.causes) == self._most:
                break
            followed = self._followed(at, now[self._some])
            if not followed or followed[0].odds < CLEAR - HOPELESS:
                break
            leader, seemed = followed[0], followed[0].odds
            near = NEAR * (leader.log - leader.level)
            # Contacts hide which of those that come near is right.
            rivals = [one for one in followed[:RIVALS] if one.log - one.level >= near]
            others = [one for one in followed if one not in rivals]
            level = self._windows.level(at)
            for one in rivals:
                refined = self._windows.refined(one.change)
                one.change, one.answers, one.begins, one.fitted, one.log = refined
                one.level = level[self._read_off(one)]
            followed = self._judged(rivals)
            for one in others:  # they stay behind the first one
                one.odds += leader.odds - seemed
            followed += others
            best = followed[0]
            assert best.fitted is not None
            if best.odds < CLEAR:
                break
            error = self._error(now)
            less = error - self._error(best.answers, best.begins)
            least = BESIDE * (whole if reference else whole - error)
            if reference and whole < CALMER * reference.left:
                least = max(least, OF_LEFT * reference.left)
            if not self._matters(best) or (0.0 < least > less and not self._read_off(best)):
                self._small.add(best.place)  # it may hide one that is larger
                continue
            alike = [each.place for each in followed[1:] if best.odds - each.odds < ALIKE]
            alike += [place for place in self._like(best) if place not in alike]
            found.causes.append((best.place, alike))
            weights = np.exp([each.odds - best.odds for each in followed])
            its = [each is best or each.place in alike for each in followed]
            none = math.exp(-min(best.odds, 700))
            found.probability[best.place] = float(weights[its].sum() / (weights.sum() + none))
            found.shown[best.place] = self._shown(now, best.answers)
            at = best.change
            self._small.clear()
            now = self._windows.begun(at)
            found.after = self._square(now)
            bias = np.array([KINDS[kind].bias for kind, _ in at])
            bias = np.maximum(bias, BIAS_FOUND) if self.motion.sought else bias
            sizes = np.array(list(at.values()))
            rounded = self._run.step * np.array([0.06 * KINDS[kind].stepped for kind, _ in at])
            variance = self._wider**2 * (np.diag(best.fitted.spread) + (bias * sizes) ** 2)
            variance += rounded**2
            if reference:
                known = reference.found.deviation
                variance += np.array([known.get(place, 0.0) / 1.96 for place in at]) ** 2
                lacking = reference.lacking(list(at))
                sizes -= lacking.size
                variance += np.diag(lacking.spread) + (UNSURE * lacking.size) ** 2
            found.change = dict(zip(at, sizes.tolist()))
            found.deviation = dict(zip(at, (1.96 * np.sqrt(variance)).tolist()))
            self._tell(f"{best.place[0]}: log odds {best.odds:.0f}")
            idle = [place for place in at if self._idle(place)]
            if idle:  # what seemed to be a cause was another one's doing
                found.causes = [each for each in found.causes if each[0] not in idle]
                at = {p: size for p, size in at.items() if p not in idle}
                found.change = {place: found.change[place] for place in at}
                now = self._windows.begun(at)
                found.after = self._square(now)
            self.left = self._error(now)
            self._few = self._windows.part(self._some, now)
        self._left = self._few.left(now[self._some])
        found.complete = True
        return found

    def lacking(self, places: Sequence[Place]) -> Fitted:
        """Return what changes of places would explain of what this search has left."""
        usual = np.array([KINDS[kind].usual for kind, _ in places])
        slopes = np.stack([self._slopes[place][0] for place in places], axis=-1)
        return self._few.likelihood.fit(self._left, slopes, usual)

    def _judged(self, followed: Sequence[Candidate], share: float = 1.0) -> list[Candidate]:
        """Return candidates by their odds, by a share of the windows."""
        for one in followed:
            alike = (each for each in followed if self._read_off(each) == self._read_off(one))
            best = max(alike, key=lambda each: each.log)
            kappa = share * max(best.fitted.kappa if best.fitted else 1.0, 1.0) * self._wider**2
            own = self._beyond_reference(one)
            one.odds = own * (one.log - one.level) / kappa + self._price(one.place)
        return sorted(followed, key=lambda one: -one.odds)

    def _read_off(self, one: Candidate) -> bool:
        return one.place in self._run.read_off

    def _beyond_reference(self, one: Candidate) -> float:
        """Return the part of a gain above that of a change which a reference has: a parabola's."""
        size = one.change[one.place]
        if self._reference is None or not size:
            return 1.0
        lacking = float(self._reference.lacking([one.place]).size[0])
        return min((1.0 - lacking / size) ** 2, 1.0)

    def _like(self, best: Candidate) -> list[Place]:
        """Return what would explain a motion as well as the best, followed or not.

        The information on one change that is left beside another is what tells them apart.
        """
        assert best.fitted is not None
        places = [best.place, *(place for place in self._places if place not in best.change)]
        slopes = np.stack([self._slopes[place][0] for place in places], axis=-1)
        left = self._few.left(best.answers[self._some], best.begins[self._some])
        known = self._few.likelihood.information(left, slopes) / self._some.mean()
        parallel = known[0] ** 2 / np.maximum(known[0, 0] * np.diag(known), 1e-30)
        apart = known[0, 0] * (1.0 - parallel)
        odds = 0.5 * best.change[best.place] ** 2 * apart / max(best.fitted.kappa, 1.0)
        alike = (odds < ALIKE) | (parallel > SAME**2)
        if places[0] in DAMPING and np.ptp(self.motion.commands["joint_damping"]) == 0.0:
            alike |= [place in DAMPING for place in places]
        return [place for place, each in zip(places[1:], alike[1:]) if each]

    def _shown(self, without: Float64, with_it: Float64) -> tuple[int, int, Float64]:
        left, less = ((self._real - answers) ** 2 for answers in (without, with_it))
        noise = np.median(less, axis=(0, 1)) + 1e-9
        gain = ((left - less) / noise).mean(axis=1)
        channel = int(np.median(gain, axis=0).argmax())
        window = int((left - less)[..., channel].sum(axis=1).argmax())
        return window, channel, np.stack([without, with_it])[:, window, :, channel]

    def _idle(self, place: Place) -> bool:
        least = max(KINDS[place[0]].least, self.found.deviation[place])
        return abs(self.found.change[place]) < least

    def _matters(self, one: Candidate, part: float = 1.0) -> bool:
        return abs(one.change[one.place]) >= part * KINDS[one.place[0]].least

    def _error(self, answers: Float64, begins: Float64 | None = None) -> float:
        left = self._windows.left(answers, begins)
        return self._windows.likelihood.error(left, self._scale)

    def _square(self, answers: Float64) -> float:
        joints = self.motion.measured["joint_pos"].shape[1]
        return float(((self._real - answers)[..., :joints] ** 2).mean())

    def _price(self, place: Place) -> float:
        """Return the log odds of a cause beforehand: how often it happens, and BIC's price."""
        kind = KINDS[place[0]]
        share = sum(each[0] == place[0] and each[1] >= 0 for each in self._places)
        odds = kind.odds / sum(each.odds for each in KINDS.values())
        odds *= 0.5 / share if place[1] >= 0 else 0.5 if kind.each else 1.0
        return math.log(odds) - 0.5 * math.log(max(len(self._real), 2.0))

    def _followed(self, at: dict[Place, float], now: Float64) -> list[Candidate]:
        """Return the candidates beside what was found, the most probable first, by few windows."""
        few = self._few
        level = few.level(at)
        others = [place for place in self._places if place not in {*at, *self._small}]
        places = self._best_alone(now, others)
        kinds, read_off = [kind for kind, _ in places], self._run.read_off
        candidates = [
            Candidate(place, at | {place: 0.0}, now, slope, base, base, few.begins)
            for row, (place, slope) in enumerate(places.items())
            for base in [level[place in read_off]]
            if kinds[:row].count(place[0]) < OF_A_KIND
        ][:FOLLOWED]
        if not candidates:
            return []
        moving = candidates
        for parts in PARTS:
            best_log = max(one.log for one in candidates)
            moving = [one for one in moving if self._fit(one) and self._hopes(one, best_log)]
            moving = self._step(moving, parts)
        candidates = [one for one in candidates if self._matters(one, HALF)]
        for one in candidates:
            self._fit(one)
        return self._judged(candidates, float(self._some.mean()))

    def _best_alone(self, now: Float64, places: Sequence[Place]) -> dict[Place, Float64]:
        """Return places, the one whose change explains most alone first, with its derivative."""
        left = self._few.left(now)
        rows = [(place, each) for place in places for each in self._slopes[place]]

        def gain(row: tuple[Place, Float64]) -> float:
            usual = np.array([KINDS[row[0][0]].usual])
            fitted = self._few.likelihood.fit(left, row[1][..., None], usual)
            return fitted.gain / math.sqrt(max(fitted.kappa, 1.0))

        found = dict[Place, Float64]()
        for place, slope in sorted(rows, key=gain, reverse=True):
            found.setdefault(place, slope)
        return found

    def _fit(self, one: Candidate) -> bool:
        """Fit from where a candidate is; return whether there is far to go."""
        slopes = {place: self._slopes[place][0] for place in one.change} | {one.place: one.slope}
        usual = np.array([KINDS[kind].usual for kind, _ in one.change])
        every = np.stack(list(slopes.values()), axis=-1)
        one.fitted = self._few.likelihood.fit(self._few.left(one.answers, one.begins), every, usual)
        return bool(np.any(np.abs(one.fitted.size) > 0.2 * np.sqrt(np.diag(one.fitted.spread))))

    def _hopes(self, one: Candidate, best: float) -> bool:
        """Return whether a candidate may still become a cause, or like the best one."""
        assert one.fitted is not None
        kappa = max(one.fitted.kappa, 1.0) * float(self._some.mean())
        reached = one.log + HOPE * one.fitted.gain
        cause = (reached - one.level) / kappa + self._price(one.place) > CLEAR - HOPELESS
        return cause and (reached - best) / kappa > -HOPELESS

    def _step(self, moving: Sequence[Candidate], parts: Sequence[float]) -> list[Candidate]:
        """Move candidates by parts of what was fitted where that helps; return those that moved."""
        rows = list[tuple[Candidate, dict[Place, float]]]()
        for one in moving:
            assert one.fitted is not None
            for part in parts:
                steps = zip(one.change.items(), part * one.fitted.size)
                rows += [(one, {p: self._run.clip(p, size + step) for (p, size), step in steps})]
        moved = list[Candidate]()
        for (one, change), found in zip(rows, self._few.best_of([change for _, change in rows])):
            log = self._few.likelihood.log(self._few.left(*found))
            if log > one.log:
                one.change, one.log, (one.answers, one.begins) = change, log, found
                moved = [*(each for each in moved if each is not one), one]
        further = [one.change | {one.place: one.change[one.place] + step_of(one.place)}
                   for one in moved]  # fmt: skip
        for one, beside in zip(moved, self._few.run(further, [e.begins for e in moved])):
            one.slope = (beside - one.answers) / step_of(one.place)
        return moved

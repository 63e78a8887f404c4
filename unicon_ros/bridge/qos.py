"""QoS of topics: rclpy's profiles, and events that tell where ours does not match, or is broken.

The middleware keeps the watch; its events are callbacks of an executor, served in the slack. What
goes on breaking is one episode: told when it begins and when it is over.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from unicon_base import TextSink
from unicon_msgs_map.spec import Qos
from unicon_ros import compat

LATEST = Qos(reliability="best_effort", depth=1)
"""For streams of states: only the newest counts, and nothing is sent again."""

LATCHED = Qos(durability="transient_local", depth=1)
"""The last message goes to late joiners too."""

REMEDY = "set qos.{policy} of the topic in the message map, or the peer's"

CALM = 3.0
"""[s] without an event, and three times what is declared, after which an episode is over: a peer
that is always a little late is told once, not each time. Events are asked for once a second."""


def qos_profile(qos: Qos) -> Any:
    """Return rclpy's profile of a map's QoS; times in [s] there, Durations here."""
    from rclpy import qos as ros
    from rclpy.duration import Duration

    values = {"depth": qos.depth}
    for word in ("reliability", "durability", "history", "liveliness"):
        values[word] = getattr(ros, f"{word.capitalize()}Policy")[getattr(qos, word).upper()]
    for name, seconds in (
        ("deadline", qos.deadline),
        ("lifespan", qos.lifespan),
        ("liveliness_lease_duration", qos.liveliness_lease),
    ):
        if seconds is not None:
            values[name] = Duration(nanoseconds=round(seconds * 1e9))
    return ros.QoSProfile(**values)


@dataclass(eq=False)
class QosEvents:
    """The events of one topic.

    Args:
        topic: for the messages.
        qos: ours, as the map declares it.
        own: what we have: `publisher` or `subscription`.
        passed: returns how many messages have passed so far.
        warn: takes the messages.
        remedy: of a `{policy}` that does not match.
        theirs: returns what a peer has for a policy, if that is known.
    """

    topic: str
    qos: Qos
    own: str
    passed: Callable[[], int]
    warn: TextSink
    remedy: str = REMEDY
    theirs: Callable[[str], str] = lambda _: ""

    def __post_init__(self) -> None:
        qos = self.qos
        self._told: set[str] = set()
        self._alive = self._not_alive = 0  # publishers of a subscription
        self._callbacks = {"incompatible_qos": self._incompatible}
        self._episodes: dict[str, _Episode] = {}
        if qos.deadline is not None:
            self._callbacks["deadline"] = self._deadline_missed
            name = f"deadline of {qos.deadline:g} s"
            self._episodes["deadline"] = _Episode(
                f"{name} missed", f"{name} kept again", qos.deadline
            )
        if qos.liveliness != "automatic" or qos.liveliness_lease is not None:
            ours, lease = self.own == "publisher", qos.liveliness_lease or 0.0
            self._callbacks["liveliness"] = self._lost if ours else self._changed
            name = "our liveliness" if ours else "liveliness"
            self._episodes["liveliness"] = _Episode(f"{name} lost", f"{name} regained", lease)

    def watch(self, create: Callable[..., Any]) -> Any:
        """Return what `create(**options)` makes, with those of our events that can be had."""
        made, lacking = compat.with_events(self.own, self._callbacks, create)
        for name in lacking:
            del self._callbacks[name]
        declared = [name for name in lacking if self._episodes.pop(name, None) is not None]
        if declared:
            events, keys = " and no ".join(declared), " and qos.".join(declared)
            self._say(f"the middleware has no {events} events, so nobody watches qos.{keys}")
        return made

    @property
    def declared(self) -> bool:
        """Whether the map declares what can break, so that `settle` has something to do."""
        return bool(self._episodes)

    @property
    def trouble(self) -> str:
        """What is broken now; empty if nothing is."""
        return next((each.began for each in self._episodes.values() if each.lasts), "")

    def counts(self) -> dict[str, int]:
        """Return how often what the map declares was broken, and who is alive, by name."""
        names = {"deadline": "deadlines missed", "liveliness": "liveliness lost"}
        found = {names[key]: episode.count for key, episode in self._episodes.items()}
        if "liveliness" in self._episodes and self.own == "subscription":
            found["publishers alive"] = self._alive
        return found

    def settle(self) -> None:
        """Tell what is over by now; to be called about once a second, outside of the tick."""
        for key, episode in self._episodes.items():
            if key == "liveliness" and self.own == "subscription":
                well = self._alive > 0 and not self._not_alive
            else:
                well = self.passed() != episode.passed
            calm = time.monotonic() - episode.at > max(CALM, 3.0 * episode.declared)
            if episode.lasts and well and calm:
                episode.lasts = False
                self._say(f"{episode.over} (so far: {episode.count})")

    def _incompatible(self, event: Any) -> None:
        policy = compat.incompatible_policy(event)
        if policy in self._told:
            return
        self._told.add(policy)
        ours, theirs = getattr(self.qos, policy, None), self.theirs(policy)
        both = [*([f"ours: {ours}"] if ours is not None else ()), *filter(None, [theirs])]
        said = f" ({', '.join(both)})" if both else ""
        peer = "publisher" if self.own == "subscription" else "subscription"
        self._say(
            f"a {peer} has an incompatible {policy}{said}, so nothing passes "
            f"between us; {self.remedy.format(policy=policy)}"
        )

    def _deadline_missed(self, event: Any) -> None:
        remedy = "raise the topic's rate"
        if self.own == "subscription":
            remedy = "see why its publisher is late"
        remedy += ", or qos.deadline in the message map"
        self._broken("deadline", event.total_count_change, remedy)

    def _lost(self, event: Any) -> None:
        remedy = "raise the topic's rate, or qos.liveliness_lease in the message map"
        self._broken("liveliness", event.total_count_change, remedy)

    def _changed(self, event: Any) -> None:
        before, self._alive = self._alive, event.alive_count
        self._not_alive = event.not_alive_count
        # A publisher that goes in good order is gone without having been counted as not alive.
        lost = max(event.not_alive_count_change, int(before > 0 and not self._alive))
        if lost > 0:
            others = f"publishers alive: {self._alive}, see what became of the others"
            self._broken("liveliness", lost, others)

    def _broken(self, key: str, times: int, remedy: str) -> None:
        self.settle()
        episode = self._episodes[key]
        episode.count += times
        episode.at, episode.passed = time.monotonic(), self.passed()
        if not episode.lasts:
            episode.lasts = True
            self._say(f"{episode.began} (so far: {episode.count}); {remedy}")

    def _say(self, text: str) -> None:
        self.warn(f"topic {self.topic}: {text}")


@dataclass
class _Episode:
    """What breaks, in words when it `began` and when it is `over`.

    Attributes:
        declared: time that the map declares, [s].
        count: how often so far, in all episodes.
        at: time of the last event, [s].
        passed: messages passed until then.
        lasts: it is not over.
    """

    began: str
    over: str
    declared: float
    count: int = 0
    at: float = 0.0
    passed: int = 0
    lasts: bool = False

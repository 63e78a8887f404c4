"""Every ready map, both ways, against a plain rclpy process over real DDS."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy")

from map_cases import CASES, TF_OUT, Case, holds
from talkers import ROOT, Talker

from unicon_base.located_yaml import read_yaml

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]

FILES = sorted(
    path.stem
    for path in (ROOT / "config" / "maps").glob("*.yaml")
    if not {"include", "trajectory"} & read_yaml(path).value.keys()  # others test those
)
PLAIN = sorted(name for name, case in CASES.items() if not case.packages)
CUSTOM = sorted(set(CASES) - set(PLAIN))


class Conversation:
    """Our side with some maps, and a plain peer."""

    def __init__(self, names: list[str], variables: dict[str, str], python: str = "") -> None:
        words = [f"{name}={CASES[name].joints}" for name in names]
        self.ours = Talker("map_host", *words, variables=variables)
        self.peer = Talker("plain_peer", variables=variables, python=python or sys.executable)
        try:
            self.ours.ready()
            self.peer.ready()
            for line in self.ours.of("out"):
                self.peer.tell(subscribe=line["topic"], type=line["type"])
        except BaseException:
            self.kill()
            raise

    def topic(self, direction: str, map_name: str, name: str) -> dict[str, Any]:
        """Return full name and type of a map's topic."""
        (line,) = self.ours.of(direction, map=map_name, name=name)
        return line

    def check(self, name: str) -> None:
        """Hold one map against its case."""
        case = CASES[name]
        self.check_says(name, case.states, case.says)
        self.check_hears(name, case)

    def check_says(self, name: str, states: dict[str, Any], says: dict[str, Any]) -> None:
        """Write states on our side and wait until the peer hears what they mean."""
        if states:
            self.ours.tell(map=name, states=states)
        for topic, expected in says.items():
            self._hears(self.topic("out", name, topic)["topic"], expected)

    def check_hears(self, name: str, case: Case) -> None:
        """Let the peer publish and wait until our states are what the message means."""
        for topic, (message, after) in case.hears.items():
            self._follows(self.topic("in", name, topic), message, after)

    def _hears(self, topic: str, expected: dict[str, Any]) -> None:
        def heard() -> list[Any]:
            return [line["message"] for line in self.peer.of("heard", topic=topic)]

        try:
            self.peer.wait(
                lambda: any(holds(message, expected) for message in heard()[-1:]),
                f"{expected} on {topic}",
            )
        except AssertionError as error:
            raise AssertionError(f"{error}\nheard last: {heard()[-1:]}") from None

    def _follows(self, line: dict[str, Any], message: Any, after: Any) -> None:
        def took() -> list[dict[str, Any]]:
            return self.ours.of("took", topic=line["topic"])

        try:
            self.ours.wait(
                lambda: any(holds(one["states"], after) for one in took()[-1:]),
                f"{after} after {line['topic']}",
                again=lambda: self.peer.tell(
                    publish=line["topic"], type=line["type"], message=message
                ),
            )
        except AssertionError as error:
            raise AssertionError(f"{error}\ntook last: {took()[-1:]}") from None

    def kill(self) -> None:
        """End both."""
        self.ours.kill()
        self.peer.kill()


@pytest.fixture(scope="module")
def plain() -> Iterator[Conversation]:
    """Maps of messages that every ROS installation has."""
    conversation = Conversation(PLAIN, {})
    yield conversation
    try:
        assert conversation.ours.end() == 0, conversation.ours.errors
        assert conversation.peer.end() == 0, conversation.peer.errors
    finally:
        conversation.kill()


@pytest.fixture(scope="module")
def custom(type_support: dict[str, str]) -> Iterator[Conversation]:
    """Maps of messages that need generated type support."""
    conversation = Conversation([*CUSTOM, "default"], type_support)
    yield conversation
    conversation.kill()


def test_every_ready_map_has_a_case() -> None:
    assert sorted(CASES) == FILES


@pytest.mark.parametrize("name", PLAIN)
def test_a_plain_peer_hears_and_says_what_the_map_means(plain: Conversation, name: str) -> None:
    plain.check(name)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", CUSTOM)
def test_a_plain_peer_with_generated_types_hears_and_says_what_the_map_means(
    custom: Conversation, name: str
) -> None:
    custom.check(name)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_plain_peer_hears_the_default_maps_transform(custom: Conversation) -> None:
    custom.check_says("default", CASES["default"].states, {"/tf": TF_OUT})


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_kilteds_rclpy_hears_and_says_what_the_maps_mean(kilted: Callable[[], str]) -> None:
    conversation = Conversation(PLAIN, {}, python=kilted())
    try:
        for name in PLAIN:
            conversation.check(name)
    finally:
        conversation.kill()

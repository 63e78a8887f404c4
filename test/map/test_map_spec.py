"""What a parsed entry tells of itself."""

from __future__ import annotations

from dataclasses import replace

import pytest
from map_helpers import publish

from unicon_msgs_map import Qos, parse_map


@pytest.mark.parametrize(
    ("rate", "period", "ticks"),
    [
        (None, 0.002, 1),
        (500.0, 0.002, 1),
        (100.0, 0.002, 5),
        (60.0, 0.02, 1),  # 0.83 ticks
        (30.0, 0.02, 2),  # 1.67 ticks
        (1000.0, 0.02, 1),  # faster than the tick: no faster than the tick
        (0.1, 0.02, 500),
    ],
)
def test_a_rate_is_kept_in_whole_ticks(rate: float | None, period: float, ticks: int) -> None:
    """No rate is every tick; others are rounded to whole ticks."""
    spec = replace(publish("std_msgs/msg/Header", {}), rate=rate)

    assert spec.every(period) == ticks


MAP = """
publish:
  - {topic: out, type: std_msgs/msg/Header, fields: {}}
subscribe:
  - {topic: unsaid, type: std_msgs/msg/Float64, fields: {data: x}}
  - {topic: default, type: std_msgs/msg/Float64, qos: default, fields: {data: x}}
  - {topic: depth, type: std_msgs/msg/Float64, qos: {depth: 3}, fields: {data: x}}
"""


@pytest.mark.parametrize("heard", [None, Qos(reliability="best_effort", depth=1)])
def test_only_subscriptions_that_say_no_qos_take_the_reader_s(heard: Qos | None) -> None:
    mapping = parse_map(MAP, heard=heard)
    assert mapping.publish[0].qos == Qos()
    said = {spec.topic: spec.qos for spec in mapping.subscribe}
    assert said == {"unsaid": heard or Qos(), "default": Qos(), "depth": Qos(depth=3)}


def test_a_key_of_null_is_as_one_that_is_left_out() -> None:
    entry = "topic: a, type: std_msgs/msg/String, fields: {{data: {{state: tick{}}}}}"
    plain, null = (
        parse_map(f"publish: [{{{entry.format(more)}}}]").publish for more in ("", ", text: null")
    )
    assert null == plain

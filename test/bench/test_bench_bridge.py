"""`unicon bench bridge`: what it compares is the same message, and what it claims is in it."""

from __future__ import annotations

import json

import pytest

pytest.importorskip("rclpy")

from benchmarks import bridge
from benchmarks.bridge import arrays_of, bench_states, plain_sender, variables_of
from unicon_ros import compat

pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]


def test_it_names_the_ratios_and_measures_every_case(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bridge, "SAMPLES", 10)
    bench = bridge.run(1)
    bars = {name: ratio["bar"] for name, ratio in bench.ratios.items()}
    assert bars == {
        "send": 0.3,
        "receive": 0.3,
        "imu_send": 0.5,
        "odometry_send": 0.5,
        "send_growth": 1.15,
        "empty_poll": 0.1,
    }
    assert all(case["samples"] == 10 for case in bench.cases.values())
    assert all(case["min"] > 0.0 for case in bench.cases.values())
    assert json.loads(bench.to_json())["bench"] == "bridge"
    # Wide of the bars, which a busy machine may miss for ten samples: ours is faster at all.
    assert bench.ratios["send"]["value"] < 1.0
    assert bench.ratios["empty_poll"]["value"] < 1.0


@pytest.mark.parametrize("topic", ["joint_states", "imu/data", "odom"])
def test_the_plain_sender_makes_the_same_message_as_ours(topic: str) -> None:
    from rclpy.serialization import deserialize_message

    from unicon_base.resources import find_config
    from unicon_msgs_map import Encoder, load_map

    states = bench_states(12)
    (spec,) = [s for s in load_map(find_config("maps", "default")).publish if s.topic == topic]
    ours = Encoder.build(spec, arrays_of(states), None, variables_of(12)).encode()
    plain = plain_sender(spec.type, states, 12)()
    assert deserialize_message(ours, compat.message_class(spec.type)) == plain

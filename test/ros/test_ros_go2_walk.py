"""The shipped policy under /cmd_vel: a plain rclpy process steers the walking Go2."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]


@pytest.mark.slow
def test_a_plain_peer_makes_the_go2_walk_backwards_where_the_script_says_forwards(
    runs: Callable[..., Any], peers: Callable[..., Any]
) -> None:
    run = runs("go2_walk")
    peer = peers("robot_watcher", "--command", "-0.4", "0", "0")
    states = run.program.states
    peer.wait_for(lambda: run.session.incoming[0].received > 0, "cmd_vel")
    seconds = round(9.0 / run.program.period)
    peer.wait_for(lambda: run.runner.statistics.count >= seconds, "nine seconds of the robot")
    x, _, z = states.base_pos_w.tolist()
    assert states.velocity_command.tolist() == pytest.approx([-0.4, 0.0, 0.0])
    # It stood up for 2.5 s and has walked since: 0.4 m/s for 6.5 s, less the start.
    assert x < -1.0
    assert z > 0.2
    report = run.end()
    assert report.faults == []
    assert not report.fell

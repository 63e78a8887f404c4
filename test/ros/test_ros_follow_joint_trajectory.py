"""The action FollowJointTrajectory against rclpy's own client: played, canceled, refused, ended.

control_msgs is not among the wheels: its type support is generated, as that of tf2_msgs.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from peer import Peer

from unicon_core.robots import load_robot

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(900)]

HERE = Path(__file__).resolve().parent

GO2 = load_robot("go2")
STAND = GO2.default_joint_pos.astype(float)
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
TICK_NS = 10_000_000
STIFF = "flow.chain.1.forward_command.integral=0"
"""Targets that are what is commanded, bit-exact."""
GONE = "nobody follows any more: the flow went on, or the run ends"


@pytest.fixture
def stage(
    control_environment: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
    processes: Callable[..., Peer],
    peers: Callable[..., Peer],
) -> Callable[..., tuple[Peer, Peer]]:
    """Starts a robot in MuJoCo that follows trajectories, and a client."""
    for name, value in control_environment.items():
        monkeypatch.setenv(name, value)

    def started(seconds: float, *overrides: str) -> tuple[Peer, Peer]:
        script = str(HERE / "trajectory_host.py")
        host = processes(sys.executable, script, "go2_joint_trajectory", f"{seconds}", *overrides)
        client = peers("trajectory_client")
        client.wait_for(lambda: client.of("ready"), "the action server", 60.0)
        host.wait_for(lambda: len(host.of("tick")) > 260, "the robot to stand", 60.0)
        return host, client

    return started


def crouched(depth: float) -> list[float]:
    """Return positions with bent knees, feet where they were; depth in [rad] of the thighs."""
    bent = STAND.copy()
    for i, name in enumerate(GO2.joint_names):
        bent[i] += {"thigh": 1.0, "calf": -2.0}.get(name.split("_")[1], 0.0) * depth
    return [float(value) for value in bent]


def goal(name: str, points: list[Any], **more: Any) -> str:
    return json.dumps({"goal": name, "joints": list(GO2.joint_names), "points": points, **more})


def result_of(client: Peer, name: str, timeout: float = 30.0) -> dict[str, Any]:
    def found() -> list[dict[str, Any]]:
        return [line for line in client.of("result") if line["goal"] == name]

    client.wait_for(lambda: bool(found()), f"the result of {name}", timeout)
    return found()[0]


@pytest.mark.parametrize("velocities", [False, True], ids=["linear", "cubic"])
def test_each_via_point_is_passed_at_its_time_and_the_goal_succeeds(
    stage: Callable[..., tuple[Peer, Peer]], velocities: bool
) -> None:
    host, client = stage(14.0)
    begin = host.of("tick")[-1]["stamp"] + 500_000_000
    depths = [0.1, 0.25, 0.15, 0.3, 0.0]
    shuffled = list(reversed(GO2.joint_names))
    points: list[Any] = []
    for k, depth in enumerate(depths):
        point = [k + 1.0, crouched(depth)[::-1]]
        points.append([*point, [0.0] * 12] if velocities else point)
    said = json.loads(goal("walk", points, stamp=begin)) | {"joints": shuffled}
    client.tell(json.dumps(said))
    ended = result_of(client, "walk")
    assert (ended["status"], ended["code"], ended["reason"]) == (SUCCEEDED, 0, "")
    ticks = {round(line["stamp"] / TICK_NS): line for line in host.of("tick")}
    for k, depth in enumerate(depths):
        there = ticks[round((begin + (k + 1) * 1_000_000_000) / TICK_NS)]
        wanted = np.array(crouched(depth))
        assert np.abs(np.array(there["measured"]) - wanted).max() < 0.05
        assert np.abs(np.array(there["commanded"]) - wanted).max() < 0.02  # the way of a tick
    told = client.of("feedback")
    assert len(told) > 60  # 20 a second
    assert told[-1]["joints"] == list(GO2.joint_names)
    for line in told:
        error = np.subtract(line["desired"], line["actual"])
        np.testing.assert_allclose(line["error"], error, atol=1e-6)
    assert [line["time"] for line in told] == sorted(line["time"] for line in told)


def test_a_cancel_stops_within_two_ticks_and_the_joints_stay_there(
    stage: Callable[..., tuple[Peer, Peer]],
) -> None:
    host, client = stage(30.0, STIFF)
    moved_on = []
    for attempt in range(5):
        name = f"go {attempt}"
        down, up = crouched(0.5), crouched(0.0)
        client.tell(goal(name, [[1.0, down], [2.0, up], [3.0, down], [4.0, up]]))
        client.wait_for(
            lambda name=name: len([f for f in client.of("feedback") if f["goal"] == name]) > 12,
            "it to move",
        )
        client.tell(json.dumps({"cancel": name}))
        ended = result_of(client, name)
        assert (ended["status"], ended["code"], ended["reason"]) == (CANCELED, 0, "canceled")
        client.wait_for(
            lambda attempt=attempt: len(client.of("cancel answered")) > attempt, "its answer"
        )
        answer = client.of("cancel answered")[-1]
        assert (answer["code"], answer["goals"]) == (0, 1)
        sent = client.of("cancel sent")[-1]["at"]
        count = len(host.of("tick"))
        host.wait_for(lambda count=count: len(host.of("tick")) > count + 30, "ticks behind it")
        ticks = host.of("tick")
        late = [
            b["target"] != a["target"]
            for a, b in pairwise(ticks)
            if a["at"] > sent and b["tick"] < ticks[-1]["tick"] - 1
        ]
        moved_on.append(sum(late))
        assert not any(late[-25:])  # it stays
        assert ticks[-1]["velocity"] == [0.0] * 12
    # A machine that is busy may hold up a message; a tick that begins after it never moves.
    assert sorted(moved_on)[2] <= 2, moved_on


REFUSED = [
    ([[1.0, [0.0] * 12]], {}, -1, "allowed are"),
    ([[0.05, crouched(0.4)]], {}, -1, "give it more time"),
    ([], {}, -1, "the trajectory has no points"),
    ([[1.0, [float("nan")] * 12]], {}, -1, "point 0 has positions that are not finite"),
    ([[1.0, crouched(0.0)], [1.0, crouched(0.1)]], {}, -1, "times of points have to increase"),
    ([[1.0, crouched(0.0)]], {"joints": ["wheel"]}, -2, "the robot has no joint 'wheel'"),
    ([[1.0, [0.8]]], {"joints": ["FR_thigh_joint"]}, -2, "the trajectory lacks joint"),
    ([[1.0, crouched(0.0)]], {"stamp": 1}, -3, "the trajectory ended"),
    ([[1.0, crouched(0.0)]], {"stamp": 10**18}, -1, "s from now; at most 60 are waited"),
    ([[0.0, crouched(0.3)], [1.0, crouched(0.0)]], {}, -1, "the first point, at 0 s, is"),
    ([[1.0, crouched(0.0)]], {"path": {"wheel": 0.1}}, -2, "there is a tolerance of 'wheel'"),
]


def test_what_would_make_it_jump_is_refused_with_one_reason_and_the_robot_stays(
    stage: Callable[..., tuple[Peer, Peer]],
) -> None:
    host, client = stage(40.0, STIFF)
    before = host.of("tick")[-1]
    for number, (points, more, code, reason) in enumerate(REFUSED):
        client.tell(goal(f"bad {number}", points, **more))
        ended = result_of(client, f"bad {number}")
        assert (ended["status"], ended["code"]) == (ABORTED, code), ended
        assert reason in ended["reason"], ended
        assert "\n" not in ended["reason"]
    targets = {tuple(line["target"]) for line in host.of("tick") if line["tick"] > before["tick"]}
    assert targets == {tuple(before["target"])}


def test_a_new_goal_takes_over_and_the_end_of_the_run_ends_it(
    stage: Callable[..., tuple[Peer, Peer]],
) -> None:
    host, client = stage(8.0, STIFF)
    client.tell(goal("old", [[3.0, crouched(0.4)]]))
    client.wait_for(lambda: len(client.of("feedback")) > 5, "it to move")
    client.tell(goal("new", [[20.0, crouched(0.2)]]))
    old = result_of(client, "old")
    assert (old["status"], old["reason"]) == (ABORTED, "another trajectory came in its place")
    client.tell(goal("bad", [[0.01, crouched(0.4)]]))
    assert result_of(client, "bad")["status"] == ABORTED  # the other goes on
    new = result_of(client, "new")
    assert (new["status"], new["code"]) == (ABORTED, -1)
    assert new["reason"] == GONE
    assert host.end()[0] == 0
    ticks = host.of("tick")
    last = max(i for i, line in enumerate(ticks) if None not in line["commanded"])
    steps = np.diff([line["target"] for line in ticks[250 : last + 100]], axis=0)  # lies down
    assert np.abs(steps).max() < 3.0 * 0.01 + 1e-6  # max_rate, through all of it


def test_a_path_tolerance_that_is_violated_aborts_and_holds(
    stage: Callable[..., tuple[Peer, Peer]],
) -> None:
    _, client = stage(15.0)
    # Nothing follows a step of half a radian a second without any error.
    path = dict.fromkeys(GO2.joint_names, 0.001)
    client.tell(goal("tight", [[1.0, crouched(0.5)]], path=path))
    ended = result_of(client, "tight")
    assert (ended["status"], ended["code"]) == (ABORTED, -4)
    assert "rad from its path after" in ended["reason"]
    client.tell(
        goal("goal", [[1.0, crouched(0.3)]], goal_tolerance={"FR_calf_joint": 1e-5}, goal_time=0.3)
    )
    ended = result_of(client, "goal")
    assert (ended["status"], ended["code"]) == (ABORTED, -5)
    assert "rad from the goal after" in ended["reason"]
    client.tell(goal("loose", [[1.0, crouched(0.0)]], path=dict.fromkeys(GO2.joint_names, 0.5)))
    assert result_of(client, "loose")["status"] == SUCCEEDED


def test_the_action_answers_whoever_asks_without_care(
    stage: Callable[..., tuple[Peer, Peer]], peers: Callable[..., Peer]
) -> None:
    _, client = stage(40.0, STIFF)
    client.tell(goal("honest", [[20.0, crouched(0.3)]]))
    client.wait_for(lambda: len(client.of("feedback")) > 5, "it to move")
    attacker = peers("trajectory_attacker")
    attacker.wait_for(lambda: bool(attacker.of("done")), "the end of the attack", 60.0)
    told = {line.pop("kind"): line for line in map(dict, attacker.lines)}
    assert told["cancel the unknown"] == {"code": 2}
    assert told["result of the unknown"] == {"status": 0}
    assert told["once"] == {"accepted": True}
    assert told["twice"] == {"accepted": False}
    assert told["its result"] == {"status": ABORTED, "code": -2}
    assert told["cancel what has ended"] == {"code": 3}
    assert told["flood"]["accepted"] == 200
    assert told["the last of the flood"] == {"status": ABORTED}
    assert told["the first of the flood"] == {"status": 0}  # forgotten: 32 are kept
    # `cancel all` was the honest client's too.
    assert told["cancel all of nothing"] == {"code": 0}
    ended = result_of(client, "honest")
    assert (ended["status"], ended["reason"]) == (CANCELED, "canceled")


def test_an_emergency_stop_ends_the_goal_and_tells_its_client(
    stage: Callable[..., tuple[Peer, Peer]], peers: Callable[..., Peer]
) -> None:
    host, client = stage(40.0, STIFF)
    client.tell(goal("long", [[30.0, crouched(0.3)]]))
    client.wait_for(lambda: len(client.of("feedback")) > 5, "it to move")
    peers("caller", "unicon", "estop")
    ended = result_of(client, "long")
    assert (ended["status"], ended["code"], ended["reason"]) == (ABORTED, -1, GONE)
    assert host.end()[0] == 0
    (end,) = host.of("end")
    assert end["faults"] == ["emergency stop by the service ~/estop"]


def test_a_client_that_is_killed_leaves_its_goal_to_its_end(
    stage: Callable[..., tuple[Peer, Peer]], peers: Callable[..., Peer]
) -> None:
    host, client = stage(30.0, STIFF)
    client.tell(goal("orphan", [[3.0, crouched(0.3)]]))
    client.wait_for(lambda: len(client.of("feedback")) > 5, "it to move")
    client.kill()
    wanted = crouched(0.3)

    def there() -> bool:
        return bool(np.abs(np.array(host.of("tick")[-1]["target"]) - wanted).max() < 1e-4)

    host.wait_for(there, "the end of the path")
    other = peers("trajectory_client")
    other.wait_for(lambda: bool(other.of("ready")), "the action server", 60.0)
    other.tell(goal("next", [[1.0, crouched(0.0)]]))
    assert result_of(other, "next")["status"] == SUCCEEDED


def test_a_reset_of_the_simulator_ends_the_goal_and_nothing_jumps(
    stage: Callable[..., tuple[Peer, Peer]], peers: Callable[..., Peer]
) -> None:
    _, client = stage(40.0, STIFF)
    client.tell(goal("long", [[30.0, crouched(0.3)]]))
    client.wait_for(lambda: len(client.of("feedback")) > 5, "it to move")
    peers("caller", "unicon", "reset")
    ended = result_of(client, "long")
    assert (ended["status"], ended["code"]) == (ABORTED, -1)
    assert ended["reason"] == GONE
    client.tell(goal("early", [[1.0, crouched(0.0)]]))  # it stands up
    ended = result_of(client, "early")
    assert "the flow does not follow joint commands now" in ended["reason"]


def test_a_pause_holds_the_path_and_goals_are_heard_in_it(
    stage: Callable[..., tuple[Peer, Peer]], peers: Callable[..., Peer]
) -> None:
    host, client = stage(40.0, STIFF)
    client.tell(goal("paused", [[2.0, crouched(0.3)], [4.0, crouched(0.0)]]))
    client.wait_for(lambda: len(client.of("feedback")) > 5, "it to move")
    assert peers("caller", "unicon", "pause").end()[0] == 0
    count = len(host.of("tick"))
    client.tell(json.dumps({"cancel": "paused"}))
    assert result_of(client, "paused")["status"] == CANCELED
    client.tell(goal("next", [[1.0, crouched(0.1)]]))
    client.wait_for(lambda: len(client.of("answered")) == 2, "the answer in the pause")
    assert len(host.of("tick")) <= count + 2
    assert peers("caller", "unicon", "start").end()[0] == 0
    assert result_of(client, "next")["status"] == SUCCEEDED

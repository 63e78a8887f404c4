"""`teleop`: clutch, axes, workspace, speed; and whatever is not tracked has no target."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vr_operator import OURS, PERIOD, Operator, angle_between, turned

from unicon_base.errors import WorkflowError
from unicon_manipulation.teleop.operator import heading


def test_nothing_is_commanded_before_the_clutch_is_engaged() -> None:
    operator = Operator()
    operator.controller()
    operator.go(50)
    assert np.isnan(operator.target()).all()
    assert not operator.engaged()
    assert (operator.velocity() == 0.0).all()


def test_engaging_moves_nothing_wherever_the_hand_is() -> None:
    operator = Operator()
    operator.controller((1.3, -0.7, 0.4), turned((0.6, 0.0, 0.8), 2.0))
    operator.engage()
    np.testing.assert_allclose(operator.target(), OURS, atol=1e-6)
    operator.go(10)
    np.testing.assert_allclose(operator.target(), OURS, atol=1e-6)


def test_a_clutch_closes_beyond_0_6_and_opens_below_0_4() -> None:
    operator = Operator()
    operator.controller()
    for pressed, engaged in ((0.55, False), (0.65, True), (0.45, True), (0.35, False)):
        operator.press(pressed)
        operator.go(50)
        assert operator.engaged() == engaged, pressed


def test_the_hand_follows_in_the_axes_in_which_the_operator_looks_ahead() -> None:
    operator = Operator(max_speed=5.0, max_turn=20.0)
    quarter = turned((0.0, 0.0, 1.0), math.pi / 2)
    operator.states["webxr_head"][3:] = quarter  # looks along y
    operator.controller((0.3, 0.2, 1.0))
    operator.engage()
    # 10 cm ahead of him is 10 cm along y, and up is up; he rolls his hand about his forward axis.
    operator.controller((0.3, 0.3, 1.05), turned((0.0, 1.0, 0.0), 0.3))
    operator.go(20)
    np.testing.assert_allclose(operator.target()[:3], np.add(OURS[:3], (0.1, 0.0, 0.05)), atol=1e-5)
    assert angle_between(operator.target()[3:], turned((1.0, 0.0, 0.0), 0.3)) < 1e-3
    operator.states["webxr_head"][3:] = (1.0, 0.0, 0.0, 0.0)  # he looks about: of no matter now
    operator.go(20)
    np.testing.assert_allclose(operator.target()[:3], np.add(OURS[:3], (0.1, 0.0, 0.05)), atol=1e-5)


def test_an_open_clutch_keeps_the_target_and_lets_the_operator_go_back() -> None:
    operator = Operator(max_speed=5.0)
    operator.controller((0.3, 0.2, 1.0))
    operator.engage()
    operator.controller((0.4, 0.2, 1.0))
    operator.go(10)
    held = operator.target()
    assert held[0] == pytest.approx(OURS[0] + 0.1, abs=1e-5)
    operator.press(0.0)
    operator.controller((0.2, 0.2, 1.0))
    operator.go(10)
    np.testing.assert_array_equal(operator.target(), held)
    assert (operator.velocity() == 0.0).all()
    operator.states["left_hand_pose"][0] += 0.01  # the arm sags: no reason to jump
    operator.press(1.0)
    operator.go()
    np.testing.assert_array_equal(operator.target(), held)
    operator.controller((0.3, 0.2, 1.0))
    operator.go(10)
    assert operator.target()[0] == pytest.approx(held[0] + 0.1, abs=1e-5)


@pytest.mark.parametrize("way", ["silent", "stale", "not tracked", "no rotation", "NaN", "far"])
def test_a_lost_hand_has_no_target_and_needs_a_new_clutch(way: str) -> None:
    operator = Operator()
    operator.controller()
    operator.engage()
    operator.go(5)
    ticks, frame = 1, True
    if way == "silent":
        operator.heard(False)
    elif way == "stale":
        ticks, frame = 11, False  # 0.01 + 11 * 0.02 s
    elif way == "not tracked":
        operator.track(lost=("left_controller",))
    else:
        wrong = {"no rotation": (3, 7.0), "NaN": (0, math.nan), "far": (1, 30.0)}[way]
        operator.states["webxr_left_controller"][wrong[0]] = wrong[1]
    operator.go(ticks, frame)
    assert np.isnan(operator.target()).all()
    assert (operator.velocity() == 0.0).all()
    assert operator.states["left_hand_target_stamp_ns"] == 0
    assert not operator.engaged()
    operator.heard(True)
    operator.controller((0.9, 0.2, 1.3))
    operator.go(50)  # the button is still held
    assert np.isnan(operator.target()).all()
    operator.states["left_hand_pose"][:3] = (0.1, 0.3, -0.2)  # the arm has gone home
    operator.engage()
    np.testing.assert_allclose(operator.target()[:3], (0.1, 0.3, -0.2), atol=1e-6)


def test_a_target_lives_through_frames_that_are_missing_for_less_than_stale() -> None:
    operator = Operator(stale=0.2)
    operator.controller()
    operator.engage()
    operator.go(9, frame=False)
    assert not np.isnan(operator.target()).any()
    assert operator.states["teleop_latency"] == pytest.approx(0.19)


def test_no_target_is_faster_than_told() -> None:
    operator = Operator(max_speed=0.4, max_turn=1.0)
    operator.controller((0.3, 0.2, 1.0))
    operator.engage()
    operator.controller((0.8, 0.2, 1.0), turned((0.0, 0.0, 1.0), 2.0))
    last = operator.target()
    for _ in range(50):
        operator.go()
        new = operator.target()
        assert np.linalg.norm(new[:3] - last[:3]) <= 0.4 * PERIOD + 1e-6
        assert angle_between(new[3:], last[3:]) <= 1.0 * PERIOD + 1e-3
        last = new
    assert last[0] == pytest.approx(OURS[0] + 0.4, abs=0.01)


def test_targets_stay_in_box_and_ball() -> None:
    box = [[0.1, -0.4, -0.1], [0.4, 0.4, 0.3]]
    operator = Operator(box=box, sphere=[0.0, 0.1, 0.1, 0.4], max_speed=5.0)
    operator.controller((0.3, 0.2, 1.0))
    operator.engage()
    for x in np.linspace(-2.0, 2.0, 9):
        for z in np.linspace(-2.0, 2.0, 9):
            operator.controller((x, x * z, 1.0 + z))
            operator.go(20)
            target = operator.target()[:3]
            assert (target >= np.array(box[0]) - 1e-6).all()
            assert (target <= np.array(box[1]) + 1e-6).all()
            assert np.linalg.norm(target - (0.0, 0.1, 0.1)) <= 0.4 + 1e-6


def test_a_hand_that_is_outside_already_is_not_pulled_in() -> None:
    operator = Operator(box=[[0.3, -0.1, 0.0], [0.6, 0.1, 0.3]], max_speed=5.0)
    operator.controller((0.3, 0.2, 1.0))
    operator.engage()
    np.testing.assert_allclose(operator.target()[:3], OURS[:3], atol=1e-6)  # y is 0.2
    operator.controller((0.3, 0.4, 1.0))
    operator.go(20)
    np.testing.assert_allclose(operator.target()[:3], OURS[:3], atol=1e-6)  # no farther out
    operator.controller((0.3, 0.05, 1.0))
    operator.go(20)
    assert operator.target()[1] == pytest.approx(0.05, abs=1e-6)
    operator.controller((0.3, 0.4, 1.0))
    operator.go(20)
    assert operator.target()[1] == pytest.approx(0.1, abs=1e-6)  # and not out again


def test_the_way_may_be_scaled() -> None:
    operator = Operator(scale=0.5, max_speed=5.0)
    operator.controller((0.3, 0.2, 1.0))
    operator.engage()
    operator.controller((0.5, 0.2, 1.0))
    operator.go(20)
    assert operator.target()[0] == pytest.approx(OURS[0] + 0.1, abs=1e-5)


def test_velocity_and_stamp_are_those_of_the_headsets_frames() -> None:
    operator = Operator(max_speed=2.0)
    operator.controller((0.3, 0.2, 1.0))
    operator.engage()
    for step in range(1, 21):
        operator.controller((0.3 + 0.004 * step, 0.2, 1.0))  # 0.2 m/s
        operator.go()
    np.testing.assert_allclose(operator.velocity(), [0.2, 0, 0, 0, 0, 0], atol=2e-3)
    now = int(operator.states["stamp_ns"])
    assert operator.states["left_hand_target_stamp_ns"] == pytest.approx(now - 10_000_000, abs=10)
    before = operator.velocity()
    operator.go(2, frame=False)  # nothing new is known
    np.testing.assert_array_equal(operator.velocity(), before)
    now = int(operator.states["stamp_ns"])
    assert operator.states["left_hand_target_stamp_ns"] == pytest.approx(now - 50_000_000, abs=10)


def test_a_button_sends_the_arm_home() -> None:
    operator = Operator()
    operator.controller()
    operator.engage()
    operator.press(button="a")
    operator.go()
    assert np.isnan(operator.target()).all()
    operator.press(0.0, button="a")
    operator.go(20)  # still squeezed: it was not opened since
    assert np.isnan(operator.target()).all()


def test_a_bare_hand_engages_by_a_pinch_that_lasts() -> None:
    operator = Operator(max_speed=5.0)
    operator.hand()
    operator.go(5)
    operator.hand(pinched=True)
    operator.go(2)
    assert not operator.engaged()
    operator.hand(pinched=False)
    operator.go()
    operator.hand(pinched=True)
    operator.go(3)
    assert operator.engaged()
    operator.hand((0.4, 0.2, 1.0), pinched=True)
    operator.go(10)
    assert operator.target()[0] == pytest.approx(OURS[0] + 0.1, abs=1e-5)
    operator.hand((0.4, 0.2, 1.0), pinched=False)
    operator.go()
    assert not operator.engaged()
    assert not np.isnan(operator.target()).any()


def test_toggle_stays_engaged_until_the_next_pinch() -> None:
    operator = Operator(clutch={"hand": "toggle"})
    operator.hand()
    operator.go(2)
    for expected in (True, False, True):
        operator.hand(pinched=True)
        operator.go(10)
        assert operator.engaged() is expected
        operator.hand(pinched=False)
        operator.go(10)
        assert operator.engaged() is expected


def test_always_engages_once_a_hand_has_been_there_for_a_while() -> None:
    operator = Operator(clutch="always")
    operator.hand()
    operator.go(24)
    assert not operator.engaged()
    operator.go(2)
    assert operator.engaged()
    operator.track(lost=("left_hand",))
    operator.go()
    assert np.isnan(operator.target()).all()
    operator.hand()
    operator.go(24)
    assert not operator.engaged()
    operator.go(2)
    assert operator.engaged()


def test_a_controller_that_is_taken_up_moves_nothing() -> None:
    operator = Operator(clutch={"hand": "toggle"})
    operator.hand()
    operator.go(2)
    operator.hand(pinched=True)
    operator.go(5)
    held = operator.target()
    operator.track(lost=("left_hand",))
    operator.controller((0.9, 0.9, 0.9))
    operator.go(5)
    np.testing.assert_array_equal(operator.target(), held)
    assert not operator.engaged()


def test_without_a_head_nobody_knows_where_ahead_is() -> None:
    operator = Operator()
    operator.controller()
    operator.track(lost=("head",))
    operator.go()
    operator.press()
    operator.go(5)
    assert not operator.engaged()
    assert np.isnan(operator.target()).all()


def test_a_robots_hand_that_is_not_known_is_not_moved() -> None:
    operator = Operator()
    operator.states["left_hand_pose"][...] = math.nan
    operator.controller()
    operator.go()
    operator.press()
    operator.go(5)
    assert not operator.engaged()
    assert np.isnan(operator.target()).all()


def test_a_robot_that_falls_silent_has_to_be_engaged_anew() -> None:
    operator = Operator()
    operator.controller()
    operator.engage()
    operator.states["left_hand_pose"][...] = math.nan  # as of a part that is not heard
    operator.go()
    assert np.isnan(operator.target()).all()
    operator.states["left_hand_pose"][...] = OURS
    operator.go(20)
    assert np.isnan(operator.target()).all()
    operator.engage()


def test_each_hand_has_its_own_clutch() -> None:
    operator = Operator()
    operator.controller(side="left")
    operator.controller((0.3, -0.2, 1.0), side="right")
    operator.engage("right")
    assert not operator.engaged("left")
    assert np.isnan(operator.target("left_hand")).all()
    assert operator.target("right_hand")[1] == pytest.approx(-OURS[1])


def test_one_arm_alone() -> None:
    operator = Operator(left=None, right="hand", sphere=[0.0, 0.1, 0.0, 0.9])
    operator.controller(side="right")
    operator.engage("right")
    assert not np.isnan(operator.target("hand")).any()


def test_reset_lets_go() -> None:
    operator = Operator()
    operator.controller()
    operator.engage()
    operator.tick.reset()
    operator.go(5)
    assert np.isnan(operator.target()).all()


def test_bowing_is_no_turn() -> None:
    for yaw in (-2.5, -0.4, 0.0, 1.2, 3.0):
        for pitch in (-1.5, -0.9, 0.0, 0.9, 1.5):
            level = turned((0.0, 0.0, 1.0), yaw)
            bow = turned((0.0, 1.0, 0.0), pitch)
            w, x, y, z = level
            bw, _, by, _ = bow
            quat = (w * bw - y * by, x * bw - z * by, y * bw + w * by, z * bw + x * by)
            assert heading(quat) == pytest.approx(yaw, abs=1e-6)


def test_smoothing_calms_a_trembling_hand_and_follows_a_quick_one() -> None:
    rng = np.random.default_rng(1)
    noise = rng.normal(0.0, 0.003, (200, 3))
    spread = {}
    for smooth in (None, [1.0, 5.0]):
        operator = Operator(smooth=smooth, max_speed=5.0)
        operator.controller((0.3, 0.2, 1.0))
        operator.engage()
        seen = []
        for row in noise:
            operator.controller(tuple(np.add((0.3, 0.2, 1.0), row)))
            operator.go()
            seen.append(operator.target()[:3])
        spread[smooth is None] = np.std(seen[50:], axis=0).max()
        for step in range(50):  # 1 m/s
            operator.controller((0.3 + 0.02 * min(step, 20), 0.2, 1.0))
            operator.go()
        assert operator.target()[0] - OURS[0] == pytest.approx(0.4, abs=0.02)
    assert spread[False] < 0.5 * spread[True]


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.lists(st.floats(width=32), min_size=7, max_size=7),
            st.sampled_from([0.0, 0.5, 1.0]),
            st.booleans(),
            st.integers(-1, 3),
        ),
        max_size=25,
    )
)
def test_whatever_comes_no_target_jumps_or_is_half_there(steps: list[Any]) -> None:
    operator = Operator(max_speed=0.5, max_turn=2.0)
    operator.controller()
    operator.engage()
    for pose, pressed, tracked, frames in steps:
        last = operator.target()
        if frames == 3:
            operator.states["webxr_head"][...] = pose
        else:
            operator.states["webxr_left_controller"][...] = pose
            if frames == 2:  # a plausible one
                operator.controller(tuple(np.clip(np.nan_to_num(pose[:3]), -2.0, 2.0)))
        operator.track(lost=() if tracked else ("left_controller",))
        operator.press(pressed)
        operator.go(frame=frames > 0)
        target, velocity = operator.target(), operator.velocity()
        missing = np.isnan(target)
        assert missing.all() or not missing.any()
        assert np.isfinite(velocity).all()
        assert np.linalg.norm(velocity[:3]) <= 0.5 + 1e-4
        assert np.linalg.norm(velocity[3:]) <= 2.0 + 1e-4
        if not missing.any():
            assert abs(np.linalg.norm(target[3:]) - 1.0) < 1e-5
            assert (np.abs(target[:3]) <= 1.0 + 1e-6).all()
            if not np.isnan(last).any():
                assert np.linalg.norm(target[:3] - last[:3]) <= 0.5 * PERIOD + 1e-5


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"left": None, "right": None}, "give the end effector of one of them"),
        ({"right": "left_hand"}, "give the end effector of one of them"),
        ({"pinch": "thumb"}, "pinch 'thumb' is not known; "),
        ({"clutch": "grab"}, "clutch is 'grab'; write "),
        ({"clutch": {"foot": "hold"}}, "clutch: unknown key 'foot'; "),
        ({"box": [[0, 0, 0], [1, 1]]}, "box.1 is [1, 1]; write a list of 3"),
        ({"box": [[0, 0, 1], [1, 1, 0]]}, "least and largest in [m]"),
        ({"box": [[0, 0, 0], [1, 1, 50]]}, "box.1.2 is 50; write a number from -3 to 3 [m]"),
        ({"sphere": [0, 0, 0.5]}, "sphere is [0, 0, 0.5]; write [x, y, z, radius]"),
        ({"sphere": [0, 0, 0, -1]}, "sphere.3 is -1; write a number above 0 to 3 [m]"),
        ({"max_speed": 0.0}, "max_speed is 0.0; write a number above 0 to 5 [m/s]"),
        ({"max_turn": 50.0}, "max_turn is 50.0"),
        ({"scale": -1.0}, "scale is -1.0"),
        ({"stale": 9.0}, "stale is 9.0"),
        ({"smooth": [1.0]}, "smooth is [1.0]; write [Hz, Hz for 1 m/s]"),
        (
            {"device": "vive"},
            "no state 'vive_alive'; list the device that writes it, such as webxr",
        ),
        ({"home": "menu"}, "no 'menu'; "),
    ],
)
def test_wrong_options_are_told(options: dict[str, Any], message: str) -> None:
    with pytest.raises(WorkflowError, match=re.escape(message)):
        Operator(**options)

"""Block `retarget`: what it commands, when it is silent, and how it is asked for wrongly."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hands import rohand_model, xhand_model
from human_hands import human_hand
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_base.errors import RobotError, UniconError, WorkflowError
from unicon_core.flow import Writes
from unicon_core.memory import Memory
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import StateSpec
from unicon_core.testing import Bench
from unicon_core.workflow import Program
from unicon_manipulation.retargeting_block import Retarget

pytest.importorskip("mujoco")

HALF = dict.fromkeys(("thumb", "index", "middle", "ring", "pinky"), 0.5)
HUMAN = StateSpec((25, 7), initial=0.0)


class Led(Bench):
    """An XHand1, or another hand, and the states of a human's."""

    def __init__(self, folder: Path, robots: str = "left", **options: Any) -> None:
        robot = load_robot(f"xhand1_{robots}")
        declared = Retarget.declares(robot=robot)
        super().__init__(robot, states={**declared, f"webxr_{robots}_hand": HUMAN})
        self.hand = self.states[f"webxr_{robots}_hand"]
        self.states.joint_pos[...] = robot.default_joint_pos
        self.told: list[str] = []
        options = {"model": str(xhand_model(folder, robots)), **options}
        self.lead = self.block("retarget", **options)
        self.lead.tick.tell = self.told.append

    def see(self, poses: np.ndarray) -> np.ndarray:
        """Return what is commanded for a human hand."""
        self.hand[...] = poses
        self.lead.tick()
        return self.states.joint_pos_command.copy()


def test_it_commands_within_the_limits_and_says_how_near(tmp_path: Path) -> None:
    led = Led(tmp_path)
    command = led.see(human_hand(HALF, side="left"))
    assert np.isfinite(command).all()
    assert (command >= led.robot.lower).all()
    assert (command <= led.robot.upper).all()
    error = led.states.left_hand_retarget_error
    assert led.states.layout.specs["left_hand_retarget_error"].names == tuple(HALF)
    assert (error[1:] < 0.01).all()
    assert led.lead.reads == ("joint_pos", "webxr_left_hand")
    assert led.lead.writes == ("joint_pos_command", "left_hand_retarget_error")
    assert led.lead.tick.moves == ()  # all joints


def test_nothing_is_commanded_for_a_hand_that_is_not_there(tmp_path: Path) -> None:
    led = Led(tmp_path)
    there = led.see(human_hand(HALF, side="left"))
    neutral = np.tile(np.array((0, 0, 0, 1, 0, 0, 0), np.float32), (25, 1))
    for absent in (neutral, np.zeros((25, 7)), np.full((25, 7), np.nan)):
        assert np.isnan(led.see(absent)).all()
        assert np.isnan(led.states.left_hand_retarget_error).all()
        np.testing.assert_array_equal(led.see(human_hand(HALF, side="left")), there)
    assert led.told == []


def test_a_hand_that_cannot_be_one_is_told_once_an_episode(tmp_path: Path) -> None:
    led = Led(tmp_path)
    good, giant = human_hand(HALF, side="left"), human_hand(HALF, 3.0, "left")
    for _ in range(50):  # flickers
        led.see(good)
        assert np.isnan(led.see(giant)).all()
    (told,) = led.told
    assert told == (
        "the way from the wrist to the index is 0.297 m; nothing is commanded until it can be a "
        "hand"
    )
    for _ in range(101):  # 2 s
        led.see(good)
    led.see(giant)
    assert len(led.told) == 2
    led.see(human_hand(HALF, side="right"))
    assert len(led.told) == 2
    again = Led(tmp_path)
    assert np.isnan(again.see(human_hand(HALF, side="right"))).all()
    assert again.told[0].startswith("it is not a left hand;")


def test_it_is_no_faster_than_told_from_where_the_joints_are(tmp_path: Path) -> None:
    led = Led(tmp_path, max_rate=2.0)
    free = Led(tmp_path).see(human_hand(HALF, side="left"))
    before = led.robot.default_joint_pos.copy()
    for _ in range(100):
        command = led.see(human_hand(HALF, side="left"))
        assert np.abs(command - before).max() <= 2.0 * led.period + 1e-6
        before = command
    np.testing.assert_allclose(before, free, atol=5e-3)
    fast = Led(tmp_path, max_rate="robot")
    rates = (fast.see(human_hand(HALF, side="left")) - fast.robot.default_joint_pos) / fast.period
    assert (np.abs(rates) <= fast.robot.velocity_limit * 1.001).all()


def test_joints_that_are_not_measured_are_no_start(tmp_path: Path) -> None:
    led = Led(tmp_path, max_rate=2.0)
    led.states.joint_pos[...] = np.nan
    assert np.isfinite(led.see(human_hand(HALF, side="left"))).all()
    led.lead.reset()
    led.states.joint_pos[...] = 50.0
    command = led.see(human_hand(HALF, side="left"))
    assert (command <= led.robot.upper).all()


def test_the_filter_takes_the_tremor_off(tmp_path: Path) -> None:
    spread = {}
    for cut in (None, 2.0):
        led, random = Led(tmp_path, filter=cut), np.random.default_rng(0)
        seen = []
        for _ in range(100):
            poses = human_hand(HALF, side="left")
            poses[1:, :3] += random.normal(scale=5e-4, size=(24, 3))
            seen.append(led.see(poses))
        spread[cut] = np.std(seen[20:], axis=0).mean()
    assert spread[2.0] < 0.45 * spread[None]


def test_a_scale_that_is_given_is_not_measured(tmp_path: Path) -> None:
    led = Led(tmp_path, scale=1.3)
    led.see(human_hand(HALF, side="left"))
    assert led.lead.tick.scale.tolist() == [1.3] * 5
    measured = Led(tmp_path)
    measured.see(human_hand(HALF, 0.8, side="left"))
    one = measured.lead.tick.scale.copy()
    led = Led(tmp_path)
    led.see(human_hand(HALF, 1.0, side="left"))
    np.testing.assert_allclose(led.lead.tick.scale * 1.25, one, rtol=1e-5)


def test_another_side_is_mirrored_and_a_file_of_both_asks(tmp_path: Path) -> None:
    right = Led(tmp_path, "right").see(human_hand(HALF, side="right"))
    robot = load_robot("xhand1_right")
    declared = Retarget.declares(robot=robot, side="left")
    bench = Bench(robot, states={**declared, "webxr_left_hand": HUMAN})
    model = str(xhand_model(tmp_path, "right"))
    block = bench.block("retarget", side="left", model=model)
    bench.states.webxr_left_hand = human_hand(HALF, side="left")
    block.tick()
    np.testing.assert_allclose(bench.states.joint_pos_command, right, atol=1e-5)
    rohand = Bench("rohand", states=Retarget.declares(robot=load_robot("rohand")))
    with pytest.raises(
        WorkflowError, match="robot rohand may be a left or a right hand; say which: side: left"
    ):
        rohand.block("retarget", model=str(rohand_model(tmp_path, "left")))


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"side": "up"}, "side 'up' is not known; known: left, right"),
        ({"hand": "webxr_left"}, "no state 'webxr_left' of a human hand; did you mean 'webxr_left"),
        ({"hand": "joint_pos"}, r"state 'joint_pos' has shape \[12\]; a human hand has \[25, 7\],"),
        ({"scale": 0.0}, "scale is 0.0; write a number from 0.2 to 5"),
        ({"contact": 1.0}, r"contact is 1.0; write a number from 0 to 0.025 \[m\]"),
        ({"filter": -1.0}, r"filter is -1.0; write a number above 0 to 1000 \[Hz\]"),
        ({"max_rate": 0.0}, r"max_rate is 0.0; write a number above 0 to 200 \[rad/s\]"),
        ({"max_rate": "fast"}, r"max_rate is 'fast'; write a number above 0 to 200"),
        ({"model": "nowhere.urdf"}, "nowhere.urdf"),
        ({"strength": 1.0}, "has no option 'strength'"),
    ],
)
def test_wrong_options_are_refused(tmp_path: Path, options: dict[str, Any], told: str) -> None:
    with pytest.raises(UniconError, match=told):
        Led(tmp_path, **options)


def test_it_is_for_one_robot_with_a_hand(tmp_path: Path) -> None:
    robot = load_robot("xhand1_left")
    states = {**Retarget.declares(robot=robot), "webxr_left_hand": HUMAN}
    with pytest.raises(WorkflowError, match="it is for one robot; leave num_robots out"):
        Bench(robot, 2, states=states).block("retarget", model=str(xhand_model(tmp_path, "left")))
    go2 = load_robot("go2")
    with pytest.raises(RobotError, match="robot go2 has no hand"):
        Bench(go2, states=Retarget.declares(robot=go2)).block("retarget")


def test_a_hand_of_which_it_moves_some_joints_says_which(tmp_path: Path) -> None:
    """Without fingers that the file does not name: their joints are free for others."""
    text = load_robot("xhand1_left").path.read_text("utf-8")
    text = text.replace("    pinky: {body: left_hand_pinky_tip}\n", "")
    path = tmp_path / "xhand1_left.yaml"
    path.write_text(text, "utf-8")
    robot = load_robot(path)
    bench = Bench(robot, states={**Retarget.declares(robot=robot), "webxr_left_hand": HUMAN})
    block = bench.block("retarget", model=str(xhand_model(tmp_path, "left")))
    assert block.tick.moves == robot.joint_names[:10]
    bench.states.webxr_left_hand = human_hand(HALF, side="left")
    block.tick()
    assert np.isnan(bench.states.joint_pos_command).tolist() == [False] * 10 + [True] * 2


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_whatever_comes_it_commands_within_limits_or_nothing(seed: int) -> None:
    led = _LED[0]
    random = np.random.default_rng(seed)
    for _ in range(4):
        poses = human_hand(dict(zip(HALF, random.uniform(-0.3, 1.3, 5))), 1.0, "left")
        poses[1:, :3] += random.normal(scale=10.0 ** random.uniform(-4, -1), size=(24, 3))
        if random.random() < 0.2:
            poses[random.integers(25), random.integers(7)] = random.choice((np.nan, np.inf, 1e30))
        with np.errstate(all="ignore"):
            command = led.see(poses)
        lacking = np.isnan(command)
        assert lacking.all() or not lacking.any()
        if not lacking.any():
            assert (command >= led.robot.lower).all()
            assert (command <= led.robot.upper).all()


_LED: list[Led] = []


@pytest.fixture(autouse=True, scope="module")
def _one_for_all(tmp_path_factory: pytest.TempPathFactory) -> None:
    _LED[:] = [Led(tmp_path_factory.mktemp("led"))]


def test_it_goes_on_to_the_bit_from_its_memory(tmp_path: Path) -> None:
    def hands(begin: int) -> list[np.ndarray]:
        turns = np.arange(begin, begin + 40) * 0.1
        return [human_hand(dict.fromkeys(HALF, 0.5 + 0.4 * np.sin(t)), side="left") for t in turns]

    first, second = (Led(tmp_path, filter=5.0, max_rate=4.0) for _ in range(2))
    for poses in hands(0):
        first.see(poses)
    snapshot = Memory({"retarget": first.lead.tick}).take()
    Memory({"retarget": second.lead.tick}).put_back(snapshot)
    for poses in hands(40):
        assert first.see(poses).tobytes() == second.see(poses).tobytes()


def write_hands(webxr_left_hand: Writes, webxr_right_hand: Writes) -> Any:
    """Stand-in of a headset: the left hand half shut, the right one open."""

    def tick() -> None:
        webxr_left_hand[...] = human_hand(HALF, side="left")
        webxr_right_hand[...] = human_hand({}, side="right")

    return tick


def test_hands_of_a_robot_are_led_each_by_its_own(tmp_path: Path) -> None:
    robots = {"body": "go2", "left_hand": "xhand1_left", "right_hand": "xhand1_right"}
    models = {side: str(xhand_model(tmp_path, side)) for side in ("left", "right")}
    program = Program(
        robot=robots,
        platform={"body": "fake", "hands": "fake"},
        rate=50,
        states={f"webxr_{side}_hand": {"shape": [25, 7]} for side in ("left", "right")},
        commands=[
            {"call": "test_retarget:write_hands"},
            *(
                {"of": f"{side}_hand", "retarget": {"model": models[side]}}
                for side in ("left", "right")
            ),
        ],
        flow={
            "zip": [
                {"of": "body", "hold": {"duration": 1.0}},
                *(
                    {"of": f"{side}_hand", "forward_command": {"max_rate": 6.0}}
                    for side in ("left", "right")
                ),
            ]
        },
    )
    report = Runner(program, RunOptions(speed="max")).run()
    assert report.faults == []
    assert program.states["joint_pos_command"].shape == (12 + 24,)
    command = program.states["joint_pos_command"]
    assert np.isnan(command[:12]).all()
    alone = Led(tmp_path).see(human_hand(HALF, side="left"))
    np.testing.assert_allclose(command[12:24], alone, atol=5e-3)
    assert np.isfinite(command[24:]).all()
    assert np.abs(program.states["joint_pos_target"][12:24] - command[12:24]).max() < 0.01

"""A diagnosis finds what was changed in a simulator, says how surely, and accuses nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")

from motions import motion, states_of

from unicon_base.arrays import Float64
from unicon_base.errors import UniconError
from unicon_core.models.frames import multiply
from unicon_core.platforms.kit.base import rotation
from unicon_core.platforms.kit.disturbances import PLACE
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import load_robot
from unicon_core.states.standard import COMMAND_STATES
from unicon_lab.diagnose.fit import Fit, Parameter, overlay_text
from unicon_lab.diagnose.motion import BASE_ANSWERS, Motion
from unicon_lab.diagnose.plant import KINDS, Change, Place
from unicon_lab.diagnose.replays import Replays, derivatives
from unicon_lab.diagnose.search import Found, Search
from unicon_lab.diagnose.windows import Likelihood, Settled

GO2 = load_robot("go2")
CALF, FR_THIGH, FL_CALF = (
    GO2.joint_names.index(f"{name}_joint") for name in ("RL_calf", "FR_thigh", "FL_calf")
)
EVERY = [(kind, -1) for kind in KINDS] + [
    (kind, joint) for kind in KINDS if KINDS[kind].each for joint in range(12)
]
NOISE = {"joint_pos": 0.003, "joint_vel": 0.2, "base_ang_vel": 0.05, "base_quat": 0.003}


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> Motion:
    return motion(tmp_path_factory.mktemp("motion"), {}, seconds=2.0, most=8)


def searched(it: Motion, places: list[Place], processes: int = 1) -> Found:
    with Replays(GO2, Scene(), it, processes) as replays:
        return Search(it, places, replays.plant.limbs, replays, lambda text: None).go()


def test_a_replay_with_the_right_change_is_the_run(tmp_path: Path) -> None:
    """Delay, too: the command of the tick before is on its way when a window begins."""
    it = motion(
        tmp_path,
        {"RL_calf_joint": {"strength": 0.5, "friction": 1.0, "armature": 0.03, "delay": 0.014}},
        seconds=2.0,
        most=10,
    )
    with Replays(GO2, Scene(), it, 1) as replays:
        own = replays.plant.own
        change = {
            ("strength", CALF): -0.5,
            ("friction", CALF): 1.0 - own["friction"][CALF],
            ("armature", CALF): 0.03 - own["armature"][CALF],
            ("delay", CALF): 0.014,
        }
        begins = replays.settle({})
        right, wrong = (answers - it.answers for answers in replays([change, {}], [begins] * 2))
    assert np.abs(right[..., :12]).max() < 2e-3  # windows begin in float32
    assert np.abs(wrong[..., CALF]).max() > 0.02


def test_a_slope_is_not_taken_for_the_flat_ground_of_the_simulator() -> None:
    """A record in simulation has the base's height, which is none above this ground."""
    slope = {"scene.terrain": {"slope": {"angle": 0.1, "flat": 1.0}}}
    states, period = states_of("go2_walk", slope, seconds=8.9)
    usable = np.arange(len(states["tick"])) > 325  # from 0.6 m in front of the start on
    it = Motion.of(states, period, usable, most=8)
    with Replays(GO2, Scene(), it, 1) as replays:
        changes = [{("slope x", -1): np.tan(0.1)}, {}, {("attitude y", -1): -0.1}]
        answers = replays(changes, [replays.settle({})] * 3)
    right, flat, attitude = (np.sqrt(((each - it.answers) ** 2).mean()) for each in answers)
    assert right < 0.25 * flat
    assert right < attitude


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("kind", KINDS)
def test_a_change_beyond_its_bounds_ends_at_them(long: Motion, kind: str, sign: float) -> None:
    """Derivatives are taken beside sizes that may lie at a bound."""
    with Replays(GO2, Scene(), long, 1) as replays:
        beyond, bound = 1e6 * sign, KINDS[kind].high if sign > 0 else KINDS[kind].low
        changes = [{(kind, -1): beyond}, {(kind, -1): bound}]
        one, other = replays(changes, [replays.settle({})] * 2)
    assert np.array_equal(one, other)
    assert np.isfinite(one).all()


def test_it_finds_a_weak_motor_and_no_other(tmp_path: Path) -> None:
    it = motion(tmp_path, {"RL_calf_joint": {"strength": 0.5}}, seconds=3.0)
    front = GO2.joint_names.index("FR_calf_joint")
    found = searched(it, [("strength", CALF), ("strength", front), ("delay", -1)])
    assert [place for place, _ in found.causes] == [("strength", CALF)]
    assert found.change["strength", CALF] == pytest.approx(-0.5, abs=0.02)
    assert found.after < 0.01 * found.before
    assert found.probability["strength", CALF] > 0.99


@pytest.mark.slow
def test_with_equal_gains_damping_is_not_told_from_viscous_friction(tmp_path: Path) -> None:
    it = motion(tmp_path, {}, seconds=3.0)
    assert np.ptp(it.commands["joint_damping"]) == 0.0
    it.commands["joint_damping"] *= 0.5
    places: list[Place] = [("damping", -1), ("viscous friction", -1), ("armature", -1)]
    ((place, alike),) = searched(it, places).causes
    assert {place, *alike} == set(places[:2])


def test_a_right_simulator_is_accused_of_nothing(tmp_path: Path) -> None:
    places = [("strength", CALF), ("delay", -1), ("payload", -1), ("friction", -1)]
    assert searched(motion(tmp_path, {}, seconds=3.0), places).causes == []


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    ("scene", "place", "size", "within"),
    [
        ({}, None, 0.0, 0.0),
        ({"payload": {"mass": 4.0}}, ("payload", -1), 4.0, 0.4),
        ({"joints": {"*": {"delay": 0.008}}}, ("delay", -1), 0.008, 0.001),
        ({"joints": {"*": {"strength": 0.8}}}, ("strength", -1), -0.2, 0.02),
        ({"joints": {"RL_calf_joint": {"strength": 0.7}}}, ("strength", CALF), -0.3, 0.03),
        ({"joints": {"FR_thigh_joint": {"friction": 1.2}}}, ("friction", FR_THIGH), 1.0, 0.2),
        ({"joints": {"FL_calf_joint": {"armature": 0.05}}}, ("armature", FL_CALF), 0.04, 0.01),
        ({"contact_friction": 0.3}, ("ground friction", -1), -0.7, 0.15),
    ],
)
def test_a_walk_with_noise_names_its_cause_among_all(
    scene: dict[str, Any], place: Place | None, size: float, within: float
) -> None:
    """The 4 kg payload is no weak motor, and noise with delay is no more torque."""
    overrides = {f"scene.{key}": value for key, value in scene.items()}
    states, period = states_of("go2_walk", {"scene.noise": NOISE} | overrides, seconds=20.0)
    it = Motion.of(states, period, np.ones(len(states["tick"]), np.bool_), most=100)
    found = searched(it, EVERY, processes=2)
    assert [one for one, _ in found.causes][:1] == ([place] if place else [])
    if place:
        assert found.change[place] == pytest.approx(size, abs=within)
        assert found.probability[place] > 0.9
        assert len(found.causes) == 1


def without_velocity(states: dict[str, Any]) -> dict[str, Any]:
    """Return what a robot measures: neither where its base is, nor how fast it moves."""
    return {n: v for n, v in states.items() if n not in ("base_lin_vel", "base_pos_w")}


def test_the_base_velocity_is_found_where_windows_begin() -> None:
    states, period = states_of("go2_walk", {"scene.noise": NOISE}, seconds=4.0)
    real = np.ones(len(states["tick"]), np.bool_)
    it = Motion.of(without_velocity(states), period, real)
    assert it.sought
    with Replays(GO2, Scene(), it, 1) as replays:
        guess = replays.plant.carried
        found, truth = guess - replays.settle({})[:, -4:-1], states["base_lin_vel"][it.starts]
    worse, better = (np.median(np.abs(each - truth)) for each in (guess, found))
    assert better < 0.015 < worse < 0.03


@pytest.mark.parametrize("heading", ["measured", "integrated"])
def test_a_gyroscope_is_compared_with_the_attitude_unless_that_integrates_it(heading: str) -> None:
    states, period = states_of("go2_walk", {"scene.noise": NOISE}, seconds=6.0)
    real, bias = np.ones(len(states["tick"]), np.bool_), 0.2
    states["base_ang_vel"] = states["base_ang_vel"] + np.array([0.0, 0.0, bias])
    if heading == "integrated":
        half = 0.5 * bias * period * np.arange(len(real))
        w, x, y, z = states["base_quat"].T
        sin, cos = np.sin(half), np.cos(half)  # the world turns about its z by twice that
        turned = cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w
        states["base_quat"] = np.stack(turned, axis=1)
    it = Motion.of(states, period, real, most=20)
    with Replays(GO2, Scene(), it, 1) as replays:
        changes = [{("gyro bias z", -1): bias}, {}]
        answers = replays(changes, [replays.settle({})] * 2)
    channel = 12 + BASE_ANSWERS.index("turn rate z against base_quat")
    right, none = ((it.answers - each)[..., channel].mean() for each in answers)
    assert right == pytest.approx(0.0, abs=0.05)
    assert none == pytest.approx(bias * (heading == "measured"), abs=0.05)


def test_a_small_turn_of_the_imu_is_reported() -> None:
    states, period = states_of("go2_walk", {"scene.noise": NOISE}, seconds=6.0)
    w, x, y, z = states["base_quat"].T
    turned = np.stack([w - 0.004 * y, x - 0.004 * z, y + 0.004 * w, z + 0.004 * x], axis=1)
    states["base_quat"] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    it = Motion.of(states, period, np.ones(len(w), np.bool_), most=20)
    found = searched(it, [("attitude y", -1), ("attitude x", -1), ("payload", -1)])
    assert [place for place, _ in found.causes] == [("attitude y", -1)]
    assert found.change["attitude y", -1] == pytest.approx(0.008, abs=0.003)


def test_sensors_are_tried_with_large_errors_both_ways() -> None:
    def run(changes: Sequence[Change], begins: Sequence[Float64]) -> list[Float64]:
        return [np.full((1, 2, 3), sum(change.values()) ** 3) for change in changes]

    places: list[Place] = [("gyro bias z", -1), ("payload", -1)]
    found = derivatives(
        places, np.zeros(1, np.int64), cast(Any, run), np.zeros(3), np.zeros((1, 2, 3))
    )
    sizes = {
        place: [float(each.mean()) ** 0.5 for each in slopes] for place, slopes in found.items()
    }
    far = KINDS["gyro bias z"].far
    assert far >= 8.0 * KINDS["gyro bias z"].step
    assert sizes == {places[0]: pytest.approx([0.05, far, far]), places[1]: pytest.approx([2.0])}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "size"), [(("encoder offset", FR_THIGH), 0.25), (("gyro bias z", -1), -0.6)]
)
def test_a_large_error_of_a_sensor_is_found(place: Place, size: float) -> None:
    """Windows that begin so far off answer nothing like a derivative says."""
    states, period = states_of("go2_walk", {"scene.noise": NOISE}, seconds=6.0)
    changed = ("joint_pos", "joint_pos_target") if place[1] >= 0 else ("base_ang_vel",)
    for name in changed:
        states[name][:, max(place[1], 2 * (place[1] < 0))] += size
    it = Motion.of(
        without_velocity(states), period, np.ones(len(states["tick"]), np.bool_), most=20
    )
    others = [("payload", -1), ("friction", CALF), ("centre of mass y", -1)]
    found = searched(it, [place, *others])
    assert [one for one, _ in found.causes] == [place]
    assert found.change[place] == pytest.approx(size, abs=0.05)


def test_a_gyroscope_reads_in_the_axes_of_its_mount() -> None:
    states, period = states_of("go2_walk", {}, seconds=13.0)
    half, every = 0.15, np.arange(len(states["tick"])) > 500  # it walks a bend
    turn = np.array([np.cos(half), np.sin(half), 0.0, 0.0])
    turned = np.stack(multiply(states["base_quat"].T, turn), axis=1)
    its = states | {"base_quat": turned, "base_ang_vel": states["base_ang_vel"] @ rotation(turn)}

    def error(states: dict[str, Any], change: Change) -> float:
        it = Motion.of(states, period, every, most=10)
        with Replays(GO2, Scene(), it, 1) as replays:
            (answers,) = replays([change], [replays.settle({})])
        return float(np.median(np.abs(answers - it.answers)[..., 14:17]))

    right = error(its, {("attitude x", -1): 2.0 * half})
    assert right < 0.08 < 0.5 < error(its, {})  # the base's height is by its feet


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    ("scene", "place", "size", "within"),
    [
        ({}, None, 0.0, 0.0),
        ({"payload": {"mass": 4.0}}, ("payload", -1), 4.0, 0.5),
        ({"joints": {"*": {"delay": 0.008}}}, ("delay", -1), 0.008, 0.001),
        ({"joints": {"RL_calf_joint": {"strength": 0.7}}}, ("strength", CALF), -0.3, 0.03),
    ],
)
def test_a_walk_without_measured_velocity_names_its_cause_too(
    scene: dict[str, Any], place: Place | None, size: float, within: float
) -> None:
    overrides = {f"scene.{key}": value for key, value in scene.items()}
    states, period = states_of("go2_walk", {"scene.noise": NOISE} | overrides, seconds=20.0)
    real = np.ones(len(states["tick"]), np.bool_)
    it = Motion.of(without_velocity(states), period, real, most=100)
    found = searched(it, EVERY, processes=2)
    assert [one for one, _ in found.causes] == ([place] if place else [])
    if place:
        assert found.change[place] == pytest.approx(size, abs=within)
        assert abs(found.change[place] - size) < found.deviation[place]


@pytest.mark.slow
def test_what_a_healthy_robot_has_otherwise_is_no_cause(tmp_path: Path) -> None:
    own = {"*": {"strength": 0.9, "friction": 0.4}}
    weak = own | {"RL_calf_joint": {"strength": 0.5, "friction": 0.4}}
    places = [("strength", -1), ("friction", -1), ("strength", CALF), ("delay", -1)]
    healthy, again, ill = (
        motion(tmp_path, joints, seconds=3.0, quick=quick)
        for joints, quick in ((own, 2.0), (own, 2.6), (weak, 2.3))
    )
    with Replays(GO2, Scene(), healthy, 1) as replays:
        limbs = replays.plant.limbs
        reference = Search(healthy, places, limbs, replays, print)
        assert reference.go().change["strength", -1] == pytest.approx(-0.1, abs=0.05)

    def found(it: Motion) -> Found:
        with Replays(GO2, Scene(), it, 1) as replays:
            return Search(it, places, limbs, replays, print, reference).go()

    assert found(again).causes == []
    assert [place for place, _ in found(ill).causes] == [("strength", CALF)]


def test_intervals_cover_and_correlated_windows_do_not_count_twice() -> None:
    """Linear answers with noise that is alike in neighbouring windows: 95 % intervals cover."""
    rng, covered, tries = np.random.default_rng(0), 0, 200
    for _ in range(tries):
        slope = rng.normal(size=(60, 5, 3, 1))
        noise = rng.normal(size=(62, 5, 3))
        left = 0.3 * slope[..., 0] + (noise[:-2] + noise[1:-1] + noise[2:]) / np.sqrt(3.0)
        fitted = Likelihood(left).fit(left, slope, np.ones(1))
        half = 1.96 * float(np.sqrt(fitted.spread[0, 0]))
        covered += abs(float(fitted.size[0]) - 0.3) < half
    assert 0.88 * tries <= covered <= 0.99 * tries


def states(ticks: int = 100) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    joints = dict.fromkeys((*PLACE[:2], *COMMAND_STATES), rng.normal(size=(ticks, 12)))
    base = {"base_quat": np.tile((1.0, 0.0, 0.0, 0.0), (ticks, 1))}
    return joints | base | {"base_pos_w": np.zeros((ticks, 3))}


class Rough:
    """Replays whose answers grow with a size, and jump by it as contacts do."""

    likely, step, base = np.full(2, 0.1), 0.002, dict[Place, float]()

    def __init__(self) -> None:
        self.read_off = dict[Place, int]()
        rng = np.random.default_rng(0)
        self.slope = rng.normal(size=(40, 5, 3))
        self.phase = rng.uniform(0.0, 2.0 * np.pi, (40, 5, 3))
        self.unknown = rng.normal(size=(40, 5, 3, 2))

    def __call__(self, changes: Sequence[Change], begins: Sequence[Float64]) -> list[Float64]:
        return [self._answers(*each) for each in zip(changes, begins)]

    def _answers(self, change: Change, begins: Float64) -> Float64:
        size = change.get(("damping", -1), 0.0)
        jump = 0.05 * np.sin(60.0 * sum(change.values()) + self.phase)
        begun = np.einsum("wlmq,wq->wlm", self.unknown, begins)
        return np.asarray(size * self.slope + jump + begun)

    def derived(self, change: Change, begins: Float64) -> tuple[Float64, Float64]:
        return self._answers(change, begins), self.unknown

    def settle(self, change: Change) -> Float64:
        return np.zeros((40, 2))

    def clip(self, place: Place, size: float) -> float:
        return size


@pytest.mark.parametrize("truth", [0.3, 0.62, -0.9])
def test_a_size_is_found_where_contacts_make_the_likelihood_rough(truth: float) -> None:
    run, place = Rough(), ("damping", -1)
    begins = np.random.default_rng(1).normal(scale=0.05, size=(40, 2))
    real = run._answers({place: truth}, begins)
    windows = Settled(cast(Any, SimpleNamespace(answers=real, sought=False)), run)
    windows.begin()
    for first in (0.5 * truth, 1.4 * truth):
        at, _, _, fitted, log = windows.refined({place: first})
        half = 1.96 * float(fitted.spread[0, 0]) ** 0.5
        assert abs(at[place] - truth) < max(half, 0.01)
        assert half < 0.1
        assert log > max(windows.level({place: 0.5 * truth}))


BIAS = "gyro bias x", -1


class Shaken(Rough):
    """Replays that a gyroscope's bias shakes like a contact; the last channel tells it alone."""

    def __init__(self) -> None:
        super().__init__()
        self.read_off[BIAS] = 2
        self.unknown[:, :, 2] = 0.0

    def _answers(self, change: Change, begins: Float64) -> Float64:
        answers = np.sin(300.0 * sum(change.values()) + self.phase)
        answers[..., 2] = change.get(BIAS, 0.0)
        return np.asarray(answers + np.einsum("wlmq,wq->wlm", self.unknown, begins))


@pytest.mark.parametrize("truth", [0.0, 0.2])
def test_a_bias_that_can_be_read_off_is_not_hidden_by_contacts(truth: float) -> None:
    run = Shaken()
    real = run._answers({}, np.zeros((40, 2)))
    real += np.random.default_rng(2).normal(scale=(0.2, 0.2, 0.3), size=real.shape)
    real[..., 2] += truth
    windows = Settled(cast(Any, SimpleNamespace(answers=real, sought=False)), run)
    windows.begin()
    at, _, _, fitted, log = windows.refined({BIAS: 0.05})
    assert abs(at[BIAS] - truth) < 3.0 * float(fitted.spread[0, 0]) ** 0.5 < 0.1
    gain = log - windows.level({})[1]
    assert gain > 8.0 if truth else gain < 4.0
    windows.begun(at)  # the windows begin without it now, and it is no change beside itself
    again = windows.refined(at)[0]
    assert abs(again[BIAS] - at[BIAS]) < 0.02


def test_windows_leave_out_gaps_falls_and_what_is_not_a_number() -> None:
    usable = np.ones(400, np.bool_)
    usable[50] = False
    given = states(400)
    given["joint_pos"] = given["joint_pos"].copy()
    given["joint_pos"][120, 3] = np.nan
    given["projected_gravity"] = np.tile((0.0, 0.0, -1.0), (400, 1))
    given["projected_gravity"][300:] = (0.0, -1.0, 0.0)
    it = Motion.of(given, 0.02, usable)
    assert it.length == 10
    assert sorted(it.measured) == ["joint_pos", "joint_vel"]  # a base that stands is not measured
    seen: set[int] = set()
    for start in it.starts:
        ticks = set(range(int(start), int(start) + 10))
        assert not (ticks | {int(start) - 1, int(start) + 10}) & {50, 120, 300}
        assert max(ticks) < 300
        assert not ticks & seen
        seen |= ticks
    assert it.answers.shape == (len(it.starts), 10, 12)
    assert np.isfinite(it.answers).all()


def test_too_little_is_one_line() -> None:
    every = np.ones(100, np.bool_)
    with pytest.raises(UniconError, match=r"needs joint_stiffness, which was not recorded"):
        Motion.of({k: v for k, v in states().items() if k != "joint_stiffness"}, 0.02, every)
    with pytest.raises(UniconError, match=r"at least 8 windows of 0\.2 s .* the run has 0"):
        Motion.of(states(9), 0.02, every[:9])
    with pytest.raises(UniconError, match=r"joints move by 0\.000 rad; .* excite"):
        Motion.of({k: 0.0 * v for k, v in states().items()}, 0.02, every)


def test_an_overlay_is_read_as_it_was_found(tmp_path: Path) -> None:
    parameters = (
        Parameter("RL_calf_joint", "strength", 1.0, 0.51234, 0.02),
        Parameter("FR_hip_joint", "delay", 0.0, 0.004, 0.001),
    )
    path = tmp_path / "fitted.yaml"
    path.write_text(overlay_text(GO2, "go2", Fit(parameters, (), 1, 0.1, 1, 0.2, (30, 10)), "real"))
    robot = load_robot(path)
    assert robot.simulated == {
        "RL_calf_joint": {"strength": 0.5123},
        "FR_hip_joint": {"delay": 0.004},
    }
    assert "# 95 %: strength ±0.02\n" in path.read_text()
    again = Fit((), (), 1.0, 1.0, 1.0, 1.0, (30, 10))
    path.write_text(overlay_text(robot, "go2", again, "real.mcap"))
    assert load_robot(path).simulated == robot.simulated  # what was found before stays

"""Each stop trips just beyond its bound, at NaN and not just inside; of a batch, for its robot."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import Fault, WorkflowError
from unicon_core.flow import Stage, Zip, children_of, compile_graph
from unicon_core.flow.fuse import fuse
from unicon_core.robots import load_robot
from unicon_core.states import StateSpec
from unicon_core.states.standard import hardware_states

Build = Callable[..., Any]

GO2 = load_robot("go2")
POLICY = {"observation": StateSpec((3,)), "action": StateSpec((2,))}
BATCH = pytest.mark.parametrize("num_robots", [None, 3])


def still(it):
    """Stand still and level, half a metre high, everything in order."""
    it.stand()
    s = it.states
    s.base_quat, s.projected_gravity = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -1.0)
    s.base_pos_w = (0.0, 0.0, 0.5)
    s.base_lin_acc = (0.0, 0.0, 9.81)
    for name, value in (("motor_temperature", 40.0), ("battery_charge", 0.5)):
        if name in s:
            s[name][...] = value
    if "battery_voltage" in s:
        s.battery_voltage = 28.0
    return it


def made(bench, num_robots=None):
    """A bench with hardware states and those of a policy."""
    more = hardware_states(GO2.joint_names) | POLICY
    return still(bench(GO2, num_robots, states=more))


# block, its options, state, element, a value just inside, one just beyond, what the fault says
EDGES = [
    ("finite", {}, "joint_pos_target", 3, 3e38, np.inf, "joint_pos_target of joint FL_hip"),
    ("finite", {}, "joint_vel_target", 3, -3e38, -np.inf, "joint_vel_target of joint FL_hip"),
    ("finite", {}, "joint_effort_ff", 3, 3e38, np.inf, "joint_effort_ff of joint FL_hip"),
    ("finite", {}, "joint_stiffness", 3, 3e38, np.inf, "joint_stiffness of joint FL_hip"),
    ("finite", {}, "joint_damping", 3, 3e38, np.inf, "joint_damping of joint FL_hip"),
    ("command_stop", {}, "joint_pos_target", 3, 25.1, 25.2, "joint_pos_target of FL_hip"),
    ("command_stop", {"stiffness": 80}, "joint_stiffness", 3, 80.0, 80.1, "joint_stiffness of"),
    ("command_stop", {}, "joint_stiffness", 3, 0.0, -0.01, "joint_stiffness of FL_hip"),
    ("command_stop", {"damping": 5.0}, "joint_damping", 3, 5.0, 5.01, "joint_damping of"),
    ("command_stop", {"factor": 1.0}, "joint_vel_target", 3, 30.1, 30.2, "joint_vel_target of"),
    ("command_stop", {"factor": 1.0}, "joint_effort_ff", 3, -23.7, -23.8, "joint_effort_ff of"),
    ("range_stop", {"margin": 0.1}, "joint_pos", 3, 1.147, 1.149, "joint_pos of FL_hip"),
    ("range_stop", {"factor": 1.1}, "joint_vel", 3, 33.1, 33.2, "joint_vel of FL_hip"),
    ("range_stop", {}, "joint_effort", 3, 1e6, 1.1e6, "joint_effort of FL_hip"),
    ("range_stop", {}, "base_quat", 0, 1.009, 1.011, "base_quat of w"),
    ("range_stop", {}, "base_ang_vel", 1, -69.9, -70.1, "base_ang_vel of y"),
    ("range_stop", {}, "base_lin_acc", 1, 1e6, 1.1e6, "base_lin_acc of y"),
    ("range_stop", {}, "projected_gravity", 2, -1.249, -1.251, "projected_gravity of z"),
    ("velocity_stop", {"factor": 1.0}, "joint_vel", 3, -30.1, -30.2, "FL_hip_joint moves at"),
    ("velocity_stop", {"limit": 2.0}, "joint_vel", 3, 2.0, 2.01, "allowed are 2.00"),
    ("tilt_stop", {"angle": 0.8}, "projected_gravity", 2, -0.697, -0.696, "leans by 0.80"),
    ("height_stop", {"lowest": 0.2}, "base_pos_w", 2, 0.2, 0.19, "base_pos_w of z is 0.19 m"),
    ("height_stop", {"lowest": 0, "highest": 1}, "base_pos_w", 2, 1.0, 1.01, "allowed are 0 to 1"),
    ("hardware_stop", {}, "motor_temperature", 3, 90.0, 90.1, "motor_temperature of FL_hip"),
    ("hardware_stop", {"temperature": 60}, "motor_temperature", 3, 60.0, 60.1, "-40 to 60"),
    ("hardware_stop", {}, "motor_temperature", 3, -40.0, -40.1, "motor_temperature of FL_hip"),
    ("hardware_stop", {}, "battery_charge", None, 0.05, 0.049, "battery_charge is 0.049, allowed"),
    ("hardware_stop", {"voltage": 24.0}, "battery_voltage", None, 24.0, 23.9, "is 23.9 V, allowed"),
    ("action_stop", {"limit": 8.0}, "action", 1, -8.0, -8.01, "action is -8.01, allowed are -8"),
    ("joint_limits", {"beyond": "trip"}, "joint_pos_target", 3, 1.047, 1.0473, "FL_hip_joint is"),
    # what holds where the workflow says nothing
    ("command_stop", {}, "joint_stiffness", 3, 2000.0, 2000.1, "joint_stiffness of FL_hip"),
    ("command_stop", {}, "joint_damping", 3, 200.0, 200.1, "joint_damping of FL_hip"),
    ("command_stop", {}, "joint_vel_target", 3, 60.1, 60.3, "joint_vel_target of FL_hip"),
    ("command_stop", {}, "joint_effort_ff", 3, 47.3, 47.5, "joint_effort_ff of FL_hip"),
    ("range_stop", {}, "joint_pos", 3, -1.547, -1.548, "joint_pos of FL_hip"),
    ("range_stop", {}, "joint_vel", 3, 90.2, 90.4, "joint_vel of FL_hip"),
    ("velocity_stop", {}, "joint_vel", 3, 45.1, 45.2, "FL_hip_joint moves at"),
    ("tilt_stop", {}, "projected_gravity", 2, -0.5405, -0.5400, "leans by 1.00"),
    ("action_stop", {}, "action", 1, 50.0, 50.1, "action is 50.1"),
    ("effort_limits", {"beyond": "trip"}, "joint_effort_ff", 3, 47.3, 47.5, "asked for 47.5"),
    ("rate_limit", {"beyond": "trip"}, "joint_pos_target", 3, 0.701, 0.703, "0.603 rad on in"),
    (
        "joint_limits",
        {"beyond": "trip", "margin": 0.2},
        "joint_pos_target",
        3,
        -0.847,
        -0.848,
        "is sent to -0.848 rad, allowed are -0.847 to 0.847",
    ),
    (
        "effort_limits",
        {"beyond": "trip", "scale": 2.0},
        "joint_effort_ff",
        3,
        47.3,
        47.5,
        "FL_hip_joint is asked for 47.5 N·m by its target, allowed are 47.4",
    ),
    (
        "rate_limit",
        {"beyond": "trip", "max_rate": 5.0},
        "joint_pos_target",
        3,
        0.1999,
        0.201,
        "FL_hip_joint is sent 0.101 rad on in one tick, allowed are 0.100",
    ),
]


@BATCH
@pytest.mark.parametrize("edge", EDGES, ids=lambda edge: f"{edge[0]}-{edge[2]}-{edge[5]}")
def test_it_trips_just_beyond_its_bound_and_at_nan(bench, edge, num_robots):
    name, options, state, element, inside, beyond, said = edge
    for value, trips in ((inside, False), (beyond, True), (np.nan, True)):
        it = made(bench, num_robots)
        block = it.block(name, **options)
        assert block.stage is Stage.SAFETY
        block.tick()
        robot = (-1,) if num_robots else ()
        it.states[state][(*robot, ... if element is None else element)] = value
        before = it.states.snapshot().data
        if not trips:
            block.tick()
            block.tick()
        else:
            with pytest.raises(Fault) as caught:
                block.tick()
            assert str(caught.value).startswith("robot 2" if num_robots else ("", "joint", name)[0])
            if value == beyond:
                assert said in str(caught.value)
        assert it.states.snapshot().data == before, "a stop changes nothing"


def test_hardware_stop_names_a_motor_in_error(bench):
    it = made(bench)
    block = it.block("hardware_stop")
    block.tick()
    it.states.motor_error[4] = 7
    with pytest.raises(Fault, match="motor_error of FL_thigh_joint is 7, allowed are 0 to 0"):
        block.tick()


def test_hardware_stop_needs_a_platform_that_tells_of_it(bench):
    with pytest.raises(WorkflowError, match="tells nothing of motors and battery"):
        bench().block("hardware_stop")


def ticks_until_fault(block, before=lambda: None, limit=60):
    """Tick until a fault; return the number of ticks without one and what it says."""
    for k in range(limit):
        before()
        try:
            block.tick()
        except Fault as fault:
            return k, str(fault)
    return limit, "none"


@BATCH
def test_tracking_stop_waits_for_its_time_out(bench, num_robots):
    it = made(bench, num_robots)
    block = it.block("tracking_stop", bound=0.5, timeout=0.2)
    pos, default = it.states.joint_pos, it.robot.default_joint_pos
    pos[..., :] = default - 0.499  # all of them, each just inside
    for _ in range(50):
        block.tick()
    pos[..., 2] = default[2] - 0.501
    for _ in range(9):
        block.tick()
    pos[..., 2] = default[2]  # a break: it counts anew
    block.tick()
    pos[..., 2] = default[2] - 0.501
    k, fault = ticks_until_fault(block)
    who = "robot 0, " if num_robots else ""
    assert k == 9
    assert fault == (
        f"{who}joint FR_calf_joint does not follow: +0.50 rad from its target for 10 ticks, "
        "allowed are 0.50; is it blocked?"
    )
    block.reset()
    assert ticks_until_fault(block)[0] == 9
    it.states.joint_stiffness = 0.0  # nobody asks it to follow
    block.reset()
    for _ in range(50):
        block.tick()
    it.states.joint_stiffness = 20.0
    pos[..., 2] = np.nan
    assert ticks_until_fault(block)[0] == 9


@BATCH
def test_power_stop_adds_up_work_and_losses(bench, num_robots):
    it = made(bench, num_robots)
    s = it.states
    s.joint_pos, s.joint_damping = s.joint_pos_target, 0.0
    s.joint_effort_ff[..., :2] = 10.0  # N·m
    s.joint_vel[..., 0], s.joint_vel[..., 1] = 4.0, -4.0  # the second brakes: no work
    inside = it.block("power_stop", limit=40.1, timeout=0.06)
    for _ in range(20):
        inside.tick()
    block = it.block("power_stop", limit=39.9, timeout=0.06)
    k, fault = ticks_until_fault(block)
    who = "robot 0: " if num_robots else ""
    assert k == 2
    assert fault == f"{who}the joints would take 40 W for 3 ticks, allowed are 40"
    block.reset()
    assert ticks_until_fault(block)[0] == 2
    block.reset()
    for _ in range(10):  # a break in every third tick: it counts anew
        for speed in (4.0, 4.0, 0.0):
            s.joint_vel[..., 0] = speed
            block.tick()
    s.joint_vel = 0.0  # what is left is lost in two windings: 2 · 0.1 · 10²
    for limit, trips in ((20.1, False), (19.9, True)):
        lossy = it.block("power_stop", limit=limit, loss=0.1, timeout=0.02)
        if trips:
            assert ticks_until_fault(lossy)[0] == 0
        else:
            lossy.tick()
    s.joint_vel = np.nan
    assert ticks_until_fault(inside)[0] == 2


def test_stale_stop_of_a_batch_minds_the_oldest(bench):
    it = made(bench, 3)
    block = it.block("stale_stop", timeout=0.06)
    for k in range(20):
        it.states.stamp_ns = k
        block.tick()
    it.states.stamp_ns[1] = 5
    block.tick()
    it.states.stamp_ns[0] += 1
    assert ticks_until_fault(block)[0] == 2
    block.reset()
    assert ticks_until_fault(block)[0] == 3


def test_encoder_stop_counts_ticks_and_motion(bench):
    it = made(bench)
    timeout, motion = 0.1, 0.1

    def ticks(step: float) -> int:
        """How many ticks of frozen joints pass while the target moves by `step` at each."""
        block = it.block("encoder_stop", timeout=timeout, motion=motion)
        it.stand()
        it.states.joint_pos += 0.01
        block.tick()

        def move() -> None:
            it.states.joint_pos_target[5] += step

        k, fault = ticks_until_fault(block, move, 30)
        assert fault == "none" or "joint FL_calf_joint is stuck" in fault
        return k

    assert ticks(0.2) == 4  # the fifth tick, 0.1 s after it froze
    assert ticks(0.01) in (13, 14)  # 0.1 s after the target is 0.1 rad away
    motion = 3.1
    assert ticks(0.1) == 30  # just inside
    motion, timeout = 0.1, 1.0
    assert ticks(0.1) == 30


def test_a_joint_that_rested_has_no_less_time_to_follow_than_one_that_moves(bench):
    it = made(bench)
    block = it.block("encoder_stop")
    for _ in range(100):
        block.tick()
    for _ in range(4):
        it.states.joint_pos_target[3] += 0.2
        block.tick()
        it.states.joint_pos[5] += 0.01  # the others' noise is none of its business
    it.states.joint_pos[3] += 0.01
    block.tick()
    for _ in range(4):
        it.states.joint_pos_target[3] += 0.2
        block.tick()
    assert ticks_until_fault(block)[0] == 0


@BATCH
def test_encoder_stop_looks_at_each_robot(bench, num_robots):
    it = made(bench, num_robots)
    block = it.block("encoder_stop")
    rng = np.random.default_rng(1)
    stuck = (2, 11) if num_robots else (11,)

    def move() -> None:
        noise = rng.normal(0, 1e-3, it.states.joint_pos.shape)
        noise[stuck] = 0.0
        it.states.joint_pos += noise
        it.states.joint_pos_target[..., 11] += 0.05

    k, fault = ticks_until_fault(block, move)
    assert k < 10
    who = "robot 2, " if num_robots else ""
    assert fault.startswith(f"{who}joint RL_calf_joint is stuck")


def test_a_joint_that_has_followed_is_not_stuck_when_it_rests_beside_one_that_idles(bench):
    it = made(bench)
    block = it.block("encoder_stop")
    block.tick()
    for k in range(40):  # joint 5 follows for 20 ticks and then rests; all others never move
        it.states.joint_pos[5] = it.states.joint_pos_target[5] = -1.0 - 0.02 * min(k, 20)
        block.tick()


def test_imu_stop_lets_noise_pass_and_faults_at_nan(bench):
    it = made(bench)
    block = it.block("imu_stop")
    rng = np.random.default_rng(2)
    for k in range(100):  # still joints would not be enough: they move
        it.states.joint_pos = it.robot.default_joint_pos + 0.3 * np.sin(0.3 * k)
        it.states.base_ang_vel = rng.normal(0, 1e-3, 3)
        block.tick()
    it.states.base_quat[1] = np.nan
    assert ticks_until_fault(block)[0] < 3


def test_imu_stop_trips_at_its_time_out_and_motion(bench):
    for motion, trips in ((0.29, True), (0.31, False)):
        it = made(bench)
        block = it.block("imu_stop", timeout=0.2, motion=motion)
        block.tick()
        block.tick()
        it.states.joint_pos[3] += 0.3
        if trips:
            assert ticks_until_fault(block)[0] == 8  # the tenth tick with the same bits
            block.reset()
        for _ in range(9 if trips else 30):
            block.tick()


def test_time_outs_that_hold_where_the_workflow_says_nothing(bench, monkeypatch):
    it = made(bench)
    s = it.states
    tracking, stale, encoder, imu = (
        it.block(name) for name in ("tracking_stop", "stale_stop", "encoder_stop", "imu_stop")
    )
    power = it.block("power_stop", limit=100.0)
    for block in (stale, encoder, imu):
        block.tick()
    imu.tick()
    s.joint_pos[2] -= 0.99
    for _ in range(60):
        tracking.tick()
    s.joint_pos[2] -= 0.02  # 1.01 rad from its target; and by more than 0.3 from where it was
    assert ticks_until_fault(tracking)[0] == 24  # 0.5 s
    assert ticks_until_fault(stale)[0] == 4  # 0.1 s
    assert ticks_until_fault(imu)[0] == 8  # 0.2 s with the first two
    encoder.tick()  # it has moved
    s.joint_pos_target[2] += 0.11
    assert ticks_until_fault(encoder)[0] == 4  # 0.1 s
    s.joint_effort_ff, s.joint_vel = 20.0, 5.0
    assert ticks_until_fault(power)[0] == 4  # 0.1 s
    clock, overrun = Clock(monkeypatch), it.block("overrun_stop")
    overrun.tick()
    for _ in range(4):
        clock.tick(overrun, 3)
    clock.tick(overrun, 2)
    with pytest.raises(Fault, match="10 ticks were missed within 1 s"):
        clock.tick(overrun, 2)


@pytest.mark.parametrize(("rate", "trips"), [(0.65, False), (0.85, True)])
def test_imu_stop_believes_a_gyroscope_within_its_angle(bench, rate, trips):
    """The base stands still at a rate: within 0.5 s it should have turned by 0.33 or 0.43 rad."""
    it = made(bench)
    it.states.base_ang_vel = (0.0, rate, 0.0)

    def goes_on() -> None:
        it.states.stamp_ns += 20_000_000

    assert (ticks_until_fault(it.block("imu_stop"), goes_on, limit=200)[0] < 200) == trips


@pytest.mark.parametrize(("lean", "trips"), [(0.80, False), (0.86, True)])
def test_imu_stop_compares_quaternion_and_gravity(bench, lean, trips):
    it = made(bench)
    it.states.projected_gravity = (0.0, -np.sin(lean), -np.cos(lean))
    k, fault = ticks_until_fault(it.block("imu_stop"))
    assert (k, "gravity by base_quat" in fault) == ((0, True) if trips else (60, False))


# -- overruns --------------------------------------------------------------------------------------


class Clock:
    """The machine's clock, in ticks of 20 ms."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.now = 1_000_000_000_000
        patch.setattr(
            "unicon_core.blocks.safety.servo_stops.time.perf_counter_ns", lambda: self.now
        )

    def tick(self, block: Any, ticks: float = 1.0) -> None:
        self.now += round(ticks * 20e6)
        block.tick()


def test_overrun_stop_counts_missed_ticks_of_a_window(bench, monkeypatch):
    clock, block = Clock(monkeypatch), made(bench).block("overrun_stop", count=5, window=1.0)
    for _ in range(200):
        clock.tick(block, 1.4)  # late, none missed
    for _ in range(10):  # 4 of each second
        for _ in range(4):
            clock.tick(block, 2)
        for _ in range(44):
            clock.tick(block)
    clock.tick(block, 500)  # a pause that somebody asked for
    for _ in range(2):
        clock.tick(block, 3)  # two missed each
    with pytest.raises(Fault, match="5 ticks were missed within 1 s: the machine does not keep"):
        clock.tick(block, 2)
    block.reset()
    clock.tick(block, 4)
    clock.tick(block, 2)


def test_overrun_stop_leaves_simulators_alone(bench, monkeypatch):
    from types import SimpleNamespace

    from unicon_core.blocks.safety.servo_stops import OverrunStop
    from unicon_core.workflow.autowire import BuildContext

    it, clock = made(bench), Clock(monkeypatch)
    for simulated in (True, False):
        facts = SimpleNamespace(simulated=simulated)
        context = BuildContext(
            it.states,
            it.robot,
            it.period,
            platform=SimpleNamespace(facts=facts),  # type: ignore[arg-type]
        )
        block = SimpleNamespace(tick=OverrunStop(context, count=3))

        def late() -> None:
            clock.now += 60_000_000

        assert ticks_until_fault(block, late)[0] == (60 if simulated else 2)


# -- what a policy sees ----------------------------------------------------------------------------


@BATCH
def test_a_good_run_gives_the_bounds_of_the_next(bench, tmp_path, num_robots):
    it = made(bench, num_robots)
    file = str(tmp_path / "good.npz")
    learn = it.block("observation_range", file=file)
    learn.tick()  # no policy has run yet: zeros do not count
    for value in (1.0, 2.0, np.nan):
        it.states.observation = (value, -value, 5.0)
        learn.tick()
    learn.close()
    with np.load(file) as bounds:
        assert bounds["lower"].tolist() == [1.0, -2.0, 5.0]
        assert bounds["upper"].tolist() == [2.0, -1.0, 5.0]
    it.states.observation = 0.0
    block = it.block("observation_stop", file=file, margin=0.5)
    assert block.stage is Stage.SAFETY
    block.tick()  # no policy has run yet
    for good in ((0.51, -0.51, 5.0), (2.49, -2.49, 5.0)):
        it.states.observation = good
        block.tick()
    for bad in ((0.49, -1, 5), (2.51, -1, 5), (1, -1, 5.01), (np.nan, -1, 5)):
        it.states.observation = bad
        with pytest.raises(Fault, match=r"observation is .*, which no good run has shown"):
            block.tick()
    usual = it.block("observation_stop", file=file)  # half of what lies between
    it.states.observation = (2.49, -1, 5)
    usual.tick()
    it.states.observation = (2.51, -1, 5)
    with pytest.raises(Fault, match="which no good run has shown"):
        usual.tick()
    again = it.block("observation_range", file=file)  # a second run adds to the first
    it.states.observation = (9.0, -1.5, 5.0)
    again.tick()
    again.close()
    with np.load(file) as bounds:
        assert bounds["lower"].tolist() == [1.0, -2.0, 5.0]
        assert bounds["upper"].tolist() == [9.0, -1.0, 5.0]


def test_a_run_without_ticks_writes_no_bounds(bench, tmp_path):
    block = made(bench).block("observation_range", file=str(tmp_path / "none.npz"))
    block.close()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (None, "no such file; write it with observation_range in a good run"),
        (b"garbage", "; write it with observation_range in a good run"),
        ({"lower": np.zeros(3)}, "upper"),
        ({"lower": np.zeros(4), "upper": np.ones(4)}, "4 values and the observation has 3"),
        ({"lower": np.ones(3), "upper": np.zeros(3)}, "its bounds are not finite and in order"),
        ({"lower": np.zeros(3), "upper": np.full(3, np.nan)}, "its bounds are not finite"),
        ({"lower": np.array([None] * 3), "upper": np.zeros(3)}, "Object arrays cannot be loaded"),
    ],
)
def test_a_file_of_bounds_that_does_not_fit_is_refused(bench, tmp_path, values, said):
    file = tmp_path / "bounds.npz"
    if isinstance(values, bytes):
        file.write_bytes(values)
    elif values is not None:
        np.savez(file, **values)
    with pytest.raises(WorkflowError) as caught:
        made(bench).block("observation_stop", file=str(file))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


# -- options ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("block", "options", "said"),
    [
        ("joint_limits", {"beyond": "warn"}, "beyond 'warn' is not known; known: clamp, trip"),
        ("effort_limits", {"beyond": "trip", "scale": 11}, "scale is 11; write a number above 0"),
        ("effort_limits", {"scale": 1.1}, "scale is 1.1; write a number above 0 to 1, or bey"),
        ("tracking_stop", {"bound": np.inf}, "bound is inf; write a number above 0"),
        ("tracking_stop", {"timeout": 0}, "timeout is 0; write a number above 0 to 5 [s]"),
        ("power_stop", {"limit": -1.0}, "limit is -1.0; write a number above 0"),
        ("power_stop", {"limit": 100.0, "loss": -1.0}, "loss is -1.0; write a number from 0"),
        ("height_stop", {"lowest": -1e9}, "lowest is -1000000000.0; write a number above -10000"),
        ("height_stop", {"lowest": 0.5, "highest": 0.2}, "lowest is 0.5; write at most 0.2 [m]"),
        ("overrun_stop", {"count": 0}, "count is 0; write a whole number from 1"),
        ("overrun_stop", {"count": 51}, "count is 51; give 1 to 50, the ticks of window: 1 s"),
        ("overrun_stop", {"window": 1e9}, "window is 1000000000.0; write a number above 0 to 60"),
        ("hardware_stop", {"temperature": 1e6}, "temperature is 1000000.0; write a number above 0"),
        ("hardware_stop", {"charge": -1}, "charge is -1; write a number from 0 to 1"),
        ("hardware_stop", {"voltage": np.nan}, "voltage is nan; write a number"),
        ("action_stop", {"limit": 1e9}, "limit is 1000000000.0; write a number above 0 to 1000"),
        ("observation_stop", {"file": "a.npz", "margin": -1}, "margin is -1; write a number from"),
        ("observation_stop", {"file": "a.txt"}, "file is 'a.txt'; write a path that ends in .npz"),
    ],
)
def test_an_option_that_would_switch_it_off_is_refused(bench, block, options, said):
    with pytest.raises(WorkflowError) as caught:
        made(bench).block(block, **options)
    assert str(caught.value).startswith(f"block {block!r}: {said}")


# -- neighbours that look at ranges are one comparison ---------------------------------------------

FUSED = ("finite", "command_stop", "range_stop", "velocity_stop", "tilt_stop", "joint_limits")


def test_fused_blocks_trip_and_clamp_as_each_does_alone(bench):
    rng, seen = np.random.default_rng(3), set()
    it = made(bench)
    before = it.states.snapshot()
    root = Zip(*(it.block(name) for name in FUSED))
    merged = fuse(root, it.states)
    assert [type(child).__name__ for child in children_of(merged)] == ["Block"]
    alone, together = compile_graph(root), compile_graph(merged)
    names = [name for name in it.states if it.states[name].dtype == np.float32]
    for k in range(600):
        name = names[rng.integers(len(names))]
        index = rng.integers(it.states[name].size)
        value = np.float32(rng.choice([np.nan, np.inf, -0.02, 0.9, 1.3, 17.0, 50.0, 1e5, 3e38]))
        found = []
        for graph in (alone, together):
            it.states.restore(before)
            it.states[name].reshape(-1)[index] = value
            said = ""
            try:
                graph.step()
            except Fault as fault:
                said = str(fault)
            found.append((said, it.states.snapshot().data))
        assert found[0] == found[1], (k, name, index, value)
        left = it.states[name].reshape(-1)[index] == value
        seen.add(said.split(" ")[0] if said else f"passes {name} {not left}")
    assert "passes joint_pos_target True" in seen  # it was clamped
    assert len(seen) > 8


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_command_that_is_not_finite_is_seen_beside_another_look(bench, value):
    it = made(bench)
    graph = compile_graph(fuse(Zip(it.block("finite"), it.block("tilt_stop")), it.states))
    assert "2_fused" in graph.source
    graph.step()
    it.states.joint_effort_ff[7] = value
    with pytest.raises(Fault, match=f"joint_effort_ff of joint RR_thigh_joint is {value}"):
        graph.step()


def test_what_stands_behind_a_clamp_sees_what_it_left(bench):
    it = made(bench)
    blocks = [it.block("joint_limits"), it.block("joint_limits", beyond="trip"), it.block("finite")]
    root = fuse(Zip(*blocks), it.states)
    it.states.joint_pos_target[0] = 9.0
    compile_graph(root).step()
    assert it.states.joint_pos_target[0] == it.robot.upper[0]
    assert [child.name for child in root.children][1:] == ["finite"]  # type: ignore[attr-defined]

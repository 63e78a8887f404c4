"""Facts, resets, seeds, batches, delays and faults: what a simulator owes to those who use it."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest

from unicon_base import Fault, PlatformError
from unicon_core.conformance.rig import STAND, TIMESTEP, Build, Case, Rig
from unicon_core.platforms.platform import SIMULATED, Pushable, Resettable

_NOISE = {"noise": {"joint_pos": 0.01, "base_ang_vel": 0.1}, "push": {"every": 0.03, "velocity": 1}}


class Contract(Case):
    """A platform from outside."""

    def test_it_says_what_it_is(self, rig: Build) -> None:
        it = rig()
        facts = it.platform.facts
        assert facts.simulated
        assert set(facts.writes) == set(SIMULATED)
        assert isinstance(it.platform, Resettable)
        assert isinstance(it.platform, Pushable)
        assert it.info["physics_step_s"] == pytest.approx(TIMESTEP)
        assert it.info["physics_steps_per_tick"] == 10
        assert it.info["model"].endswith("probe.xml")
        assert isinstance(it.info["notes"], list)

    def test_a_base_that_cannot_move_is_not_measured(self, rig: Build) -> None:
        writes = rig(floating=False).platform.facts.writes
        assert "joint_pos" in writes
        assert not {"base_quat", "base_pos_w"} & set(writes)

    def test_nothing_is_left_out_of_a_model_that_has_nothing(self, rig: Build) -> None:
        limited = {"limits"}  # the one thing that the rig's model has
        notes = [note for note in rig().info["notes"] if not limited & set(note.split())]
        assert notes == []

    def test_time_goes_by_ticks(self, rig: Build) -> None:
        stamps = rig(steps=7).run(30)["stamp_ns"]
        assert stamps.tolist() == [7_000_000 * tick for tick in range(31)]

    def test_a_tick_is_whole_physics_steps(self, rig: Build) -> None:
        it, ones = (rig(steps=n).command(joint_effort_ff={"yaw": 0.1}) for n in (7, 1))
        last = it.run(10)["joint_pos"][-1]
        assert ones.run(70)["joint_pos"][-1] == pytest.approx(last, rel=1e-3, abs=1e-5)

    def test_a_reset_begins_anew_to_the_bytes(self, rig: Build) -> None:
        it = rig(initial_height=0.06)
        runs = []
        for _ in range(3):
            runs.append([it.bytes(), *_bytes(it, 30)])
            assert isinstance(it.platform, Resettable)
            it.platform.reset()
            it.platform.recv()
        assert int(it.states.stamp_ns) == 0
        assert runs[0] == runs[1] == runs[2]
        assert runs[0][0] != runs[0][-1]

    def test_a_seed_says_all_and_another_one_otherwise(self, rig: Build) -> None:
        runs = [_bytes(rig(seed=seed, **_NOISE), 10) for seed in (1, 1, 2)]
        assert runs[0] == runs[1]
        assert runs[0][-1] != runs[2][-1]

    def test_two_worlds_do_not_meet(self, rig: Build) -> None:
        alone = _bytes(rig(), 10)
        one, other = rig(), rig()
        other.command(joint_effort_ff=1.0)
        mixed = []
        for _ in range(10):
            mixed += _bytes(one, 1)
            other.run(1)
        assert mixed == alone
        other.close()
        one.run(2)

    def test_robots_of_a_batch_do_not_know_each_other(self, rig: Build) -> None:
        runs = []
        for effort in (0.0, 2.0):
            it = rig(num_robots=2, initial_height=0.06)
            it.command(robot=1, joint_effort_ff=effort)
            runs.append(it.command(robot=0, joint_effort_ff={"yaw": 0.1}).run(30))
        for name in ("joint_pos", "joint_vel", "base_quat", "base_lin_acc", "joint_effort"):
            assert runs[0][name].shape[1] == 2
            assert runs[0][name][:, 0].tobytes() == runs[1][name][:, 0].tobytes()
        apart = np.abs(runs[0]["joint_pos"][-1] - runs[1]["joint_pos"][-1]).max(axis=1)
        assert apart[1] > 0.05

    def test_a_robot_of_a_batch_does_as_it_would_alone(self, rig: Build) -> None:
        rigs = rig(), rig(num_robots=3)
        for it in rigs:
            it.command(joint_pos_target=0.3, joint_stiffness=10.0, joint_damping=0.3)
        one, three = (it.run(20) for it in rigs)
        for name in ("joint_pos", "base_quat", "base_pos_w"):
            for k in range(3):
                assert three[name][:, k] == self.alike(one[name])

    def test_what_is_not_finite_moves_nothing(self, rig: Build) -> None:
        it = rig()
        it.run(3)
        before = it.bytes()
        it.states.joint_pos_target[it.joint("knee")] = np.nan
        with pytest.raises(Fault, match=r"^joint_pos_target of joint knee is nan$"):
            it.platform.send()
        it.platform.recv()
        assert it.bytes() == before

    def test_a_fault_of_a_batch_names_its_robot(self, rig: Build) -> None:
        it = rig(num_robots=3)
        it.states.joint_effort_ff[2, it.joint("yaw")] = np.inf
        with pytest.raises(Fault, match=r"robot 2, joint_effort_ff of joint yaw is inf"):
            it.platform.send()

    def test_commands_come_late_by_the_scenes_delay(self, rig: Build) -> None:
        moved = {}
        for delay in (0, 3):
            it = rig(**STAND, delay=delay)
            it.run(1)
            moved[delay] = it.command(joint_effort_ff={"yaw": 0.1}).run(8).of("joint_vel", "yaw")
        assert np.abs(moved[3][:4]).max() < 1e-6
        assert moved[3][3:] == pytest.approx(moved[0][:-3], rel=0.01, abs=1e-5)

    def test_a_joints_own_delay_is_in_physics_steps(self, rig: Build) -> None:
        speeds = {}
        for delay in (0.0, 0.004):
            it = rig(**STAND, joints={"yaw": {"delay": delay}})
            it.run(1)
            told = it.command(joint_effort_ff={"yaw": 0.1, "right": 0.1}).run(1)
            speeds[delay] = told["joint_vel"][-1]
        yaw, right = map(it.joint, ("yaw", "right"))
        assert speeds[0.004][yaw] == pytest.approx(0.6 * speeds[0.0][yaw], rel=0.02)
        assert speeds[0.004][right] == pytest.approx(speeds[0.0][right], rel=1e-3)

    def test_strength_is_a_factor_on_torque(self, rig: Build) -> None:
        efforts = []
        for strength in (1.0, 0.25):
            joints = {"yaw": {"strength": strength}}
            it = rig(floating=False, steps=1, effort=0.4, joints=joints)
            it.command(joint_pos_target={"yaw": 100.0}, joint_stiffness=100.0)
            efforts.append(it.after(3, "joint_effort", "yaw"))
        assert efforts == pytest.approx([0.4, 0.1], rel=0.01)

    def test_a_push_is_along_the_worlds_axes_and_at_once(self, rig: Build) -> None:
        half = np.sqrt(0.5)
        it = rig(steps=1, model={"quat": f"{half} 0 0 {half}", "gravity": 0.0})  # looks along y
        it.run(1)
        assert isinstance(it.platform, Pushable)
        it.platform.push(np.array((0.5, 0.2)))
        assert it.run(1)["base_lin_vel"][-1] == pytest.approx((0.2, -0.5, 0.0), abs=0.01)

    def test_a_base_that_is_fixed_is_not_pushed(self, rig: Build) -> None:
        it = rig(floating=False)
        before = it.bytes()
        with suppress(PlatformError):  # to refuse it is right too
            it.platform.push(np.array((0.5, 0.2)))  # type: ignore[attr-defined]
        it.platform.recv()
        assert it.bytes() == before

    def test_it_is_closed_twice(self, rig: Build) -> None:
        it = rig()
        it.run(1)
        it.close()
        it.close()
        rig().run(1)


def _bytes(it: Rig, ticks: int) -> list[bytes]:
    """Return all that is measured after each tick."""
    told = []
    for _ in range(ticks):
        it.run(1)
        told.append(it.bytes())
    return told

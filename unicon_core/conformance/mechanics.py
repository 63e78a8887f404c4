"""Names, signs, units, frames, servos and contacts: what a simulator must say of a moving robot."""

from __future__ import annotations

import numpy as np
import pytest

from unicon_base.arrays import Array
from unicon_core.conformance.rig import (
    EFFORT_LIMIT,
    FRICTION,
    IMU_POSITION,
    JOINTS,
    STAND,
    TIMESTEP,
    Build,
    Case,
)
from unicon_core.platforms.kit.base import rotation

KNEE_INERTIA = 0.003 + 0.4 * 0.1**2
"""Of the shank about the knee in [kg·m²], the thigh standing still."""

YAW_INERTIA = 0.003 + 0.5 * 0.1**2
"""Of the mast about its joint in [kg·m²]."""

# Torques in [N·m] with which the box turns about all of its axes.
_TUMBLE = {"left": 2.0, "knee": -1.0, "right": 3.0, "yaw": 1.5}


class Mechanics(Case):
    """A robot in the air, on a stand and on the floor."""

    # Names and order

    def test_joints_begin_where_their_names_say(self, rig: Build) -> None:
        asked = {"left": 0.1, "knee": -0.2, "right": 0.3, "yaw": -0.4}
        for order in (JOINTS, JOINTS[::-1]):
            found = rig(order=order, initial_pose=asked).states.joint_pos.tolist()
            assert dict(zip(order, found)) == pytest.approx(asked, abs=1e-5)

    def test_another_order_of_joints_is_the_same_motion(self, rig: Build) -> None:
        ends = []
        targets = dict(zip(JOINTS, (0.2, 0.1, 0.0, -0.1)))
        gains = dict(zip(JOINTS, (5.0, 8.0, 11.0, 14.0)))
        damping = dict(zip(JOINTS, (0.3, 0.4, 0.5, 0.6)))
        for order in (JOINTS, ("yaw", "left", "right", "knee")):
            it = rig(order=order)
            it.command(joint_pos_target=targets, joint_stiffness=gains, joint_damping=damping)
            told = it.run(20)
            joints = [told.of("joint_pos", name)[-1] for name in JOINTS]
            ends.append([*joints, *told["base_quat"][-1]])
        assert ends[0] == self.alike(ends[1])

    # Signs and units

    @pytest.mark.parametrize("name", JOINTS)
    def test_a_torque_turns_its_own_joint_its_own_way(self, rig: Build, name: str) -> None:
        told = rig(**STAND, steps=1).command(joint_effort_ff={name: 0.2}).run(5)
        speeds = {joint: told.of("joint_vel", joint)[-1] for joint in JOINTS}
        limb = ("left", "knee") if name in ("left", "knee") else (name,)
        assert speeds[name] > 0.01
        assert max(abs(speeds[other]) for other in JOINTS if other not in limb) < 1e-6
        first, *_, last = told.of("joint_pos", name)
        assert last > first

    def test_torque_over_inertia_is_acceleration(self, rig: Build) -> None:
        told = rig(**STAND, steps=1).command(joint_effort_ff={"yaw": 0.1}).run(40)
        speed = told.of("joint_vel", "yaw")[-1]
        assert speed == pytest.approx(0.1 / YAW_INERTIA * 0.040, rel=0.01)
        assert told.of("joint_effort", "yaw")[-1] == pytest.approx(0.1, rel=0.01)

    def test_positions_are_integrals_of_velocities(self, rig: Build) -> None:
        torques = {"left": -1.0, "knee": 0.6, "yaw": 0.05}
        told = rig(floating=False, steps=1).command(joint_effort_ff=torques).run(100)
        steps = np.diff(told["joint_pos"], axis=0)
        between = 0.5 * (told["joint_vel"][1:] + told["joint_vel"][:-1]) * TIMESTEP
        change = np.abs(np.diff(told["joint_vel"], axis=0)).max()
        assert np.abs(steps - between).max() < 0.5 * TIMESTEP * change + 1e-6

    def test_holding_a_limb_takes_its_weight(self, rig: Build) -> None:
        it = rig(floating=False, initial_pose={"left": 0.6, "knee": 0.7})
        at = {name: float(it.states.joint_pos[it.joint(name)]) for name in JOINTS}
        told = it.command(joint_pos_target=at, joint_stiffness=300.0, joint_damping=3.0).run(100)
        left, knee = (told.of("joint_pos", name)[-1] for name in ("left", "knee"))
        shank = -9.81 * 0.4 * 0.1 * np.sin(left + knee)
        thigh = shank - 9.81 * (0.8 * 0.1 + 0.4 * 0.2) * np.sin(left)
        assert told.of("joint_effort", "knee")[-1] == pytest.approx(shank, rel=0.02)
        assert told.of("joint_effort", "left")[-1] == pytest.approx(thigh, rel=0.02)

    # Base and IMU

    def test_it_falls_with_g(self, rig: Build) -> None:
        told = rig().run(20)  # 0.2 s, one meter and more above the floor
        fallen = np.diff(told["base_pos_w"][:, 2], 2) / 0.01**2
        assert fallen == pytest.approx(-9.81, rel=0.005)
        assert np.abs(told["base_lin_acc"][2:]).max() < 0.05
        assert told["base_lin_vel"][-1] == pytest.approx((0.0, 0.0, -9.81 * 0.2), abs=0.015)

    def test_gravity_is_the_models(self, rig: Build) -> None:
        told = rig(model={"gravity": -3.7}).run(20)
        assert told["base_lin_vel"][-1][2] == pytest.approx(-3.7 * 0.2, abs=0.01)
        assert told["projected_gravity"][-1] == pytest.approx((0.0, 0.0, -1.0), abs=1e-3)

    def test_at_rest_an_imu_feels_the_floor(self, rig: Build) -> None:
        told = rig(initial_height=0.0505).command(joint_stiffness=50.0, joint_damping=2.0).run(60)
        felt = told["base_lin_acc"][30:]
        assert felt.mean(axis=0) == pytest.approx((0.0, 0.0, 9.81), abs=0.15)
        assert told["base_pos_w"][-1][2] == pytest.approx(0.05, abs=0.005)
        assert np.abs(told["base_lin_vel"][-10:]).max() < 0.02

    def test_the_base_begins_turned_as_the_model_says(self, rig: Build) -> None:
        half = np.sqrt(0.5)
        told = rig(model={"quat": f"{half} 0 {half} 0", "height": 1.5}).run(0)  # x points down
        assert told["base_quat"][0] == pytest.approx((half, 0.0, half, 0.0), abs=1e-5)
        assert told["base_pos_w"][0] == pytest.approx((0.0, 0.0, 1.5), abs=1e-4)
        assert told["projected_gravity"][0] == pytest.approx((1.0, 0.0, 0.0), abs=1e-5)

    def test_the_bases_velocity_is_that_of_its_origin_in_its_own_frame(self, rig: Build) -> None:
        told = self._tumbling(rig)
        world = np.diff(told["base_pos_w"], axis=0) / TIMESTEP
        here = np.einsum("nij,nj->ni", rotation(told["base_quat"]), told["base_lin_vel"])
        assert _apart(world, here) < 0.01

    def test_the_bases_rate_is_in_its_own_frame(self, rig: Build) -> None:
        told = self._tumbling(rig)
        quats = rotation(told["base_quat"])
        turned = np.einsum("nji,njk->nik", quats[:-1], quats[1:])
        rates = (
            np.array((turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]))
            - np.array((turned[:, 1, 2], turned[:, 2, 0], turned[:, 0, 1]))
        ).T / (2 * TIMESTEP)
        assert np.abs(told["base_ang_vel"]).max(axis=0).min() > 0.05  # about every axis
        assert _apart(rates, told["base_ang_vel"]) < 0.01

    def test_an_imu_feels_what_its_own_place_does(self, rig: Build) -> None:
        told = self._tumbling(rig)
        turned = rotation(told["base_quat"])
        around = np.cross(told["base_ang_vel"], IMU_POSITION)
        velocity = np.einsum("nij,nj->ni", turned, told["base_lin_vel"] + around)
        world = np.diff(velocity, axis=0) / TIMESTEP + (0.0, 0.0, 9.81)
        felt = np.einsum("nij,nj->ni", turned, told["base_lin_acc"])
        assert np.abs(felt).max() > 2.0
        assert _apart(felt[1:-1], world) < 0.02  # over the last physics step, or of this moment

    def test_gravity_is_projected_into_the_base(self, rig: Build) -> None:
        told = self._tumbling(rig)
        down = -rotation(told["base_quat"])[:, 2]
        assert told["projected_gravity"] == pytest.approx(down, abs=1e-4)
        assert np.linalg.norm(told["base_quat"], axis=1) == pytest.approx(1.0, abs=1e-4)

    def _tumbling(self, rig: Build) -> dict[str, Array]:
        """Return what is measured at each physics step of a box that turns about all axes."""
        it = rig(steps=1, model={"height": 5.0}).command(joint_effort_ff=_TUMBLE)
        it.run(60)
        return it.command(joint_damping=0.3).run(60)

    # Servo

    def test_every_motor_follows_the_servos_equation(self, rig: Build) -> None:
        it = rig(floating=False, steps=1)
        gains, damping = np.array((8.0, 4.0, 6.0, 5.0)), np.array((0.2, 0.1, 0.3, 0.15))
        target, velocity = np.array((0.3, -0.4, 0.2, -0.5)), np.array((0.5, -1.0, 0.2, 1.0))
        feed = np.array((0.4, -0.1, 0.2, 0.05))
        it.states.joint_pos_target, it.states.joint_vel_target = target, velocity
        it.states.joint_effort_ff = feed
        it.states.joint_stiffness, it.states.joint_damping = gains, damping
        told = it.run(80)
        asked = gains * (target - told["joint_pos"]) + damping * (velocity - told["joint_vel"])
        torque = np.clip(asked + feed, -EFFORT_LIMIT, EFFORT_LIMIT)
        middle = 0.5 * (torque[1:] + torque[:-1])  # before the step, or after it
        wide = 0.5 * np.abs(torque[1:] - torque[:-1])
        assert (
            np.abs(told["joint_effort"][1:] - middle) <= wide + 0.01 * np.abs(torque).max()
        ).all()

    def test_the_servo_acts_at_each_physics_step(self, rig: Build) -> None:
        ends = []
        for steps in (1, 20):
            it = rig(steps=steps)
            it.command(joint_pos_target=0.4, joint_stiffness=15.0, joint_damping=0.4)
            ends.append(it.run(200 // steps)["joint_pos"][-1])
        assert ends[0] == self.alike(ends[1], 20.0)

    def test_torques_stay_within_the_limits_of_effort(self, rig: Build) -> None:
        it = rig(**STAND, steps=1, effort=0.5)
        told = it.command(joint_pos_target={"yaw": 100.0}, joint_stiffness=1000.0).run(10)
        assert told.of("joint_effort", "yaw")[1:] == pytest.approx(0.5, rel=1e-3)
        speed = told.of("joint_vel", "yaw")[-1]
        assert speed == pytest.approx(0.5 / YAW_INERTIA * 0.010, rel=0.02)

    def test_the_models_motor_may_be_weaker(self, rig: Build) -> None:
        model = {"gravity": 0.0, "motor": 'ctrlrange="-0.3 0.2"'}
        it = rig(floating=False, steps=1, model=model)
        for target, torque in ((100.0, 0.2), (-100.0, -0.3)):
            it.command(joint_pos_target={"yaw": target}, joint_stiffness=1000.0)
            assert it.after(3, "joint_effort", "yaw") == pytest.approx(torque, rel=1e-3)

    def test_a_velocity_is_followed_by_damping_alone(self, rig: Build) -> None:
        it = rig(**STAND).command(joint_vel_target={"yaw": 2.0}, joint_damping={"yaw": 1.0})
        assert it.after(20, "joint_vel", "yaw") == pytest.approx(2.0, rel=0.02)

    # Joints and contacts as the model has them

    def test_passive_damping_acts_if_kept(self, rig: Build) -> None:
        speeds = {}
        for word in ("keep", "replace"):
            model = {"gravity": 0.0, "joint": 'damping="0.05"'}
            it = rig(floating=False, model=model, options={"passive": word})
            speeds[word] = it.command(joint_effort_ff={"yaw": 0.1}).after(10, "joint_vel", "yaw")
        kept = 0.1 / 0.05 * (1.0 - np.exp(-0.1 / (YAW_INERTIA / 0.05)))
        assert speeds["keep"] == pytest.approx(kept, rel=0.02)
        assert speeds["replace"] == pytest.approx(0.1 / YAW_INERTIA * 0.1, rel=0.01)

    def test_dry_friction_holds_and_brakes(self, rig: Build) -> None:
        joints = {"yaw": {"friction": 0.06}, "knee": {"friction": 0.3}}
        it = rig(**STAND, joints=joints).command(joint_effort_ff={"yaw": 0.1, "knee": 0.2})
        told = it.run(10)
        yaw, knee = (told.of("joint_vel", name)[-1] for name in ("yaw", "knee"))
        assert yaw == pytest.approx(0.04 / YAW_INERTIA * 0.1, rel=0.06)
        assert abs(knee) < 0.05 * 0.2 / KNEE_INERTIA * 0.1

    def test_armature_is_inertia_or_left_out_with_a_note(self, rig: Build) -> None:
        it = rig(floating=False, model={"gravity": 0.0, "joint": 'armature="0.008"'})
        speed = it.command(joint_effort_ff={"yaw": 0.1}).after(10, "joint_vel", "yaw")
        noted = any("armature" in note for note in it.platform.facts.notes)
        whole = YAW_INERTIA + 0.008 * (not noted)
        assert speed == pytest.approx(0.1 / whole * 0.1, rel=0.01)
        assert any("armature" in note for note in it.info["notes"]) == noted

    def test_joints_stop_at_their_limits(self, rig: Build) -> None:
        it = rig(floating=False, model={"gravity": 0.0, "lower": -0.3, "upper": 0.3})
        it.command(joint_effort_ff={"yaw": 0.1}, joint_damping=0.02)
        assert 0.25 < it.after(100, "joint_pos", "yaw") < 0.35

    def test_a_box_slides_as_far_as_its_friction_lets_it(self, rig: Build) -> None:
        it = rig(initial_height=0.0502).command(joint_stiffness=50.0, joint_damping=2.0)
        it.run(20)
        start = np.array(it.states.base_pos_w)
        it.platform.push(np.array((0.6, 0.8)))  # type: ignore[attr-defined]
        end = it.run(80)["base_pos_w"][-1]
        distance = 1.0 / (2 * FRICTION * 9.81)
        assert np.hypot(*(end - start)[:2]) == pytest.approx(distance, rel=0.2)
        assert end[1] - start[1] == pytest.approx(0.8 * distance, rel=0.3)


def _apart(differences: Array, values: Array) -> float:
    """Return how far differences between rows are from the values at both ends, relative."""
    low = np.minimum(values[1:], values[:-1])
    high = np.maximum(values[1:], values[:-1])
    off = np.maximum(np.maximum(low - differences, differences - high), 0.0)
    return float(off.max() / np.abs(values).max())

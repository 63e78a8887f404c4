"""The plant: what may differ between a robot and its simulator, and replays with a difference.

A difference is a `Change`: places of parameters to their change from the simulator's own value. A
replay begins each window where the robot was measured and repeats the recorded commands.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from unicon_base.arrays import Array, Float64, Int64
from unicon_base.errors import Fault, ModelError
from unicon_core.models.feet import Feet
from unicon_core.models.frames import multiply, turned_by
from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.models.posed import PosedModel
from unicon_core.platforms.kit.base import rotation
from unicon_core.platforms.kit.disturbances import Beside
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import Robot
from unicon_core.robots.load import joint_physics
from unicon_lab.diagnose.motion import Motion, gravity_xy


@dataclass(frozen=True)
class Kind:
    """One kind of parameter.

    Attributes:
        unit: of a change; "" for a factor.
        step: by which a derivative is taken.
        usual: standard deviation of the change, beforehand.
        least: smallest change that matters: below it a cause is not reported.
        low, high: bounds of the change.
        odds: how often it is the cause, beside others; shared by its joints.
        each: of a joint, not of the whole robot alone.
        bias: standard deviation of what noise at the beginning of windows biases a size, as a part
            of it; measured with walks of a Go2 whose joint velocities had 0.2 rad/s of noise. The
            height of a centre of mass came out 17 % too low or 41 % too high in PyBullet.
        stepped: the simulator rounds it to its steps.
        far: a larger step, both ways: of a large error in what a window begins with, a derivative
            says nothing, since feet that stood are in the ground or in the air.
        remedy: what to change, with `{size}`, `{after}` and `{joint}`.
    """

    unit: str
    step: float
    usual: float
    least: float
    low: float
    high: float
    odds: float
    each: bool = False
    remedy: str = ""
    bias: float = 0.01
    stepped: bool = False
    far: float = 0.0


_PAYLOAD = "scene: {{payload: {{mass: {size:.3g}}}}}"
_GROUND = "scene: {{contact_friction: {after:.3g}}}"
_SLOPE = "scene: {{terrain: {{slope: {{angle: {size:.3g}}}}}}}"


def _joint(word: str) -> str:
    return f'simulated: {{{{"{{joint}}": {{{{{word}: {{after:.4g}}}}}}}}}}'


KINDS = {
    "delay": Kind("s", 0.01, 0.01, 0.002, 0.0, 0.1, 4.0, True, _joint("delay"), stepped=True),
    "strength": Kind("", -0.2, 0.3, 0.03, -0.95, 1.5, 2.0, True, _joint("strength"), bias=0.02),
    "friction": Kind("N·m", 0.5, 1.0, 0.1, -20.0, 20.0, 2.0, True, _joint("friction"), bias=0.04),
    "viscous friction": Kind("N·m·s/rad", 0.4, 1.0, 0.05, -5.0, 20.0, 1.0, True, bias=0.05),
    "armature": Kind(
        "kg·m²", 0.016, 0.02, 0.003, -0.5, 0.5, 1.0, True, _joint("armature"), bias=0.035
    ),
    "encoder offset": Kind("rad", 0.04, 0.05, 0.01, -0.5, 0.5, 2.0, True, far=0.2),
    "weakening": Kind("1/min", -0.2, 0.5, 0.15, -3.0, 3.0, 0.5, True),
    "torque limit": Kind("", -0.2, 0.3, 0.1, -0.95, 1.0, 1.0, True),
    "payload": Kind("kg", 2.0, 3.0, 0.3, -50.0, 100.0, 4.0, False, _PAYLOAD, bias=0.02),
    "centre of mass x": Kind("kg·m", 0.2, 0.3, 0.03, -20.0, 20.0, 1.0),
    "centre of mass y": Kind("kg·m", 0.2, 0.3, 0.03, -20.0, 20.0, 1.0),
    "centre of mass z": Kind("kg·m", 0.4, 0.3, 0.1, -20.0, 20.0, 0.5, bias=0.15),
    "inertia": Kind("", 0.5, 0.5, 0.2, -0.9, 20.0, 0.5),
    "ground friction": Kind("", -0.3, 0.5, 0.15, -0.97, 4.0, 2.0, False, _GROUND, 0.02),
    "stiffness": Kind("", 0.15, 0.3, 0.05, -0.95, 5.0, 1.0, bias=0.03),
    "damping": Kind("", 0.3, 0.5, 0.1, -0.95, 10.0, 1.0, bias=0.03),
    "gyro bias x": Kind("rad/s", 0.05, 0.05, 0.01, -1.0, 1.0, 0.7),
    "gyro bias y": Kind("rad/s", 0.05, 0.05, 0.01, -1.0, 1.0, 0.7),
    "gyro bias z": Kind("rad/s", 0.05, 0.05, 0.01, -1.0, 1.0, 0.7, far=0.4),
    "IMU latency": Kind("s", 0.01, 0.01, 0.003, 0.0, 0.1, 1.0),
    "attitude x": Kind("rad", 0.04, 0.03, 0.005, -0.5, 0.5, 0.7, far=0.15),
    "attitude y": Kind("rad", 0.04, 0.03, 0.005, -0.5, 0.5, 0.7, far=0.15),
    "slope x": Kind("", 0.04, 0.05, 0.01, -0.5, 0.5, 0.5, False, _SLOPE),
    "slope y": Kind("", 0.04, 0.05, 0.01, -0.5, 0.5, 0.5),
}
"""What may differ. Weakening is the loss of strength from the middle of a record on. Attitude is
that of the IMU on its base. Slope is how much the ground rises along an axis of the world.
Steps and bounds are ours, chosen for robots of 10 to 80 kg."""

OF_BASE = tuple(
    name for name in KINDS if name[:4] in ("payl", "cent", "iner", "gyro", "atti", "IMU ", "slop")
)

MOTION = {
    **dict.fromkeys(("friction", "viscous friction"), "drop"),
    **dict.fromkeys(("ground friction", *OF_BASE), "sway"),
    **{name: "rest" for name in KINDS if name[:4] in ("gyro", "atti")},
}
"""The motion of `MOTIONS` that shows a kind best; a wiggle shows all others."""

Place = tuple[str, int]
"""A kind, and the joint's number; -1 for the whole robot, or all joints by the same."""

Change = Mapping[Place, float]

TOGETHER = 0.3
"""Part of a kind's step by which all joints are moved at once: contacts resist a larger one."""


def step_of(place: Place) -> float:
    """Return the step by which a derivative by a place is taken, in the unit of its kind."""
    kind = KINDS[place[0]]
    return kind.step * (TOGETHER if kind.each and place[1] < 0 else 1.0)


AROUND = 3
"""Ticks before and behind the first one of a window, over which `Plant.carried` is a median."""
LEVEL = 0.03
"""Distance in [m] of the lowest foot from the simulator's ground, from which on the height of the
base counts as not measured: the robot stood on other ground."""
SURE = 4.0
"""Standard errors from which on turn rate and heading disagree."""
_LOST = np.pi
"""Error in [rad] that stands for physics that blew up."""


class Plant:
    """A simulator that can be changed, for replays.

    Args:
        robot: that is simulated.
        scene: its model and what its joints are like before any change.
        motion: that is replayed.
    """

    def __init__(self, robot: Robot, scene: Scene, motion: Motion) -> None:
        from unicon_core.platforms.mujoco import make

        self._robot, self._scene, self._motion = robot, scene, motion
        self._beside = Beside(make, robot, motion.period, scene)
        platform: Any = self._beside.platform
        self._platform = platform
        self.base = platform.robots[0].loaded.base
        model, dofs = platform.model, platform.robots[0].loaded.dofs
        self.step = float(model.opt.timestep)
        physics = joint_physics(robot, scene.joints)
        self.own = {
            "strength": np.nan_to_num(physics.strength, nan=1.0),
            "delay": np.nan_to_num(physics.delay),
            "friction": np.array(model.dof_frictionloss[dofs]),
            "armature": np.array(model.dof_armature[dofs]),
        }
        """What the simulator has of each joint without a change, shape (n,)."""
        self.limbs = _limbs(platform.robots[0].loaded)
        """The limb that each joint belongs to, shape (n,)."""
        feet = _feet(platform.robots[0].loaded, robot) if motion.sought else None
        self.carried = np.zeros((len(motion.starts), 3)) if feet is None else self._carried(feet)
        """The base's velocity in its frame where windows begin, by its feet; zeros without."""
        sent = [values.reshape(len(values), -1) for values in motion.commands.values()]
        self._finite = np.isfinite(np.concatenate(sent, axis=1)).all(axis=1)
        self._ahead = 1
        self._offset = np.zeros(robot.num_joints)
        self._sent = {**motion.commands}
        self._bias, self._tilt, self._late = np.zeros(3), np.zeros(3), 0.0
        self._apart = np.array([1.0, 1.0, motion.has_base and _disagrees(motion.answers[..., -1])])
        told = zip("xyz", (-3, -2, -1), self._apart * motion.has_base)
        self.read_off = {(f"gyro bias {axis}", -1): channel for axis, channel, is_told in told
                         if is_told}  # fmt: skip
        """Changes that the record tells without a replay, to the channel of the answers that does:
        that of the turn rate above that of the attitude."""
        self._slope = np.zeros(3)
        self._gravity = np.array(model.opt.gravity)
        self._measured = dict(motion.measured)
        if motion.has_base and "base_pos_w" in self._measured and not self._level():
            del self._measured["base_pos_w"]

    def replayed(self, change: Change, begins: Float64) -> Float64:
        """Return the answers of a motion's windows with a change; see `Motion.answers`.

        Args:
            change: of the plant.
            begins: errors of what each window begins with: of the joints' velocities [rad/s], and
                where the base was measured, of its velocity in its frame [m/s] and of its height
                [m]; shape (w, n) or (w, n + 4). A window of NaN is left out: its answers are NaN.
        """
        self._apply(change)
        motion, base = self._motion, self._motion.has_base
        found = np.empty_like(motion.answers)
        states = self._beside.states
        for window, start in enumerate(motion.starts):
            if np.isnan(begins[window, 0]):
                found[window] = np.nan
                continue
            try:
                put = self._put(window, begins[window])
                for row in range(start - self._ahead, start):  # commands on their way
                    there = row >= 0 and self._finite[row]
                    self._beside.step(self._commands(row if there else start - 1))
                self._beside.put(put)
                for tick in range(motion.length):
                    row = found[window, tick]
                    n = len(self._offset)
                    row[:n] = self._beside.step(self._commands(start + tick)) + self._offset
                    if base:
                        late = states["base_ang_vel"] * self._late
                        quat = self._tilted(states["base_quat"], self._tilt - late, 1.0)
                        row[n : n + 2] = gravity_xy(quat)
                        row[n + 2 : n + 5] = states["base_ang_vel"] @ self._mount + self._bias
                        row[n + 5 :] = self._bias * self._apart
            except Fault:
                found[window] = motion.answers[window] + _LOST
                self._platform.reset()
        return found

    def close(self) -> None:
        """Let go of the simulator."""
        self._beside.close()

    def _carried(self, feet: Feet) -> Float64:
        """Return the base's velocity in its frame by its lowest foot, shape (w, 3), in [m/s].

        That foot is taken to stand still; of ticks around a window's first the median counts.
        """
        found = np.zeros((len(self._motion.starts), 3))
        for row, start in zip(found, self._motion.starts):
            velocities = []
            for tick in range(max(start - AROUND, 0), start + AROUND + 1):
                at = {name: values[tick] for name, values in self._motion.measured.items()}
                turning, joints = (at["base_quat"], at["base_ang_vel"]), at["joint_pos"]
                if feet(*turning, joints, at["joint_vel"], None):
                    velocities.append(-feet.velocity[feet.position[:, 2].argmin()])
            if velocities:
                velocity = np.median(velocities, axis=0)
                row[:] = velocity @ rotation(self._motion.measured["base_quat"][start])
        return found

    def _put(self, window: int, begin: Float64) -> dict[str, Array]:
        """Put the robot where a window begins, and return what was put there."""
        start = self._motion.starts[window]
        put = {name: values[start] for name, values in self._measured.items()}
        put["joint_pos"] = put["joint_pos"] - self._offset
        put["joint_vel"] = put["joint_vel"] - begin[: len(self._offset)]
        if "base_ang_vel" in put:
            put["base_ang_vel"] = self._mount @ (put["base_ang_vel"] - self._bias)
        if "base_quat" in put:
            late = put["base_ang_vel"] * self._late if "base_ang_vel" in put else 0.0
            put["base_quat"] = self._tilted(put["base_quat"], late - self._tilt, -1.0)
        if not self._motion.has_base:
            self._beside.put(put)
            return put
        put["base_lin_vel"] = put.get("base_lin_vel", self.carried[window]) - begin[-4:-1]
        self._beside.put(put)
        base = self._platform.data.qpos[self._platform.model.jnt_qposadr[self.base] :][:3]
        put["base_pos_w"] = base - (0.0, 0.0, begin[-1])
        self._beside.put(put)
        return put

    def _level(self) -> bool:
        """Whether the measured base stands on the simulator's ground where windows begin."""
        posed, found = PosedModel(self._platform.robots[0].loaded), list[float]()
        for start in self._motion.starts:
            at = {name: values[start] for name, values in self._measured.items()}
            posed.put(at["joint_pos"], np.concatenate([at["base_pos_w"], at["base_quat"]]))
            found.append(min(posed.heights().values(), default=0.0))
        return bool(np.median(np.abs(found)) < LEVEL)

    def _tilted(self, quat: Array, angles: Float64, sense: float) -> Float64:
        """Return an attitude turned about its own axes, and with the ground or against it (−1)."""
        if self._slope.any():
            angles = angles + sense * (self._slope @ rotation(quat))
        return _turned(quat, angles)

    def _commands(self, row: int) -> dict[str, Array]:
        return {name: values[row] for name, values in self._sent.items()}

    def _apply(self, change: Change) -> None:
        names, n = self._robot.joint_names, self._robot.num_joints
        sums = {kind: np.zeros(n) for kind in KINDS}
        for (kind, joint), size in change.items():
            sums[kind][slice(None) if joint < 0 else joint] += size
        for kind, values in sums.items():
            np.clip(values, KINDS[kind].low, KINDS[kind].high, out=values)
        whole = {kind: float(values[0]) for kind, values in sums.items() if not KINDS[kind].each}
        joints: dict[str, dict[str, float]] = {}
        for word, own in self.own.items():
            least = 0.01 if word == "strength" else 1e-5 if word == "armature" else 0.0
            for i in np.flatnonzero(sums[word]):
                joints.setdefault(names[i], {})[word] = max(float(own[i] + sums[word][i]), least)
        scene = replace(
            self._scene,
            joints={**self._scene.joints, **_merged(self._scene.joints, joints)},
            contact_friction=self._scene.contact_friction
            * max(1.0 + whole["ground friction"], 0.0),
        )
        self._platform.change(scene)
        model, dofs = self._platform.model, self._platform.robots[0].loaded.dofs
        model.dof_damping[dofs] = np.maximum(model.dof_damping[dofs] + sums["viscous friction"], 0)
        limits = 1.0 + sums["torque limit"]
        model.actuator_forcerange[self._platform.servo.actuators] *= limits[:, None]
        self._late = whole["IMU latency"]
        delay = float((self.own["delay"] + sums["delay"]).max())
        self._ahead = 1 + int(delay / self._motion.period)
        self._offset = sums["encoder offset"]
        sent = self._sent = {**self._motion.commands}
        minutes = np.arange(len(self._finite)) - self._motion.starts.mean()
        minutes = minutes[:, None] * self._motion.period / 60.0
        strength = np.maximum(1.0 + sums["weakening"] * minutes, 0.0)
        sent["joint_pos_target"] = sent["joint_pos_target"] - self._offset
        for word, factor in (
            ("joint_stiffness", 1.0 + whole["stiffness"]),
            ("joint_damping", 1.0 + whole["damping"]),
            ("joint_effort_ff", 1.0),
        ):
            sent[word] = sent[word] * factor * strength
        self._bias = np.array([whole[f"gyro bias {axis}"] for axis in "xyz"])
        self._tilt = np.array([whole["attitude x"], whole["attitude y"], 0.0])
        self._mount = rotation(_turned(np.array([1.0, 0.0, 0.0, 0.0]), self._tilt))
        # Rotation of the ground, and gravity as it is seen from there.
        self._slope = np.array([whole["slope y"], -whole["slope x"], 0.0])
        model.opt.gravity[:] = self._gravity + np.cross(self._gravity, self._slope)
        moment = np.array([whole[f"centre of mass {axis}"] for axis in "xyz"])
        if self.base is not None and (whole["payload"] or whole["inertia"] or moment.any()):
            self._weigh(model, whole["payload"], moment, 1.0 + whole["inertia"])

    def _weigh(self, model: Any, payload: float, moment: Float64, inertia: float) -> None:
        """Change the base's mass [kg], first moment [kg·m] and inertia (a factor)."""
        body = int(model.jnt_bodyid[self.base])
        mass = max(float(model.body_mass[body]) + payload, 0.1)
        model.body_mass[body] = mass
        model.body_ipos[body] += moment / mass
        model.body_inertia[body] *= inertia
        mujoco = import_mujoco()
        mujoco.mj_setConst(model, mujoco.MjData(model))


def _disagrees(rate: Float64) -> bool:
    """Whether a gyroscope's turn rate above that of the heading [rad/s], shape (w, l), is no noise.

    A heading that an IMU integrates from its gyroscope agrees whatever the bias is.
    """
    windows = rate.mean(axis=1)
    return bool(abs(windows.mean()) > SURE * windows.std() / np.sqrt(len(windows)))


def _feet(loaded: LoadedModel, robot: Robot) -> Feet | None:
    try:
        return Feet(loaded, robot)
    except ModelError:  # it names none
        return None


def _limbs(loaded: LoadedModel) -> Int64:
    model = loaded.model
    root = 0 if loaded.base is None else int(model.jnt_bodyid[loaded.base])
    found = []
    for joint in loaded.joints:
        body = int(model.jnt_bodyid[joint])
        while int(model.body_parentid[body]) not in (root, 0):
            body = int(model.body_parentid[body])
        found.append(body)
    return np.array(found)


def _merged(
    given: Mapping[str, Mapping[str, float]], changed: Mapping[str, Mapping[str, float]]
) -> dict[str, Mapping[str, float]]:
    return {name: {**given.get(name, {}), **words} for name, words in changed.items()}


def _turned(quat: Array, angles: Float64) -> Float64:
    """Return an attitude (wxyz) turned by an axis times an angle [rad] in its own frame."""
    if not angles.any():
        return np.asarray(quat, np.float64)
    turn = turned_by((1.0, 0.0, 0.0, 0.0), angles.tolist(), 1.0)
    return np.array(multiply(np.asarray(quat, np.float64).tolist(), turn))

"""Motion files: BeyondMimic's and mjlab's `.npz`, and retargeted `.csv`, brought to one form.

From HybridRobotics/whole_body_tracking `scripts/csv_to_npz.py` and unitreerobotics/unitree_rl_mjlab
`scripts/csv_to_npz.py`: the `.npz` has `fps` (one number), `joint_pos`, `joint_vel` (frames, n) in
the simulator's joint order, and `body_pos_w`, `body_quat_w` (wxyz), `body_lin_vel_w`,
`body_ang_vel_w` (frames, bodies, …) with the base first; it names neither joints nor bodies. A
`.csv` row is the base's position [m], its quaternion **xyzw** and the joints [rad], without a head;
between frames positions are interpolated, then differentiated.
"""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from unicon_base import PolicyError, alternatives, one_line
from unicon_base.arrays import Float32, Float64
from unicon_core.models.frames import Floats, multiply, plus, rotate, towards, turned
from unicon_core.models.kinematic_tree import BASE, frame_of, read_tree
from unicon_core.models.load import load_model
from unicon_core.policies.contract import PolicyContract
from unicon_core.policies.hints import AXES, MotionSpec
from unicon_core.robots import Robot

MOST_BYTES = 1 << 30
"""Most that a motion file may hold: a day of a humanoid at 50 Hz is less."""
_LARGE = "{}: it holds more than 1 GiB; cut the motion"
MOST_FRAMES = 1_000_000
NEAR, TURNED = 0.03, 0.1
"""How far forward kinematics may put the anchor from where the file has it, in [m] and [rad]."""


@dataclass(frozen=True)
class Step:
    """A link on the way from base to anchor: where it stands, and what its joint does to it.

    Attributes:
        position: in the parent's frame in [m].
        quat: link to parent at joint position 0, wxyz.
        index: of its joint in the robot's order, -1 where it is fixed.
        axis: unit vector in the link's frame.
        sliding: moves along the axis and does not turn about it.
    """

    position: Floats = (0.0, 0.0, 0.0)
    quat: Floats = (1.0, 0.0, 0.0, 0.0)
    index: int = -1
    axis: Floats = AXES["z"]
    sliding: bool = False


@dataclass(frozen=True)
class Chain:
    """The way from the base to the body by which motions are compared: forward kinematics.

    A humanoid measures the orientation of its pelvis, and motions are compared by the torso: three
    joints are between.

    Attributes:
        steps: from the base outwards; empty where the base itself is meant.
        placed: whether positions are known; of axes alone they are not.
    """

    steps: tuple[Step, ...]
    placed: bool = True

    def __call__(
        self, position: Floats, quat: Floats, joints: Sequence[float]
    ) -> tuple[Floats, Floats]:
        """Return where the body is in the world, [m], and its orientation, body to world, wxyz.

        Args:
            position: of the base in the world in [m].
            quat: base to world, wxyz.
            joints: positions in the robot's order in [rad] or [m].
        """
        for step in self.steps:
            position = plus(position, rotate(quat, step.position))
            quat = multiply(quat, step.quat)
            if step.index < 0:
                continue
            if step.sliding:
                position = plus(position, rotate(quat, step.axis), joints[step.index])
            else:
                quat = multiply(quat, turned(step.axis, joints[step.index]))
        return position, quat


def chain_of_axes(axes: Mapping[str, str], joints: Sequence[str], what: str) -> Chain:
    """Return a chain of joints that turn about axes of the base, as a contract may say it.

    Args:
        axes: joint to `x`, `y`, `z`, `-x`, `-y` or `-z`, from the base outwards.
        joints: of the robot.
        what: the policy, for messages.

    Raises:
        PolicyError: a joint that the robot lacks.
    """
    for joint in axes:
        if joint not in joints:
            raise PolicyError(
                f"{what}: motion.chain names {joint!r}; {alternatives(joint, joints)}"
            )
    places = {joint: i for i, joint in enumerate(joints)}
    steps = tuple(Step(index=places[joint], axis=AXES[axis]) for joint, axis in axes.items())
    return Chain(steps, placed=not steps)


def chain_in_model(robot: Robot, path: Path, body: str, what: str) -> Chain:
    """Return the chain to a body of a model.

    Args:
        robot: gives joint names and the base.
        path: MJCF or URDF.
        body: its name in the model.
        what: the policy, for messages.

    Raises:
        PolicyError: the model has no such body.
        UniconError: the model cannot be read.
    """
    model = load_model(path, robot, quiet=True).model
    links = read_tree(model, robot)
    base = (BASE, robot.base_frame)
    own = {model.body(number).name for number in range(model.nbody)}
    names = [link.name if link.name in (*base, *own) else "" for link in links]
    if body not in names:
        known = alternatives(body, [name for name in names if name])
        raise PolicyError(f"{what}: motion.anchor_body {body!r} is not a body of {path}; {known}")
    steps: list[Step] = []
    if body not in base:  # a link's origin is at its joint, a body's is not
        origin = frame_of(model, robot, model.body(body).id)
        assert origin is not None
        steps.append(Step((-origin[1]).tolist()))
    place = names.index(body)
    while place >= 0:
        link = links[place]
        position, quat, axis = ([*map(float, v)] for v in (link.position, link.quat, link.axis))
        steps.insert(0, Step(position, quat, link.index, axis, link.sliding))
        place = link.parent
    return Chain(tuple(steps))


@dataclass(frozen=True, eq=False)
class Clip:
    """A motion as the policy is shown it: one row for each of its control periods, K of them.

    Attributes:
        joint_pos: in policy order, [rad], shape (K, n).
        joint_vel: in policy order, [rad/s], shape (K, n).
        anchor_pos: in the motion's world, [m], shape (K, 3), or None where it is not known.
        anchor_quat: anchor to the motion's world, wxyz, shape (K, 4).
    """

    joint_pos: Float32
    joint_vel: Float32
    anchor_pos: Float64 | None
    anchor_quat: Float64


@dataclass
class _Frames:
    fps: float
    joint_pos: Float64
    joint_vel: Float64 | None
    base_pos: Float64
    base_quat: Float64
    bodies: tuple[Float64, Float64] | None = None


def read_clip(
    spec: MotionSpec, contract: PolicyContract, robot_joints: Sequence[str], chain: Chain
) -> Clip:
    """Read a motion file and bring it to the policy's rate and joint order.

    Args:
        spec: of the contract, with a file.
        contract: gives the period and the joint order.
        robot_joints: the robot's joint order.
        chain: from the base to the anchor.

    Raises:
        PolicyError: the file is not a motion of these joints; names what does not fit.
    """
    path = spec.file
    assert path is not None
    frames = _read_npz(path, spec.fps) if path.suffix == ".npz" else _read_csv(path, spec.fps)
    order = _joint_order(path, spec, contract, robot_joints, frames.joint_pos.shape[1])
    last = (len(frames.joint_pos) - 1) / frames.fps
    end = last if spec.end is None else spec.end
    if not 0.0 <= spec.start < end <= last + 1e-6:
        raise PolicyError(
            f"{path}: it lasts {last:g} s, and motion says from {spec.start:g} to {end:g} s; "
            "correct motion.start and motion.end"
        )
    count = int(np.floor((end - spec.start) / contract.period + 1e-6)) + 1
    at = (spec.start + np.arange(count) * contract.period) * frames.fps
    first = np.minimum(np.floor(at + 1e-9).astype(np.intp), len(frames.joint_pos) - 2)
    share = np.clip(at - first, 0.0, 1.0)

    def between(values: Float64) -> Float64:
        ratio = share[:, None]
        mixed: Float64 = values[first] * (1.0 - ratio) + values[first + 1] * ratio
        return mixed

    joint_pos, base_pos = between(frames.joint_pos), between(frames.base_pos)
    ends = (frames.base_quat[first + i].tolist() for i in (0, 1))
    base_quat = np.array([towards(a, b, part) for a, b, part in zip(*ends, share.tolist())])
    joint_vel = np.zeros_like(joint_pos)
    if frames.joint_vel is not None:
        joint_vel = between(frames.joint_vel)
    elif count > 1:
        joint_vel = np.gradient(joint_pos, contract.period, axis=0)
    places = {name: i for i, name in enumerate(order)}
    robot_from_file = [places.get(name, -1) for name in robot_joints]
    anchor_pos, anchor_quat = _anchors(chain, base_pos, base_quat, joint_pos, robot_from_file)
    if frames.bodies is not None:
        _agree(path, spec, frames, chain, robot_from_file)
    policy_from_file = [places[name] for name in contract.joints]
    return Clip(
        np.ascontiguousarray(joint_pos[:, policy_from_file], np.float32),
        np.ascontiguousarray(joint_vel[:, policy_from_file], np.float32),
        anchor_pos if chain.placed else None,
        anchor_quat,
    )


def _anchors(
    chain: Chain,
    base_pos: Float64,
    base_quat: Float64,
    joint_pos: Float64,
    robot_from_file: list[int],
) -> tuple[Float64, Float64]:
    """Return where the anchor is; a joint that the file lacks, -1, stands at 0."""
    joints = np.pad(joint_pos, ((0, 0), (0, 1)))[:, robot_from_file]
    rows = zip(base_pos.tolist(), base_quat.tolist(), joints.tolist())
    poses = [chain(*row) for row in rows]
    return np.array([pos for pos, _ in poses]), np.array([quat for _, quat in poses])


def _agree(
    path: Path, spec: MotionSpec, frames: _Frames, chain: Chain, robot_from_file: list[int]
) -> None:
    """Refuse a file none of whose bodies is where its joints put the anchor: a wrong order."""
    assert frames.bodies is not None
    places = np.linspace(0, len(frames.joint_pos) - 1, min(len(frames.joint_pos), 50)).astype(int)
    shown = (frames.base_pos[places], frames.base_quat[places], frames.joint_pos[places])
    pos, quat = _anchors(chain, *shown, robot_from_file)
    body_pos, body_quat = (part[places] for part in frames.bodies)
    cosine = np.clip(np.abs(np.einsum("kbi,ki->kb", body_quat, quat)), 0.0, 1.0)
    angle = (2.0 * np.arccos(cosine)).max(axis=0)
    away = np.linalg.norm(body_pos - pos[:, None], axis=2).max(axis=0)
    near = (angle < TURNED) & (away < NEAR if chain.placed else True)
    if not near.any():
        nearest = int(np.argmin(angle))
        raise PolicyError(
            f"{path}: no body of it is where its joints put {spec.anchor_body} (the nearest is "
            f"body {nearest}, {angle[nearest]:.2f} rad and {away[nearest]:.2f} m off); give the "
            "order of its joints as motion.joints, and the anchor of training as motion.anchor_body"
        )


def _joint_order(
    path: Path, spec: MotionSpec, contract: PolicyContract, robot_joints: Sequence[str], count: int
) -> list[str]:
    said = spec.joints or (None if path.suffix == ".csv" else "policy")
    if said is None:
        raise PolicyError(
            f"{path}: a .csv does not name its joints; give motion.joints: robot (the order of the "
            f"robot file), policy, or the list of its {count} joints"
        )
    named = {"policy": contract.joints, "robot": tuple(robot_joints)}
    order = list(named[said] if isinstance(said, str) else said)
    if len(order) != count:
        what = f"motion.joints{f': {said}' if isinstance(said, str) else ''} has {len(order)}"
        text = f"it has {count} joints and {what}; give the list of its joints as motion.joints"
        raise PolicyError(f"{path}: {text}")
    for name in contract.joints:
        if name not in order:
            known = alternatives(name, order)
            raise PolicyError(f"{path}: it lacks joint {name!r} of the policy; {known}")
    return order


def _read_npz(path: Path, fps: float | None) -> _Frames:
    needed = ("fps", "joint_pos", "joint_vel", "body_pos_w", "body_quat_w")
    try:
        with zipfile.ZipFile(path) as parts:
            large = sum(part.file_size for part in parts.infolist()) > MOST_BYTES
        with np.load(path, allow_pickle=False) as file:
            keys = [] if large else list(file.keys())
            arrays = {key: np.asarray(file[key], np.float64) for key in needed if key in keys}
    except Exception as error:  # whatever its reader finds: zip, header, objects
        raise PolicyError(
            f"{path}: not a motion in .npz: {one_line(error)[:120]}; export it again"
        ) from error
    if large:
        raise PolicyError(_LARGE.format(path))
    if fps is not None:
        arrays["fps"] = np.array(fps)
    if lost := [key for key in needed if key not in arrays]:
        raise PolicyError(
            f"{path}: it has no {lost[0]!r}; {alternatives(lost[0], keys)}; write it with "
            "csv_to_npz.py of BeyondMimic or mjlab"
        )
    joint_pos, joint_vel, pos, quat = (arrays[key] for key in needed[1:])
    count, joints = (*joint_pos.shape, 0, 0)[:2]
    bodies = (*pos.shape, 0, 0)[1]
    shapes = ((count, joints), joint_pos.shape, (count, bodies, 3), (count, bodies, 4))
    for key, shape in zip(needed[1:], shapes):
        if arrays[key].shape != shape or 0 in shape:
            raise PolicyError(
                f"{path}: {key} has shape {arrays[key].shape}, not (frames, n) or (frames, bodies, "
                "…) as the others; export it again"
            )
    rate = arrays["fps"]
    frames = float(rate.flat[0]) if rate.size == 1 else np.nan
    return _sound(path, _Frames(frames, joint_pos, joint_vel, pos[:, 0], quat[:, 0], (pos, quat)))


def _read_csv(path: Path, fps: float | None) -> _Frames:
    if path.stat().st_size > MOST_BYTES:
        raise PolicyError(_LARGE.format(path))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that it is empty: refused below
            rows = np.loadtxt(path, delimiter=",", ndmin=2, dtype=np.float64)
    except (OSError, ValueError) as error:
        raise PolicyError(
            f"{path}: not a motion in .csv: {one_line(error)[:120]}; give rows of numbers"
        ) from error
    if rows.shape[1] < 8:
        raise PolicyError(
            f"{path}: a row has {rows.shape[1]} numbers; give base position (3), quaternion x, y, "
            "z, w (4) and the joints"
        )
    rate, quat = 30.0 if fps is None else fps, rows[:, [6, 3, 4, 5]]
    return _sound(path, _Frames(rate, rows[:, 7:], None, rows[:, :3], quat))


def _sound(path: Path, frames: _Frames) -> _Frames:
    """Refuse what no motion is; make quaternions go on without a change of sign."""
    arrays = (frames.joint_pos, frames.joint_vel, frames.base_pos, frames.base_quat)
    for array in (*arrays, *(frames.bodies or ())):
        bad = np.argwhere(~np.isfinite(0.0 if array is None else array))
        if bad.size:
            raise PolicyError(
                f"{path}: frame {int(bad[0][0])} holds a number that is not finite; mend the motion"
            )
    count = len(frames.joint_pos)
    if not 2 <= count <= MOST_FRAMES:
        raise PolicyError(f"{path}: it has {count} frames; give 2 to {MOST_FRAMES}")
    if not 1.0 <= frames.fps <= 10_000.0:
        raise PolicyError(f"{path}: {frames.fps:g} frames per second; give motion.fps")
    length = np.linalg.norm(frames.base_quat, axis=1)
    off = np.flatnonzero(np.abs(length - 1.0) > 0.02)
    if off.size:
        raise PolicyError(
            f"{path}: the base's quaternion of frame {int(off[0])} has length "
            f"{length[off[0]]:.2f}, not 1; correct the columns"
        )
    quat = frames.base_quat / length[:, None]
    flips = np.where((quat[1:] * quat[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    quat[1:] *= np.cumprod(flips)[:, None]
    up = 1.0 - 2.0 * (quat[0, 1] ** 2 + quat[0, 2] ** 2)
    if up < -0.5:
        order = "x, y, z, w" if path.suffix == ".csv" else "w, x, y, z"
        raise PolicyError(
            f"{path}: its first frame stands upside down; its quaternions must be {order}"
        )
    frames.base_quat = quat
    return frames

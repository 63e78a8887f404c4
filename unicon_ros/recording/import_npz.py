"""Import of UniCon's own recordings (`--rec` with an .npz): its keys, units and orders.

Its arrays are `states_q`, `states_qd`, … of shape (frames, …), with `ts` [s], `rec_dt` [s] and
`DOF_NAMES`; quaternions are xyzw. https://github.com/CreeperLin/unicon
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import UniconError, alternatives
from unicon_core.platforms.kit.base import quat_of_rpy
from unicon_core.robots import Robot
from unicon_ros.recording.imported import write_imported

__all__ = ["KEYS", "import_npz"]

KEYS = {
    "states_q": "joint_pos",
    "states_qd": "joint_vel",
    "states_q_tau": "joint_effort",
    "states_q_ctrl": "joint_pos_target",
    "states_tau_ctrl": "joint_effort_ff",
    "states_q_temp": "motor_temperature",
    "states_quat": "base_quat",
    "states_ang_vel": "base_ang_vel",
    "states_lin_acc": "base_lin_acc",
    "states_lin_vel": "base_lin_vel",
    "states_pos": "base_pos_w",
    "states_cmd": "velocity_command",
}
"""Key of UniCon to our state. `states_rpy` counts where there is no quaternion."""


def import_npz(
    source: Path,
    out: Path,
    robot: Robot,
    joints: Sequence[str] = (),
    rate: float | None = None,
) -> int:
    """Write a record of ticks; return how many.

    Args:
        source: the .npz file.
        out: of the record.
        robot: whose joints they are.
        joints: names in the file's order; those in `DOF_NAMES` unless told.
        rate: frames per second in [Hz]; by `rec_dt`, else `ts`, unless told.

    Raises:
        UniconError: it is not such a file, or does not fit the robot.
    """
    arrays = _arrays(source)
    found = {KEYS[key]: values for key, values in arrays.items() if key in KEYS}
    if not found:
        raise UniconError(
            f"{source} has no key of UniCon; known: {', '.join(KEYS)}; it has: "
            f"{', '.join(sorted(arrays)) or 'none'}"
        )
    lengths = {len(values) for values in found.values() if values.ndim}
    if len(lengths) != 1 or any(values.ndim != 2 for values in found.values()):
        shapes = ", ".join(f"{key} {v.shape}" for key, v in arrays.items() if key in KEYS)
        raise UniconError(f"{source}: arrays are (frames, elements) of one length; it has {shapes}")
    (frames,) = lengths
    names = tuple(joints) or tuple(str(name) for name in np.ravel(arrays.get("DOF_NAMES", ())))
    states = {}
    for state, values in found.items():
        if state.startswith(("joint_", "motor_")):
            values = _ordered(source, values, names, robot)
        elif state == "base_quat":
            values = values[:, [3, 0, 1, 2]] if values.shape[1] == 4 else values
        states[state] = _fitting(source, state, values)
    if "base_quat" not in states and "states_rpy" in arrays:
        rpy = _fitting(source, "states_rpy", arrays["states_rpy"])
        states["base_quat"] = quat_of_rpy(rpy).astype(np.float32)
    stamps = _stamps(source, arrays, frames, rate)
    return write_imported(out, source, robot, stamps, states)


def _arrays(source: Path) -> dict[str, NDArray[Any]]:
    """Return what is plain in the file; what would have to be unpickled is left out."""
    arrays: dict[str, NDArray[Any]] = {}
    try:
        with np.load(source, allow_pickle=False) as file:
            for key in file.files:
                try:
                    arrays[key] = file[key]
                except ValueError:  # an object
                    if key in KEYS:
                        raise
    except OSError as error:
        raise UniconError(f"cannot read {source}: {error.strerror or error}") from error
    except Exception as error:  # whatever zip files and headers of arrays raise
        told = " ".join(f"{error}".split())[:300] or type(error).__name__
        raise UniconError(f"{source} is not an .npz file of arrays: {told}") from error
    return arrays


def _ordered(
    source: Path, values: NDArray[Any], names: Sequence[str], robot: Robot
) -> NDArray[Any]:
    """Return columns in the robot's order of joints, aligned by name."""
    if not names:
        raise UniconError(
            f"{source} does not say the order of its {values.shape[1]} joints (DOF_NAMES); give "
            f"--joints with their names; robot {robot.name} has {', '.join(robot.joint_names)}"
        )
    if len(names) != values.shape[1]:
        raise UniconError(f"{source} has {values.shape[1]} joints, and {len(names)} names for them")
    for name in robot.joint_names:
        if name not in names:
            raise UniconError(
                f"{source} has no joint {name!r} of robot {robot.name}; {alternatives(name, names)}"
            )
    return values[:, [list(names).index(name) for name in robot.joint_names]]


def _fitting(source: Path, state: str, values: NDArray[Any]) -> NDArray[np.float32]:
    wanted = {"base_quat": 4}.get(state, 3)
    if not state.startswith(("joint_", "motor_")):
        if values.ndim != 2 or values.shape[1] < wanted:
            raise UniconError(
                f"{source}: {state} has shape {values.shape}; (frames, {wanted}) is wanted"
            )
        values = values[:, :wanted]
    if values.dtype.kind not in "fiu":
        raise UniconError(f"{source}: {state} is {values.dtype}; numbers are wanted")
    return np.ascontiguousarray(values, np.float32)


def _stamps(
    source: Path, arrays: Mapping[str, NDArray[Any]], frames: int, rate: float | None
) -> NDArray[np.int64]:
    """Return the time of each frame in [ns] from 0: float32 seconds of `ts` are too coarse."""
    step = arrays.get("rec_dt")
    if rate is not None:
        period = 1.0 / rate
    elif step is not None and step.size == 1 and step.dtype.kind in "fiu":
        period = float(step)
    else:
        times = arrays.get("ts")
        if times is None or times.shape != (frames,) or times.dtype.kind != "f":
            raise UniconError(f"{source} has neither rec_dt nor ts; give --rate HZ")
        told = np.round((times.astype(float) - float(times[0])) * 1e9).astype(np.int64)
        if not np.isfinite(times).all() or (np.diff(told) <= 0).any():
            raise UniconError(f"{source}: ts does not grow with every frame; give --rate HZ")
        return told
    if not 0.0 < period < 86_400.0:
        raise UniconError(f"{source}: rec_dt is {period:g} s; give --rate HZ")
    return np.round(np.arange(frames) * period * 1e9).astype(np.int64)

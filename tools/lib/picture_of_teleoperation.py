"""Draws docs/pictures/teleoperation.png: a session of `g1_vr` with the emulated headset.

    UNICON_ASSETS=… python tools/lib/picture_of_teleoperation.py [RECORDING.mcap]

Needs the extras `sim`, `ik`, `webxr` and `plots`. Without a recording it runs one at real rate:
the operator takes hold after 3 s, walks the robot on, and takes the headset off after 13 s.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
PICTURE = ROOT / "docs" / "pictures" / "teleoperation.png"
WANTED, MEASURED, GREY, RED = "#c4501b", "#1f5fa8", "#9aa3ad", "#b3261e"
MOMENT = 8.0
"""Of the run in [s], at which the robot is drawn."""


def recorded(path: Path) -> None:
    """Run a session."""
    command = [sys.executable, "-m", "unicon_ros", "run", "g1_vr", "--no-ros", "--quiet"]
    run = subprocess.Popen([*command, "--duration", "14", "--record", str(path)])
    headset = [sys.executable, str(ROOT / "examples" / "emulated_headset.py"), "--begin", "3"]
    subprocess.run([*headset, "--seconds", "13", "--forward", "0.6"], check=True)
    if run.wait(60.0):
        raise SystemExit("the run has failed")


def bones(positions: np.ndarray) -> list[np.ndarray]:
    """Return a line from each body of the robot to the one that carries it, in the base's frame.

    Args:
        positions: of all joints in [rad], shape (n,).
    """
    import mujoco

    from unicon_core.models.find import model_of
    from unicon_core.models.load import load_model
    from unicon_core.robots import load_robot

    robot = load_robot("g1_29dof")
    model = load_model(model_of(None, robot), robot, quiet=True).model
    data = mujoco.MjData(model)
    names = [model.joint(j).name for j in range(model.njnt)]
    for name, value in zip(robot.joint_names, positions):
        data.qpos[model.jnt_qposadr[names.index(name)]] = value
    mujoco.mj_kinematics(model, data)
    base = data.body(robot.base_frame).xpos.copy()
    return [
        np.array([data.xpos[parent], data.xpos[body]]) - base
        for body in range(2, model.nbody)
        if (parent := int(model.body_parentid[body])) > 0
    ]


def draw(path: Path) -> None:
    """Draw a recording."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    from unicon_lab.recording import open_record

    record = open_record(path)
    run = np.array([phase == "run" for phase in record.phases])
    stamps = 1e-9 * record.states("stamp_ns")[run]
    time = stamps - stamps[0]
    row = int(np.searchsorted(time, MOMENT))
    figure = pyplot.figure(figsize=(11.0, 4.6), dpi=110)
    space = figure.add_axes((-0.02, -0.05, 0.44, 1.1), projection="3d")
    for line in bones(record.states("joint_pos")[run][row]):
        space.plot(*line.T, color="#3c434b", linewidth=3.0, solid_capstyle="round")
    for side in ("left_hand", "right_hand"):
        for state, color in (("target", WANTED), ("pose", MEASURED)):
            way = record.states(f"{side}_{state}")[run][row - 125 : row + 1, :3]
            space.plot(*way.T, color=color, linewidth=1.2)
            space.scatter(*way[-1], color=color, s=18)
    space.set_box_aspect((1.0, 1.0, 1.6), zoom=1.9)
    space.set(xlim=(-0.5, 0.5), ylim=(-0.5, 0.5), zlim=(-0.8, 0.8))
    space.view_init(elev=12.0, azim=35.0)
    space.set_axis_off()
    upper, middle, lower = (figure.add_axes((0.46, y, 0.52, 0.22)) for y in (0.72, 0.42, 0.12))
    engaged = record.states("teleop_engaged")[run][:, 0] > 0
    alive = record.states("webxr_alive")[run] > 0
    arm = record.states("joint_pos_target")[run][:, 15:29]
    rates = np.abs(np.diff(arm, axis=0, prepend=arm[:1])).max(axis=1) / np.diff(time).mean()
    for each in (upper, middle, lower):
        each.fill_between(
            time, 0, 1, where=engaged, transform=each.get_xaxis_transform(), color="#f3ede6"
        )
        each.axvline(time[np.flatnonzero(alive)[-1]], color=RED, linewidth=0.8)
        each.set_xlim(0.0, time[-1])
        each.spines[["top", "right"]].set_visible(False)
        each.tick_params(labelsize=8, labelbottom=each is lower)
    height = "height of the left hand [m]"
    upper.plot(time, record.states("left_hand_target")[run][:, 2], color=WANTED, label="target")
    upper.plot(time, record.states("left_hand_pose")[run][:, 2], color=MEASURED, label="hand")
    upper.legend(loc="upper right", fontsize=8, frameon=False, ncols=2)
    middle.plot(time, rates, color=MEASURED)
    middle.axhline(1.0, color=GREY, linewidth=0.8, linestyle="--")
    middle.set_ylim(0.0, 4.0)
    lower.plot(time, 1e3 * record.states("teleop_latency")[run], color=MEASURED, linewidth=0.7)
    lower.set_ylim(0.0, 40.0)
    lower.set_xlabel(
        "[s]; shaded: the clutch is engaged; red: the headset is taken off", fontsize=8
    )
    for axis, text in (
        (upper, height),
        (middle, "quickest arm joint's target [rad/s]"),
        (lower, "headset's frame to tick [ms]"),
    ):
        axis.set_title(text, fontsize=8, loc="left")
    figure.savefig(PICTURE)
    print(f"{PICTURE.relative_to(ROOT)}: {PICTURE.stat().st_size / 1e3:.0f} kB")


def main(*given: str) -> int:
    """Run a session unless one is given, and draw it."""
    if given:
        draw(Path(given[0]))
        return 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "session.mcap"
        recorded(path)
        draw(path)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))

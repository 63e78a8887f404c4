"""Measure the shipped Go2 policy against its acceptance lines: `python evaluate.py [--assert]`.

Runs real MuJoCo with the deployed timing (50 Hz network, PD with torque clip in every 2 ms step)
from fixed seeds and writes EVALUATION.md beside the policy. `--assert` exits 1 when a line misses.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from exam import Marks, examine, load_policy, table
from walker import Walker

ROOT = Path(__file__).resolve().parents[2]
OWN_MODEL = ROOT / "config" / "models" / "go2" / "go2.xml"
POLICY_DIR = ROOT / "config" / "policies" / "go2_velocity"
COMMAND_LOW, COMMAND_HIGH = np.array([-0.5, -0.4, -1.0]), np.array([1.0, 0.4, 1.0])
FORWARD = np.array([0.8, 0.0, 0.0])
ZERO = np.zeros(3)
TICKS_PER_S = 50
CONSTANT = {
    "vx -0.5": [-0.5, 0.0, 0.0],
    "vx 1.0": [1.0, 0.0, 0.0],
    "vy 0.4": [0.0, 0.4, 0.0],
    "vy -0.4": [0.0, -0.4, 0.0],
    "wz 1.0": [0.0, 0.0, 1.0],
}
HEADER = f"""# Evaluation of go2_velocity

Written by `tools/train/evaluate.py`; rerun it with `python tools/train/evaluate.py --assert`.
MuJoCo {mujoco.__version__}, network at 50 Hz, PD with torque clip in every 2 ms physics step,
no sensor noise, fixed seeds. A fall is a base under 0.15 m or tilted beyond 60 degrees.
Errors are means over every tick, the transients after each switch of the command included.
Torques count every physics step. Sim to sim runs on unitree_mujoco's Go2, which training never saw.

| line | required | measured | |
|---|---|---|---|
"""
MORE = ["", "## Further figures", "", "| run | measured |", "|---|---|"]


@dataclass
class Line:
    """One acceptance line: what was measured and whether it holds (None: not measured)."""

    name: str
    required: str
    measured: str
    holds: bool | None


def assets() -> Path | None:
    """Folder of other people's models, or None."""
    folder = os.environ.get("UNICON_ASSETS")
    path = Path(folder) if folder else ROOT.parent / "shared" / "assets"
    return path if (path / "models" / "go2" / "go2.xml").is_file() else None


def random_episode(walker: Walker, seed: int, push: float) -> tuple[bool, np.ndarray]:
    """20 s, a new random command every 4 s, a push of `push` [m/s] every 5 s.

    Returns whether the robot fell, and per tick: speed error [m/s], yaw rate error [rad/s],
    seconds since the command changed, shape (ticks, 3).
    """
    rng = np.random.default_rng(seed)
    walker.reset(yaw=rng.uniform(-np.pi, np.pi))
    rows: list[tuple[float, float, float]] = []
    command = ZERO
    for tick in range(20 * TICKS_PER_S):
        if tick % (4 * TICKS_PER_S) == 0:
            command = rng.uniform(COMMAND_LOW, COMMAND_HIGH)
        if push and tick and tick % (5 * TICKS_PER_S) == 0:
            angle = rng.uniform(-np.pi, np.pi)
            walker.data.qvel[:2] += push * np.array([np.cos(angle), np.sin(angle)])
        walker.tick(command)
        if walker.fallen():
            return True, np.array(rows).reshape(-1, 3)
        error = command - walker.velocity()
        since = (tick % (4 * TICKS_PER_S)) / TICKS_PER_S
        rows.append((np.hypot(error[0], error[1]), abs(error[2]), since))
    return False, np.array(rows)


def random_episodes(walker: Walker, count: int, push: float, seed: int) -> dict[str, float]:
    """Falls and mean errors over `count` episodes; `settled` leaves out 1 s after each switch."""
    falls, rows = 0, []
    for episode in range(count):
        fell, errors = random_episode(walker, seed + episode, push)
        falls += fell
        rows.append(errors)
    table = np.concatenate(rows)
    settled = table[table[:, 2] >= 1.0]
    return {
        "falls": falls,
        "lin": table[:, 0].mean(),
        "ang": table[:, 1].mean(),
        "lin_settled": settled[:, 0].mean(),
        "ang_settled": settled[:, 1].mean(),
    }


def straight(walker: Walker, seconds: float, command: np.ndarray) -> dict[str, float]:
    """One constant command after 1 s of standing: displacement, drift, smoothness, torque."""
    walker.reset()
    for _ in range(TICKS_PER_S):
        walker.tick(ZERO)
    start, yaw, last = walker.data.qpos[:2].copy(), walker.yaw, walker.action
    rates, torques, joint_speed, moved = [], [], [], 0.0
    turned, fell = 0.0, False
    for _ in range(round(seconds * TICKS_PER_S)):
        walker.tick(command)
        fell |= walker.fallen()
        turned += (walker.yaw - yaw - turned + np.pi) % (2 * np.pi) - np.pi
        rates.append(np.abs(walker.action - last).mean())
        last = walker.action
        torques.append(np.abs(walker.torque) / walker.effort)
        joint_speed.append(np.abs(walker.data.qvel[walker.qvel]).mean())
        moved = max(moved, float(np.linalg.norm(walker.data.qpos[:2] - start)))
    offset = walker.data.qpos[:2] - start
    ratio = np.concatenate(torques)
    scale = float(np.mean(walker.contract["action"]["scale"]))
    return {
        "fell": fell,
        "forward": float(offset @ [np.cos(yaw), np.sin(yaw)]),
        "sideways": float(offset @ [-np.sin(yaw), np.cos(yaw)]),
        "yaw_drift": turned,
        "moved": moved,
        "joint_speed": float(np.mean(joint_speed)),
        "action_rate": float(np.mean(rates)),
        "target_rate": float(np.mean(rates)) * scale * TICKS_PER_S,
        "torque_mean": float(ratio.mean()),
        "torque_p999": float(np.quantile(ratio, 0.999)),
        "torque_peak": float(ratio.max()),
    }


def load(path: Path, policy: Path, latency: int = 0) -> Walker:
    """A walker on the model file, as shipped except for an added motor latency in ticks."""
    walker = Walker(mujoco.MjModel.from_xml_path(str(path)), policy)
    walker.latency = latency
    return walker


def at_most(name: str, value: float, limit: float, unit: str) -> Line:
    """A line that holds when `value` is at most `limit`."""
    return Line(name, f"≤ {limit:g} {unit}", f"{value:.3f} {unit}", bool(value <= limit))


def own_lines(own: Walker, episodes: int) -> tuple[list[Line], list[tuple[str, str]]]:
    """Lines 1, 2, 4 and 6 on our model, and further figures."""
    plain = random_episodes(own, episodes, 0.0, seed=1000)
    pushed = random_episodes(own, episodes, 0.5, seed=2000)
    still = straight(own, 30.0, ZERO)
    walk = straight(own, 10.0, FORWARD)
    of = f"of {episodes} episodes"
    lines = [
        at_most("1a falls, random commands", plain["falls"], 0, of),
        at_most("1b mean speed error", plain["lin"], 0.15, "m/s"),
        at_most("1c mean yaw rate error", plain["ang"], 0.2, "rad/s"),
        at_most("2 falls, pushes of 0.5 m/s every 5 s", pushed["falls"], episodes // 25, of),
        at_most("4a standing 30 s: base moves", still["moved"], 0.1, "m"),
        at_most("4b standing 30 s: mean joint speed", still["joint_speed"], 0.1, "rad/s"),
        at_most("6a torque at vx 0.8, mean", walk["torque_mean"], 0.6, "of the limit"),
        at_most("6b torque at vx 0.8, peak", walk["torque_peak"], 0.6, "of the limit"),
    ]
    rate = f"{walk['action_rate']:.3f} action units a tick = {walk['target_rate']:.2f} rad/s"
    figures = [
        ("random commands, from 1 s after each switch", errors(plain, "_settled")),
        ("random commands, pushed, all ticks", errors(pushed)),
        ("vx 0.8 for 10 s", path(walk)),
        ("vx 0.8: mean absolute action rate", rate),
        ("vx 0.8: torque / limit", torque(walk)),
    ]
    for name, command in CONSTANT.items():
        figures.append((f"{name} for 10 s", path(straight(own, 10.0, np.array(command)))))
    return lines, figures


def foreign_lines(other: Walker, episodes: int) -> tuple[list[Line], list[tuple[str, str]]]:
    """Line 3 on a model that we did not write, and further figures."""
    far = straight(other, 10.0, FORWARD)
    pushed = random_episodes(other, episodes, 0.5, seed=3000)
    still = straight(other, 30.0, ZERO)
    ahead = Line(
        "3a sim to sim, vx 0.8 for 10 s: forward",
        "≥ 6.0 m",
        f"{far['forward']:.2f} m",
        far["forward"] >= 6.0,
    )
    lines = [
        ahead,
        at_most("3b sim to sim: yaw drift", abs(far["yaw_drift"]), 0.5, "rad"),
        at_most("3c sim to sim: falls", float(far["fell"]), 0, "of 1 run"),
    ]
    figures = [
        (f"unitree_mujoco, {episodes} pushed episodes, all ticks", errors(pushed)),
        ("unitree_mujoco, vx 0.8: torque / limit", torque(far)),
        ("unitree_mujoco, standing 30 s", f"moved {still['moved']:.3f} m"),
    ]
    return lines, figures


def measure(policy: Path, episodes: int) -> tuple[list[Line], list[tuple[str, str]]]:
    """All acceptance lines, and further figures as (run, measured)."""
    few = max(1, episodes // 5)
    lines, figures = own_lines(load(OWN_MODEL, policy), episodes)
    late = random_episodes(load(OWN_MODEL, policy, latency=1), few, 0.0, seed=4000)
    figures.append((f"targets one period (20 ms) late, {few} episodes, all ticks", errors(late)))
    folder = assets()
    if folder is None:
        lines.append(Line("3 sim to sim", "≥ 6.0 m", "no assets: set UNICON_ASSETS", None))
    else:
        other = load(folder / "models" / "go2" / "go2.xml", policy)
        more_lines, more_figures = foreign_lines(other, few)
        lines, figures = lines + more_lines, figures + more_figures
    return sorted(lines, key=lambda line: line.name), figures


def exam_lines(marks: list[Marks], robots: int) -> list[Line]:
    """Line 7: the worst direction of the exam."""
    moving = [x for x in marks if any(x.command)]
    falls, count = sum(x.falls for x in marks), len(marks) * robots
    return [
        at_most("7a exam: mean speed, worst direction", max(x.lin for x in moving), 0.1, "m/s"),
        at_most("7b exam: mean yaw rate, worst", max(x.ang for x in moving), 0.1, "rad/s"),
        at_most("7c exam: falls", falls, count // 100, f"of {count} episodes"),
    ]


def errors(run: dict[str, float], which: str = "") -> str:
    """Falls and tracking errors in words."""
    lin, ang = run[f"lin{which}"], run[f"ang{which}"]
    return f"{run['falls']:.0f} falls, {lin:.3f} m/s, {ang:.3f} rad/s"


def path(run: dict[str, float]) -> str:
    """Where a straight run went, in words."""
    moved = f"{run['forward']:+.2f} m forward, {run['sideways']:+.2f} m left"
    return f"{moved}, turned {run['yaw_drift']:+.2f} rad"


def torque(run: dict[str, float]) -> str:
    """Torque of every joint and physics step over its limit, in words."""
    p999, peak = run["torque_p999"], run["torque_peak"]
    return f"mean {run['torque_mean']:.3f}, 99.9 % {p999:.3f}, peak {peak:.3f}"


def report(lines: list[Line], figures: list[tuple[str, str]], exam: str) -> str:
    """The text of EVALUATION.md."""
    verdict = {True: "holds", False: "**misses**", None: "not measured"}
    rows = [f"| {x.name} | {x.required} | {x.measured} | {verdict[x.holds]} |" for x in lines]
    more = [f"| {run} | {measured} |" for run, measured in figures]
    return HEADER + "\n".join([*rows, *MORE, *more]) + "\n" + exam


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--policy", type=Path, default=POLICY_DIR)
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--out", type=Path, help="default: EVALUATION.md beside the policy")
    parser.add_argument("--assert", dest="check", action="store_true", help="exit 1 on a miss")
    args = parser.parse_args()
    lines, figures = measure(args.policy, args.episodes)
    robots = max(1, args.episodes * 2 // 5)
    marks = examine(load_policy(args.policy), robots)
    lines += exam_lines(marks, robots)
    text = report(lines, figures, table(marks, robots))
    (args.out or args.policy / "EVALUATION.md").write_text(text, encoding="utf-8")
    print(text)
    return int(args.check and any(line.holds is False for line in lines))


if __name__ == "__main__":
    sys.exit(main())

"""Which stairs the Go2 policies climb: `python stairs.py`, blind and seeing, in plain MuJoCo.

Physics as deployed (`walker.py`: 2 ms, all contacts), ground of the shipped terrain words, a
constant command. The robots differ by seed. Writes EVALUATION.md beside the policy that sees.
"""

from __future__ import annotations

import argparse
from collections import deque
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import contract
import mujoco
import numpy as np
from evaluate import CONSTANT, OWN_MODEL, ZERO, errors, load, path, random_episodes, straight
from stairs_env import DELAY, DRIFT, HOLD, OFFSET, POINT
from terrain import heights, lay, stairs
from walker import Walker

from unicon_core.terrain.ground import Ground

STEPS, RUN, FLAT, LANDING = 5, 0.3, 2.0, 8.0
SPEED = 0.5  # [m/s]
PATIENCE = 3.0  # without 5 cm of progress in [s]: it is stuck
BEYOND = 0.5  # past the last edge: on the landing with all feet, in [m]
TICKS_PER_S = 50
HEADER = f"""# Evaluation of go2_stairs

Written by `tools/train/stairs.py`; rerun it with `python tools/train/stairs.py`.
MuJoCo {mujoco.__version__}, network at 50 Hz, PD with torque clip in every 2 ms physics step, all
contacts.

## Stairs

`scene: {{terrain: {{stairs: {{rise: RISE, run: {RUN}, steps: {STEPS}, landing: {LANDING:g}}}}}}}`,
command {SPEED:g} m/s straight ahead. A robot has a foot friction of 0.5 to 1.2, a payload of
0 to 2 kg, targets 0 or 20 ms late, a start within ±0.2 m and ±0.1 rad, drawn by its seed. It has
climbed once its base is {BEYOND} m past the last edge, in twice the time that the command takes;
it is stuck after {PATIENCE:g} s without 5 cm of progress, and falls beyond 60 degrees or below
0.15 m above the ground. Where the heading is held, the yaw rate of the command is {HOLD:g}/s of
the error. With errors, each point of a scan is off by up to {POINT * 100:g} cm, all of it by up to
{OFFSET * 100:g} cm up and {DRIFT * 100:g} cm sideways, and its heights are {DELAY * 20} ms old.

| rise | heading | blind (`go2_velocity`) | seeing | seeing, with errors |
|---|---|---|---|---|
"""
# Rise in [m], and whether the command holds the heading.
ROWS = [*((rise, True) for rise in (0.04, 0.06, 0.08, 0.10)), (0.08, False)]


@dataclass
class Climb:
    """How one robot fared.

    Attributes:
        climbed: it stood on the landing in time, and never fell.
        fell: tilted beyond 60 degrees, or its base under 0.15 m above the ground.
        seconds: until then, or until the end.
        reached: how far it came at most in [m].
    """

    climbed: bool
    fell: bool
    seconds: float
    reached: float


class Blurred:
    """Heights of the ground as a map of depth images may have them."""

    def __init__(self, ground: Ground, rng: np.random.Generator) -> None:
        self.ground, self.rng = ground, rng
        self.offset, self.drift = rng.uniform(-OFFSET, OFFSET), rng.uniform(-DRIFT, DRIFT, 2)
        self.past: deque[np.ndarray] = deque(maxlen=DELAY + 1)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        seen = heights(self.ground, points + self.drift) + self.offset
        self.past.append(seen + self.rng.uniform(-POINT, POINT, seen.shape))
        return self.past[0]


class Course:
    """Stairs that go up in front of a robot.

    Attributes:
        goal: x of the base that counts as climbed in [m].
    """

    def __init__(self, policy: Path, rise: float, blurred: bool = False, held: bool = True) -> None:
        self.ground, self.blurred, self.held = (
            stairs(rise, RUN, STEPS, LANDING, FLAT),
            blurred,
            held,
        )
        spec = mujoco.MjSpec.from_file(str(contract.MODEL_PATH))
        lay(spec, self.ground)
        self.walker = Walker(spec.compile(), policy)
        self.goal = FLAT / 2 + (STEPS - 1) * RUN + BEYOND
        model = self.walker.model
        self.feet = [model.geom(leg).id for leg in contract.LEGS]
        self.mass = float(model.body_mass[1])

    def climb(self, seed: int) -> Climb:
        """Walk for at most twice as long as the command should take."""
        walker, rng = self.walker, np.random.default_rng(seed)
        model, data = walker.model, walker.data
        model.geom_friction[self.feet, 0] = rng.uniform(0.5, 1.2)
        model.body_mass[1] = self.mass + rng.uniform(0.0, 2.0)
        walker.latency = int(rng.integers(0, 2))
        walker.reset(yaw=rng.uniform(-0.1, 0.1))
        data.qpos[:2] = rng.uniform(-0.2, 0.2, 2)
        mujoco.mj_forward(model, data)
        walker.ground = partial(heights, self.ground)
        if self.blurred:
            walker.ground = Blurred(self.ground, rng)
        command, reached, since = np.array([SPEED, 0.0, 0.0]), 0.0, 0
        for tick in range(round(2.0 * self.goal / SPEED * TICKS_PER_S)):
            if self.held:
                command[2] = np.clip(-HOLD * walker.yaw, -0.6, 0.6)
            walker.tick(command)
            seconds = tick / TICKS_PER_S
            if data.qpos[0] > reached + 0.05:
                reached, since = float(data.qpos[0]), tick
            above = data.qpos[2] - heights(self.ground, data.qpos[:2])
            if above < 0.15 or walker.rotation()[2, 2] < 0.5:
                return Climb(False, True, seconds, reached)
            if data.qpos[0] > self.goal:
                return Climb(True, False, seconds, reached)
            if tick - since > PATIENCE * TICKS_PER_S:
                break
        return Climb(False, False, seconds, reached)

    def measure(self, seeds: int) -> str:
        """How many climbed, fell and how long it took, in words."""
        climbs = [self.climb(seed) for seed in range(seeds)]
        done = [x.seconds for x in climbs if x.climbed]
        fell = sum(x.fell for x in climbs)
        far = (
            f"median {np.median(done):.1f} s of {self.goal / SPEED:.1f}"
            if done
            else (f"median {np.median([x.reached for x in climbs]):.2f} m of {self.goal:.2f}")
        )
        return f"{len(done)} of {seeds}, {fell} fell, {far}"


def stops(walker: Walker) -> str:
    """Walk 5 s at 0.5 m/s, then stand: how the second to fourth second look, in words."""
    walker.reset()
    for _ in range(5 * TICKS_PER_S):
        walker.tick(np.array([SPEED, 0.0, 0.0]))
    for _ in range(TICKS_PER_S):
        walker.tick(ZERO)
    start, speeds = walker.data.qpos[:2].copy(), []
    for _ in range(3 * TICKS_PER_S):
        walker.tick(ZERO)
        speeds.append(np.abs(walker.data.qvel[walker.qvel]).mean())
    moved = np.linalg.norm(walker.data.qpos[:2] - start)
    return f"moved {moved:.3f} m, {np.mean(speeds):.3f} rad/s"


def flat(policy: Path, episodes: int) -> str:
    """The section on flat ground."""
    walker = load(OWN_MODEL, policy)
    still = straight(walker, 30.0, ZERO)
    pushed = random_episodes(walker, episodes, 0.5, seed=2000)
    rows = [(name, path(straight(walker, 10.0, np.array(v)))) for name, v in CONSTANT.items()]
    rows = [(f"{name} for 10 s", text) for name, text in rows]
    rows.append(("standing 3 s, from 1 s after walking", stops(walker)))
    rows.append(
        ("standing 30 s", f"moved {still['moved']:.3f} m, {still['joint_speed']:.3f} rad/s")
    )
    rows.append(
        (f"{episodes} episodes of 20 s, random commands, pushed by 0.5 m/s", errors(pushed))
    )
    head = "\n## Flat ground\n\n| run | measured |\n|---|---|\n"
    return head + "".join(f"| {name} | {text} |\n" for name, text in rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--policy", type=Path, default=contract.STAIRS_DIR)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--rise", type=float, help="of a quick look at one in [m]: writes nothing")
    args = parser.parse_args()
    if args.rise is not None:
        for blurred, held in ((False, True), (True, True), (False, False)):
            print(Course(args.policy, args.rise, blurred, held).measure(args.seeds), flush=True)
        return
    text = HEADER
    for rise, held in ROWS:
        courses = [Course(contract.POLICY_DIR, rise, False, held)]
        courses += [Course(args.policy, rise, blurred, held) for blurred in (False, True)]
        cells = [course.measure(args.seeds) for course in courses]
        row = [f"{rise * 100:g} cm", "held" if held else "free", *cells]
        print(*row, sep=" | ", flush=True)
        text += f"| {' | '.join(row)} |\n"
    text += flat(args.policy, max(1, args.seeds // 2))
    (args.policy / "EVALUATION.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()

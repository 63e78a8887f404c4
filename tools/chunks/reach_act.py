"""A toy of action chunks: ARX X5 reaches for goals, by an ACT of LeRobot's own class.

    python tools/chunks/reach_act.py OUT      # demonstrations, training, 20 goals; a JSON line
    python tools/chunks/reach_act.py OUT --serve PYTHON --delay 0.08   # over `unicon serve`
    python tools/chunks/reach_act.py OUT --serve PYTHON --fail stop    # of the server, on the way

It needs a Python with `unicon_ros[sim,ik,bags,lerobot,lerobot-policies]`. The demonstrations are
the block `reach` with random goals, recorded and exported as a data set; the network sees the
joints and the goal as environment state, no picture. Everything is trained here, on one thread. A
policy that is in OUT already is taken as it is.

With `--serve` the named PYTHON alone needs `lerobot-policies`: it runs `unicon serve`, which the
robot here asks.
"""

from __future__ import annotations

import argparse
import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from slow_link import SlowLink

from unicon_base.resources import same_modules
from unicon_core.flow.block import Writes

ROWS, FPS, RATE = 10, 20, 100  # of a chunk, of the data set in [Hz], of the workflow in [Hz]
STEPS = 2  # rows from one inference to the next: 10 Hz
GOALS, PAUSE = 20, 2.5  # of the evaluation, and the time for each in [s]
NEAR = 0.02  # m
LOW, HIGH = np.array([[0.2, -0.2, 0.1], [0.4, 0.2, 0.35]])  # in the base frame in [m]
BEGIN = {"pose": {"to": {"joint2": 1.0, "joint3": 1.0}, "duration": 2.0}}


class Goals:
    """Random goals, a new one every `every` seconds; the hand's target with them.

    Args:
        goal: in the base frame in [m], shape (3,).
        period: of a tick in [s].
        every: time of a goal in [s].
        seed: of their places.
    """

    memory = ("_tick", "_random")
    endless = True

    def __init__(self, goal: Writes, *, period: float, every: float = 1.5, seed: int = 0) -> None:
        self._goal, self._every = goal, round(every / period)
        self._tick, self._random = 0, np.random.default_rng(seed)

    def __call__(self) -> None:
        """Go on to the next goal where it is time."""
        if self._tick % self._every == 0:
            self._goal[...] = self._random.uniform(LOW, HIGH)
        self._tick += 1


class Aim:
    """The goal as the target of the hand, whose orientation is free."""

    memory = ()
    endless = True

    def __init__(
        self, hand_target: Writes, hand_target_velocity: Writes, hand_target_stamp_ns: Writes,
        *, states: Any,
    ) -> None:  # fmt: skip
        self._target, self._goal = hand_target, states["goal"]
        self.reads = ("goal",)
        self._target[3:] = (1.0, 0.0, 0.0, 0.0)

    def __call__(self) -> None:
        """Aim."""
        self._target[:3] = self._goal
        self._target[3:] = (1.0, 0.0, 0.0, 0.0)


class NoTorque:
    """No torque and no velocity: a policy that gives positions leaves what `gravity` adds to."""

    memory = ()
    endless = True

    def __init__(self, joint_effort_ff: Writes, joint_vel_target: Writes) -> None:
        self._rates = joint_effort_ff, joint_vel_target

    def __call__(self) -> None:
        """Zero them."""
        for rate in self._rates:
            rate[...] = 0.0


def workflow(commands: list[Any], flow: Any, **more: Any) -> dict[str, Any]:
    """Return the workflow that demonstrations and policy share."""
    return {
        "schema": "unicon.workflow/1",
        "robot": "arx_x5",
        "platform": "mujoco",
        "rate": RATE,
        "states": {"goal": {"shape": [3], "unit": "m"}},
        "estimate": [{"frames": {"of": ["hand"]}}],
        "commands": commands,
        "flow": {"chain": [BEGIN, {"zip": [*flow, {"gravity": {"moves": ["joint*"]}}]}]},
        "safety": ["finite", "joint_limits", "velocity_limits"],
        **more,
    }


def goals(every: float, seed: int) -> dict[str, Any]:
    """Return the block of the goals."""
    return {"call": {"function": "reach_act:Goals", "every": every, "seed": seed}}


def demonstration() -> dict[str, Any]:
    """Return the workflow of the demonstrations."""
    free = {"hand": {"position": 1.0, "orientation": 0.0}}
    reach = {"function": "unicon_manipulation.reach:Reach", "effectors": free}
    reach |= {"moves": ["joint*"], "max_rate": "robot"}
    follow = {"moves": ["joint*"], "max_rate": "robot", "start_tolerance": 0.5, "silent": "hold"}
    commands = [goals(1.0, 1), {"call": {"function": "reach_act:Aim"}}, {"call": reach}]
    return workflow(commands, [{"forward_command": follow}])


def demonstrate(out: Path, seconds: float) -> Path:
    """Record and export the demonstrations."""
    from unicon_core.runtime import Runner, RunOptions
    from unicon_core.workflow import Program
    from unicon_lab.datasets.export import Wanted, export_dataset
    from unicon_lab.fault_record import FaultRecord
    from unicon_lab.recording.run_recording import Recording

    recording = Recording(out / "demonstrations.mcap", patient=True)
    record = FaultRecord("off", recording=recording)
    program = Program(**demonstration(), hooks=[recording.hook, record.hook])
    runner = Runner(program, RunOptions(duration=seconds, speed="max"))
    record.attach(runner)
    runner.run()
    wanted = Wanted(
        FPS, "reach the goal", ("joint_pos", "goal"), ("joint_pos_command",), writer="own"
    )
    export_dataset([Path(recording.path)], out / "dataset", wanted)
    return out / "dataset"


def windows(dataset: Path) -> dict[str, Any]:
    """Return observation, goal and the actions that follow, of windows with one goal."""
    from pyarrow import parquet

    (file,) = (dataset / "data").rglob("*.parquet")
    table = parquet.read_table(file)
    columns = {
        name: np.array(table[name].to_pylist(), np.float32)
        for name in ("observation.state", "observation.goal", "action")
    }
    at, goal = np.arange(len(table) - ROWS), columns["observation.goal"]
    at = at[np.isfinite(columns["action"]).all(1)[at] & (goal[at] == goal[at + ROWS - 1]).all(1)]
    at = at[at > 2 * FPS]  # behind the pose that comes first
    rows = at[:, None] + np.arange(ROWS)
    return {
        "observation.state": columns["observation.state"][at],
        "observation.environment_state": goal[at],
        "action": columns["action"][rows],
    }


def train(data: dict[str, Any], folder: Path, steps: int) -> float:
    """Train an ACT and write its folder; return the last loss in units of the deviation."""
    import torch
    from lerobot.configs.types import FeatureType, NormalizationMode, PolicyFeature
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.policies.factory import make_pre_post_processors

    torch.set_num_threads(1)
    torch.manual_seed(0)
    kinds = {"observation.state": FeatureType.STATE, "action": FeatureType.ACTION}
    features = {
        name: PolicyFeature(kinds.get(name, FeatureType.ENV), values.shape[-1:])
        for name, values in data.items()
    }
    config = ACTConfig(
        input_features={name: f for name, f in features.items() if name != "action"},
        output_features={"action": features["action"]},
        chunk_size=ROWS, n_action_steps=STEPS, dim_model=64, n_heads=4, dim_feedforward=128,
        n_encoder_layers=1, use_vae=False, dropout=0.0, device="cpu", push_to_hub=False,
    )  # fmt: skip
    stats = {
        name: {
            "mean": torch.from_numpy(values.reshape(-1, values.shape[-1]).mean(0)),
            "std": torch.from_numpy(values.reshape(-1, values.shape[-1]).std(0)),
        }
        for name, values in data.items()
    }
    config.normalization_mapping["ENV"] = NormalizationMode.MEAN_STD  # left as it is otherwise
    before, behind = make_pre_post_processors(config, dataset_stats=stats)
    policy = ACTPolicy(config)
    policy.train()
    seen = before({name: torch.from_numpy(values) for name, values in data.items()})
    tensors = {name: seen[name] for name in data}
    optimizer = torch.optim.AdamW(policy.parameters(), lr=1e-3)
    plan = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    padded, loss = torch.zeros(256, ROWS, dtype=torch.bool), torch.zeros(())
    for _ in range(steps):
        batch = torch.randint(len(tensors["action"]), (256,))
        seen = {name: values[batch] for name, values in tensors.items()}
        loss, _ = policy.forward({**seen, "action_is_pad": padded})
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        plan.step()
    for each in (policy, before, behind):
        each.save_pretrained(folder)
    return loss.item()


def reaching(folder: Path, address: str = "", **chunk: Any) -> dict[str, Any]:
    """Return the workflow that runs the policy of a folder; the facts that it lacks are given.

    Args:
        folder: of the policy.
        address: of a server; "": in a child.
        chunk: options of its chunks; the robot holds its place after an underrun.
    """
    from unicon_core.robots import load_robot

    robot = load_robot("arx_x5")
    given = {
        "period": 1.0 / FPS,
        "default_joint_pos": robot.default_joint_pos.tolist(),
        "stiffness": robot.joint_stiffness.tolist(),
        "damping": robot.joint_damping.tolist(),
        "observation": {"terms": {"environment_state": {"state": "goal"}}},
        "chunk": {"underrun": "done", **chunk},
    }
    runs = {"remote": {"address": address}} if address else {"child": True}
    policies = {"reach": {"path": str(folder.resolve()), "given": given, **runs}}
    return workflow(
        [goals(PAUSE, 99)],
        [{"chain": [{"zip": [{"call": "reach_act:NoTorque"}, {"policy": "reach"}]}, "hold"]}],
        policies=policies,
    )


@contextmanager
def serving(python: str, folder: Path, delay: float) -> Iterator[tuple[Any, SlowLink]]:
    """Run `unicon serve` in a process; yield it and the link to it.

    Args:
        python: that runs it.
        folder: of the policy.
        delay: of the link, there and back, in [s].
    """
    command = [python, "-m", "unicon_ros", "serve", str(folder), "--bind", "tcp://127.0.0.1:*"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=same_modules())
    assert process.stdout is not None
    try:
        for line in process.stdout:
            if found := re.search(r"tcp://\S+", line):
                with closing(SlowLink(found[0], delay / 2)) as link:
                    yield process, link
                return
        raise SystemExit(f"{' '.join(command)} ended with status {process.wait()}")
    finally:
        process.kill()
        process.communicate()


def evaluate(
    values: dict[str, Any], speed: Any, ticked: Callable[[Any], object] = bool, goals: int = GOALS
) -> tuple[list[float], Any]:
    """Run a workflow; how far the hand is from each goal when its time is over, in [m].

    Args:
        values: the workflow.
        speed: of its run.
        ticked: takes the states after each tick.
        goals: so many.
    """
    from unicon_core.runtime import Runner, RunOptions
    from unicon_core.workflow import Program

    missed: list[float] = []

    def look() -> None:
        ticks = int(states["tick"])
        ticked(states)
        if ticks % round(PAUSE * RATE) == round(PAUSE * RATE) - 1:
            missed.append(float(np.linalg.norm(states["hand_pose"][:3] - states["goal"])))

    program = Program(**values, deferred=[lambda: look()])
    states = program.states
    options = RunOptions(duration=(goals + 1) * PAUSE, speed=speed, warn=print)
    report = Runner(program, options).run()
    return missed[1:], report


class Failing:
    """Lets a server fail amid a run, and looks at the robot from then on.

    Attributes:
        oldest: age of the oldest action that ran, in [s].
        moved: how far a joint went in the last second, in [rad].
    """

    def __init__(self, kind: str, process: Any, link: SlowLink) -> None:
        self._kind, self._process, self._link = kind, process, link
        self._places: list[Any] = []
        self.oldest = 0.0

    def __call__(self, states: Any) -> None:
        """Look after a tick."""
        if states["tick"] == round(2.2 * PAUSE * RATE):
            if self._kind == "garbage":
                self._link.garbles = True
            else:
                number = {"kill": signal.SIGKILL, "stop": signal.SIGSTOP}[self._kind]
                self._process.send_signal(number)
        self.oldest = max(self.oldest, float(states["action_age"]))
        self._places.append(states["joint_pos"].copy())

    @property
    def moved(self) -> float:
        return float(np.ptp(self._places[-RATE:], axis=0).max())


def main() -> None:
    """Demonstrate, train and evaluate."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("out", type=Path, help="folder of the data set and the policy")
    parser.add_argument("--serve", metavar="PYTHON", help="runs the policy by `unicon serve`")
    parser.add_argument("--delay", type=float, default=0.0, help="of the link to it in [s]")
    parser.add_argument("--fail", choices=("kill", "stop", "garbage"), help="of the server")
    said = parser.parse_args()
    if (said.delay or said.fail) and not said.serve:
        parser.error("--delay and --fail are of a server; add --serve PYTHON")
    sys.path.insert(0, str(Path(__file__).parent))
    policy: Path = said.out / "policy"
    found: dict[str, Any] = {}
    if not policy.is_dir():
        said.out.mkdir(parents=True, exist_ok=True)
        dataset = demonstrate(said.out, 420.0)
        found["loss"] = train(windows(dataset), policy, 1200)
    if not said.serve:
        missed, report = evaluate(reaching(policy), "real")
    else:
        with serving(said.serve, policy, said.delay) as (process, link):
            failing = Failing(said.fail, process, link) if said.fail else None
            values = reaching(policy, link.address)
            missed, report = evaluate(values, "real", failing or bool, 3 if failing else GOALS)
        found |= {what: {k: round(v, 2) for k, v in times.items()}
                  for what, times in report.extra["remote"]["reach"].items()}  # fmt: skip
        if failing:
            found |= {"oldest": failing.oldest, "moved": failing.moved}
    found |= {
        "missed": [round(each, 4) for each in missed],
        "reached": sum(each < NEAR for each in missed),
        "goals": len(missed),
        "ended": report.ended,
        "faults": report.faults,
    }
    print(json.dumps(found))


if __name__ == "__main__":
    main()

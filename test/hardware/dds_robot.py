"""A process that looks like a robot behind DDS: a face in front of joints that follow, upright.

python dds_robot.py ROBOT FACE DOMAIN

It writes a JSON line for what a test wants to know: `ready`; `first`, how far the first command is
from where the joints are, in [rad]; and at the end on SIGTERM `end`, with the joints, the stiffness
of the last command, and what was refused.
"""

from __future__ import annotations

import importlib
import json
import signal
import sys
import time
from typing import Any

import numpy as np

from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states
from unicon_core.states.standard import hardware_states

# Share of the way to the target that a joint goes in a frame.
FOLLOWS = 0.02


def say(**words: Any) -> None:
    print(json.dumps(words), flush=True)


def main(name: str, module: str, domain: str) -> None:
    robot = load_robot(name)
    states = States(standard_states(robot.joint_names) | hardware_states(robot.joint_names))
    states["joint_pos"][...] = robot.rest_joint_pos
    states["base_quat"][...] = (1, 0, 0, 0)
    states["base_lin_acc"][...] = (0, 0, 9.81)
    made = importlib.import_module(module).face(states, robot, domain=int(domain))
    ended: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(1))
    say(ready=True)
    commands, period = 0, 1.0 / made.rate
    states["joint_pos_target"][...] = states["joint_pos"]
    rng = np.random.default_rng(1)
    before = time.monotonic()
    while not ended:
        states["base_ang_vel"][...] = rng.normal(size=3) * 1e-3  # or the IMU is told to stand still
        made.now = time.monotonic()
        made.tell()
        if made.hear():
            away = states["joint_pos_target"] - states["joint_pos"]
            if not commands:
                say(first=float(np.abs(away).max()))
            commands += 1
        driven = states["joint_stiffness"].any() or robot.position_controlled
        away = states["joint_pos_target"] - states["joint_pos"]
        now, step = time.monotonic(), FOLLOWS * driven * away
        states["joint_pos"] += step
        states["joint_vel"][...] = step / (now - before)
        before = now
        time.sleep(period)
    stiffness = float(states["joint_stiffness"].max())
    say(end=states["joint_pos"].tolist(), stiffness=stiffness, commands=commands)
    say(refused=dict(made.counts.refused))
    made.close()


if __name__ == "__main__":
    main(*sys.argv[1:])

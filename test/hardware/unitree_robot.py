"""A process that looks like a Unitree robot: our face in front of MuJoCo, in real time.

python unitree_robot.py ROBOT DOMAIN POSE [MODE]

It writes a JSON line for what a test wants to know: `ready`; `first`, how far the first command is
from where the joints are, in [rad]; and at the end on SIGTERM `end`, with the highest place of the
base in [m], where it is, the stiffness of the last command, and what was refused.
"""

from __future__ import annotations

import json
import signal
import sys
import time
from typing import Any

import numpy as np

from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.mujoco import make
from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states
from unicon_hardware.unitree.face import face


def say(**words: Any) -> None:
    print(json.dumps(words), flush=True)


def main(name: str, domain: str, pose: str, mode: str = "normal") -> None:
    robot = load_robot(name)
    states = States(standard_states(robot.joint_names))
    period = 1.0 / robot.transport["rate_hz"]
    body = make(states, robot, period, scene=Scene(initial_pose=pose))
    made = face(states, robot, domain=int(domain), mode=mode)
    ended: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(1))
    states["joint_damping"][...] = robot.joint_damping  # limp
    body.recv()
    say(ready=True)
    highest, commands, due = 0.0, 0, time.monotonic()
    while not ended:
        made.tell()
        if made.hear():
            if not commands:
                away = np.abs(states["joint_pos_target"] - states["joint_pos"]).max()
                say(first=float(away), stiffness=float(states["joint_stiffness"].max()))
            commands += 1
        body.send()
        body.recv()
        highest = max(highest, float(states["base_pos_w"][2]))
        due += period
        if time.monotonic() > due + 0.1:  # a busy machine: time goes on more slowly here
            due = time.monotonic()
        time.sleep(max(0.0, due - time.monotonic()))
    place = states["base_pos_w"].tolist()
    stiffness = float(states["joint_stiffness"].max())
    refused = dict(made.counts.refused)
    say(end=True, highest=highest, place=place, stiffness=stiffness, commands=commands)
    say(refused=refused, asked=made.asked)
    made.close()
    body.close()


if __name__ == "__main__":
    main(*sys.argv[1:])

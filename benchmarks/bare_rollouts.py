"""Bare rollouts: physics and network alone in a loop, the floor of `unicon bench sweep`.

`python -m`: reads how many rollouts to run, a line each, and answers with seconds of CPU and the
way in [m] of the last one. Nothing is checked, recorded, hashed or measured on the way.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from unicon_core.models.loaded import import_mujoco
from unicon_core.policies.networks.onnx import OnnxNetwork
from unicon_core.robots import joint_index
from unicon_core.workflow import load_workflow


def rollout_of(workflow: str, ticks: int) -> Callable[[], float]:
    """Return a function that runs one rollout of a policy that walks and returns its way in [m].

    Model, actuators and gains are those of the workflow's platform, so that the physics are the
    same; a tick is what no program can do without: the observation written, the network run on it,
    its action into controls, the physics stepped.

    Args:
        workflow: of the Go2 and its policy alone, which walks from its default pose on.
        ticks: of a rollout.
    """
    mujoco = import_mujoco()
    program = load_workflow(workflow)
    platform: Any = program.platform
    (contract,) = program.policies.values()
    model, data, steps = platform.model, platform.data, platform.decimation
    names = program.robot.joint_names
    command = np.array([0.5, 0.0, 0.0], np.float32)
    gains = np.zeros((5, len(names)))
    policy_from_robot = joint_index(contract.joints, names)
    gains[3][policy_from_robot], gains[4][policy_from_robot] = contract.stiffness, contract.damping
    servo = platform.robots[0].servo
    servo.push(data.ctrl, gains)
    joints = np.array(platform._loaded.joints)[policy_from_robot]
    at_pos, at_vel = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    actuators = np.array(servo.actuators)[policy_from_robot]
    first = data.qpos.copy()
    default, scale = contract.default_joint_pos, np.float32(0.25)
    observation, action = np.zeros((1, 45), np.float32), np.zeros((1, 12), np.float32)
    network = OnnxNetwork(contract.model)
    memory = {x.name: np.zeros((1, int(x.shape[1])), np.float32) for x in network.inputs[1:]}
    following = {pair.output: memory[pair.input].copy() for pair in contract.recurrent}
    pairs = [(memory[pair.input], following[pair.output]) for pair in contract.recurrent]
    run = network.bind({"obs": observation, **memory}, {"actions": action, **following})
    row, rotation = observation[0], data.xmat[1].reshape(3, 3)

    def rollout() -> float:
        mujoco.mj_resetData(model, data)
        data.qpos[:] = first
        mujoco.mj_forward(model, data)
        action[...] = 0.0
        for held, _ in pairs:
            held[...] = 0.0
        qpos, qvel, ctrl = data.qpos, data.qvel, data.ctrl
        for _ in range(ticks):
            row[0:3] = qvel[3:6] * 0.25
            row[3:6] = -rotation[2]
            row[6:9] = command * 2.0
            row[9:21] = qpos[at_pos] - default
            row[21:33] = qvel[at_vel] * 0.05
            row[33:45] = action[0]
            run()
            for held, told in pairs:
                held[...] = told
            np.clip(action, -8.0, 8.0, out=action)
            ctrl[actuators] = default + scale * action[0]
            mujoco.mj_step(model, data, steps)
        return float(qpos[0] - first[0])

    return rollout


def main() -> int:
    """Run rollouts as asked for until the input ends."""
    rollout, way = rollout_of(sys.argv[1], int(sys.argv[2])), 0.0
    for line in sys.stdin:
        begin = time.process_time()
        for _ in range(int(line)):
            way = rollout()
        print(time.process_time() - begin, way, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())

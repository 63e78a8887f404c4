"""The official unitree_sdk2_python as robot or as controller, for test_unitree_sdk.py.

python unitree_sdk_peer.py robot|controller go|hg DOMAIN COUNT

It runs where the SDK runs, and imports nothing of ours. Both sides draw message i from a generator
seeded with i. It says `{"ready": true}`, and at the end how many messages were equal.
"""

import importlib
import json
import struct
import sys
import threading
import time

import numpy as np
from unitree_sdk2py.core.channel import (
    ChannelFactoryInitialize,
    ChannelPublisher,
    ChannelSubscriber,
)
from unitree_sdk2py.utils.crc import CRC

COMMAND = ("q", "dq", "tau", "kp", "kd")
MOTORS = {"go": 12, "hg": 29}


def values(i, count):
    """Return the numbers of message i, exact in float32."""
    return np.random.default_rng(i).standard_normal(count).astype(np.float32).tolist()


def fill_state(state, i, kind):
    n = MOTORS[kind]
    numbers = values(i, 3 * n + 10)
    quat = np.array(numbers[-10:-6], np.float64)
    quat = (quat / np.linalg.norm(quat)).astype(np.float32).tolist()
    state.tick = i + 1
    state.imu_state.quaternion = quat
    state.imu_state.gyroscope = numbers[-6:-3]
    state.imu_state.accelerometer = numbers[-3:]
    state.wireless_remote = [(i + k) % 256 for k in range(40)]
    for k in range(n):
        motor = state.motor_state[k]
        motor.q, motor.dq, motor.tau_est = numbers[k], numbers[n + k], numbers[2 * n + k]
        if kind == "go":
            motor.temperature = (i + k) % 128
        else:
            motor.temperature = [(i + k) % 100, (3 * i + k) % 100]
            motor.motorstate = i % 7
    if kind == "go":
        state.foot_force = [i % 300, 2, -3, 4]
        state.bms_state.soc = i % 101
        state.power_v = 25.0 + i % 8
    else:
        state.mode_machine = 5
    return state


def equal_command(command, i, kind):
    n = MOTORS[kind]
    numbers = values(i, 5 * n)
    for k in range(n):
        motor = command.motor_cmd[k]
        wanted = [numbers[row * n + k] for row in range(5)]
        if [getattr(motor, key) for key in COMMAND] != wanted or motor.mode != 1:
            return False
    if kind == "go":
        idle = command.motor_cmd[n]
        if (idle.q, idle.dq) != (struct.unpack("f", struct.pack("f", 2.146e9))[0], 16000.0):
            return False
        return list(command.head) == [0xFE, 0xEF] and command.level_flag == 0xFF
    return command.mode_machine == 5 and command.mode_pr == 0


def fill_command(command, i, kind):
    n = MOTORS[kind]
    numbers = values(i, 5 * n)
    for k in range(n):
        motor = command.motor_cmd[k]
        motor.mode = 1
        for row, key in enumerate(COMMAND):
            setattr(motor, key, numbers[row * n + k])
    if kind == "go":
        command.head, command.level_flag = [0xFE, 0xEF], 0xFF
    else:
        command.mode_machine, command.mode_pr = 5, 0
    return command


def equal_state(state, i, kind, template):
    wanted = fill_state(template, i, kind)
    got, n = state, MOTORS[kind]
    pairs = [(got.tick, wanted.tick)]
    pairs += [
        (list(getattr(got.imu_state, key)), list(getattr(wanted.imu_state, key)))
        for key in ("quaternion", "gyroscope", "accelerometer")
    ]
    pairs.append((list(got.wireless_remote), list(wanted.wireless_remote)))
    for k in range(n):
        ours, theirs = got.motor_state[k], wanted.motor_state[k]
        pairs += [(getattr(ours, key), getattr(theirs, key)) for key in ("q", "dq", "tau_est")]
    return all(a == b for a, b in pairs)


def main(role, kind, domain, count):
    ChannelFactoryInitialize(int(domain), "lo")
    default = importlib.import_module("unitree_sdk2py.idl.default")
    types = importlib.import_module(f"unitree_sdk2py.idl.unitree_{kind}.msg.dds_")
    state = getattr(default, f"unitree_{kind}_msg_dds__LowState_")()
    command = getattr(default, f"unitree_{kind}_msg_dds__LowCmd_")()
    crc, done, last = CRC(), threading.Event(), int(count)
    robot = role == "robot"
    told = {"equal": 0, "crc": 0, "count": 0}
    out = ChannelPublisher(
        *(("rt/lowstate", types.LowState_) if robot else ("rt/lowcmd", types.LowCmd_))
    )
    out.Init()

    def answer(i):
        message = fill_state(state, i, kind) if robot else fill_command(command, i, kind)
        message.crc = crc.Crc(message)
        out.Write(message)

    def heard(message):
        i = told["count"]
        good = equal_command(message, i, kind) if robot else equal_state(message, i, kind, state)
        if not good and i and (robot and equal_command(message, i - 1, kind)):
            answer(i - 1)  # it was sent again
            return
        told["count"] += 1
        told["equal"] += good
        told["crc"] += crc.Crc(message) == message.crc
        answer(i)
        if told["count"] == last:
            done.set()

    if not robot:
        from unitree_sdk2py.comm.motion_switcher.motion_switcher_client import MotionSwitcherClient

        switcher = MotionSwitcherClient()
        switcher.SetTimeout(5.0)
        switcher.Init()
        before = switcher.CheckMode()
        released = switcher.ReleaseMode()
        print(json.dumps({"modes": [before, released, switcher.CheckMode()]}), flush=True)
    into = ChannelSubscriber(
        *(("rt/lowcmd", types.LowCmd_) if robot else ("rt/lowstate", types.LowState_))
    )
    into.Init(heard, 10)
    print(json.dumps({"ready": True}), flush=True)
    done.wait(240)
    time.sleep(0.2)
    print(json.dumps(told), flush=True)


main(*sys.argv[1:])

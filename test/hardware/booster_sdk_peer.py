"""The vendor's booster_robotics_sdk_python as controller, for test_booster_sdk.py.

python booster_sdk_peer.py DOMAIN COUNT

It runs where the SDK runs, and imports nothing of ours. Both sides draw message i from a generator
seeded with i. It says `{"ready": true}`, what its service was answered, and at the end how many
states were equal.
"""

import json
import sys
import threading
import time

import booster_robotics_sdk_python as sdk
import numpy as np

N = 23


def say(**words):
    print(json.dumps(words), flush=True)


def values(i, count):
    """Return the numbers of message i, exact in float32."""
    return np.random.default_rng(i).standard_normal(count).astype(np.float32).tolist()


def equal_state(state, i):
    numbers = values(i, 3 * N + 6)
    got = [*state.imu_state.gyro, *state.imu_state.acc]
    equal = got == numbers[3 * N :]
    for motors in (state.motor_state_serial, state.motor_state_parallel):
        equal = equal and len(motors) == N
        for k, motor in enumerate(motors):
            equal = equal and [motor.q, motor.dq, motor.tau_est] == numbers[k : 3 * N : N]
            equal = equal and motor.temperature == (i + k) % 100
            equal = equal and list(motor.reserve) == [(i * k) % 256, 0]
    return equal


def command(i):
    made, numbers = sdk.LowCmd(), values(i, 5 * N)
    made.cmd_type = sdk.LowCmdType.SERIAL
    motors = [sdk.MotorCmd() for _ in range(N)]
    for k, motor in enumerate(motors):
        motor.q, motor.dq, motor.tau, motor.kp, motor.kd = numbers[k : 5 * N : N]
    made.motor_cmd = motors
    return made


def asked(call):
    try:
        return call() or 0
    except Exception as error:  # the SDK raises where the status is not 0
        return str(error)


def main(domain, count):
    sdk.ChannelFactory.Instance().Init(int(domain), "127.0.0.1")
    told, done = {"equal": 0, "count": 0}, threading.Event()
    publisher = sdk.B1LowCmdPublisher()
    publisher.InitChannel()

    def heard(state):
        i = round(state.imu_state.rpy[0] * 1000.0)
        if i < told["count"]:
            publisher.Write(command(i))  # it was told again, since a command was lost
            return
        told["equal"] += i == told["count"] and equal_state(state, i)
        told["count"] = i + 1
        publisher.Write(command(i))
        if told["count"] == int(count):
            done.set()

    gamepad = sdk.B1RemoteControllerStatePublisher()
    gamepad.InitChannel()
    client = sdk.B1LocoClient()
    client.Init()
    say(ready=True)
    say(there=client.WaitForService(10000))
    say(mode=int(client.GetMode().mode))
    say(early=asked(lambda: client.ChangeMode(sdk.RobotMode.kCustom)))
    publisher.Write(command(0))
    time.sleep(0.3)
    say(custom=asked(lambda: client.ChangeMode(sdk.RobotMode.kCustom)))
    say(mode_now=int(client.GetMode().mode))
    subscriber = sdk.B1LowStateSubscriber(heard)
    subscriber.InitChannel()
    done.wait(120.0)
    held = sdk.RemoteControllerState()
    held.event, held.lx, held.ly, held.a, held.rb, held.hat_lu = 0x603, 0.5, -1.0, True, True, True
    say(**told)
    while True:  # until it is killed
        gamepad.Write(held)
        time.sleep(0.02)


if __name__ == "__main__":
    main(*sys.argv[1:])

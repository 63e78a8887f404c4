"""The vendor's own code as a T1, for test_booster_sdk.py.

python booster_robot_peer.py LIBRARY DOMAIN COUNT

LIBRARY is booster_robot.cpp, compiled. It runs where the SDK runs, and imports nothing of ours.
Both sides draw message i from a generator seeded with i. It says `{"ready": true}`, `{"mode": …}`
once that is custom, and at the end how many commands were equal, and the mode that is left.
"""

import ctypes
import json
import os
import sys
import time

import numpy as np

N, CUSTOM = 23, 3
ANKLES = [15, 16, 21, 22]
EFFORT = np.array([20.0, 15.0, 20.0, 15.0], np.float32)
FLOATS, WORDS = ctypes.POINTER(ctypes.c_float), ctypes.POINTER(ctypes.c_uint32)
PATIENCE = 5.0


def say(**words):
    print(json.dumps(words), flush=True)


def values(i, count):
    """Return the numbers of message i."""
    return np.random.default_rng(i).standard_normal(count).astype(np.float32)


class Robot:
    def __init__(self, library, domain):
        sys.setdlopenflags(os.RTLD_NOW | os.RTLD_GLOBAL)
        import booster_robotics_sdk_python  # noqa: F401 (holds what the library needs)

        self.library = ctypes.CDLL(library, mode=os.RTLD_NOW | os.RTLD_GLOBAL)
        self.library.begin(int(domain))
        self.heard = np.zeros(2 + 6 * N, np.float32)

    def tell(self, i):
        numbers, words = values(i, 4 * N), np.zeros((N, 4), np.uint32)
        imu = np.concatenate(([i / 1000.0], values(i + 1, 8))).astype(np.float32)
        imu[1:3] *= 0.1
        words[:, 0], words[:, 1] = (i + np.arange(N)) % 100, i
        words[:, 2], words[:, 3] = (i * np.arange(N)) % 256, 500
        self.library.tell(
            imu.ctypes.data_as(FLOATS),
            numbers.ctypes.data_as(FLOATS),
            words.ctypes.data_as(WORDS),
            i % (N + 1),
        )
        return numbers.reshape(N, 4)[:, 0]

    def command(self):
        self.library.heard(self.heard.ctypes.data_as(FLOATS))
        return self.heard[:2].tolist(), self.heard[2:].reshape(N, 6)


def equal(head, got, i, measured):
    """Tell whether a command is number i, with ankles by torques."""
    wanted = np.zeros((N, 6), np.float32)
    wanted[:, :5] = values(i, 5 * N).reshape(5, N).T
    torque = wanted[ANKLES, 3] * (wanted[ANKLES, 0] - measured[ANKLES]) + wanted[ANKLES, 2]
    wanted[ANKLES, 0], wanted[ANKLES, 3] = measured[ANKLES], 0.0
    wanted[ANKLES, 2] = np.clip(torque, -EFFORT, EFFORT)
    return head == [1.0, N] and np.array_equal(got, wanted)


def main(library, domain, count):
    robot, told = Robot(library, domain), 0
    say(ready=True)
    while robot.library.mode_now() != CUSTOM:
        robot.tell(0)
        time.sleep(0.005)
    say(mode=CUSTOM)
    for i in range(int(count)):
        end, again, good = time.monotonic() + PATIENCE, 0.0, False
        while not good and time.monotonic() < end:
            if time.monotonic() > again:
                measured, again = robot.tell(i), time.monotonic() + 0.1
            good = equal(*robot.command(), i, measured)
            time.sleep(0.0003)
        told += good
    say(equal=told)
    while robot.library.mode_now() == CUSTOM:
        robot.tell(int(count))
        time.sleep(0.01)
    say(left=robot.library.mode_now())


if __name__ == "__main__":
    main(*sys.argv[1:])

"""unitree_mujoco's Python simulator without a window, as robot for test_unitree_mujoco.py.

python unitree_mujoco_peer.py CHECKOUT ROBOT DOMAIN PERIOD SLOWER

It runs where the SDK runs, and imports nothing of ours. The simulator's own program, bridge and
robot are used as they are; its configuration and the window are replaced, and its scene, which has
stairs and stones in the way, by a floor. PERIOD is of its physics in [s]. Its time goes SLOWER
times slower than the wall's: it computes torques only when a command comes, which has to be often,
and a thousand messages in a second are more than its Python carries on a small machine.

The keys that a user would press in the window come in as lines: 8 lets the elastic band out by
0.1 m, 9 takes it off or on. It says JSON lines: the simulator's time and the wall's in [s], the
base's position in [m], how upright it is (z of its z axis), and the largest torque that is asked
for, in [N·m].
"""

import functools
import importlib
import json
import os
import runpy
import sys
import tempfile
import threading
import time
import types

import mujoco
from unitree_sdk2py.utils import thread

SCENE = """<mujoco model="flat">
  <include file="{model}"/>
  <worldbody>
    <light pos="0 0 1.5" dir="0 0 -1" directional="true"/>
    <geom name="floor" size="0 0 0.05" type="plane"/>
  </worldbody>
</mujoco>
"""
MODELS = {"go2": "go2.xml", "g1": "g1_29dof.xml"}
EVERY = 5  # calls of sync, which come each 20 ms


class Viewer:
    """What the simulator takes for its window."""

    def __init__(self, slower, model, data, key_callback=None):
        self.data, self.slower, self.calls, self.ahead = data, slower, 0, None
        if key_callback is not None:
            threading.Thread(target=self._keys, args=(key_callback,), daemon=True).start()

    def _keys(self, press):
        for line in sys.stdin:
            press(ord(line[0]))  # GLFW's numbers of the digits are their characters

    def is_running(self):
        """Be asked once before each step, and once with each picture; hold back the steps."""
        if "Simulation" in threading.current_thread().name:
            now, due = time.monotonic(), self.slower * self.data.time
            if self.ahead is None or self.ahead + due < now - 0.1:  # it does not catch up
                self.ahead = now - due
            time.sleep(max(0.0, self.ahead + due - now))
        return True

    def sync(self):
        self.calls += 1
        if self.calls % EVERY:
            return
        data = self.data
        _, x, y, _ = data.qpos[3:7]
        words = {
            "time": data.time,
            "wall": time.monotonic(),
            "place": data.qpos[:3].tolist(),
            "upright": 1.0 - 2.0 * (x * x + y * y),
            "torque": float(abs(data.ctrl).max()),
        }
        print(json.dumps(words), flush=True)


def scene(checkout, robot, folder):
    """Write a floor beside links to the robot's files; return it."""
    files = os.path.join(checkout, "unitree_robots", robot)
    for name in os.listdir(files):
        if name != "scene.xml":
            os.symlink(os.path.join(files, name), os.path.join(folder, name))
    path = os.path.join(folder, "scene.xml")
    with open(path, "w") as file:
        file.write(SCENE.format(model=MODELS[robot]))
    return path


def slowly(slower, thread, interval, **more):
    """Make a thread of the SDK that does something again and again, in the simulator's time."""
    return thread(interval=slower * interval, **more)


def main(checkout, robot, domain, period, slower):
    checkout = os.path.abspath(checkout)
    sys.setswitchinterval(0.0002)  # its threads wait for each other, by default 5 ms and more
    simulator = os.path.join(checkout, "simulate_python")
    sys.path.insert(0, simulator)
    window = types.ModuleType("mujoco.viewer")
    window.launch_passive = functools.partial(Viewer, float(slower))
    sys.modules["mujoco.viewer"] = mujoco.viewer = window
    sys.modules.setdefault("pygame", types.ModuleType("pygame"))  # for a joystick, which is off
    thread.RecurrentThread = functools.partial(slowly, float(slower), thread.RecurrentThread)
    if not hasattr(mujoco, "glfw"):
        keys = types.SimpleNamespace(KEY_7=ord("7"), KEY_8=ord("8"), KEY_9=ord("9"))
        mujoco.glfw = types.SimpleNamespace(glfw=keys)
    config = importlib.import_module("config")
    with tempfile.TemporaryDirectory() as folder:
        config.ROBOT, config.ROBOT_SCENE = robot, scene(checkout, robot, folder)
        config.DOMAIN_ID, config.INTERFACE = int(domain), "lo"
        config.USE_JOYSTICK, config.PRINT_SCENE_INFORMATION = 0, False
        config.ENABLE_ELASTIC_BAND = robot == "g1"
        config.SIMULATE_DT = float(period)
        runpy.run_path(os.path.join(simulator, "unitree_mujoco.py"), run_name="__main__")


main(*sys.argv[1:])

"""go2_walk and g1_walk on platform `unitree`, against unitree_mujoco's Python simulator as robot.

UNICON_UNITREE_MUJOCO names a checkout of unitreerobotics/unitree_mujoco, UNICON_UNITREE_SDK one of
unitree_sdk2_python, UNICON_UNITREE_PYTHON a Python with cyclonedds 0.10.2, NumPy and mujoco. Both
the simulator and the workflow go SLOWER times slower than the wall (UNICON_UNITREE_SLOWER), so that
the simulator's 500 commands in a second of its own time fit a machine that others use, too.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-unitree]'")

from unicon_ros.bench.report import free_domain

pytestmark = [pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(500)]

PEER = Path(__file__).with_name("unitree_mujoco_peer.py")
POLICIES = Path(__file__).resolve().parents[2] / "config/policies"
PHYSICS = 0.002  # s
SLOWER = float(os.environ.get("UNICON_UNITREE_SLOWER", "10"))
# Patient with a simulator that a busy machine holds up.
STOPS = "stale_stop", "imu_stop", "encoder_stop"


class Simulator:
    """unitree_mujoco in a process of its own, and what it says."""

    def __init__(self, robot: str) -> None:
        given = {
            name: os.environ.get(f"UNICON_UNITREE_{name}", "")
            for name in ("MUJOCO", "SDK", "PYTHON")
        }
        for name, what in (
            ("MUJOCO", "a checkout of unitree_mujoco"),
            ("SDK", "a checkout of unitree_sdk2_python"),
            ("PYTHON", "a Python with cyclonedds 0.10.2, NumPy and mujoco"),
        ):
            if not given[name]:
                pytest.skip(f"UNICON_UNITREE_{name} does not name {what}")
        self.domain = free_domain()
        options = [robot, str(self.domain), str(PHYSICS), str(SLOWER)]
        self.process = subprocess.Popen(
            [given["PYTHON"], str(PEER), given["MUJOCO"], *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": given["SDK"]},
        )
        self.said: list[dict[str, Any]] = []
        self._reading = threading.Thread(target=self._read)
        self._reading.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if line.startswith("{"):
                self.said.append(json.loads(line))

    def wait_for(self, condition: Callable[[dict[str, Any]], bool], patience: float = 120) -> None:
        end = time.monotonic() + patience
        while not (self.said and condition(self.said[-1])):
            assert time.monotonic() < end, self.said[-1:]
            assert self.process.poll() is None, "the simulator has ended"
            time.sleep(0.05)

    def press(self, key: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{key}\n")
        self.process.stdin.flush()

    def end(self) -> None:
        self.process.kill()
        self.process.wait()
        self._reading.join()


@pytest.fixture
def simulators() -> Iterator[Callable[[str], Simulator]]:
    made: list[Simulator] = []

    def start(robot: str) -> Simulator:
        made.append(Simulator(robot))
        return made[-1]

    yield start
    for simulator in made:
        simulator.end()


def slower(policy: Path, contract: str, folder: Path, period: tuple[str, str]) -> Path:
    """Copy a policy with another period in its contract."""
    copy = folder / "policy"
    shutil.copytree(policy, copy)
    text = (copy / contract).read_text()
    assert period[0] in text
    (copy / contract).write_text(text.replace(*period))
    return copy


def run(workflow: str, simulator: Simulator, folder: Path, *sets: str) -> subprocess.Popen[str]:
    options = f"address: lo, domain: {simulator.domain}, peer: unitree_mujoco"
    stops = ", ".join(f"{{{name}: {{timeout: 5.0}}}}" for name in STOPS)
    every = (
        "platform=unitree",
        f"platforms={{unitree: {{{options}, silence: 5, connect: 30}}}}",
        f"rate={1.0 / (SLOWER * PHYSICS):g}",
        "pacing.hang=20",
        f"safety=[finite, joint_limits, tilt_stop, {stops}]",
        *sets,
    )
    command = [sys.executable, "-m", "unicon_ros", "run", workflow, "--yes", "--quiet"]
    command += ["--force", "timing.period", f"--report={folder / 'report.json'}"]
    with (folder / "run.txt").open("w") as said:
        return subprocess.Popen(
            [*command, *(f"--set={each}" for each in every)],
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=subprocess.STDOUT,
        )


def test_go2_stands_up_and_walks_three_metres(
    simulators: Callable[[str], Simulator], tmp_path: Path
) -> None:
    simulator = simulators("go2")
    simulator.wait_for(lambda now: now["time"] > 1.5)  # it has fallen on its belly
    assert simulator.said[-1]["place"][2] < 0.15
    begin = simulator.said[-1]["place"]
    period = "period: 0.02", f"period: {SLOWER * 0.02:g}"
    policy = slower(POLICIES / "go2_velocity", "policy.yaml", tmp_path, period)
    stand, walk = 1.5 * SLOWER, 5.5 * SLOWER
    schedule = f"[[0, 0, 0, 0], [{stand}, 0.8, 0, 0], [{stand + walk - SLOWER}, 0, 0, 0]]"
    driven = run(
        "go2_walk",
        simulator,
        tmp_path,
        f"policies.walk={policy}",
        f"commands=[{{velocity_command: {{schedule: {schedule}}}}}]",
        f"flow.chain.0.pose.duration={SLOWER}",
        f"flow.chain.1.hold.duration={0.5 * SLOWER}",
        f"flow.chain.2={{loop: {{do: {{policy: walk}}, until: {{elapsed: {walk}}}}}}}",
        f"flow.chain.3.hold.duration={0.5 * SLOWER}",
        f"flow.chain.4.pose.duration={SLOWER}",
        f"flow.chain.5.damp.duration={0.5 * SLOWER}",
        f"duration={20 * SLOWER}",
        f"start.fade_in={0.3 * SLOWER}",
    )
    said = len(simulator.said)
    assert driven.wait(300) == 0, (tmp_path / "run.txt").read_text()
    seen = simulator.said[said:]
    report = json.loads((tmp_path / "report.json").read_text())
    heights = [each["place"][2] for each in seen]
    told(simulator, begin)
    assert report["ended"] == "done"
    assert seen[-1]["place"][0] - begin[0] >= 3.0
    assert max(heights) > 0.25  # it stood
    assert heights[-1] < 0.2  # and lies again
    assert min(each["upright"] for each in seen) > 0.8


def test_g1_walks_when_its_band_is_taken_off(
    simulators: Callable[[str], Simulator], tmp_path: Path, assets: Path
) -> None:
    simulator = simulators("g1")
    simulator.wait_for(lambda now: now["time"] > 1.0)  # it hangs
    period = "step_dt: 0.02", f"step_dt: {SLOWER * 0.02:g}"
    policy = slower(assets / "policies/g1_velocity_mjlab", "deploy.yaml", tmp_path, period)
    seconds = 14
    driven = run(
        "g1_walk",
        simulator,
        tmp_path,
        f"policies.walk.path={policy}",
        f"duration={seconds * SLOWER}",
        f"start.fade_in={0.3 * SLOWER}",
        f"start.approach={2 / SLOWER}",
    )
    simulator.wait_for(lambda now: now["torque"] > 1.0 or driven.poll() is not None)
    assert driven.poll() is None, (tmp_path / "run.txt").read_text()
    began = simulator.said[-1]["time"]
    simulator.wait_for(lambda now: now["time"] > began + 1.0)
    for _ in range(30):  # let it down until the feet bear it
        if simulator.said[-1]["place"][2] < 0.80:
            break
        simulator.press("8")
        at = simulator.said[-1]["time"]
        simulator.wait_for(lambda now, at=at: now["time"] > at + 0.1)
    simulator.press("9")
    begin, said = simulator.said[-1]["place"], len(simulator.said)
    assert driven.wait(400) == 0, (tmp_path / "run.txt").read_text()
    seen = [each for each in simulator.said[said:] if each["torque"] > 0]
    told(simulator, begin)
    whole = [each for each in seen if each["time"] < seen[-1]["time"] - 1.0]  # then it is damped
    assert whole[-1]["place"][0] - begin[0] >= 2.0
    assert min(each["place"][2] for each in whole) > 0.6
    assert min(each["upright"] for each in whole) > 0.8


def told(simulator: Simulator, begin: list[float]) -> None:
    """Print how far it went, and at which share of real time."""
    a, b = simulator.said[0], simulator.said[-1]
    speed = (b["time"] - a["time"]) / (b["wall"] - a["wall"])
    way = [round(after - before, 2) for after, before in zip(b["place"], begin)]
    print(f"went {way} m; {speed:.3f} of real time, {1 / SLOWER:.3f} wanted")

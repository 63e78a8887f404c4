"""A run in real time while peers come, command, fall silent and are killed: all of it is noticed.

Each round a peer comes and commands a velocity, which has to reach the joints; then something
goes wrong with it, which the run has to notice. Others come, look on and go. In the end the robot
itself is killed.
"""

from __future__ import annotations

import math
import os
import signal
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_watch import CommandWatch, Heard
from peer import Peer
from standin_runs import begun, ended, said, stand_in

from unicon_core.robots import load_robot

WORKFLOW = """\
schema: unicon.workflow/1
robot: go2
platform: ros
rate: 50
commands: [{{velocity_command: {{constant: [0.0, 0.0, 0.0]}}}}]
flow: {{sway: {{gains: {{"*_hip_joint": [{gain}, 0, 0]}}, time_constant: 0.0}}}}
"""
GAIN = 0.5
"""In [rad] of the hips for each m/s."""
TIMEOUT = 0.5
"""Of `cmd_vel` in config/maps/default.yaml, [s]."""
ROOM = 1.5
"""For a busy machine in [s]."""
COMING = 15.0
"""In which a peer and a run find each other, [s]."""
HIGHEST = 1.0
"""Velocity that the run allows in [m/s]."""
GROWTH = 1_000_000
"""In [B]."""
HIPS = slice(0, None, 3)
KINDS = ("silent", "leave", "SIGKILL", "SIGSTOP", "nan", "1e30")

pytestmark = [pytest.mark.ros, pytest.mark.slow]
Start = Callable[..., Peer]


class Comings:
    """Peers that come and go around a run, at random moments.

    Args:
        peers: starts them.
        watch: hears what the robot is commanded.
        rest: the joints while nobody commands, shape (n,).
        seed: of what happens when.

    Attributes:
        noticed: how long each kind of fault took to be noticed in [s]; NaN for what was missed.
        nans: messages that were to be refused.
        came: peers so far.
    """

    def __init__(self, peers: Start, watch: CommandWatch, rest: np.ndarray, seed: int) -> None:
        self._peers, self._watch, self._rest = peers, watch, rest
        self._random = np.random.default_rng(seed)
        self._onlookers: list[tuple[float, Peer]] = []
        self._bag: list[str] = []
        self.noticed: list[tuple[str, float]] = []
        self.obeyed: list[float] = []
        self.nans = self.came = 0

    def round(self) -> None:
        """One commander comes, commands, and something happens to it."""
        self._look_on()
        if not self._bag:  # each kind once, in an order drawn anew
            self._bag = [str(kind) for kind in self._random.permutation(KINDS)]
        kind = self._bag.pop()
        peer = self._come()
        speed = float(self._random.uniform(0.2, 0.9))
        self.obeyed.append(self.reaches(speed, self._told(peer, "say", f"say {speed}"), COMING))
        time.sleep(self._random.uniform(0.2, 1.0))
        wanted = HIGHEST if kind == "1e30" else 0.0
        at = self._go_wrong(peer, kind)
        self.noticed.append((kind, self.reaches(wanted, at, TIMEOUT + ROOM)))
        if kind == "SIGSTOP":  # a process that is woken up commands again
            peer.process.send_signal(signal.SIGCONT)
            self.obeyed.append(self.reaches(speed, time.monotonic(), COMING))
        if kind == "nan":
            began = peer.of("say")[-1]["count"]
            self._told(peer, "silent", "silent")
            self.nans += peer.of("silent")[-1]["count"] - began
        peer.kill()
        if kind in ("SIGSTOP", "1e30"):  # it was commanding until now
            self.noticed.append(("SIGKILL", self.reaches(0.0, time.monotonic(), TIMEOUT + ROOM)))
        time.sleep(self._random.uniform(0.0, 1.5))

    def _go_wrong(self, peer: Peer, kind: str) -> float:
        """Let it happen, and return when."""
        if kind in ("SIGKILL", "SIGSTOP"):
            os.kill(peer.process.pid, getattr(signal, kind))
            return time.monotonic()
        if kind in ("nan", "1e30"):
            return self._told(peer, "say", f"say {kind}")
        return self._told(peer, kind, kind)

    def _look_on(self) -> None:
        """Others come and go, well and badly."""
        now = time.monotonic()
        for due, peer in list(self._onlookers):
            if due < now:
                self._onlookers.remove((due, peer))
                how = self._random.integers(3)
                if how == 0 and peer.process.poll() is None:
                    peer.tell("leave")
                elif how == 1:
                    peer.process.send_signal(signal.SIGSTOP)  # and is killed later on
                    self._onlookers.append((now + 15.0, peer))
                else:
                    peer.kill()
        if len(self._onlookers) < 3 and self._random.random() < 0.5:
            stays = float(self._random.uniform(2.0, 20.0))
            self._onlookers.append((now + stays, self._come()))
        if self._random.random() < 0.1:
            self.came += 1
            caller = self._peers("caller", "unicon", "clear_estop")
            os.setpriority(os.PRIO_PROCESS, caller.process.pid, 10)
            status, errors = caller.end()
            assert status == 0, errors

    def _come(self) -> Peer:
        self.came += 1
        peer = self._peers("passer_by")
        os.setpriority(os.PRIO_PROCESS, peer.process.pid, 10)  # starting takes a second of a core
        peer.wait_for(lambda: bool(peer.of("ready")), "a peer", timeout=30.0)
        return peer

    def _told(self, peer: Peer, kind: str, line: str) -> float:
        """Tell a peer something and return when it was done, on `time.monotonic`."""
        count = len(peer.of(kind))
        peer.tell(line)
        peer.wait_for(lambda: len(peer.of(kind)) > count, f"{line!r} of a peer")
        return float(peer.of(kind)[-1]["at"])

    def reaches(self, speed: float, since: float, timeout: float) -> float:
        """Return how long the joints took to be told a velocity [m/s]; NaN for not in time, [s]."""

        def there(heard: Heard) -> bool:
            return bool(np.abs(heard.target[HIPS] - self._rest[HIPS] - GAIN * speed).max() < 1e-3)

        return self._watch.first(since, there, timeout)


@pytest.mark.parametrize(
    "seconds",
    [
        pytest.param(90.0, marks=pytest.mark.timeout(400), id="90 s"),
        pytest.param(600.0, marks=pytest.mark.timeout(1200), id="10 min"),
    ],
)
def test_no_fault_is_missed_and_no_memory_grows_while_peers_come_and_go(
    processes: Start,
    peers: Start,
    watches: Callable[[str], CommandWatch],
    tmp_path: Path,
    seconds: float,
) -> None:
    robot = stand_in(processes, "go2", "--posture=default")
    workflow = tmp_path / "soak.yaml"
    workflow.write_text(WORKFLOW.format(gain=GAIN))
    run = begun(workflow, tmp_path, seconds=1e5, more=["--ros"])
    rest = load_robot("go2").default_joint_pos
    comings = Comings(peers, watches("go2"), rest, seed=round(seconds))
    robot.wait_for(lambda: bool(robot.of("commands")), "50 commands", timeout=60.0)
    began = time.monotonic()
    assert not math.isnan(comings.reaches(0.0, began, 20.0))
    memory: list[tuple[float, int]] = []
    while time.monotonic() < began + seconds:
        comings.round()
        assert run.poll() is None, said(tmp_path)
        memory.append((time.monotonic() - began, resident(run.pid)))
    robot.kill()
    driven = ended(run, robot, tmp_path)
    growth = grown(memory, seconds)
    topic = driven.report["bridge"]["topics"]["/cmd_vel"]
    times = [took for _, took in comings.noticed]
    facts = {
        "peers": comings.came,
        "faults": Counter(kind for kind, _ in comings.noticed),
        "missed": [kind for kind, took in comings.noticed if math.isnan(took)],
        "noticed after [s]": np.round(np.nanpercentile(times, [0, 50, 99, 100]), 3).tolist(),
        "not obeyed": sum(map(math.isnan, comings.obeyed)),
        "obeyed after [s]": np.round(np.nanpercentile(comings.obeyed, [50, 100]), 3).tolist(),
        "refused": (topic["rejected"], comings.nans),
        "rss growth [kB]": growth / 1000,
        "overruns": driven.report["overruns"],
        "ticks": driven.report["ticks"],
    }
    print(facts)
    assert facts["missed"] == [], facts
    assert facts["not obeyed"] == 0, facts
    assert 0.5 * comings.nans <= topic["rejected"] + topic["dropped"], facts
    assert (driven.status, len(driven.report["faults"])) == (3, 1), driven.report["faults"]
    # Whichever looks first: the set of a robot at its stamps, the platform at its topics.
    assert any(word in driven.report["faults"][0] for word in ("stale", "no message for"))
    assert growth < GROWTH, (facts, memory)


def resident(pid: int) -> int:
    """Return the resident memory of a process in [B]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def grown(memory: list[tuple[float, int]], seconds: float) -> float:
    """Return by how much it grew in [B], from the first minute to the last, by their medians."""
    warm = min(60.0, seconds / 3.0)
    after = [rss for at, rss in memory if warm <= at < 2.0 * warm]
    last = [rss for at, rss in memory if at >= seconds - warm]
    return float(np.median(last) - np.median(after))

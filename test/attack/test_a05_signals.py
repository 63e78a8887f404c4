"""Every signal whose default action ends the process ends in damping, building included."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from runs import Run

RARE = [
    signal.SIGQUIT,
    signal.SIGABRT,
    signal.SIGUSR1,
    signal.SIGUSR2,
    signal.SIGALRM,
    signal.SIGVTALRM,
    signal.SIGPROF,
    signal.SIGXCPU,
    signal.SIGIO,
    signal.SIGPWR,
    signal.SIGRTMIN + 3,
]
ENDING = [
    signal.SIGHUP,
    signal.SIGINT,
    signal.SIGTERM,
    *(pytest.param(number, marks=pytest.mark.slow) for number in RARE),
]

SLOW_BLOCK = """
import os, time
from unicon_core.flow import Amends, Tick

def slow(joint_pos_target: Amends, flag: str) -> Tick:
    open(flag, "w").close()
    while not os.path.exists(f"{flag}.over"):
        time.sleep(0.01)
    return lambda: False
"""


@pytest.mark.parametrize("number", ENDING)
def test_a_signal_ends_the_run_and_the_robot_is_damped(tmp_path: Path, number: int) -> None:
    run = Run(tmp_path).start()
    run.until_sent()
    run.process.send_signal(number)
    status, out, err = run.wait()
    assert (status, err) == (0, "")
    assert run.closed
    name = "signal" if number == signal.SIGRTMIN + 3 else signal.Signals(number).name
    assert run.report["ended"].startswith(name)
    assert name in out


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_signal_while_building_closes_the_platform_that_is_open(
    tmp_path: Path, number: int
) -> None:
    (tmp_path / "slow_block.py").write_text(SLOW_BLOCK)
    flag = tmp_path / "building"
    run = Run(tmp_path, flow=f'zip: [hold, {{"slow_block:slow": {{flag: {flag}}}}}]')
    run.start()
    run.until(flag.exists)
    run.process.send_signal(number)
    Path(f"{flag}.over").touch()
    status, _, _ = run.wait()
    assert status == 128 + number
    assert [line[0] for line in run.lines()] == ["close"]


def test_ctrl_z_damps_first_then_stops(tmp_path: Path) -> None:
    run = Run(tmp_path).start()
    run.until_sent()
    run.process.send_signal(signal.SIGTSTP)
    stat = Path(f"/proc/{run.process.pid}/stat")
    run.until(lambda: stat.read_text().rpartition(")")[2].split()[0] == "T")
    assert run.closed
    run.process.send_signal(signal.SIGCONT)
    status, _, _ = run.wait()
    assert status == 0
    assert run.report["ended"] == "SIGTSTP"
    assert run.closed


def test_a_second_ctrl_c_damps_in_the_middle_of_a_hang(tmp_path: Path) -> None:
    run = Run(tmp_path, "fault: hang").start()
    run.until(lambda: bool(run.times("fault")))
    run.process.send_signal(signal.SIGINT)
    time.sleep(0.5)
    assert not run.closed
    run.process.send_signal(signal.SIGINT)
    status, _, _ = run.wait(timeout=5.0)
    assert status == 3
    assert run.closed
    assert "SIGINT came twice: damped at once" in run.report["faults"][0]


def test_two_signals_of_one_press_are_one(tmp_path: Path) -> None:
    """A terminal and `ros2 launch` both send SIGINT when somebody presses Ctrl-C once."""
    run = Run(tmp_path).start()
    run.until_sent()
    run.process.send_signal(signal.SIGINT)
    run.process.send_signal(signal.SIGINT)
    status, _, _ = run.wait()
    assert status == 0
    assert run.report["faults"] == []


def test_what_nohup_ignores_stays_ignored(tmp_path: Path) -> None:
    run = Run(tmp_path, more="duration: 0.5")
    run.start(preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))
    run.until_sent()
    run.process.send_signal(signal.SIGHUP)
    status, _, _ = run.wait()
    assert status == 0
    assert run.report["ended"] == "duration"


def test_a_command_that_holds_no_motors_ends_at_once() -> None:
    """An exception that falls into an import or a destructor is swallowed; the default is not."""
    code = (
        "from unicon_core.signals import SIGNALS\n"
        "import os, signal\n"
        "class Dying:\n"
        "    def __del__(self):\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "with SIGNALS:\n"
        "    Dying()\n"
        "    print('went on')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert done.returncode == -signal.SIGINT
    assert "went on" not in done.stdout

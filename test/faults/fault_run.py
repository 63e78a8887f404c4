"""One case as real processes: writes the workflow, runs it, does the fault, waits, cleans up."""

from __future__ import annotations

import json
import os
import pty
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from faults.case import Case
from faults.command_log import CLOSE, RECV, SEND, CommandLog
from faults.simulated_case import ROBOTS
from unicon_core.robots import Robot, load_robot
from unicon_ros.bench.report import loopback_environment
from unicon_ros.process_exit import die_with_parent

PLATFORM = "faults.recording_platform:RecordingPlatform"
SIMULATOR = "faults.recording_platform:RecordingSimulator"
PEERS = "faults.peers"
START = 40.0  # s in which the first command must have left
LINGER = 10.0  # s beyond its duration after which a run is killed
AFTERWARDS = 2.6  # s in which is seen what comes of a peer that was killed
_NEVER = 10**9
_NODE = "import sys; from unicon_ros.node_main import main; sys.exit(main())"


class FaultRun:
    """The processes of one case.

    Args:
        case: what to run.
        folder: where everything of it is written; exists and is empty.

    Attributes:
        robot: whose commands are logged.
        log: of the recording platform, or of the robot that is the peer.
        fault_ns: when it was done from outside, on the clock of the log; 0 where the log tells.
        ended_ns: when the process had ended; 0 where it had to be killed.
        process: the run.
        terminal: our end of its terminal, where it has one.
        stream: where its output goes.
    """

    def __init__(self, case: Case, folder: Path) -> None:
        self.case, self.folder = case, folder
        self.robot: Robot = load_robot(ROBOTS[case.robot]["robot"])
        joints = self.robot.num_joints
        self.log = CommandLog(folder / "commands.log", joints)
        self.peer_log = CommandLog(folder / "peer.log", joints)
        self.fault_ns = self.ended_ns = 0
        self.terminal = self.stream = -1
        self._workflow = folder / "workflow.yaml"
        self.process: subprocess.Popen[bytes]
        self._peer: subprocess.Popen[bytes] | None = None
        kept = {"UNICON_FAULTS": "faults", "UNICON_LATCHES": "latches"}
        kept = {name: str(folder / below) for name, below in kept.items()}
        path = [str(Path(__file__).resolve().parents[1]), os.environ.get("PYTHONPATH", "")]
        kept["PYTHONPATH"] = os.pathsep.join(filter(None, path))
        self._environment = loopback_environment() | kept

    @property
    def motors(self) -> CommandLog:
        """Return the log in which commands are looked for."""
        return self.peer_log if self.case.topics else self.log

    def run(self) -> int | None:
        """Run to the end; return the exit status, None where it had to be killed."""
        case = self.case
        with ExitStack() as stack:
            self._workflow.write_text(json.dumps(self._described()), encoding="utf-8")
            if case.peer:
                module, *arguments = map(self._filled, case.peer)
                files = [str(self.peer_log.path), str(self.log.path)]
                command = [sys.executable, "-m", f"{PEERS}.{module}", *files, *arguments]
                out, _ = stack.enter_context(_output("file", self.folder / "peer.txt"))
                self._peer = self._start(command, out, stack)
            output = _output(case.output, self.folder / "output.txt")
            self.stream, self.terminal = stack.enter_context(output)
            self.process = self._start(self._command(), self.stream, stack)
            status = self._watch()
            return status if case.again is None else self._again(case.again, stack)

    def mark(self) -> None:
        """Note that the fault is done now."""
        self.fault_ns = time.perf_counter_ns()

    def wait_for(self, condition: Callable[[], bool], seconds: float = START) -> bool:
        """Wait until a condition holds or the process has ended; return whether it held."""
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end or self.process.poll() is not None:
                return condition()
            time.sleep(0.002)
        return True

    def wait_for_tick(self, tick: int) -> None:
        """Wait until a tick has begun."""
        self.wait_for(lambda: bool((self.log.of(RECV)["tick"] >= tick).any()))

    def said(self) -> str:
        """Return what the process wrote, of two the second."""
        return self._text("output.txt" if self.case.again is None else "again.txt")

    def peer_said(self) -> str:
        """Return what the peer wrote."""
        return self._text("peer.txt")

    # -- insides --------------------------------------------------------------------------------

    def _text(self, name: str) -> str:
        try:
            return (self.folder / name).read_text(encoding="utf-8", errors="replace")
        except OSError:
            return ""

    def _again(self, arguments: tuple[str, ...], stack: ExitStack) -> int | None:
        """Start the workflow, without its fault, anew; return the status."""
        case, module = self.case, [sys.executable, "-m", "unicon_ros"]
        out, _ = stack.enter_context(_output("file", self.folder / "again.txt"))
        if case.clear:
            self._start([*module, "latches", "--clear", case.clear], out, stack).wait(LINGER)
        self._workflow.write_text(json.dumps(self._described(fault=False)), encoding="utf-8")
        timed = ["--duration", str(case.duration)]
        run = self._start([*module, "run", str(self._workflow), *timed, *arguments], out, stack)
        try:
            return run.wait(START)
        except subprocess.TimeoutExpired:
            return None

    def _watch(self) -> int | None:
        case, patience = self.case, self.case.duration + LINGER
        peer = None if case.topics else self._peer
        if peer is None or case.outside is not None:
            self.wait_for(lambda: bool(self.motors.of(SEND).size))
        if case.outside is not None:
            case.outside(self)
        if peer is not None:  # it does the fault, then all is over
            self.wait_for(lambda: peer.poll() is not None)
            if peer.poll() == -signal.SIGKILL:  # which is the fault
                self.wait_for(lambda: False, AFTERWARDS)
            patience = LINGER
            if self.log.of(CLOSE).size:  # it is ending by itself
                self.wait_for(lambda: self.process.poll() is not None, LINGER)
            if self.process.poll() is None:
                self.process.send_signal(signal.SIGTERM)
        try:
            status = self.process.wait(patience)
        except subprocess.TimeoutExpired:
            return None
        self.ended_ns = time.perf_counter_ns()
        return status

    def _command(self) -> list[str]:
        case, path = self.case, self._workflow
        arguments = list(map(self._filled, case.arguments))
        if case.node:
            own = ["--ros-args", "-p", f"workflow:={path}", "-p", "exit_on_fault:=true"]
            return [sys.executable, "-c", _NODE, *own, *arguments]
        module, first = "unicon_ros", list[str]()
        if case.failing:
            module = "faults.failing_middleware"
            first = [str(self.log.path), case.failing, str(case.at)]
        head = [sys.executable, "-m", module, *first, "run", str(path)]
        report = str(self.folder / "report.json")
        return [*head, "--duration", str(case.duration), "--report", report, *arguments]

    def _filled(self, word: str) -> str:
        """Return a word of a command line with what is known by now."""
        at = self.case.at
        known = {
            "folder": self.folder,
            "workflow": self._workflow,
            "at": at,
            "later": at + 20,
        }
        for name, value in known.items():
            word = word.replace(f"{{{name}}}", str(value))
        return word

    def _described(self, fault: bool = True) -> dict[str, Any]:
        """Return the workflow, with its fault or without."""
        case, log = self.case, str(self.log.path)
        platform = "ros" if case.topics else SIMULATOR if case.mujoco else PLATFORM
        options: dict[str, Any] = {"log": log, "fault": case.fault if fault else {}, "at": case.at}
        values: dict[str, Any] = {
            **ROBOTS[case.robot],
            "start": "none",  # faults count from the first command on
            "platform": platform,
            "platforms": {} if case.topics else {platform: options},
            "commands": [{"velocity_command": {"constant": [0.1, 0.0, 0.0]}}],
            "flow": case.flow,
            "safety": ["finite", "joint_limits", "tilt_stop"],
            **case.workflow,
        }
        if isinstance(values["safety"], list):  # what a robot has besides hides what is asked
            values["safety"] = {"only": values["safety"]}
        if not case.uses_policy:
            del values["policies"]
        if not case.mujoco:
            del values["scene"]
        elif case.robot == "go2":
            values["scene"] = {"initial_pose": "stand"}
        text = json.dumps(values).replace("{log}", log)
        text = text.replace('"{at}"', str(case.at if fault else _NEVER))
        text = text.replace("{name}", self.folder.name)
        filled: dict[str, Any] = json.loads(text)
        return filled

    def _start(self, command: list[str], out: int, stack: ExitStack) -> subprocess.Popen[bytes]:
        limit = self.case.file_limit

        def prepare() -> None:
            # A group of its own, yet in our session: Ctrl-Z does nothing in an orphaned one.
            os.setpgid(0, 0)
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            if sys.platform == "linux":
                die_with_parent()
            if limit is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=out,
            env=self._environment,
            cwd=self.folder,
            preexec_fn=prepare,
        )
        stack.callback(_kill, process)
        return process


@contextmanager
def _output(kind: str, path: Path) -> Iterator[tuple[int, int]]:
    """Open where a run's output goes: its end, and ours of a terminal (else -1)."""
    theirs, ours = -1, -1
    if kind == "terminal":
        ours, theirs = pty.openpty()
    elif kind in ("closed", "pipe"):
        ours, theirs = os.pipe()
        if kind == "closed":
            os.close(ours)
            ours = -1
    elif kind == "device full":
        theirs = os.open("/dev/full", os.O_WRONLY)
    else:
        theirs = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    try:
        yield theirs, ours if kind == "terminal" else -1
    finally:
        os.close(theirs)
        if ours >= 0:
            os.close(ours)


def _kill(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.kill()
        process.wait()

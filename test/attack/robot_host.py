"""What attacks on a running workflow share: `unicon run --ros`, unicon_node, and their caller."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
ENTRY = {
    "run": "from unicon_ros.cli.main import main",
    "node": "from unicon_ros.node_main import main",
}
TRIGGERS = ("start", "pause", "estop", "clear_estop")
WORKFLOW = """\
schema: unicon.workflow/1
robot: go2
platform: estop_platform:make
platforms: {{"estop_platform:make": {{log: {log}{options}}}}}
rate: {rate}
flow: {{hold: {{}}}}
"""


def write_workflow(folder: Path, rate: float = 50, **options: Any) -> tuple[Path, Path]:
    """Write a workflow on the recording platform; return its path and the platform's log."""
    log, path = folder / "commands.log", folder / "recorded.yaml"
    more = "".join(f", {name}: {value}" for name, value in options.items())
    path.write_text(WORKFLOW.format(log=log, rate=rate, options=more))
    return path, log


class Host:
    """A process that ticks, and what it said."""

    def __init__(self, kind: str, *arguments: str) -> None:
        code = f"import sys; {ENTRY[kind]}; sys.exit(main(sys.argv[1:]))"
        environment = dict(os.environ)
        environment["PYTHONPATH"] = os.pathsep.join((str(HERE), str(ROOT)))
        self.process = subprocess.Popen(
            [sys.executable, "-c", code, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=environment,
        )
        self.said = ""
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.said += line

    @property
    def alive(self) -> bool:
        """Whether the process is there."""
        return self.process.poll() is None

    def says(self, text: str, timeout: float = 60.0) -> None:
        """Wait until it has said a text, through its start on a busy machine."""
        with suppress(AssertionError):  # what it said instead tells more
            wait_for(lambda: text in self.said or not self.alive, text, timeout)
        assert text in self.said, f"no {text!r} within {timeout} s; it said:\n{self.said}"

    def end(self, timeout: float = 30.0) -> int:
        """Return its exit status once it has ended."""
        status = self.process.wait(timeout)
        self._thread.join(timeout)
        return status

    def interrupt(self) -> int:
        """SIGINT; return the exit status."""
        self.process.send_signal(signal.SIGINT)
        return self.end()

    def kill(self) -> None:
        """SIGKILL."""
        self.process.kill()
        self.process.wait(10)


def services() -> dict[str, Any]:
    """Return what `unicon run --ros` and unicon_node offer to callers: name to type."""
    from lifecycle_msgs.srv import ChangeState, GetState
    from rcl_interfaces.srv import ListParameters
    from std_srvs.srv import Trigger

    transitions = {"get_state": GetState, "change_state": ChangeState}
    return dict.fromkeys(TRIGGERS, Trigger) | transitions | {"list_parameters": ListParameters}


class Caller:
    """A plain rclpy client of one node, in a context of its own."""

    def __init__(self, target: str = "/unicon") -> None:
        import rclpy
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        self._rclpy = rclpy
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("attacker", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._clients = {  # at once, so that their services are waited for once
            name: self.node.create_client(kind, f"{target}/{name}")
            for name, kind in services().items()
        }
        self._seen = False

    def find(self, name: str) -> Any:
        """Return a client whose service is there and sees it.

        rmw_fastrtps drops a response if the server has not discovered the client's reader yet.
        Readers are discovered in the order of their making, so the first answer to the last client,
        which every node gives, shows that those of all clients are known.
        """
        found = self._clients[name]
        last = next(reversed(self._clients.values()))
        if not found.service_is_ready() or not self._seen:
            # Its own `wait_for_service` looks four times a second.
            for client in (found, last):
                wait_for(client.service_is_ready, f"the service {client.srv_name}")
            self._seen = any(
                self.wait(last.call_async(last.srv_type.Request()), 2.0) for _ in range(10)
            )
            assert self._seen, f"{last.srv_name} did not answer"
        return found

    def assume_seen(self, name: str) -> None:
        """Wait for a service of a node that answers nothing else yet, and for its discovery."""
        wait_for(self._clients[name].service_is_ready, f"the service {name}")
        time.sleep(0.7)
        self._seen = True

    def send(self, name: str, request: Any = None) -> tuple[int, Any]:
        """Send a request; return when, in [ns], and its future."""
        client = self.find(name)
        return time.monotonic_ns(), client.call_async(request or client.srv_type.Request())

    def wait(self, future: Any, timeout: float = 10.0) -> Any:
        """Return the answer, or None where none came."""
        self._executor.spin_until_future_complete(future, timeout_sec=timeout)
        return future.result()

    def call(self, name: str, request: Any = None) -> Any:
        """Return the answer to a request."""
        _, future = self.send(name, request)
        answer = self.wait(future)
        assert answer is not None, f"{name} did not answer"
        return answer

    def state(self) -> str:
        """Return the node's lifecycle state."""
        return str(self.call("get_state").current_state.label)

    def become(self, state: str, timeout: float = 20.0) -> None:
        """Wait for a lifecycle state."""
        wait_for(lambda: self.state() == state, f"the state {state}", timeout)

    def close(self) -> None:
        """Let the node go."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._rclpy.try_shutdown(context=self._context)


def wait_for(condition: Any, what: str, timeout: float = 20.0) -> None:
    """Wait until a condition holds, or fail."""
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, f"waited {timeout} s for: {what}"
        time.sleep(0.01)

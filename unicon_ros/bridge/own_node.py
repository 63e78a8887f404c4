"""OwnNode: a node in a ROS context of its own, for a session without a host; services of any node.

`calm_middleware_threads` keeps the middleware's threads out of the tick's way, and so does
`NodeLog`: rclpy keeps Python's interpreter lock while it writes to standard error, so on a terminal
that Ctrl-S has stopped all threads would stand still. It gets lines where it takes them at once.

Our nodes reach others by UDP, where Fast DDS by itself would take shared memory too. A process that
ends by SIGKILL leaves its ports there. A later process gets such a port, and a writer checks its
health first: 335 ms in the tick's thread, now and then 1 to 3 s. UDP has no such check, and takes
messages of a robot's joints as well. Fast DDS reads the environment when a node is made; so the
environment differs meanwhile, and processes that are started later inherit what the user set.
"""

from __future__ import annotations

import os
import re
import select
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from unicon_base import UniconError, one_line
from unicon_base.resources import find_config
from unicon_core.non_blocking_writer import NonBlockingWriter
from unicon_ros import compat
from unicon_ros.process_exit import exit_watchdog

Answer = tuple[bool, str]
"""Of a service: success, and a line for the caller."""

TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"
PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
RANGE, LOCALHOST_ONLY = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY"
# A user who sets one of these, or has one of these files in the working folder, has chosen.
CHOICES = (TRANSPORTS, "FASTDDS_ENVIRONMENT_FILE", "ROS2_EASY_MODE")
FILES = ("DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml")
OTHERS = ("ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER")
# Those of them that the loopback profile reaches.
_LOOPBACK = re.compile(r"(127(\.\d+){3}|localhost)?(:\d+)?")

_loaded: str | None = None  # the profile that Fast DDS read, once for this process


@contextmanager
def without_shared_memory() -> Iterator[None]:
    """Keep the node that is made inside, its context included, out of Fast DDS's shared memory.

    Nothing is changed for other middlewares, nor where the user has chosen a transport.
    """
    global _loaded
    variable = compat.fast_dds_profiles()
    if variable is None:
        yield
        return
    loopback = str(find_config("dds", "no_shared_memory", ".xml"))
    unread = _loaded is None and compat.imported_first() and not compat.import_rclpy().ok()
    values = changes(os.environ, Path(), variable, loopback, unread or _loaded == loopback)
    before = {name: os.environ.get(name) for name in values}
    _set(values)
    if _loaded is None:
        _loaded = os.environ.get(variable, "")
    try:
        yield
    finally:
        _set(before)


def changes(
    environment: Mapping[str, str], folder: Path, variable: str, loopback: str, readable: bool
) -> dict[str, str | None]:
    """Return the variables to set, or to unset (None), while a node is made.

    Args:
        environment: what the user set.
        folder: where the process works.
        variable: names the profile file for this Fast DDS.
        loopback: the profile with UDP on loopback alone.
        readable: whether Fast DDS will read that profile, or has it.
    """
    if any(environment.get(name) for name in CHOICES):
        return {}
    profiles = [environment[name] for name in PROFILES if environment.get(name)]
    if not all(map(_leaves_transports, profiles)):
        return {}
    if any((folder / name).exists() for name in FILES):
        return {}
    reach = environment.get(RANGE)
    if reach == "OFF":
        return {}
    if reach != "LOCALHOST" and environment.get(LOCALHOST_ONLY) != "1":
        return {TRANSPORTS: "UDPv4"}
    # For LOCALHOST rmw_fastrtps adds shared memory to any profile, so the profile is what keeps
    # to loopback: where that is not certain, or peers are elsewhere, all stays as it is.
    others = ";".join(environment.get(name, "") for name in OTHERS).split(";")
    if not readable or not all(map(_LOOPBACK.fullmatch, others)):
        return {}
    values: dict[str, str | None] = dict.fromkeys((*PROFILES, LOCALHOST_ONLY))
    values |= {variable: loopback, RANGE: "SUBNET"}
    return values


def _leaves_transports(profile: str) -> bool:
    """Tell whether a profile is our fast discovery, which the others have too."""
    try:
        ours = find_config("dds", "fast_discovery", ".xml").read_bytes()
        return Path(profile).read_bytes() == ours
    except OSError:
        return False


def _set(values: Mapping[str, str | None]) -> None:
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


class OwnNode:
    """A plain rclpy node and its executor; signals stay with the runner, which damps first.

    Args:
        name: of the node, unless `ros_args` remap it.
        namespace: of the node.
        ros_args: ROS arguments (`-r a:=b`, `-p name:=value`), with or without `--ros-args`.

    Attributes:
        node: the rclpy node.
        executor: a single-threaded executor with the node in it.
        context: their rclpy context.

    Raises:
        MissingDependencyError: rclpy is not installed.
        UniconError: a name or an argument is wrong.
    """

    def __init__(self, name: str, namespace: str | None, ros_args: Sequence[str]) -> None:
        rclpy = self._rclpy = compat.import_rclpy()
        arguments = list(ros_args)
        if arguments and "--ros-args" not in arguments:
            arguments.insert(0, "--ros-args")
        self.context: Any = rclpy.context.Context()
        self._closed = False
        try:
            with without_shared_memory():
                rclpy.init(
                    args=arguments,
                    context=self.context,
                    signal_handler_options=rclpy.signals.SignalHandlerOptions.NO,
                )
                self.node: Any = rclpy.node.Node(name, namespace=namespace, context=self.context)
        except Exception as error:
            rclpy.try_shutdown(context=self.context)
            raise UniconError(
                f"ROS 2 node {name!r} in namespace {namespace or '/'!r} with arguments "
                f"{arguments}: {one_line(error)}; correct the name, the namespace or --ros-args"
            ) from error
        self.executor: Any = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def close(self) -> None:
        """Destroy the node and shut its context down, once."""
        if not self._closed:
            self._closed = True
            # A middleware that never ends is a fault; a caller may ask for it sooner.
            with exit_watchdog(3, 20.0):
                self.executor.shutdown()
                self.node.destroy_node()
                self._rclpy.try_shutdown(context=self.context)


def calm_middleware_threads() -> int:
    """Give this process's threads that are not Python's SCHED_BATCH; return how many there were.

    That keeps the threads of DDS from pushing the tick's thread off its core. A write wakes two or
    three of them, each of which preempts the writer: with a reader that hangs, `publish` took 84 µs
    at p50 and 1440 at p99 on a busy machine, with 1.7 forced switches a call. Threads of
    SCHED_BATCH do not preempt on waking (sched(7)): then 63 and 158 µs and none, while they still
    run at once on a free core. It needs no privilege and is not a priority.

    Does nothing where the system has no such thing, or where a thread has a policy of its own.
    """
    if not hasattr(os, "SCHED_BATCH"):
        return 0
    own = {thread.native_id for thread in threading.enumerate()} | {threading.get_native_id()}
    calmed = 0
    try:
        numbers = [int(name) for name in os.listdir("/proc/self/task")]
    except OSError:
        return 0
    for number in numbers:
        if number in own:
            continue
        with suppress(OSError):  # it has ended, or a sandbox forbids it
            if os.sched_getscheduler(number) == os.SCHED_OTHER:
                os.sched_setscheduler(number, os.SCHED_BATCH, os.sched_param(0))
                calmed += 1
    return calmed


STDERR = 2


class NodeLog:
    """Says lines through a logger, in a thread of its own.

    Args:
        logger: of an rclpy node.
    """

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self._poll = select.poll()
        self._poll.register(STDERR, select.POLLOUT)
        self._outlet = NonBlockingWriter(self._say)

    @property
    def dropped(self) -> int:
        """Lines that nobody took."""
        return self._outlet.dropped

    def info(self, text: str) -> None:
        """Say what happens."""
        self._outlet(("info", text))

    def warning(self, text: str) -> None:
        """Say what is not as it should be."""
        self._outlet(("warning", text))

    def error(self, text: str) -> None:
        """Say what went wrong."""
        self._outlet(("error", text))

    def close(self) -> None:
        """Let what waits out, for a second at most."""
        self._outlet.close()

    def _say(self, line: tuple[str, str]) -> None:
        if not self._poll.poll(500):
            raise BlockingIOError("standard error takes nothing")  # counted as dropped
        level, text = line
        # Each level from a line of its own: rcutils refuses a place that changes its level.
        if level == "info":
            self._logger.info(text)
        elif level == "warning":
            self._logger.warning(text)
        else:
            self._logger.error(text)


def add_services(
    node: Any, handlers: dict[str, Callable[[], Answer]], warn: Callable[[str], object]
) -> list[Any]:
    """Create `~/<name>` of type std_srvs/srv/Trigger for each handler; return the services.

    A handler that raises is answered with the reason: a mistake of ours must not end a node.
    """
    from std_srvs.srv import Trigger

    def callback(name: str, handler: Callable[[], Answer]) -> Callable[[Any, Any], Any]:
        def answer(_: Any, response: Any) -> Any:
            try:
                response.success, response.message = handler()
            except Exception as error:
                response.success, response.message = False, f"~/{name} failed: {explained(error)}"
                warn(response.message)
            return response

        return answer

    return [
        node.create_service(Trigger, f"~/{name}", callback(name, handler))
        for name, handler in handlers.items()
    ]


def explained(error: BaseException) -> str:
    """Return an unexpected exception as one line: its kind and what it says."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__

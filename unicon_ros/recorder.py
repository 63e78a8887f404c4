"""Recorder: writes the messages of a map into an MCAP file, for `unicon run --record`.

The file is a plain rosbag2 recording: `ros2 bag play`, rosbags and Foxglove read it. While it is
open it grows in a folder `FILE.partial/` beside its place, so that a killed run leaves its data.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unicon_core.errors import MissingDependencyError, UniconError
from unicon_core.flow import Block
from unicon_core.resources import find_config
from unicon_msgs_map import Encoder, MapStateError, load_map
from unicon_msgs_map.messages import message_definition

if TYPE_CHECKING:
    from unicon_core.workflow import Hook, Workflow
    from unicon_ros.bridge import RosSession

__all__ = ["Recorder", "recorder_hook"]


class Recorder:
    """An MCAP file that is being written.

    Args:
        path: of the file, must not exist; folders are made.

    Raises:
        MissingDependencyError: rosbags is not installed.
        UniconError: the file exists, or cannot be written.
    """

    def __init__(self, path: str | Path) -> None:
        try:
            from rosbags.rosbag2 import StoragePlugin, Writer
        except ModuleNotFoundError as error:
            raise MissingDependencyError(
                "--record", "rosbags", "pip install 'unicon_ros[bags]'"
            ) from error
        self.path = Path(path)
        self._partial = self.path.with_name(f"{self.path.name}.partial")
        for taken in (self.path, self._partial):
            if taken.exists():
                raise UniconError(f"recording {taken} exists; move it away or give another name")
        self._writer: Any = Writer(self._partial, version=9, storage_plugin=StoragePlugin.MCAP)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._writer.open()
        except OSError as error:
            raise UniconError(
                f"cannot record to {self.path}: {error.strerror}; give a path in a writable folder"
            ) from error
        self._closed = False
        self.messages = 0

    def channel(self, topic: str, kind: str) -> Callable[[int, bytes], None]:
        """Add a topic and return what writes a message of it: `write(stamp_ns, cdr)`.

        Args:
            topic: its name.
            kind: its message type, `sensor_msgs/msg/JointState`.
        """
        definition = message_definition(kind)
        connection = self._writer.add_connection(
            f"/{topic.lstrip('/')}", kind, msgdef=definition.text, rihs01=definition.rihs
        )
        write = self._writer.write

        def record(stamp_ns: int, raw: bytes) -> None:
            write(connection, stamp_ns, raw)
            self.messages += 1

        return record

    def close(self) -> None:
        """Finish the file and put it in its place; safe to call twice."""
        if self._closed:
            return
        self._closed = True
        self._writer.close()
        for written in self._partial.glob("*.mcap"):
            written.replace(self.path)
        for rest in self._partial.iterdir():
            rest.unlink()
        self._partial.rmdir()


def recorder_hook(
    path: str | Path, map_name: str | None, session: RosSession | None = None
) -> Hook:
    """Return the hook that records what the map publishes, at its rates, after `send`.

    Args:
        path: of the MCAP file.
        map_name: message map, name or path; `default` if None.
        session: where ROS is on, its messages are recorded as they leave, encoded once; the hook
            must then stand behind the session's own.
    """

    def hook(workflow: Workflow) -> list[Block]:
        recorder = Recorder(path)
        try:
            return _blocks(recorder, workflow, map_name, session)
        except BaseException:
            recorder.close()
            raise

    return hook


def _blocks(
    recorder: Recorder, workflow: Workflow, map_name: str | None, session: RosSession | None
) -> list[Block]:
    # Arrays, names and variables are the bridge's, so that bag and topics hold the same bytes.
    from unicon_ros.bridge.bindings import arrays_of, names_of, variables_of

    arrays = arrays_of(workflow)
    variables = variables_of(workflow, session.frame_prefix if session is not None else "")
    simulated, stamp = workflow.platform.simulated, workflow.states["stamp_ns"].reshape(-1)

    def now() -> int:
        return int(stamp[0]) if simulated else time.time_ns()

    leaving = {id(out.spec): out for out in session.outgoing} if session is not None else {}
    due: list[tuple[int, Callable[[], bytes], Callable[[int, bytes], None]]] = []
    reads: set[str] = set()
    mapping = session.map if session is not None else load_map(_map_path(map_name))
    for spec in mapping.publish:
        if id(spec) in leaving:
            write = recorder.channel(spec.topic, spec.type)
            leaving[id(spec)].tap = partial(_stamped, write, now)
            continue
        try:
            encoder = Encoder.build(spec, arrays, names_of(workflow), variables)
        except MapStateError:
            if not spec.optional:
                raise
            continue
        write = recorder.channel(spec.topic, spec.type)
        due.append((spec.every(workflow.period), encoder.encode, write))
        reads.update(spec.states)
    tick = 0

    def record() -> None:
        nonlocal tick
        for every, encode, write in due:
            if tick % every == 0:
                write(now(), encode())
        tick += 1

    return [Block("recorder", record, reads=tuple(sorted(reads)), close=recorder.close)]


def _stamped(write: Callable[[int, bytes], None], now: Callable[[], int], raw: bytes) -> None:
    write(now(), raw)


def _map_path(name: str | None) -> Path:
    return find_config("maps", name or "default")

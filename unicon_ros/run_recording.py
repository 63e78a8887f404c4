"""Recording: writes the messages of a run and every tick into MCAP, for `unicon run --record`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unicon_core.errors import MissingDependencyError, UniconError
from unicon_core.flow import Block, Stage
from unicon_ros.recorded_ticks import RecordedTicks
from unicon_ros.recorder import Recorder
from unicon_ros.recording.bag_folder import Split

if TYPE_CHECKING:
    from unicon_core.runtime.statistics import TickStatistics
    from unicon_core.runtime.tick_ring import TickRing
    from unicon_core.workflow import Program
    from unicon_ros.bridge import RosSession
    from unicon_ros.recorded_frames import RecordedFrames
    from unicon_ros.recorded_topics import RecordedTopics


class Recording:
    """Records the messages of a run, what came in and what goes out, and every state of every tick.

        recording = Recording("walk.mcap")
        record = FaultRecord(recording=recording)
        program = load_workflow("go2_walk", hooks=[recording.hook, record.hook])
        runner = Runner(program)
        record.attach(runner)

    Args:
        path: of the MCAP file.
        map_name: message map, name or path; `default` if None.
        session: where ROS is on, its messages are recorded as they leave, encoded once; the hook
            must then stand behind the session's own.
        warn: takes warnings, one line each, from a thread.
        patient: wait for a slow disk rather than drop messages: for runs at full speed.
        split: where a next file of a bag folder begins, such as `1GB` or `60s`; "" for nowhere.
        namespace: of relative topics, where there is no session.
        frame_prefix: of the names of frames, where there is no session.
        frames: handles whose pictures and clouds are recorded, without `_handle`, or `all`.
        jpeg: quality from 1 to 100 of pictures that are raw, 0 to leave them as they are.

    Raises:
        MissingDependencyError: rosbags is not installed.
        UniconError: nothing can be split so, or that is not a quality.
    """

    def __init__(
        self,
        path: str | Path,
        map_name: str | None = None,
        session: RosSession | None = None,
        warn: Callable[[str], None] = print,
        patient: bool = False,
        split: str = "",
        namespace: str = "",
        frame_prefix: str = "",
        frames: Sequence[str] = (),
        jpeg: int = 0,
    ) -> None:
        try:
            import rosbags  # noqa: F401  (the texts of the message types are its)
        except ModuleNotFoundError as error:
            raise MissingDependencyError(
                "--record", "rosbags", "pip install 'unicon_ros[bags]'"
            ) from error
        if not 0 <= jpeg <= 100:
            raise UniconError(f"{jpeg} is not a quality of a JPEG; give 1 to 100, or 0 for none")
        self._path, self._map_name, self._session = path, map_name, session
        self._namespace, self._frame_prefix = namespace, frame_prefix
        self._warn, self._patient = warn, patient
        self._split = Split.of(split) if split else None
        self._recorder: Recorder | None = None
        self._ticks: RecordedTicks | None = None
        self._wanted, self._jpeg = tuple(frames), jpeg
        self._frames: RecordedFrames | None = None
        self._statistics: TickStatistics | None = None

    def counts(self) -> dict[str, Any]:
        """Return messages in the file, those dropped, bytes, and the error or "".

        Where frames are recorded, `frames` tells of each ring how many were taken and missed.
        """
        counts = {} if self._recorder is None else self._recorder.counts()
        return counts if self._frames is None else counts | {"frames": self._frames.counts()}

    def summary(self) -> str:
        """Return what became of it, for the end of a run."""
        counts = self.counts()
        text = f"{self._path}: {counts['messages']} messages"
        if counts["dropped"]:
            text += f", {counts['dropped']} lost"
        for name, frames in counts.get("frames", {}).items():
            missed = f", {frames['missed']} missed" if frames["missed"] else ""
            text += f", {frames['frames']} frames of {name}{missed}"
        return text + (f" ({counts['error']})" if counts["error"] else "")

    def hook(self, program: Program) -> dict[Stage, list[Block]]:
        """Return the block that records."""
        # A robot does not wait for a disk, however its run is paced.
        patient = self._patient and program.platform.facts.simulated
        from unicon_ros.recorded_topics import RecordedTopics

        recorder = Recorder(self._path, self._warn, patient, self._split)
        try:
            names = (self._namespace, self._frame_prefix)
            topics = RecordedTopics(recorder, program, self._map_name, self._session, *names)
            if self._wanted:
                self._add_frames(recorder, program, topics)
        except BaseException:
            recorder.close()
            raise
        self._recorder, topics.block.close = recorder, self._close
        return {Stage.OBSERVE: [topics.block]}

    def _add_frames(self, recorder: Recorder, program: Program, topics: RecordedTopics) -> None:
        from unicon_ros.recorded_frames import RecordedFrames, chosen_sources

        sources = chosen_sources(program, self._wanted)
        self._frames = RecordedFrames(recorder, sources, topics.now, self._jpeg, self._warn)

    def _close(self) -> None:
        assert self._recorder is not None
        if self._frames is not None:
            self._frames.close()
        if self._ticks is not None and self._statistics is not None:
            self._ticks.close(self._statistics)
        self._recorder.close()

    def keep(self, ring: TickRing) -> None:
        """Record the ticks that a ring keeps; behind the hook."""
        assert self._recorder is not None
        self._ticks = RecordedTicks(self._recorder, ring)

    def attach(self, facts: Mapping[str, str], statistics: TickStatistics) -> None:
        """Get facts and statistics of the run, and begin to write, before the first tick."""
        assert self._recorder is not None
        self._statistics = statistics
        if self._ticks is not None:
            self._ticks.attach(facts)
        self._recorder.start()
        if self._frames is not None:
            self._frames.start()


def names_in(text: str) -> list[str]:
    """Return the names that stand in a text with commas between them."""
    return [name.strip() for name in text.split(",") if name.strip()]

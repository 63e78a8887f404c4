"""Recordings: MCAP files that grow chunk by chunk, off the tick's thread, for the recorder."""

from unicon_ros.recording.background import Background
from unicon_ros.recording.mcap_file import McapFile
from unicon_ros.recording.read import Record, open_record
from unicon_ros.recording.recover import recover

__all__ = ["Background", "McapFile", "Record", "open_record", "recover"]

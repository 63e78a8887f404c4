"""Recordings: MCAP files that grow chunk by chunk, off the tick's thread, for the recorder."""

from unicon_lab.recording.background import Background
from unicon_lab.recording.mcap_file import McapFile
from unicon_lab.recording.read import Record, open_record
from unicon_lab.recording.recover import recover

__all__ = ["Background", "McapFile", "Record", "open_record", "recover"]

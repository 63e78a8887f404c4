"""Memory: what the blocks of a graph remember between two ticks, for records and their replay."""

from unicon_core.memory.changes import changes
from unicon_core.memory.memory import Memory, Remembered
from unicon_core.memory.values import from_json, to_json

__all__ = ["Memory", "Remembered", "changes", "from_json", "to_json"]

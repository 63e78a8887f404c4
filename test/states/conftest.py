"""Makes the helpers beside these tests importable, and gives a folder of one's own for segments."""

import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder for segments and frames in shared memory, where no other test makes any."""
    from unicon_core import handles
    from unicon_core.states.backends.shm import files

    made = Path(tempfile.mkdtemp(prefix="unicon_test_", dir="/dev/shm"))
    monkeypatch.setattr(files, "FOLDER", made)
    monkeypatch.setattr(handles, "FOLDER", made)
    yield made
    shutil.rmtree(made)

"""Frame rings: handles, what is overwritten, and a second process that looks at the same frames."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from unicon_core import handles
from unicon_core.handles import FrameRing, clean_frames


@pytest.fixture
def ring() -> Iterator[FrameRing]:
    made = FrameRing.create(8, slots=3)
    yield made
    made.close()


def put(ring: FrameRing, value: int) -> int:
    ring.fill()[:] = value
    return ring.commit(1000 * value)


def test_a_handle_finds_its_frame_until_the_ring_comes_round(ring: FrameRing) -> None:
    assert ring.latest == 0
    assert ring.frame(0) is None
    handles = [put(ring, value) for value in (1, 2, 3, 4)]
    assert handles == [1, 2, 3, 4]
    assert ring.latest == 4
    assert ring.frame(1) is None
    assert ring.stamp_ns(1) == 0
    for handle in (2, 3, 4):
        frame = ring.frame(handle)
        assert frame is not None
        assert set(frame.tolist()) == {handle}
        assert ring.stamp_ns(handle) == 1000 * handle
    assert ring.frame(5) is None


def test_the_oldest_frame_is_gone_as_soon_as_it_is_filled_anew(ring: FrameRing) -> None:
    for value in (1, 2, 3):
        put(ring, value)
    assert ring.holds(1)
    ring.fill()
    assert not ring.holds(1)
    assert ring.holds(2)


def test_frames_are_looked_at_in_place_and_not_written_to(ring: FrameRing) -> None:
    put(ring, 7)
    frame = ring.frame(1)
    assert frame is not None
    with pytest.raises(ValueError, match="read-only"):
        frame[0] = 1
    put(ring, 8)
    put(ring, 9)
    put(ring, 10)  # the slot of the first
    assert set(frame.tolist()) == {10}
    assert not ring.holds(1)


def test_another_process_fills_and_this_one_looks(ring: FrameRing) -> None:
    code = (
        "import sys; from unicon_core.handles import FrameRing\n"
        "ring = FrameRing.attach(sys.argv[1])\n"
        "for k in range(1, 6):\n    ring.fill()[:] = k; ring.commit(k)\n"
    )
    subprocess.run([sys.executable, "-c", code, str(ring.path)], check=True)
    assert ring.latest == 5
    frame = ring.frame(5)
    assert frame is not None
    np.testing.assert_array_equal(frame, np.full(8, 5))


def test_its_maker_removes_it_and_an_impossible_ring_is_refused() -> None:
    ring = FrameRing.create(8)
    other = FrameRing.attach(ring.path)
    other.close()
    assert ring.path.exists()
    ring.close()
    assert not ring.path.exists()
    with pytest.raises(ValueError, match="a ring of 1 frames"):
        FrameRing.create(8, slots=1)


def test_frames_of_a_maker_that_died_are_removed_and_no_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(handles, "FOLDER", tmp_path)
    living = FrameRing.create(8)
    pid = os.fork()
    if pid == 0:  # dies without closing
        FrameRing.create(8)
        os._exit(0)
    os.waitpid(pid, 0)
    unlocked = tmp_path / "unicon_frames_old"  # as rings were made before makers held a lock
    unlocked.write_bytes(bytes(8) + (4).to_bytes(8, "little") + (8).to_bytes(8, "little") * 6)
    (tmp_path / "unicon_frames_short").write_bytes(b"")
    (tmp_path / "unicon_frames_link").symlink_to(unlocked)
    (tmp_path / "unicon_frames_folder").mkdir()
    os.mkfifo(tmp_path / "unicon_frames_fifo")
    (dead,) = {path.name for path in tmp_path.glob("*")} - {
        *(living.path.name, "unicon_frames_old", "unicon_frames_short", "unicon_frames_link"),
        *("unicon_frames_folder", "unicon_frames_fifo"),
    }
    assert clean_frames() == [dead]
    assert len(list(tmp_path.iterdir())) == 6
    put(living, 1)
    living.close()
    assert clean_frames() == []
    assert len(list(tmp_path.iterdir())) == 5

"""`unicon video`: the robot of a recording moves in each format; nothing is left of half a file."""

from __future__ import annotations

import os
import pty
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base import UniconError
from unicon_lab.recording import open_record
from unicon_lab.view.video import write_video
from unicon_ros.cli.main import main

pytest.importorskip("mujoco")
pytest.importorskip("viser", reason="pip install 'unicon_ros[video]'")
images = pytest.importorskip("PIL.Image")


SIZE = ("--size", "160x128", "--fps", "10")
RUN = ["run", "go2_walk", "--no-ros", "--speed", "max", "--quiet", "--duration", "6"]


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of a robot that walks from 4 s on."""
    path: Path = tmp_path_factory.mktemp("video") / "walk.mcap"
    assert main([*RUN, "--record", str(path)]) == 0
    return path


def video(*words: object, **more: Any) -> subprocess.CompletedProcess[str]:
    """Make a video in a process of its own, which has OpenGL for itself."""
    command = [sys.executable, "-m", "unicon_ros", "video", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=100, **more)
    if "no offscreen OpenGL" in done.stderr and "nonsense" not in done.stderr:
        pytest.skip("no offscreen OpenGL: apt install libegl1 libgl1-mesa-dri")
    return done


def frames(path: Path) -> list[Any]:
    """Return the frames of a file, shape (height, width, 3) each."""
    if path.suffix in (".mp4", ".webm"):
        av = pytest.importorskip("av")
        return [f.to_ndarray(format="rgb24") for f in av.open(str(path)).decode(video=0)]
    image, found = images.open(path), []
    for number in range(image.n_frames):
        image.seek(number)
        found.append(np.asarray(image.convert("RGB")).copy())
    return found


def moved(found: list[Any]) -> float:
    """Return how many pixels differ between the first frame and the last, as a share."""
    return float((np.abs(found[0].astype(int) - found[-1]).max(axis=-1) > 24).mean())


def test_robot_ghost_plot_and_cursor_are_seen_and_a_second_video_is_the_same(
    record: Path, tmp_path: Path
) -> None:
    span = ("--size", "320x256", "--fps", "10", "--from", 4.5, "--to", 5.5)
    done = video(record, tmp_path / "a.gif", *span)
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{tmp_path / 'a.gif'}: 11 frames, 1.10 s\n"
    plain = frames(tmp_path / "a.gif")
    assert len(plain) == 11
    assert plain[0].shape == (256, 320, 3)
    assert moved(plain) > 0.02
    with_all = ("--ghost", "--plot", "joint_pos:FL_calf_joint")
    done = video(record, tmp_path / "b.gif", *span, *with_all)
    assert (done.returncode, done.stderr) == (0, "")
    ghost = frames(tmp_path / "b.gif")

    def blue(pixels: Any) -> int:
        return int(((pixels[..., 2].astype(int) - pixels[..., 0]) > 60).sum())

    assert blue(ghost[5][40:192]) > blue(plain[5][40:192]) + 200
    cursors = [
        np.flatnonzero((f[204:, :, 0].astype(int) - f[204:, :, 1] > 90).all(0)) for f in ghost
    ]
    middles = [float(found.mean()) for found in cursors]
    assert np.allclose(np.diff(middles), (middles[-1] - middles[0]) / 10, atol=1.5)
    assert middles[-1] - middles[0] > 160
    assert video(record, tmp_path / "c.gif", *span, *with_all).returncode == 0
    assert (tmp_path / "b.gif").read_bytes() == (tmp_path / "c.gif").read_bytes()


@pytest.mark.parametrize("ending", ["mp4", "webp", pytest.param("webm", marks=pytest.mark.slow)])
def test_formats_are_read_by_others(record: Path, tmp_path: Path, ending: str) -> None:
    pytest.importorskip("av")
    path = tmp_path / f"a.{ending}"
    done = video(record, path, *SIZE, "--from", "4.5", "--to", "5.5", "--speed", "2")
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{path}: 6 frames, 0.60 s\n"
    found = frames(path)
    assert len(found) == 6
    assert found[0].shape == (128, 160, 3)
    assert moved(found) > 0.02
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["a.avi"], r"cannot write \S+a.avi: unknown ending; known: .gif, .mp4, .webm, .webp"),
        (["a.gif", "--from", "7"], r"--from 7 is not before 5.98, where the video ends"),
        (["a.gif", "--from", "2", "--to", "2"], r"--from 2 is not before 2, where the video"),
        (["a.gif", "--plot", "joint_po"], r"no state 'joint_po' .*did you mean 'joint_pos'"),
        (["a.gif", "--plot", "joint_pos:x"], r"joint_pos has no element 'x'; known: FL_calf"),
        (
            ["a.gif", "--plot", "joint_pos", "--size", "320x128"],
            r"no room for the plots; give a lar",
        ),
        (["a.gif", *["--plot", "joint_pos"] * 8], r"640x480 has no room for the plots; give"),
        (["a.gif", "--speed", "1e-6"], r"more than 36000 frames; give --from and --to"),
    ],
)
def test_what_is_wrong_is_one_line(
    record: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    message: str,
) -> None:
    capsys.readouterr()
    assert main(["video", str(record), str(tmp_path / words[0]), *words[1:]]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert re.search(message, line), line
    assert not list(tmp_path.iterdir())


def test_a_video_does_not_replace_its_record(
    record: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (there := tmp_path / "walk.gif").write_bytes(record.read_bytes())
    assert main(["video", str(there), str(tmp_path / "." / "walk.gif")]) == 1
    assert "walk.gif is the record, which a video would replace" in capsys.readouterr().err
    assert there.read_bytes() == record.read_bytes()


@pytest.mark.parametrize("size", ["641x480", "0x0", "8x8", "64", "99999x64"])
def test_a_size_has_two_even_numbers(size: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["video", "a.mcap", "a.gif", "--size", size])
    assert f"{size} is no size; give even numbers like 640x480" in capsys.readouterr().err


def test_without_opengl_the_error_names_what_to_install(record: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "MUJOCO_GL": "nonsense"}
    done = video(record, tmp_path / "a.gif", env=environment)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "unicon video: no offscreen OpenGL" in line
    assert "apt install libegl1" in line


@pytest.mark.parametrize("ending", ["gif", "mp4"])
def test_a_full_disk_leaves_nothing(record: Path, tmp_path: Path, ending: str) -> None:
    limited = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000)); "
    limited += "from unicon_ros.cli.main import main; raise SystemExit(main())"
    path = tmp_path / "out" / f"a.{ending}"
    path.parent.mkdir()
    path.write_bytes(b"kept")
    words = ["video", record, path, *SIZE, "--from", "4.5", "--to", "5.5"]
    command = [sys.executable, "-c", limited, *map(str, words)]
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "MESA_SHADER_CACHE_DISABLE": "1"}
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=100, env=environment
    )
    if "no offscreen OpenGL" in done.stderr:
        pytest.skip("no offscreen OpenGL")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert f"cannot write {path}: File too large; give a path in a writable folder with" in line
    assert [each.read_bytes() for each in path.parent.iterdir()] == [b"kept"]


def test_a_signal_leaves_nothing(record: Path, tmp_path: Path) -> None:
    words = ["video", record, tmp_path / "a.gif", "--size", "640x480", "--fps", "120"]
    code = "import unicon_lab.view.video as v, sys\n"
    code += "class G(v._Gif):\n  def add(self, p): super().add(p); print('frame', flush=True)\n"
    code += "v._Gif = G\nfrom unicon_ros.cli.main import main; raise SystemExit(main())"
    command = [sys.executable, "-c", code, *map(str, words)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    if not process.stdout.readline():
        pytest.skip("no offscreen OpenGL")
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors.splitlines() == [f"unicon video: stopped: {tmp_path / 'a.gif'} was not written"]
    assert not list(tmp_path.iterdir())


def test_a_record_without_ticks_or_base_says_so(record: Path, tmp_path: Path) -> None:
    from unicon_lab.view.video import Film

    class Other:
        """A recording without a state, or without ticks."""

        def __init__(self, lacking: str = "", ticks: Any = None) -> None:
            self._own, self._lacking = open_record(record), lacking
            self.ticks = self._own.ticks if ticks is None else ticks

        def __getattr__(self, name: str) -> Any:
            return getattr(self._own, name)

        def states(self, name: str) -> Any:
            values = self._own.states(name)
            return np.full_like(values, np.nan) if name == self._lacking else values

    film = Film(Other("base_pos_w"), (64, 64), False, ())  # type: ignore[arg-type]
    assert film.notes == ["the record has no base_pos_w: the robot stays in its place"]
    with pytest.raises(UniconError, match=r"walk.mcap has no ticks: its run ended before"):
        Film(Other(ticks=np.zeros(0)), (64, 64), False, ())  # type: ignore[arg-type]


@pytest.mark.parametrize("still", [False, True])
def test_a_gif_is_written_frame_by_frame_and_shows_each_as_it_is(
    tmp_path: Path, still: bool
) -> None:
    sizes = []

    def drawn() -> Iterator[np.ndarray]:
        for number in range(40):
            pixels = np.full((64, 80, 3), 200, np.uint8)
            pixels[10:20, 0 if still else number : 50] = 250, 20, 30
            yield pixels
            sizes.extend(path.stat().st_size for path in tmp_path.glob(".*.gif"))

    path = tmp_path / "a.gif"
    assert write_video(path, drawn(), 10.0) == 40
    found = frames(path)
    assert len(found) == 40
    assert images.open(path).info["duration"] == 100
    for seen, pixels in zip(found, drawn(), strict=True):
        assert np.abs(seen.astype(int) - pixels).max() < 8
    buffered = 8192
    assert sizes[-1] + buffered >= path.stat().st_size  # no frame waits for the end
    assert sizes == sorted(sizes)


def test_a_terminal_sees_how_many_frames_are_drawn(record: Path, tmp_path: Path) -> None:
    theirs, ours = pty.openpty()[::-1]
    command = [sys.executable, "-m", "unicon_ros", "video", str(record), str(tmp_path / "a.gif")]
    with subprocess.Popen([*command, *SIZE], stdout=subprocess.PIPE, stderr=theirs) as run:
        os.close(theirs)
        said = b""
        with suppress(OSError):  # it has ended
            while part := os.read(ours, 4096):
                said += part
        told = run.communicate(timeout=60.0)[0]
    os.close(ours)
    if b"no offscreen OpenGL" in said:
        pytest.skip("no offscreen OpenGL: apt install libegl1 libgl1-mesa-dri")
    assert re.search(rb"a\.gif \d+ of 60 frames", said), said
    assert told == f"{tmp_path / 'a.gif'}: 60 frames, 6.00 s\n".encode()

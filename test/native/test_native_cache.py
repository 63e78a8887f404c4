"""The cache and the compiler of native ticks, attacked: one warning, and never another command."""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import Fault
from unicon_core.blocks.safety.stops import TiltStop
from unicon_core.flow import Block, CompiledGraph, When, Zip, as_block
from unicon_core.flow.block import LinearMap
from unicon_core.native import build
from unicon_core.native.tick import NativeTick
from unicon_core.states import States, StateSpec

needs_compiler = pytest.mark.skipif(
    not any(map(shutil.which, build.COMPILERS)), reason="no C++ compiler (apt install g++)"
)
pytestmark = needs_compiler


def compiled(
    scale: float = 2.0, num_robots: int | None = None
) -> tuple[CompiledGraph, States, list[str]]:
    """Return a graph that scales a state, its states and the warnings."""
    states = States({"x": StateSpec((4,)), "y": StateSpec((4,))}, num_robots)
    states["x"][...] = [1.0, -2.0, 3.0, 0.1]
    warnings: list[str] = []
    root = Zip(
        *[as_block(LinearMap(states["x"], states["y"], None, scale)) for _ in range(int(scale))]
    )
    native = NativeTick(states, warnings.append)
    for _ in range(2):  # of a run and of its wind-down: one warning for both
        graph = native.compile(root, trace=True)
    return graph, states, warnings


def works(scale: float = 2.0, warning: str = "") -> None:
    """Compile and tick; the command is right, natively or with one warning in Python."""
    graph, states, warnings = compiled(scale)
    graph.step()
    assert (states["y"] == states["x"] * np.float32(scale)).all()
    if not warning:
        assert not warnings
        assert "n0()" in graph.source
        return
    assert len(warnings) == 1
    assert warning in warnings[0]
    assert warnings[0].endswith("; the Python tick runs, with the same commands")
    assert "n0()" not in graph.source


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "unicon" / "native"


def script(path: Path, text: str) -> str:
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return str(path)


def test_a_library_is_compiled_once(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    works()
    (kept,) = cache.iterdir()
    before = kept.stat().st_mtime_ns
    monkeypatch.setattr(build, "_compile", lambda *_: pytest.fail("compiled again"))
    works()
    assert [path.stat().st_mtime_ns for path in cache.iterdir()] == [before]


@pytest.mark.parametrize(
    ("setting", "warning"),
    [
        ({"PATH": "/nowhere", "CXX": ""}, "no C++ compiler: none of c++, g++, clang++"),
        ({"CXX": "/nowhere/c++"}, "CXX=/nowhere/c++ is no command"),
        ({"CXX": "'"}, "is no command"),
        ({"CXX": "false"}, "false fails with status 1"),
        ({"CXX": "true"}, "cannot keep a library"),
        ({"CXX": "c++ -DT=5"}, "error"),
        ({"XDG_CACHE_HOME": "/dev/null"}, "set XDG_CACHE_HOME"),
        ({"XDG_CACHE_HOME": "/proc/1"}, "set XDG_CACHE_HOME"),
    ],
)
def test_what_is_missing_leaves_the_tick_to_python(
    setting: dict[str, str], warning: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in setting.items():
        monkeypatch.setenv(name, value)
    works(warning=warning)


def test_a_python_that_cannot_hold_a_file_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "memfd_create")
    works(warning="a Python with os.memfd_create")


def test_a_full_cache(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    works(warning="No space left on device; make room or give write access")
    assert not [*cache.iterdir()]  # no part is left


def test_a_slow_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CXX", script(tmp_path / "slow", '[ "$4" = -dM ] || exec sleep 9'))
    monkeypatch.setattr(build, "PATIENCE", 0.2)
    works(warning="took more than 0.2 s")


def test_several_robots_stay_in_python() -> None:
    graph, _, warnings = compiled(num_robots=3)
    assert "num_robots" in warnings[0]
    assert len(warnings) == 1
    assert not graph.step()


DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda data: b"",
    "cut off": lambda data: data[: len(data) // 2],
    "without its end": lambda data: data[:-1],
    "changed": lambda data: data[:5000] + b"\xff" + data[5001:],
    "a text": lambda data: b"int main() {}",
    "signed garbage": lambda data: signed(b"\x7fELF" + b"\0" * 5000),
}


def signed(content: bytes) -> bytes:
    return content + build.MARK + hashlib.sha256(content).hexdigest().encode()


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_library_is_compiled_again(damage: str, cache: Path) -> None:
    works()
    (kept,) = cache.iterdir()
    kept.write_bytes(DAMAGE[damage](kept.read_bytes()))
    works()
    assert build._content(kept)  # it is whole again


def test_a_library_of_another_source_is_compiled_again(cache: Path) -> None:
    works(2.0)
    (first,) = cache.iterdir()
    data = first.read_bytes()
    works(3.0)
    (second,) = (path for path in cache.iterdir() if path != first)
    second.write_bytes(data)
    works(3.0)


def test_a_library_that_cannot_be_mended(cache: Path) -> None:
    works()
    (kept,) = cache.iterdir()
    kept.unlink()
    kept.mkdir()
    works(warning="cannot keep a library")


def test_a_library_that_computes_otherwise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = "s/a != a ? a : a > b ? a : b/a > b ? a : b/"
    wrong = f'[ "$4" = -dM ] && exec c++ "$@"; sed "{other}" | c++ "$@"'
    monkeypatch.setenv("CXX", script(tmp_path / "wrong", wrong))
    works(warning="differ from C++ on this machine")


@pytest.mark.parametrize("flags", ["-Ofast", "-ffast-math -march=native"])
def test_flags_of_the_user_leave_numbers_as_they_are(
    flags: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CXX", f"c++ {flags}")
    works()
    small = np.full(4, 1e-45, np.float32)
    assert (small * np.float32(1.0) != 0.0).all()  # denormals are not flushed to zero


def test_a_library_of_other_cpu_features_is_compiled_again(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CXX", script(tmp_path / "native", 'exec c++ $FEATURES "$@"'))
    for features in ("", "-D__AVX9__"):  # as -march=native has it on two machines of one home
        monkeypatch.setenv("FEATURES", features)
        works()
    assert len([*cache.iterdir()]) == 2


def test_a_library_that_changes_under_the_run(cache: Path) -> None:
    graph, states, _ = compiled()
    (kept,) = cache.iterdir()
    with kept.open("r+b") as stream:  # the same file, in place
        stream.write(b"\0" * kept.stat().st_size)
    for number in range(3):
        states["x"][...] = number
        graph.step()
        assert (states["y"] == 2.0 * number).all()


def test_two_programs_of_one_source_have_their_own_memory() -> None:
    one, first, _ = compiled()
    other, second, _ = compiled()
    first["x"][...] = 5.0
    one.step()
    assert not second["y"].any()
    other.step()
    assert (first["y"] == 10.0).all()
    assert (second["y"] == second["x"] * 2.0).all()


CHILD = "from test_native_cache import works; works(7.0)"


def child(**settings: str) -> subprocess.Popen[bytes]:
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    environment = {**os.environ, "PYTHONPATH": path, **settings}
    return subprocess.Popen([sys.executable, "-c", CHILD], env=environment, start_new_session=True)


def test_two_builds_at_once(cache: Path) -> None:
    children = [child(), child()]
    assert [each.wait(60) for each in children] == [0, 0]
    assert len([*cache.iterdir()]) == 1


def test_a_build_that_is_killed(cache: Path, tmp_path: Path) -> None:
    begun = tmp_path / "begun"
    text = f'[ "$4" = -dM ] && exec c++ "$@"; cat > /dev/null; : > {begun}; exec sleep 60'
    with child(CXX=script(tmp_path / "killed", text)) as killed:
        while not begun.exists():
            assert killed.poll() is None
            time.sleep(0.01)
        cache.joinpath(".old.1.2.part").write_bytes(b"half")
        os.utime(cache / ".old.1.2.part", (0, 0))
        os.killpg(killed.pid, signal.SIGKILL)
    works(7.0)
    assert all(path.suffix == ".so" for path in cache.iterdir())


def test_inline_code_that_is_no_expression_over_arrays_stays_in_python() -> None:
    states = States({"y": StateSpec((3,))})
    copy: Any = LinearMap(np.ones(3, np.float32), states["y"])
    scales: Any = memoryview(np.zeros(1).data)
    seen = [0]
    asked = Block("asked", lambda: scales[0] > 0, inline="m[0] > 0", inline_names={"m": scales})
    text = "seen[0] += 1\nif seen[0] > 9: seen[0] = 0"
    count = Block("count", lambda: None, inline=text, inline_names={"seen": seen}, endless=True)
    graph = NativeTick(states, pytest.fail).compile(Zip(When(asked, as_block(copy)), count))
    for value in (0.0, 1.0):
        scales[0] = value
        graph.step()
        assert (states["y"] == value).all()
    assert seen == [2]


def test_libraries_that_were_long_unused_go(cache: Path) -> None:
    cache.mkdir(parents=True)
    for name, age in (("old.so", 31), ("used.so", 29)):
        (cache / name).touch()
        then = time.time() - 86400 * age
        os.utime(cache / name, (then, 0))
    works()
    names = {path.name for path in cache.iterdir()}
    assert "used.so" in names
    assert "old.so" not in names


def test_fault_in_a_stretch_is_the_blocks_own() -> None:
    states = States({"g": StateSpec((3,)), "y": StateSpec((3,))})
    copy: Any = LinearMap(states["g"], states["y"])
    root = Zip(as_block(copy), as_block(TiltStop(states["g"])))
    graph = NativeTick(states, pytest.fail).compile(root)
    states["g"][...] = [0.0, 0.0, -1.0]
    assert graph.step() is False
    states["g"][...] = [np.nan] * 3
    for _ in range(3):
        with pytest.raises(Fault, match="projected_gravity is NaN"):
            graph.step()
    states["g"][...] = [0.0, 0.0, -1.0]
    assert graph.step() is False


def test_an_interrupt_in_a_stretch_goes_on() -> None:
    """A handler that raises where native code calls a block: ctypes would only print that."""

    def interrupt(*_: object) -> None:
        raise InterruptedError

    states = States({"x": StateSpec((3_000_000,)), "y": StateSpec((3_000_000,))})
    copy: Any = LinearMap(states["x"], states["y"], None, 2.0)
    gravity = States({"g": StateSpec((3,))})["g"]
    gravity[...] = np.nan
    root = Zip(as_block(copy), as_block(TiltStop(gravity)))
    graph = NativeTick(states, pytest.fail).compile(root)
    before = signal.signal(signal.SIGALRM, interrupt)
    found = []
    try:
        for _ in range(10):
            try:
                signal.setitimer(signal.ITIMER_REAL, 2e-4)  # the copy takes longer
                graph.step()
            except (InterruptedError, Fault) as error:
                found.append(type(error))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert found == [InterruptedError] * 10

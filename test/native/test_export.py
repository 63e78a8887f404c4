"""`unicon export --cpp`: refusals, header and folder; slow: compiled without Python, exact."""

from __future__ import annotations

import errno
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import WorkflowError
from unicon_core.native import build
from unicon_core.native.operands import Arena
from unicon_core.runtime.rollouts import Rollouts
from unicon_core.workflow import Program, load_document
from unicon_ros.cli.main import main

pytest.importorskip("mujoco")
pytest.importorskip("onnxruntime")

MIXED = """
schema: unicon.workflow/1
name: mixed
robot: go2
platform: mujoco
scene: {initial_pose: rest}
policies: {walk: go2_velocity}
rate: 50
commands: [{velocity_command: {constant: [3.0, 0.0, 0.2], ramp: 2.0}}]   # beyond its bounds
flow:
  chain:
    - pose: {to: stand, duration: 1.0}
    - loop: {do: {policy: walk}, until: "tick > 120"}
    - hold: {duration: 0.2}
    - loop: {do: NESTED, until: {elapsed: 1.0}}
    - pose: {to: rest, duration: 0.5, fade_in: 0.2}
    - damp: {duration: 0.2}
safety:
  - finite
  - joint_limits
  - rate_limit
  - effort_limits
  - velocity_stop: {limit: 60.0}
  - tilt_stop
  - stale_stop: {timeout: 1.0}
"""
WORKFLOWS = {
    "go2_walk": 1000,
    "g1_walk": 1000,
    "go2_teleop": 500,
    "mixed": 400,
    "h1_stand": 100,
    "unsafe": 600,
}


def exported(folder: Path, workflow: str, *words: str) -> int:
    return main(["export", workflow, "--cpp", str(folder), *words])


def mixed(folder: Path) -> str:
    path = folder / "mixed.yaml"
    nested = "{policy: walk}"
    for _ in range(13):  # the compiler puts deep levels into functions of their own
        nested = f"{{chain: [{nested}]}}"
    path.write_text(MIXED.replace("NESTED", nested))
    return str(path)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["go2_stand"], "go2_stand cannot do without Python (sway: it has no twin); leave these"),
        (["go2_teleop", "--set", "flow.chain.1.switch.on=tick % 2"], r"\(switch: it has no twin\)"),
        (["go2_stand", "--set", "platform=unitree"], "use --set platform=mujoco"),
        (["go2_stand", "--set", "num_robots=2"], "leave out num_robots"),
    ],
)
def test_what_cannot_be_exported(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exported(tmp_path / "out", *words) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert re.search(said.replace("(sway", r"\(sway").replace("twin);", r"twin\);"), line)
    assert not [*tmp_path.iterdir()]


def test_a_folder_that_is_taken(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    full, file = tmp_path / "full", tmp_path / "file"
    full.mkdir()
    full.joinpath("mine").write_text("mine")
    file.write_text("mine")
    for folder in (full, file, file / "below"):
        assert exported(folder, "h1_stand", "--ticks", "2") == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert f"cannot export into {folder}" in line
        assert "absent or empty folder" in line
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "full", "mine"]
    assert file.read_text() == "mine"


def test_a_full_disk_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    assert exported(tmp_path / "out", "h1_stand", "--ticks", "2") == 1
    assert "No space left on device; name" in capsys.readouterr().err
    assert not [*tmp_path.iterdir()]


def test_the_header_says_where_states_lie(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()  # an empty one is fine
    assert exported(tmp_path / "out", "h1_stand", "--ticks", "3") == 0
    text = (tmp_path / "out" / "controller.h").read_text()
    program = Program(load_document("h1_stand"), dry=True)
    for name, slot in program.states.layout.slots.items():
        assert f"(struct unicon_tick_states, {name}, {slot.offset}, {slot.nbytes})" in text
    program.close()
    assert "/* joint positions; rad: " in text
    ticks, done, into, out, took, cpu, rest = head_of(tmp_path / "out")
    assert (ticks, done) == (3, 0)
    assert 0.0 < took[0] <= took[1] <= took[2]
    assert len(rest) == 3 * (into + out)
    assert cpu in Path("/proc/cpuinfo").read_bytes()
    if compiler := shutil.which("cc"):
        for language in ("c", "c++"):
            command = [compiler, "-fsyntax-only", "-Wall", "-Werror", "-x", language]
            subprocess.run([*command, tmp_path / "out" / "controller.h"], check=True)


def test_an_arena_keeps_what_arrays_share() -> None:
    base, other = np.arange(12, dtype=np.float32), np.arange(3, dtype=np.int64)
    views: list[Any] = [other, base[1::2], base[4:6], base]
    arena = Arena(views)
    offsets = [int(arena.at(each).rpartition(" ")[2]) for each in views]
    assert offsets[0] == 0
    assert [offset - offsets[3] for offset in offsets[1:]] == [4, 16, 0]
    content = arena.content()
    for view, offset in zip((other, base), (0, offsets[3])):
        assert content[offset : offset + view.nbytes].tobytes() == view.tobytes()


def test_a_reset_is_what_it_writes() -> None:
    values, others = np.arange(4, dtype=np.uint8), np.zeros(2, np.int64)
    arena = Arena([values, others])

    def fixed() -> None:
        values[1:3] = 7

    def relative() -> None:
        others[1] = values[0]

    text = arena.effect(fixed, "reset")
    assert "{7, 7}" in text
    assert "arena.memory + 1," in text
    assert arena.effect(lambda: None, "reset") == ""
    with pytest.raises(WorkflowError, match="reset depends on memory"):
        arena.effect(relative, "reset")
    assert values.tolist() == [0, 1, 2, 3]
    assert not others.any()


@pytest.mark.slow
def test_two_exports_at_once(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "unicon_ros", "export", "h1_stand", "--ticks", "50"]
    both = [subprocess.Popen([*words, "--cpp", str(tmp_path / "out")]) for _ in range(2)]
    assert sorted(each.wait(60) for each in both) == [0, 1]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out" / "vectors.bin").is_file()


def commands(workflow: str, ticks: int, overrides: list[str]) -> bytes:
    """Return the outputs of a rollout in Python, as they are recorded."""
    program = Program(load_document(workflow, overrides), dry=True)
    rollout = Rollouts(program).run(ticks)
    names = program.platform.facts.reads
    places = [program.states.offset(name) for name in names]
    sizes = [program.states[name].size for name in names]
    rows = [rollout.states[:, p : p + n] for p, n in zip(places, sizes)]
    program.close()
    return np.concatenate(rows, 1).astype(np.float32).tobytes()


def run(bare: Path, folder: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    """Run a command with nothing but some tools on its path, no Python among them."""
    done = subprocess.run(
        [*map(str, words)], cwd=folder, env={"PATH": str(bare)}, capture_output=True, text=True,
        timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    folder = tmp_path / "bare"
    folder.mkdir()
    for tool in ("ar", "as", "ld", "make", "ranlib", "cmake", "ctest", *build.COMPILERS):
        if found := shutil.which(tool):
            folder.joinpath(tool).symlink_to(found)
    return folder


def onnxruntime_library() -> Path:
    """Return the shared library of the installed wheel, or skip."""
    import onnxruntime

    library = next((Path(onnxruntime.__file__).parent / "capi").glob("libonnxruntime.so*"), None)
    if library is None:
        pytest.skip("onnxruntime without a shared library")
    return library


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Exports a workflow of WORKFLOWS, once for all compilers."""

    @cache
    def exported_once(workflow: str) -> Path:
        folder, name, words = tmp_path_factory.mktemp(workflow), workflow, list[str]()
        if workflow == "mixed":
            name = mixed(folder)
        if workflow == "unsafe":  # a command that is not finite is none nevertheless
            name, words = "go2_walk", ["--set", "safety=none"]
        if workflow == "go2_teleop":  # two switches with blends
            schedule = "[[0, 0, 0, 0], [3, 0.5, 0, 0], [6, 0, 0, 0]]"
            words = ["--set", f"commands=[{{velocity_command: {{schedule: {schedule}}}}}]"]
        ticks, out = WORKFLOWS[workflow], folder / "out"
        assert exported(out, name, "--ticks", str(ticks), *words) == 0
        assert main(["states", "--header", str(out / "states.h"), name, *words]) == 0
        count, done, into, size, *_, rest = head_of(out)
        rows = np.frombuffer(rest[count * into :], np.float32).reshape(count, -1)
        python = np.frombuffer(commands(name, ticks, words[1:]), np.float32).reshape(count, -1)
        assert done == (workflow == "mixed")
        assert rows.nbytes == count * size
        assert (rows[:, : python.shape[1]].view(np.int32) == python.view(np.int32)).all()
        return out

    return exported_once


def head_of(out: Path) -> tuple[int, int, int, int, list[float], bytes, bytes]:
    """Return ticks, done, bytes of input and output, times [us], CPU features and vectors."""
    first, cpu, rest = (out / "vectors.bin").read_bytes().split(b"\n", 2)
    ticks, done, into, size, _, *took = first.decode().split()
    return int(ticks), int(done), int(into), int(size), [*map(float, took)], cpu, rest


FAST = ("-O2", "-fno-fast-math", "-ffp-contract=off")
CHECKED = (*FAST, "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
NUMBERS = r"p50 ([\d.]+), p99 ([\d.]+), maximum ([\d.]+)"


@pytest.mark.slow
@pytest.mark.parametrize("flags", [FAST, CHECKED], ids=["fast", "sanitizers"])
@pytest.mark.parametrize("compiler", ["g++", "clang++"])
@pytest.mark.parametrize("workflow", WORKFLOWS)
def test_compiled_without_python(
    workflow: str,
    compiler: str,
    flags: tuple[str, ...],
    bare: Path,
    tmp_path: Path,
    project: Callable[[str], Path],
) -> None:
    if workflow == "g1_walk" and not os.environ.get("UNICON_ASSETS"):
        pytest.skip("no assets (UNICON_ASSETS)")
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler} (apt install {'clang' if compiler == 'clang++' else compiler})")
    if flags == CHECKED:
        empty = tmp_path / "empty.cpp"
        empty.write_text("int main() {}\n")
        command = [compiler, *flags, empty, "-o", tmp_path / "empty"]
        if subprocess.run(command, capture_output=True).returncode:
            pytest.skip(f"{compiler} without sanitizers (apt install libclang-rt-dev)")
    library = onnxruntime_library()
    out = shutil.copytree(project(workflow), tmp_path / "out")
    count, *_, python, _, _ = head_of(out)
    strict = [compiler, "-std=c++17", "-Wall", "-Wextra", "-Werror", *flags]
    run(bare, out, *strict, "-c", "controller.cpp")
    run(bare, out, *strict, "-c", "main.cpp")
    attack = Path(__file__).with_name("attack_controller.cpp")
    for program in (attack, "replay.cpp")[workflow == "h1_stand" :]:  # no network is missed
        run(bare, out, *strict, "-I.", "controller.o", program, "-o", "p", "-ldl")
        said = run(bare, out, "./p", ".", library).stdout
        if program == attack:
            first_block = "send" if workflow == "unsafe" else "finite"
            assert said.startswith(first_block) or workflow == "g1_walk"
            assert said.endswith("policy\n") or workflow == "mixed"
    equal, spread = said.splitlines()
    assert equal == f"{count} ticks: equal bit for bit"
    print(f"{workflow}, {compiler}, {flags[-2]}: {spread}")
    found = re.fullmatch(rf"a step \[us\]: {NUMBERS}; Python's: {NUMBERS}", spread)
    assert found
    times = [*map(float, found.groups())]
    assert times[3:] == python
    assert 0.0 < times[0] <= times[1] <= times[2]
    assert 0.0 < times[3] <= times[4] <= times[5]


@pytest.mark.slow
def test_its_cmake_project_and_damaged_vectors(
    bare: Path, tmp_path: Path, project: Callable[[str], Path]
) -> None:
    for tool in ("cmake", "make", "c++"):
        if shutil.which(tool) is None:
            pytest.skip(f"no {tool} (apt install cmake make g++)")
    library = onnxruntime_library()
    out = shutil.copytree(project("go2_walk"), tmp_path / "out")
    made = "-B", "b", "-G", "Unix Makefiles", f"-DUNICON_ONNXRUNTIME={library}"
    run(bare, out, "cmake", *made)
    run(bare, out, "cmake", "--build", "b")
    run(bare, out, "cmake", "--build", "b", "--target", "drive")
    ended = subprocess.run([out / "b/drive"], capture_output=True, text=True)
    assert ended.returncode == 2
    assert "FOLDER SEGMENT_TO_READ SEGMENT_TO_WRITE" in ended.stderr
    run(bare, out, "ctest", "--test-dir", "b", "--output-on-failure")
    first, cpu, rest = (out / "vectors.bin").read_bytes().split(b"\n", 2)
    (out / "vectors.bin").write_bytes(b"\n".join([first, cpu + b" more", rest]))
    said = run(bare, out, "b/replay", ".", library).stdout
    assert "; other CPU features: compared within 1e-5" in said
    assert "1000 ticks: equal within 1e-5" in said
    for damaged in (rest, b"\n".join([first, cpu, rest[:-1]]), b""):
        (out / "vectors.bin").write_bytes(damaged)
        ended = subprocess.run([out / "b/replay", out, library], capture_output=True, text=True)
        assert ended.returncode == 1
        assert "vectors.bin is absent, cut off or another's" in ended.stderr

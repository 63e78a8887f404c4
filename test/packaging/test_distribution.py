"""What an outsider gets: an archive without our tests, a wheel for each machine, files for CI."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
import yaml
from source_tree import PACKAGES, ROOT, copy_source

LOW = "3.10"


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory, under_colcon: bool) -> Path:
    """Return a folder with the archive, and the wheel that was built of it."""
    if under_colcon:
        pytest.skip("colcon tests its own installation")
    source = copy_source(tmp_path_factory.mktemp("source") / "unicon_ros")
    out = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "setup.py", "-q", "sdist", "-d", str(out)]
    subprocess.run(command, cwd=source, check=True, capture_output=True, timeout=120)
    (archive,) = out.glob("*.tar.gz")
    pip = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation"]
    subprocess.run(
        [*pip, "--no-index", "-w", str(out), str(archive)],
        check=True,
        capture_output=True,
        timeout=120,
    )
    return out


def test_the_archive_has_code_and_configurations_and_no_tests(built: Path) -> None:
    (path,) = built.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        names = [name.partition("/")[2] for name in archive.getnames()]
    tops = {name.partition("/")[0] for name in names if name}
    assert not tops & {"test", "tools", "docs", "examples", ".ci", ".github"}
    assert {"config", "launch", "resource", *PACKAGES} <= tops
    assert "config/assets.yaml" in names
    assert "config/policies/go2_velocity/policy.yaml" in names


def test_the_wheel_is_for_every_machine_and_python(built: Path) -> None:
    (path,) = built.glob("*.whl")
    assert path.name.endswith("-py3-none-any.whl")
    with zipfile.ZipFile(path) as wheel:
        names = wheel.namelist()
        (metadata,) = (n for n in names if n.endswith(".dist-info/METADATA"))
        told = wheel.read(metadata).decode()
    assert f"Requires-Python: >={LOW}" in told
    assert not [name for name in names if name.startswith(("test/", "tools/"))]
    assert [name for name in names if name.endswith("unicon_core/py.typed")]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_an_outsider_installs_it_of_an_index_and_walks(built: Path, tmp_path: Path) -> None:
    """From wheels in a folder alone, in an empty environment and an empty home."""
    wheels, home = tmp_path / "wheels", tmp_path / "home"
    home.mkdir()
    (own,) = built.glob("*.whl")
    got = subprocess.run(
        [sys.executable, "-m", "pip", "download", "-q", "-d", str(wheels), f"{own}[sim]"],
        capture_output=True,
        text=True,
        timeout=600,
    )
    if got.returncode:
        pytest.skip(f"no index at hand: {got.stderr.strip().splitlines()[-1]}")
    subprocess.run([sys.executable, "-m", "venv", str(tmp_path / "venv")], check=True)
    bin_ = tmp_path / "venv" / "bin"
    pip = [str(bin_ / "pip"), "install", "-q", "--no-index", "--find-links", str(wheels)]
    subprocess.run([*pip, "unicon_ros[sim]"], check=True, timeout=600)
    environment = {"PATH": f"{bin_}:{os.environ['PATH']}", "HOME": str(home)}
    command = ["unicon", "run", "go2_walk", "--speed", "max", "--quiet", "--report", "walk.json"]
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    told = json.loads((tmp_path / "walk.json").read_text("utf-8"))
    assert not told["fell"]
    assert told["base_displacement_m"][0] > 2.0


def test_the_files_for_ci_call_what_there_is() -> None:
    told = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text("utf-8"))
    jobs = told["jobs"]
    runs = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    made = {word for run in runs for word in re.findall(r"^make (\S+)", run, re.MULTILINE)}
    assert made == {"venv", "check", "test"}
    assert made <= set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text("utf-8"), re.M))
    assert jobs["test"]["strategy"]["matrix"]["python"][0] == LOW
    assert jobs["colcon"]["strategy"]["matrix"]["distribution"] == ["humble", "jazzy", "kilted"]


def test_the_containers_install_extras_that_exist() -> None:
    text = (ROOT / "Dockerfile").read_text("utf-8")
    extras = re.search(r"^ARG EXTRAS=(\S+)$", text, re.MULTILINE)
    assert extras is not None
    known = re.findall(r'^    "([\w-]+)":', (ROOT / "setup.py").read_text("utf-8"), re.MULTILINE)
    assert set(extras[1].split(",")) <= set(known)
    words = {line.split()[0] for line in text.splitlines() if re.match(r"[A-Z]", line)}
    assert words <= {"ARG", "FROM", "RUN", "COPY", "ENV", "ENTRYPOINT", "CMD"}
    told = json.loads((ROOT / ".devcontainer" / "devcontainer.json").read_text("utf-8"))
    assert told["postCreateCommand"] == "make venv"


@pytest.mark.parametrize("system", ["darwin", "win32", "linux"])
def test_an_import_elsewhere_than_on_linux_warns(system: str) -> None:
    code = f"import sys; sys.platform = {system!r}; import unicon_core"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ("runs on Linux alone" in said.stderr) is (system != "linux")

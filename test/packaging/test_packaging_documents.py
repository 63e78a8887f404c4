"""README, ARCHITECTURE and CONTRIBUTING tell the truth: links, file names, commands, examples."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from source_tree import PACKAGES, ROOT, tracked_files

DOCUMENTS = (
    *("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md"),
    *sorted(name for name in tracked_files() if re.fullmatch(r"docs/[\w/]+\.md", name)),
)
FOLDERS = (*(f"{package}/" for package in PACKAGES), "config/", "launch/", "test/")


def text_of(document: str) -> str:
    return (ROOT / document).read_text(encoding="utf-8")


def code_block(document: str, language: str, first_words: str) -> str:
    """Return the code block of a document whose first line starts with these words."""
    blocks = re.findall(rf"```{language}\n(.*?)```", text_of(document), re.DOTALL)
    [block] = [block for block in blocks if block.startswith(first_words)]
    return str(block)


def unicon(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(cwd), str(ROOT), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, "-m", "unicon_ros", *arguments],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": path.rstrip(os.pathsep)},
        capture_output=True,
        text=True,
        check=False,
        timeout=90,
    )


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_relative_link_leads_to_a_tracked_file(document: str) -> None:
    links = re.findall(r"\]\(([^)#]+)\)", text_of(document))
    folder = (ROOT / document).parent
    relative = {link for link in links if "://" not in link}
    tracked = {ROOT / name for name in tracked_files()}
    assert {link for link in relative if (folder / link).resolve() not in tracked} == set()


def test_the_index_of_documents_names_each() -> None:
    linked = set(re.findall(r"\]\(([\w/]+\.md)\)", text_of("docs/README.md")))
    assert {f"docs/{name}" for name in linked} | {"docs/README.md"} == {
        name for name in DOCUMENTS if name.startswith("docs/")
    }


@pytest.mark.parametrize("document", DOCUMENTS)
def test_nothing_is_said_twice(document: str) -> None:
    words = re.sub(r"```.*?```", "", text_of(document), flags=re.DOTALL)
    long = [line for line in words.splitlines() if len(line) > 100]
    assert {line for line in long if long.count(line) > 1} == set()


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_file_and_folder_that_is_named_exists(document: str) -> None:
    quoted = re.findall(r"`([A-Za-z0-9_./-]+)`", text_of(document))
    named = {name for name in quoted if name.startswith(FOLDERS)}
    named |= {f"unicon_core/{name}" for name in quoted if _below(name, ROOT / "unicon_core")}
    assert {name for name in named if not (ROOT / name).exists()} == set()


def _below(name: str, folder: Path) -> bool:
    # ARCHITECTURE shortens unicon_core/flow/block.py to flow/block.py.
    return name[0].isalpha() and "/" in name and (folder / name.split("/")[0]).is_dir()


LONGEST_PATH = 1200
"""Lines of the classes and functions that a reader reads on one way through the house."""


@pytest.mark.parametrize("path", ["From `recv` to a published byte", "From a `cmd_vel` byte to"])
def test_each_reading_path_is_one_sitting(path: str) -> None:
    section = text_of("ARCHITECTURE.md").split(f"**{path}", 1)[1].split("\n\n", 2)[1]
    steps = re.findall(r"^\d+\. `([\w/.]+\.py)` \((.+?)\) – ", section, re.MULTILINE)
    assert len(steps) == len(section.strip().splitlines()) >= 5
    lines = sum(
        length_of(file, name) for file, names in steps for name in re.findall(r"[\w.]+", names)
    )
    assert lines <= LONGEST_PATH, f"{lines} lines in {len(steps)} files"


def length_of(file: str, name: str) -> int:
    """Return how many lines a class, method or function has."""
    body: list[ast.stmt] = ast.parse(text_of(file)).body
    for part in name.split("."):
        [node] = [each for each in body if getattr(each, "name", "") == part]
        body = getattr(node, "body", [])
    return (node.end_lineno or 0) - node.lineno + 1


def test_every_make_target_that_is_named_exists() -> None:
    targets = set(re.findall(r"^([a-z-]+):", text_of("Makefile"), re.MULTILINE))
    for document in DOCUMENTS:
        assert set(re.findall(r"(?:`|^)make ([a-z-]+)", text_of(document), re.MULTILINE)) <= targets


def test_every_command_of_the_table_exists(tmp_path: Path) -> None:
    named = set(
        re.findall(r"^\| `unicon ([a-z-]+)", text_of("docs/reference/commands.md"), re.MULTILINE)
    )
    assert named >= {"run", "check", "show", "robots"}
    for command in named:
        done = unicon(command, "--help", cwd=tmp_path)
        assert done.returncode == 0, f"unicon {command}: {done.stderr}"


def test_every_option_of_run_that_is_named_exists(tmp_path: Path) -> None:
    sentence = re.search(
        r"`unicon run` takes (.*?)\. Exit", text_of("docs/reference/commands.md"), re.DOTALL
    )
    assert sentence is not None
    options = set(re.findall(r"--[a-z-]+", sentence.group(1)))
    help_text = unicon("run", "--help", cwd=tmp_path).stdout
    assert {option for option in options if option not in help_text} == set()


def test_every_topic_of_the_default_map_is_in_the_table_with_its_type() -> None:
    documents = yaml.safe_load(text_of("config/maps/default.yaml"))
    topics = {
        (entry["topic"], entry["type"].replace("/msg/", "/"))
        for direction in ("publish", "subscribe")
        for entry in documents[direction]
    }
    told = set(
        re.findall(
            r"^\| `([a-z_/]+)`.*? \| (\w+/\w+) \|", text_of("docs/reference/ros.md"), re.MULTILINE
        )
    )
    assert topics <= told


def test_the_table_of_services_is_that_of_the_code() -> None:
    from unicon_ros.parameter_table import SERVICES

    rows = re.findall(r"^\| `~/(\w+)` \| (.*) \|$", text_of("docs/reference/ros.md"), re.MULTILINE)
    assert dict(rows) == SERVICES


def test_every_parameter_of_the_node_is_in_the_table() -> None:
    from unicon_ros.parameter_table import DECLARED

    _, table = text_of("docs/reference/ros.md").split("| parameter | default | means |")
    rows = re.findall(r"^\| (`.*?`) \|", table, re.MULTILINE)
    told = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    assert told == {"use_sim_time", *(name for name, *_ in DECLARED)}


def test_the_readme_is_short_and_its_two_walks_are_one(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    assert len(text_of("README.md").split()) <= 600
    (tmp_path / "walk.py").write_text(code_block("README.md", "python", "from unicon_core"))
    (tmp_path / "walk.yaml").write_text(code_block("README.md", "yaml", "# walk.yaml"))
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    python = subprocess.run(
        [sys.executable, "walk.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
        timeout=90,
    )
    yaml_run = unicon("run", "walk.yaml", "--speed", "max", "--quiet", cwd=tmp_path)
    moved = [re.search(r"moved .*", text) for text in (python.stdout, yaml_run.stdout)]
    assert moved[0] is not None
    assert moved[1] is not None
    assert moved[0][0] == moved[1][0]


def test_the_examples_of_the_tutorial_run(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    page = "docs/tutorial.md"
    (tmp_path / "my_blocks.py").write_text(code_block(page, "python", "# my_blocks.py"), "utf-8")
    workflow = tmp_path / "my_workflow.yaml"
    workflow.write_text(code_block(page, "yaml", "# my_workflow.yaml"), "utf-8")
    checked = unicon("check", str(workflow), cwd=tmp_path)
    assert checked.returncode == 0, checked.stdout + checked.stderr
    ran = unicon("run", str(workflow), "--speed", "max", "--no-ros", cwd=tmp_path)
    assert ran.returncode == 0, ran.stdout + ran.stderr


def test_the_parts_of_the_slow_tests_have_every_folder_once() -> None:
    of_make = ("MAKE", "MFLAGS", "TEST_ARGS")  # of the make that runs this test
    plain = {name: value for name, value in os.environ.items() if not name.startswith(of_make)}
    said = re.findall(r"^SLOW_PARTS := (.*)", text_of("Makefile"), re.MULTILINE)[0].split()
    seen: list[str] = []
    for part in (*said, "others"):
        command = ["make", "-n", "--no-print-directory", "test-slow", f"PART={part}"]
        made = subprocess.run(
            command, cwd=ROOT, capture_output=True, text=True, timeout=60, env=plain
        )
        assert made.returncode == 0, made.stderr
        seen += made.stdout.rpartition("-m slow")[2].replace("\\\n", " ").split()
        assert f"`{part}`" in text_of("CONTRIBUTING.md")
    folders = {f"test/{path.parent.name}" for path in (ROOT / "test").glob("*/test_*.py")}
    assert sorted(seen) == sorted(
        {*folders, *(f"test/{p.name}" for p in (ROOT / "test").glob("test_*.py"))}
    )
    wrong = subprocess.run(
        ["make", "-n", "test-slow", "PART=nope"], cwd=ROOT, capture_output=True, text=True
    )
    assert "PART=nope is none of: " in wrong.stderr

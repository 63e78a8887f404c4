"""B15: a workflow's functions are called only where they say that they make blocks or platforms."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from attack_files import BASE, told, workflow

MODULE = """\
from unicon_core.flow import Amends, Reads, Tick
from unicon_core.platforms import fake
from unicon_core.platforms.platform import Platform

def plain(**options):
    open("pwn", "w").close()

def make(states, robot, period):
    open("pwn", "w").close()

def block(tick: Reads) -> Tick:
    return lambda: True

def ticking(*, period: float) -> Tick:
    return lambda: True

class Counting:
    def __init__(self, joint_pos_target: Amends):
        pass
    def __call__(self):
        return True

def platform(states, robot, period) -> Platform:
    return fake.make_robot(states, robot, period)

def robot_of_mine(states, robot, period) -> fake.FakePlatform:
    return fake.make(states, robot, period)
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "attack_module.py").write_text(MODULE, "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "attack_module", raising=False)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("command", ["check", "show", "run"])
@pytest.mark.parametrize(
    "call",
    [
        '{function: "os:system", command: "touch pwn"}',
        '{function: "subprocess:Popen", args: [touch, pwn]}',
        "{function: \"builtins:exec\", source: \"open('pwn', 'w')\"}",
        '{function: "attack_module:plain", x: 1}',
        '"attack_module:plain"',
    ],
)
def test_an_undeclared_function_is_refused_before_the_call(
    command: str, call: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = workflow(folder, BASE.replace("{hold: {duration: 0.1}}", f"{{call: {call}}}"))
    status, spoken = told(capsys, command, path)
    spoken = " ".join(spoken.split())
    assert status == 1
    assert not (folder / "pwn").exists()
    assert "does not say that it makes one, so it is not called" in spoken
    assert "annotate its states (Reads, Writes, Amends)" in spoken
    assert "Traceback" not in spoken


@pytest.mark.parametrize("command", ["check", "show", "run"])
def test_an_undeclared_platform_is_refused_before_the_call(
    command: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = workflow(folder)
    status, spoken = told(capsys, command, path, "--set", "platform=attack_module:make")
    assert status == 1
    assert not (folder / "pwn").exists()
    assert "annotate what it returns (-> Platform" in " ".join(spoken.split())


@pytest.mark.parametrize("name", ["block", "ticking", "Counting"])
def test_a_declared_factory_is_called(
    name: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flow = f'{{zip: [hold, {{call: "attack_module:{name}"}}]}}'
    path = workflow(folder, BASE.replace("{hold: {duration: 0.1}}", flow))
    status, spoken = told(capsys, "show", path)
    assert status == 0, spoken


@pytest.mark.parametrize("name", ["platform", "robot_of_mine"])
def test_a_declared_platform_is_built(
    name: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = workflow(folder)
    status, spoken = told(capsys, "show", path, "--set", f"platform=attack_module:{name}")
    assert status == 0, spoken


@pytest.mark.parametrize("target", ["", ":", "os:", ":x", "..os:system", "os path:x", "os:a.b"])
def test_what_is_no_target_is_told(
    target: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = workflow(folder, BASE.replace("{hold: {duration: 0.1}}", f'{{call: "{target}"}}'))
    status, spoken = told(capsys, "show", path)
    assert status == 1
    assert "Traceback" not in spoken


def test_a_module_that_breaks_while_it_is_imported_is_told(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "broken_attack_module.py").write_text("raise ValueError('no')\n", "utf-8")
    call = '{call: "broken_attack_module:f"}'
    path = workflow(folder, BASE.replace("{hold: {duration: 0.1}}", call))
    status, spoken = told(capsys, "show", path)
    assert status == 1
    assert "importing 'broken_attack_module' raised ValueError: no" in spoken


@pytest.mark.parametrize("data", ["robot", "map", "policy"])
def test_data_files_import_nothing(
    data: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mark = "open('pwn', 'w')\n"
    (folder / "imported_by_data.py").write_text(mark, "utf-8")
    texts = {
        "robot": "schema: unicon.robot/1\nname: NAME\nmodels: {mjcf: NAME}\n",
        "map": "publish: [{topic: NAME, type: NAME, fields: {}}]\n",
        "policy": "schema: unicon.policy/1\nname: NAME\nonnx: NAME\n",
    }
    path = folder / "data.yaml"
    path.write_text(texts[data].replace("NAME", "'imported_by_data:x'"), "utf-8")
    overrides = {
        "robot": "robot=./data.yaml",
        "map": "map=./data.yaml",
        "policy": "policies.p=./data.yaml",
    }
    told(capsys, "check", workflow(folder), "--set", overrides[data])
    assert "imported_by_data" not in sys.modules
    assert not (folder / "pwn").exists()

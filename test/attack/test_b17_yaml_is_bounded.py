"""B17: every reader of YAML is bounded in size, depth and number, and reads YAML 1.2's numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from attack_files import BASE, one_line, run_bounded, workflow

from unicon_base.bounded_yaml import MAX_SIZE
from unicon_base.errors import PolicyError, RobotError, UniconError, WorkflowError
from unicon_base.located_yaml import parse_value, parse_yaml, read_yaml
from unicon_core.policies import load_policy
from unicon_core.robots import load_robot
from unicon_core.workflow.document import load_document
from unicon_msgs_map import load_map
from unicon_msgs_map.errors import MapError

BOMB = "\n".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9 if i else ['lol'] * 9)}]" for i in range(10)
)
ATTACKS = {
    "bomb": BOMB + "\n",
    "mapping bomb": "\n".join(
        f"a{i}: &a{i} {{{', '.join(f'k{j}: *a{i - 1}' for j in range(9)) if i else 'k: 1'}}}"
        for i in range(10)
    ),
    "million": "a: [" + "1," * 1_000_000 + "1]\n",
    "million lines": "a:\n" + "- 1\n" * 1_000_000,
    "large": "a: " + "x" * (MAX_SIZE + 1) + "\n",
    "self": "a: &a [*a]\n",
    "self key": "a: &a {? *a : 1}\n",
    "deep": "a: " + "[" * 3000 + "]" * 3000 + "\n",
    "deeper": "a: " + "[" * 300_000 + "\n",
    "deep mapping": "a: " + "{a: " * 3000 + "\n",
    "deep lines": "\n".join(" " * i + "a:" for i in range(500)) + "\n",
    "digits": "a: " + "9" * 5000 + "\n",
    "more than 64 bits": "a: " + "9" * 20 + "\n",
    "beyond a double": "a: 1e999\n",
    "control": 'a: "\\a"\n',
    "surrogate": 'a: "\\ud800"\n',
    "documents": "a: 1\n---\nb: 1\n",
    "tag": "a: !!python/object/apply:os.system ['touch pwn']\n",
    "tagged set": "a: !!set {b}\n",
    "unknown alias": "a: *b\n",
    "bytes": "a: \x00\n",
}
READERS: dict[str, tuple[Callable[[Path], Any], type[Exception]]] = {
    "workflow": (load_document, WorkflowError),
    "robot": (load_robot, RobotError),
    "map": (load_map, MapError),
    "policy": (load_policy, PolicyError),
}


LARGE = ("million lines", "deep")
"""Attacks that take half a second each: of one reader only, but in the slow tests."""
CASES = [
    pytest.param(
        attack, reader, marks=[pytest.mark.slow] if attack in LARGE and reader != "workflow" else []
    )
    for attack in ATTACKS
    for reader in READERS
]


@pytest.mark.parametrize(("attack", "reader"), CASES)
def test_every_reader_refuses_it_with_its_line(attack: str, reader: str, tmp_path: Path) -> None:
    read, error = READERS[reader]
    path = tmp_path / "a.yaml"
    path.write_text(ATTACKS[attack], "utf-8", errors="surrogatepass")
    with pytest.raises(error) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert len(str(caught.value)) < 1000
    assert "\n" not in str(caught.value)
    if reader != "policy" or "tag" not in attack:
        assert "not valid YAML" in str(caught.value) or "cannot be read" in str(caught.value)


@pytest.mark.parametrize("attack", ["bomb", "million", "million lines", "deep", "deeper"])
def test_the_command_line_refuses_it_at_once(attack: str, tmp_path: Path) -> None:
    path = workflow(tmp_path, BASE + "states:\n" + " " + ATTACKS[attack].replace("\n", "\n "))
    status, spoken = run_bounded("check", path)
    assert status == 1, spoken[-2000:]
    assert "Traceback" not in spoken
    assert "not valid YAML" in " ".join(spoken.split())


@pytest.mark.parametrize("attack", ["bomb", "million", "self", "deep", "digits", "beyond a double"])
def test_a_value_of_set_is_bounded_too(
    attack: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    value = ATTACKS[attack]
    told = one_line(capsys, "run", workflow(tmp_path), "--set", f"states={value}")
    assert told.startswith("--set states: ")
    assert len(told) < 500


def test_a_path_of_set_is_bounded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = one_line(capsys, "run", workflow(tmp_path), "--set", "a." * 5000 + "b=1")
    assert "steps" in told


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0100", 100),
        ("0o17", 15),
        ("0x1F", 31),
        ("1:30", "1:30"),
        ("1:30.5", "1:30.5"),
        ("1_000", "1_000"),
        ("0b11", "0b11"),
        ("2020-99-99", "2020-99-99"),
        ("2020-01-01", "2020-01-01"),
        ("yes", "yes"),
        ("no", "no"),
        ("on", "on"),
        ("off", "off"),
        ("<<", "<<"),
        ("=", "="),
        ("1e3", 1000.0),
        ("-.inf", -math.inf),
        ("+12", 12),
        ("0.", 0.0),
        ("18446744073709551615", 2**64 - 1),
        ("Null", None),
        ("''", ""),
        ("'12'", "12"),
        ("!!str 12", "12"),
        ("!!float 12", 12.0),
    ],
)
def test_words_and_numbers_are_those_of_yaml_1_2(text: str, value: Any) -> None:
    assert parse_value(text) == value
    assert type(parse_value(text)) is type(value)


@pytest.mark.parametrize(("rate", "told"), [("1:30", "rate is '1:30'; write"), ("1_0", "'1_0'")])
def test_a_rate_of_yaml_1_1_is_refused(
    rate: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = workflow(tmp_path, BASE.replace("rate: 50", f"rate: {rate}"))
    assert told in one_line(capsys, "run", path)


def test_a_leading_zero_means_nothing(tmp_path: Path) -> None:
    path = workflow(tmp_path, BASE.replace("rate: 50", "rate: 0100"))
    assert load_document(path).values["rate"] == 100


@pytest.mark.parametrize("foreign", [False, True])
def test_files_and_texts_hold_the_same_numbers(foreign: bool, tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("a: 0100\nb: 1:30\nc: no\nd: 2020-99-99\n", "utf-8")
    values = {"a": 100, "b": "1:30", "c": "no", "d": "2020-99-99"}
    assert read_yaml(path, foreign=foreign).value == values
    assert parse_yaml(path.read_text(), "a", foreign=foreign).value == values


def test_a_flow_repeated_by_aliases_is_bounded(tmp_path: Path) -> None:
    parts = ["&a0 {hold: {duration: 0.1}}"]
    parts += [f"&a{i} {{chain: [{', '.join([f'*a{i - 1}'] * 9)}]}}" for i in (1, 2, 3, 4)]
    flow = f"{{chain: [{', '.join(parts)}]}}"
    path = workflow(tmp_path, BASE.replace("{hold: {duration: 0.1}}", flow))
    status, spoken = run_bounded("show", path)
    assert status == 1, spoken[-2000:]
    assert "more than 1000 blocks" in spoken


def test_a_device_is_not_read_to_its_end(tmp_path: Path) -> None:
    with pytest.raises(UniconError, match="not valid YAML"):
        read_yaml(Path("/dev/zero"))

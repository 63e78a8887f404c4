"""The YAML reader: words of YAML 1.2, lines of values, no silent duplicates."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from unicon_base.errors import UniconError, WorkflowError
from unicon_base.located_yaml import Tagged, parse_value, parse_yaml, read_yaml


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("on", "on"),
        ("no", "no"),
        ("y", "y"),
        ("true", True),
        ("False", False),
        ("1e-3", 1e-3),
        ("-2.5E2", -250.0),
        ("+.5", 0.5),
        ("12", 12),
        ("1.", 1.0),
        (".inf", float("inf")),
        ("1.2.3", "1.2.3"),
        ("e3", "e3"),
        ("[0.1, 2]", [0.1, 2]),
        ("~", None),
    ],
)
def test_words_and_numbers_are_those_of_yaml_1_2(text: str, value: Any) -> None:
    assert parse_value(text) == value
    assert type(parse_value(text)) is type(value)


def test_on_is_a_key(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("switch:\n  on: x\n", encoding="utf-8")
    located = read_yaml(path)
    assert located.value == {"switch": {"on": "x"}}
    assert located.where(("switch", "on")) == f"{path}:2"
    assert located.where(("switch", "no such key")) == f"{path}:1"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "a: 1\nb: 2\na: 3\n",
            "3: not valid YAML: key 'a' stands twice, first in line 1; remove one",
        ),
        ("a: [1,\nb: 2\n", "3: not valid YAML: expected ',' or ']', but got"),
        ("? [1]\n: 2\n", "1: not valid YAML: key [1] is neither a word nor a number"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(WorkflowError) as told:
        read_yaml(path, WorkflowError)
    assert str(told.value).startswith(f"{path}:{message}")
    assert "\n" not in str(told.value)


def test_a_tag_of_python_makes_no_object(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("a: !!python/object:os.system {b: 1}\n", encoding="utf-8")
    with pytest.raises(UniconError, match=r"a\.yaml:1: .*python/object:os\.system' is not read"):
        read_yaml(path)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(UniconError, match="cannot be read"):
        read_yaml(tmp_path)


def test_foreign_tags_are_kept_inert_where_they_are_asked_for() -> None:
    text = "a: !!python/tuple [1, 2]\nb: !!python/name:os.system ''\n0.5: !!python/int '3'\n"
    read = parse_yaml(text, "a.yaml", foreign=True)
    assert read.value == {"a": [1, 2], "b": Tagged("name:os.system", ""), 0.5: 3}
    assert read.where(("a", 1)) == "a.yaml:1"
    with pytest.raises(UniconError, match=r"a\.yaml:1: not valid YAML: tag .* is not read"):
        parse_yaml(text, "a.yaml")


def test_what_stands_below_its_key_has_the_keys_line() -> None:
    read = parse_yaml("a:\n  b:\n    - 1\n    - 2\n", "a.yaml")
    places = [(), ("a",), ("a", "b"), ("a", "b", 1), ("a", "none")]
    assert [read.where(place)[7:] for place in places] == ["1", "1", "2", "4", "1"]
    assert str(read.error(("a", "b"), "no")) == "a.yaml:2: no"


def test_nobody_else_reads_yaml() -> None:
    """PyYAML's own readers follow every alias, and read YAML 1.1; writing is anybody's."""
    root = Path(__file__).resolve().parents[2]
    reading = re.compile(r"\byaml\.\w*(?:load|Loader|compose|parse|scan)|from yaml import")
    readers = {
        path.relative_to(root).as_posix()
        for path in root.glob("unicon_*/**/*.py")
        if reading.search(path.read_text("utf-8"))
    }
    assert readers == {"unicon_base/bounded_yaml.py"}

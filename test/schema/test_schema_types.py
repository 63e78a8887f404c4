"""Types of documents: what they read, what they refuse in which words, all mistakes at once."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
import pytest

from unicon_base.errors import UniconError
from unicon_base.located_yaml import parse_yaml
from unicon_base.schema.marks import Key, Like, NotAKey, Point, Quat, Size, Text, Unit, Within
from unicon_base.schema.read import check_made, json_schema, read, read_value, refuse
from unicon_base.schema.records import option_type, type_of
from unicon_base.schema.types import Here, Mistakes


@dataclass(frozen=True)
class Leg:
    """A leg.

    Attributes:
        name: of the leg.
        length: of it.
    """

    name: Text
    length: Annotated[float, Unit("m"), Within(0.0, 2.0, above=True)]


@dataclass(frozen=True)
class Animal:
    """An animal.

    Attributes:
        schema: version.
        kind: what it is.
        legs: those it has, in [m] and
            by name.
    """

    schema: Literal["test.animal/1"]
    kind: Literal["dog", "cat"]
    legs: Annotated[list[Leg], Size(1)]
    age: int | None = None
    eats: Mapping[str, float] = field(default_factory=dict)
    at: Point | Literal["home"] = "home"
    turned: Quat | None = None
    mother: Annotated[str, Key("from")] = ""
    tail: Annotated[Mapping[str, Any], Like(Leg, open=True)] = field(default_factory=dict)
    secret: Annotated[object, NotAKey()] = None

    @staticmethod
    def between(found: dict[str, Any], here: Here) -> None:
        if found.get("kind") == "cat" and len(found.get("legs", ())) > 4:
            here.value("is too many for a cat; write 4", "legs")


GOOD = "schema: test.animal/1\nkind: dog\nlegs: [{name: front, length: 1}]\n"


def animal(text: str) -> Animal:
    return read(Animal, parse_yaml(text, "a.yaml"), "animal file")


def wrong(text: str) -> list[str]:
    with pytest.raises(UniconError) as caught:
        animal(text)
    return [str(each) for each in caught.value.problems or (caught.value,)]


def test_a_document_becomes_an_object() -> None:
    found = animal(
        GOOD + "age: 3\neats: {meat: 1}\nat: [1, 2, 3]\nfrom: mary\nturned: [1, 0, 0, 0]\n"
        "tail: {name: t, length: 0.5, colour: red}\n"
    )
    assert found.legs == [Leg("front", 1.0)]
    assert type(found.legs[0].length) is float
    assert (found.age, found.eats, found.at) == (3, {"meat": 1.0}, (1.0, 2.0, 3.0))
    assert (found.mother, found.turned) == ("mary", (1.0, 0.0, 0.0, 0.0))
    assert found.tail == {"name": "t", "length": 0.5, "colour": "red"}


def test_all_mistakes_are_told_in_the_order_of_lines() -> None:
    assert wrong(
        "schema: test.animal/1\nkind: dogg\nlegs:\n- {name: front, length: 0}\n- {name: '', "
        "lenght: 1}\n- 7\nage: 1.5\neats: {meat: much}\nat: [1, 2]\nturned: [1, 1, 0, 0]\n"
        "secret: 1\ntail: {name: t}\n"
    ) == [
        "a.yaml:2: kind 'dogg' is not known; did you mean 'dog'? known: cat, dog",
        "a.yaml:4: legs.front.length is 0; write a number above 0 to 2 [m]",
        "a.yaml:5: legs.: unknown key 'lenght'; did you mean 'length'? known: length, name",
        "a.yaml:5: legs..name is ''; write a text",
        "a.yaml:6: legs.2 is 7; write a mapping with name, length",
        "a.yaml:7: age is 1.5; write a whole number or null",
        "a.yaml:8: eats.meat is 'much'; write a number",
        "a.yaml:9: at is [1, 2]; write a list of 3, each a number from -10 to 10 [m]",
        "a.yaml:10: turned has length 1.414; write a unit quaternion, w first",
        "a.yaml:11: unknown key 'secret'; known: age, at, eats, from, kind, legs, schema, tail, "
        "turned",
        "a.yaml:12: tail: missing key 'length'; add length: a number above 0 to 2 [m]",
    ]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("kind: true", "kind is true; write dog or cat"),
        ("legs: []", "legs is []; write a list, each a mapping with name, length"),
        ("age: true", "age is true; write a whole number or null"),
        ("eats: {meat: .nan}", "eats.meat is nan; write a number"),
        ("eats: {meat: .inf}", "eats.meat is inf; write a number"),
        ("eats: {3: 1}", "eats: unknown key 3; write a text"),
        ("at: work", "at is 'work'; write a list of 3, each a number from -10 to 10 [m] or home"),
        ("from: 3", "from is 3; write a text"),
    ],
)
def test_each_kind_of_value_is_refused_in_its_words(line: str, said: str) -> None:
    key = line.partition(":")[0]
    kept = [each for each in GOOD.splitlines() if not each.startswith(f"{key}:")]
    (message,) = wrong("\n".join([*kept, line]) + "\n")
    assert message == f"a.yaml:{len(kept) + 1}: {said}"


@pytest.mark.parametrize("sign", [1, -1])
def test_a_number_that_no_float_holds_is_refused(sign: int) -> None:
    """A Python file or JSON can hold it."""
    mistakes = Mistakes({})
    type_of(float).read(sign * 10**400, ("weight",), mistakes)
    with pytest.raises(UniconError, match=r"weight is .*write a number"):
        refuse(mistakes, lambda where, text: UniconError(text), "file")


def test_another_version_is_told_alone() -> None:
    assert wrong("schema: test.animal/2\nlegs: 3\n") == [
        "a.yaml:1: schema is 'test.animal/2'; write test.animal/1"
    ]
    assert wrong("- 1\n") == [
        "a.yaml:1: a animal file is a mapping; begin with `schema: test.animal/1`"
    ]


def test_a_rule_between_fields_sees_those_that_are_right() -> None:
    legs = ", ".join(f"{{name: l{i}, length: 1}}" for i in range(5))
    (message,) = wrong(f"schema: test.animal/1\nkind: cat\nlegs: [{legs}]\n")
    assert message == "a.yaml:3: legs is too many for a cat; write 4"
    assert len(wrong(f"schema: test.animal/1\nkind: cta\nlegs: [{legs}]\n")) == 1


def test_values_of_python_are_read_too() -> None:
    error = UniconError

    def as_error(where: Any, text: str) -> UniconError:
        return error(text)

    assert read_value(Point, np.zeros(3), as_error, "point") == (0.0, 0.0, 0.0)
    assert read_value(float, np.float32(0.5), as_error, "number") == 0.5
    with pytest.raises(UniconError, match="write a number"):
        read_value(float, np.zeros(2), as_error, "number")
    with pytest.raises(UniconError, match=r"leg\.length is -1; write a number above 0 to 2 \[m\]"):
        check_made(Leg("front", -1), UniconError, "leg")


def test_options_of_a_function_are_typed_where_a_file_can_say_them() -> None:
    def factory(a: int, b: Annotated[float, Within(0.0)], c: object, d: np.ndarray) -> None: ...

    said = {name for name in "abcd" if option_type(factory, name) is not None}
    assert said == {"a", "b", "c"}
    assert option_type(factory, "e") is None


def test_json_schema_has_bounds_texts_and_required_keys() -> None:
    schema = json_schema(Animal)
    definition = schema["$defs"]["Animal"]
    assert definition["required"] == ["schema", "kind", "legs"]
    assert definition["properties"]["legs"]["description"] == "those it has, in [m] and by name."
    assert schema["$defs"]["Leg"]["properties"]["length"] == {
        "type": "number", "exclusiveMinimum": 0.0, "maximum": 2.0, "description": "of it."
    }  # fmt: skip
    assert "secret" not in definition["properties"]
    assert math.isfinite(len(definition["properties"]))

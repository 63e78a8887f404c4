"""Whatever stands in a policy file, the answer is a contract or a clear line for each mistake."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from policy_helpers import JOINTS, robot, toy_values, write_linear
from test_deploy_yaml import DEPLOY, MOTORS
from test_training_configs import ENV, GYM

from unicon_base.errors import PolicyError, UniconError
from unicon_base.located_yaml import Tagged, read_yaml
from unicon_core.policies import load_policy

JUNK: list[Any] = [None, "x", -1, float("nan"), [], [[1, 2]], ["x"], {"x": 1}]


def places(tree: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield path
    if isinstance(tree, (dict, list)):
        children = tree.items() if isinstance(tree, dict) else enumerate(tree)
        for key, value in children:
            yield from places(value, (*path, key))


def replaced(tree: Any, path: tuple[Any, ...], value: Any) -> Any:
    if not path:
        return value
    result = copy.deepcopy(tree)
    place = result
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return result


def plain(value: Any) -> Any:
    """A document with foreign tags as plain values, so that it can be written again."""
    if isinstance(value, Tagged):
        return plain(value.value)
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    return [plain(item) for item in value] if isinstance(value, list) else value


def full() -> dict[str, Any]:
    values = toy_values(
        inputs={"observation": "obs"},
        outputs={"action": "actions"},
        command_ranges={"lin_vel_x": [-1, 1]},
        phase={"period": 1.0, "offsets": [0.0], "stand": 3.1, "stand_below": 0.1},
        recurrent=[{"input": "h", "output": "g"}],
        action={"scale": 0.2, "offset": 0.1, "clip": [-1, [1, 2, 3, 4]], "joints": list(JOINTS)},
    )
    values["observation"]["terms"][0] |= {"index": [0, 1], "clip": [-1, 1], "history": 2}
    return values


def document(tmp_path: Path, text: str) -> Any:
    path = tmp_path / "source.yaml"
    path.write_text(text, "utf-8")
    return plain(read_yaml(path, foreign=True).value)


@pytest.mark.parametrize("source", ["policy", "deploy", "env", "gym"])
@pytest.mark.parametrize("each", [2, pytest.param(len(JUNK), marks=pytest.mark.slow)])
def test_junk_anywhere_gives_a_contract_or_clear_lines(
    tmp_path: Path, source: str, each: int
) -> None:
    values, given, machine = {
        "policy": (full(), {}, robot()),
        "deploy": (document(tmp_path, DEPLOY), {}, robot(MOTORS)),
        "env": (document(tmp_path, ENV), {"joints": list(JOINTS)}, robot()),
        "gym": (document(tmp_path, GYM), {"joints": list(JOINTS)}, robot()),
    }[source]
    folder = tmp_path / "policy"
    write_linear(folder / "policy.onnx", 15, 4)
    path = folder / f"{source}.yaml"
    tried = 0
    messages: list[UniconError] = []
    for i, place in enumerate(places(values)):
        for k in range(each):
            junk = JUNK[(i + k * (len(JUNK) // each)) % len(JUNK)]
            path.write_text(yaml.safe_dump(replaced(values, place, junk)), "utf-8")
            tried += 1
            try:
                load_policy(path, robot=machine, given=given)
            except PolicyError as error:
                messages += error.problems or [error]
    texts = list(map(str, messages))
    assert len(texts) > tried / 4
    assert [text for text in texts if "\n" in text or not text.startswith(str(folder))] == []

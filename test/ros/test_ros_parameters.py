"""Parameters of the node: numbers and lists that are taken, and what is refused when it is set."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from unicon_base.errors import UniconError
from unicon_ros.parameters import Parameters, Tuning

pytestmark = pytest.mark.ros


@pytest.fixture
def declared() -> Iterator[Callable[..., tuple[Any, Parameters]]]:
    """Declares the parameters on a node that was given some: node and parameters."""
    made: list[tuple[Any, Context]] = []

    def declare(*given: str) -> tuple[Any, Parameters]:
        context = Context()
        arguments = ["--ros-args", *(part for text in given for part in ("-p", text))]
        rclpy.init(args=arguments, context=context, signal_handler_options=SignalHandlerOptions.NO)
        node = rclpy.create_node("parameters", context=context)
        made.append((node, context))
        return node, Parameters(node, Tuning())

    yield declare
    for node, context in made:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def test_integers_are_numbers_and_a_list_may_be_empty(declared: Any) -> None:
    node, settings = declared("rate:=100", "max_vx:=1", "overrides:=[]", "force:=['']")
    assert settings["rate"] == 100.0
    assert type(settings["rate"]) is float
    assert settings["max_vx"] == 1.0
    assert settings.overrides == ["rate=100.0"]
    assert settings.force == []
    result = node.set_parameters(
        [
            Parameter("rate", value=50),
            Parameter("overrides", Parameter.Type.BOOL_ARRAY, []),
            Parameter("force", Parameter.Type.STRING_ARRAY, []),
        ]
    )
    assert [(each.successful, each.reason) for each in result] == [(True, "")] * 3
    assert node.get_parameter("rate").type_ == Parameter.Type.DOUBLE
    assert node.get_parameter("overrides").type_ == Parameter.Type.STRING_ARRAY
    assert settings.overrides == ["rate=50.0"]
    (refused,) = node.set_parameters([Parameter("rate", value=20_000)])
    assert not refused.successful
    assert "rate" in refused.reason


def test_a_parameter_file_may_hold_integers_and_empty_lists(declared: Any, tmp_path: Path) -> None:
    path = tmp_path / "parameters.yaml"
    path.write_text("/**:\n  ros__parameters: {rate: 20, overrides: [], max_wz: 1}\n")
    context = Context()
    rclpy.init(args=["--ros-args", "--params-file", str(path)], context=context)
    node = rclpy.create_node("parameters", context=context)
    settings = Parameters(node, Tuning())
    found = settings["rate"], settings["max_wz"], settings.overrides
    node.destroy_node()
    rclpy.try_shutdown(context=context)
    assert found == (20.0, 1.0, ["rate=20.0"])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("rate:=fast", "parameter rate is 'fast'; give a number"),
        ("rate:=true", "parameter rate is True; give a number"),
        ("autostart:=1", "parameter autostart is 1; give true or false"),
        ("workflow:=[a, b]", "parameter workflow is ['a', 'b']; give a text"),
        ("overrides:=rate=3", "parameter overrides is 'rate=3'; give a list of texts"),
        ("overrides:=[1, 2]", "parameter overrides is [1, 2]; give a list of texts"),
    ],
)
def test_another_type_is_refused_at_start(declared: Any, given: str, said: str) -> None:
    with pytest.raises(UniconError) as error:
        declared(given)
    assert str(error.value).replace("array('q', [1, 2])", "[1, 2]") == said


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        (
            "workflow",
            "go2_stnd",
            "workflow: unknown workflow 'go2_stnd'; did you mean 'go2_stand'?",
        ),
        ("workflow", "/nowhere.yaml", "workflow: no file /nowhere.yaml"),
        ("map", "nope", "map: unknown map 'nope'"),
        ("robot", "go3", "robot: unknown robot 'go3'"),
        ("platform", "mujoc", "platform: unknown platform 'mujoc'; did you mean 'mujoco'?"),
        ("overrides", ["rate=5", "rate"], "overrides: --set 'rate' has no '='"),
        ("force", ["nope"], "force: no finding has the code 'nope'"),
        ("frame_prefix", "/a/", "frame_prefix: frame prefix '/a/': tf2 takes no frames"),
        ("record_split", "1XB", "record_split: a recording cannot be split at '1XB'"),
        ("speed", "fast", "speed is one of real, max, not 'fast'"),
        ("max_vx", float("nan"), "max_vx"),
    ],
)
def test_what_can_be_known_is_refused_when_it_is_set(
    declared: Any, name: str, value: Any, said: str
) -> None:
    node, settings = declared()
    before = settings[name]
    result = node.set_parameters_atomically([Parameter(name, value=value)])
    assert not result.successful
    assert said in result.reason
    assert settings[name] == before


def test_what_is_good_may_be_set_and_nothing_removed(declared: Any) -> None:
    node, settings = declared()
    for name, value in {
        "workflow": "go2_stand",
        "map": "default",
        "robot": "go1",
        "platform": "fake",
        "overrides": ["rate=5"],
        "force": ["graph"],
        "frame_prefix": "a/",
        "record_split": "60s",
        "speed": "max",
    }.items():
        result = node.set_parameters_atomically([Parameter(name, value=value)])
        assert result.successful, (name, result.reason)
    (removed,) = node.set_parameters([Parameter("workflow", Parameter.Type.NOT_SET)])
    assert not removed.successful
    assert settings["workflow"] == "go2_stand"


def test_parameters_that_the_node_does_not_have_are_told(declared: Any) -> None:
    _, settings = declared("workflw:=go2_stand", "use_sim_time:=true", "rate:=5")
    (line,) = settings.unknown
    assert line.startswith("no parameter 'workflw'; did you mean 'workflow'? known: autostart, ")

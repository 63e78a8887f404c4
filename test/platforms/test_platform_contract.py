"""A platform from outside: recv, send and close are enough, and what lacks is told in one line."""

from __future__ import annotations

import pytest

from unicon_base.errors import UniconError
from unicon_core.check import check_workflow
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow

DRIVER = """
from unicon_core.platforms.platform import Facts, Platform

POSE = 4 * (0.0, 0.8, -1.5)  # hip, thigh, calf


class Robot:
    {facts}

    def __init__(self, states, options=None):
        self.states, self.options, self.sent = states, options, 0

    def recv(self):
        self.states.joint_pos[...] = POSE

    def send(self):
        self.sent += 1

    def {close}(self):
        self.closed = True


def make(states, robot, period) -> Platform:
    return Robot(states)


def made(states, robot, period, **options) -> Robot:
    return Robot(states, options)




def nothing(states, robot, period) -> Platform:
    return None
"""

WORKFLOW = """\
robot: go2
platform: my_robot.driver:make
rate: 50
duration: 0.1
start: none
flow: hold
"""


@pytest.fixture
def path(tmp_path):
    """A workflow of somebody's own robot."""
    file = tmp_path / "theirs.yaml"
    file.write_text(WORKFLOW, encoding="utf-8")
    return file


def driver(folder, patch, facts="pass", close="close"):
    """Write the package `my_robot`, never imported before."""
    import sys

    (folder / "my_robot").mkdir(exist_ok=True)
    (folder / "my_robot" / "__init__.py").write_text("", encoding="utf-8")
    text = DRIVER.format(facts=facts, close=close)
    (folder / "my_robot" / "driver.py").write_text(text, encoding="utf-8")
    patch.syspath_prepend(str(folder))
    for name in ("my_robot", "my_robot.driver"):
        patch.delitem(sys.modules, name, raising=False)


def test_recv_send_and_close_are_enough(path, tmp_path, monkeypatch):
    driver(tmp_path, monkeypatch)
    assert check_workflow(path).clean
    workflow = load_workflow(path)
    facts = workflow.platform.facts
    assert (facts.name, facts.simulated) == ("my_robot.driver:make", False)
    report = Runner(workflow, RunOptions()).run()
    assert report.faults == []
    assert report.ticks == 5
    assert workflow.platform.sent == 5 + 25  # type: ignore[attr-defined]  # 0.5 s of damping
    assert workflow.platform.closed  # type: ignore[attr-defined]


def test_what_it_does_not_declare_is_not_there(path, tmp_path, monkeypatch):
    driver(tmp_path, monkeypatch)
    with pytest.raises(UniconError, match="reads 'projected_gravity', which no block writes"):
        load_workflow(path, ["safety=[finite, tilt_stop]"])
    driver(tmp_path, monkeypatch, 'facts = Facts(writes=("joint_pos", "projected_gravity"))')
    workflow = load_workflow(path, ["safety=[finite, tilt_stop]", "platform=my_robot.driver:made"])
    assert workflow.platform.facts.name == "my_robot.driver:made"
    workflow.close()


def test_open_options_are_handed_over(path, tmp_path, monkeypatch):
    driver(tmp_path, monkeypatch)
    name = "my_robot.driver:made"
    options = {"port": "can0", "slow": True}
    workflow = load_workflow(path, {"platform": name, "platforms": {name: options}})
    assert workflow.platform.options == options  # type: ignore[attr-defined]
    workflow.close()


@pytest.mark.parametrize(
    ("factory", "facts", "close", "message"),
    [
        (
            "make",
            "pass",
            "stop",
            "platform 'my_robot.driver:make': what its factory returned, a Robot, has no close; "
            "a platform has recv(), send() and close()",
        ),
        (
            "nothing",
            "pass",
            "close",
            "platform 'my_robot.driver:nothing': what its factory returned, a NoneType, has no "
            "recv and no send and no close; a platform has recv(), send() and close()",
        ),
        (
            "make",
            "facts = 5",
            "close",
            "platform 'my_robot.driver:make': what its factory returned, a Robot, has facts of "
            "type int; give it facts = Facts(…) of unicon_core.platforms.platform",
        ),
        (
            "make",
            '__slots__ = ("states", "options", "sent", "closed")',
            "close",
            "platform 'my_robot.driver:make': what its factory returned, a Robot, has facts of "
            "type NoneType; give it facts = Facts(…) of unicon_core.platforms.platform",
        ),
        (
            "made",
            'facts = Facts("mine", writes=("joint_poss",))',
            "close",
            "platform 'mine': what its factory returned, a Robot, writes 'joint_poss', which is "
            "not a state; did you mean 'joint_pos'? known: ",
        ),
        (
            "make",
            'facts = Facts("mine", simulated=True)',
            "close",
            "platform 'my_robot.driver:make': what its factory returned, a Robot, says "
            "simulated=True and the factory False; say it once, in `facts` of the class, and "
            "annotate the factory with that class (-> Class)",
        ),
    ],
)
def test_what_lacks_is_told(factory, facts, close, message, path, tmp_path, monkeypatch):
    driver(tmp_path, monkeypatch, facts, close)
    with pytest.raises(UniconError) as error:
        load_workflow(path, {"platform": f"my_robot.driver:{factory}"})
    assert str(error.value).startswith(message)
    assert "\n" not in str(error.value)

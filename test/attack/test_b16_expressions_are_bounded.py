"""B16: what an expression costs is bounded by its length, and its mistakes have one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from attack_files import BASE, one_line, run_bounded, workflow

from unicon_base.errors import WorkflowError
from unicon_core.states import States, standard_states
from unicon_core.workflow.uses import expression

STATES = States(standard_states(("a", "b")))


def of(text: str) -> bool:
    return bool(expression(text, STATES).tick())


@pytest.mark.parametrize(
    "text",
    [
        "9**9**9",
        "9**9**9 > tick",
        "(9**8)**8",
        "tick ** tick",
        "tick ** -1",
        "2 ** 99999999",
        "not " * 1000 + "tick",
        "not " * 200 + "tick",
        "-" * 100000 + "1",
        "(" * 300 + "1" + ")" * 300,
        "tick" + "[0]" * 300,
        "tick" + " + tick" * 300,
        "9" * 5000,
        "9" * 500,
        "1e999",
        "1j",
        "'x' * 999999999",
        "[0] * 999999999",
        "joint_pos[9]",
        "joint_pos[0.5]",
        "joint_pos[tick]",
        "joint_pos[0:1]",
        "joint_pos[0, 1]",
        "1[0]",
        "(1)(2)",
        "max(tick, key=abs)",
        "max(*joint_pos)",
        "max()",
        "tick > 100 and joint_pos[7] > 1",
        "tick > 100 and joint_pos > 1",
        "tick >= 0 or 1 / 0",
        "lambda: 0",
        "tick if tick else tick",
        "(tick := 5)",
        "f'{tick}'",
        "tick.__class__",
        "\x00",
        "",
        "tick\n",
        "\ud800",
    ],
    ids=lambda text: repr(text[:24]),
)
def test_what_costs_too_much_or_means_nothing_is_refused(text: str) -> None:
    if text == "tick\n":
        assert of(text) is False
        return
    with pytest.raises(WorkflowError) as caught:
        expression(text, STATES)
    assert len(str(caught.value)) < 1000
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text", ["9**9**9", "not " * 3000 + "tick", "-" * 100000 + "1"], ids=("power", "not", "minus")
)
@pytest.mark.parametrize("command", ["check", "run"])
def test_the_command_line_refuses_it_at_once(command: str, text: str, tmp_path: Path) -> None:
    path = workflow(
        tmp_path,
        BASE.replace("{hold: {duration: 0.1}}", f'\n  loop: {{do: hold, until: "{text}"}}'),
    )
    status, spoken = run_bounded(command, path)
    assert status == 1, spoken[-2000:]
    assert "Traceback" not in spoken
    assert "expression " in " ".join(spoken.split())


def test_an_expression_that_would_fail_later_is_refused_now(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = "tick > 100 and base_pos_w[9] > 0"
    path = workflow(
        tmp_path,
        BASE.replace("{hold: {duration: 0.1}}", f'\n  loop: {{do: hold, until: "{text}"}}'),
    )
    assert "out of bounds" in one_line(capsys, "run", path)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("tick == 0", True),
        ("tick > 100 and joint_pos[1] < 0.2", False),
        ("abs(base_quat[0]) ** 2 > 0.5", True),
        ("max(joint_pos) <= 0 and min(joint_pos) >= -0.0", True),
        ("any(joint_pos) or not tick", True),
        ("-1 < joint_pos[-1] < 1", True),
        ("all(joint_pos)", False),
        ("tick % 5 == 0", True),
        ("True", True),
    ],
)
def test_ordinary_expressions_mean_what_they_did(text: str, value: bool) -> None:
    assert of(text) is value
